"""Power cuts of a flight: at chosen instants, in all ways, without ending the flight. The study runs hundreds of them."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

from daq.recorder.storage import RealFile, StorageFile
from tests.chain.card.flight import CardFlight, Slowness
from tests.chain.card.forgetting import CUTS, Cut
from tests.chain.card.judge import Left, judge
from tests.chain.card.mounted import MountedCard

FLIGHT = "flight"
ONE_SECOND = 20
"""Scans in a second."""


@dataclass(frozen=True, slots=True)
class Case:
    """One cut and what it left. directory: the survivors, as a new session finds them. head: where the flight's folder is."""

    cut: Cut
    at_s: float
    left: Left
    directory: Path


def cut_flight(
    card: MountedCard,
    scratch: Path,
    instants_s: Iterable[float],
    *,
    slowness: Slowness,
    recorder: dict[str, object] | None = None,
    cuts: tuple[Cut, ...] = CUTS,
    make: Callable[[Path], StorageFile] = RealFile,
) -> list[Case]:
    """Fly on the card, cut the power at every instant in every way, and judge what each has left."""
    flight = CardFlight(card.path / FLIGHT, slowness=slowness, recorder=recorder, make=make)
    found: list[tuple[Cut, float, int, Path]] = []
    instants = sorted(instants_s)

    def look(number: int, at_s: float, taken: int) -> None:
        for kind, cut in enumerate(cuts):
            into = card.survivors(cut, scratch / f"cut_{number}_{kind}", seed=number)
            found.append((cut, at_s, taken, into))

    for number, at_s in enumerate(instants):
        flight.at(at_s, lambda taken, number=number, at_s=at_s: look(number, at_s, taken))  # type: ignore[misc]
    flight.fly(max(instants) + 1.0)
    session = flight.directory.relative_to(card.path)
    return [
        Case(cut, at_s, judge(into / session, flight.truth, taken, into / "recovered.mcap"), into)
        for cut, at_s, taken, into in found
    ]


def next_session(directory: Path, seconds: float = 1.0) -> list[str]:
    """Start the logger again on what a cut has left; what is wrong with its recording, in words."""
    flight = CardFlight(directory / FLIGHT)
    books = flight.fly(seconds)
    left = judge(flight.directory, flight.truth, flight.taken, directory / "next.mcap")
    wrong = list(left.wrong)
    if left.lost or not books.closes or books.written != flight.taken:
        wrong.append(f"the next session lost {left.lost} of {flight.taken} scans")
    return wrong
