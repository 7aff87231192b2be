"""Fits that begin or end badly: stiff, unstable, in wrong units, unexcited. Each has to end in a sentence.

    python -m tests.studies.hard_starts [FIRST LAST]

Start k is kind k mod 10 of a drawn aeroplane (`tests.studies.random_aeroplanes`) by ml, fem or ls in turn. Right: a refusal of
one sentence (`UserError`), or a verdict with a sentence; wrong: any other exception, a warning, or a recommendation with a
derivative more than 3 corrected bounds from truth. The count is kept in docs/validation.md.
"""

import sys
import warnings
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from daq.utilities.errors import UserError
from estimation.aircraft import Aircraft
from estimation.models import load_model
from estimation.session import runner
from groundstation.flight import Flight
from tests.studies import random_aeroplanes as own

ALL = 200
METHODS = (("ml",), ("fem",), ("ls",), ("ml", "fem"), ("ml", "ls"))
WRONG = 3.0


@dataclass(frozen=True)
class Start:
    """A flight, what the aircraft file says, and starts by parameter."""

    flight: Flight
    aircraft: Aircraft
    starts: Mapping[str, float]


Spoil = Callable[[Start, np.random.Generator], Start]


def _columns(start: Start, **columns: np.ndarray) -> Start:
    return replace(start, flight=start.flight.with_columns(**columns))


def _scaled(name: str, factor: float) -> Spoil:
    return lambda start, rng: _columns(start, **{name: factor * start.flight[name]})


def _stiff(start: Start, rng: np.random.Generator) -> Start:
    """Inertias a hundredth to a hundred-thousandth of what they are: modes of thousands of rad/s."""
    share = 10.0 ** rng.uniform(-5, -2)
    a = start.aircraft
    return replace(
        start, aircraft=replace(a, Ixx=a.Ixx * share, Iyy=a.Iyy * share, Izz=a.Izz * share, Ixz=a.Ixz * share)
    )


def _unstable(start: Start, rng: np.random.Generator) -> Start:
    """Starts of a motion that runs away within a sample or two."""
    return replace(start, starts={"Cl_p": 50.0 * rng.uniform(0.5, 2), "Cn_r": 20.0, "Cn_beta": -5.0})


def _huge(start: Start, rng: np.random.Generator) -> Start:
    return replace(start, starts=dict.fromkeys(own.MAIN, 10.0 ** rng.uniform(3, 12)))


def _unexcited(start: Start, rng: np.random.Generator) -> Start:
    """Controls and motion at rest, with their noise or without."""
    size = float(rng.choice([0.0, 1e-9, 1e-3]))
    names = ("p", "r", "beta", "phi", "ay", "delta_a", "delta_r")
    return _columns(start, **{n: size * rng.standard_normal(len(start.flight)) for n in names})


def _holes(start: Start, rng: np.random.Generator) -> Start:
    """Nine of ten samples of every output missing, at random."""
    missing = rng.uniform(size=len(start.flight)) < 0.9
    return _columns(start, **{n: np.where(missing, np.nan, start.flight[n]) for n in ("p", "r", "beta", "phi", "ay")})


def _short(start: Start, rng: np.random.Generator) -> Start:
    return replace(start, flight=start.flight.part(slice(0, int(rng.integers(8, 40)))))


def _spikes(start: Start, rng: np.random.Generator) -> Start:
    """Infinities and numbers of 1e30 here and there."""
    p = start.flight["p"].copy()
    p[rng.integers(0, p.size, 12)] = rng.choice([np.inf, -np.inf, 1e30, 1e300], 12)
    return _columns(start, p=p)


KINDS: Mapping[str, Spoil] = {
    "stiff": _stiff,
    "unstable": _unstable,
    "huge starts": _huge,
    "unexcited": _unexcited,
    "degrees": _scaled("beta", 57.3),
    "rates in deg/s": _scaled("p", 57.3),
    "V in mm/s": _scaled("V", 1000.0),
    "holes": _holes,
    "short": _short,
    "spikes": _spikes,
}


def start_of(number: int) -> tuple[str, Start, Mapping[str, float]]:
    """Kind, start and truth of one of them."""
    rng = np.random.default_rng([81, number])
    craft = own.Aeroplane.drawn(rng)
    (flight,) = own.fly(craft, own.Situation("plain"), rng, 1, 14.0)
    kind = list(KINDS)[number % len(KINDS)]
    aircraft = Aircraft("drawn", craft.span, craft.area, craft.chord, craft.mass, *craft.inertia)
    return kind, KINDS[kind](Start(flight, aircraft, {}), rng), craft.derivatives


def ending(number: int) -> tuple[str, str]:
    """(kind, how it ended): refused, none, recommended, or what is wrong."""
    kind, start, truth = start_of(number)
    model = load_model("lateral", start.aircraft).with_starts(start.starts)
    try:
        with warnings.catch_warnings(record=True) as warned:
            warnings.simplefilter("always")
            methods = METHODS[number // len(KINDS) % len(METHODS)]
            session = runner.estimate(model, [start.flight], start.aircraft, methods)
    except UserError as error:
        return kind, "refused" if str(error) and "\n" not in str(error) else f"WRONG: {error!r}"
    except Exception as error:  # noqa: BLE001 - the study counts them
        return kind, f"WRONG: {type(error).__name__}: {error}"
    if warned:
        return kind, f"WRONG: warns {warned[0].message} in {warned[0].filename}:{warned[0].lineno}"
    (answer,) = session.flights
    assert answer.verdict is not None
    chosen = answer.verdict.recommended
    if not chosen.why:
        return kind, "WRONG: no sentence"
    if chosen.method == "none":
        return kind, "none"
    shown = answer.results[chosen.method].parameters
    misses = [abs(shown[n].estimate - truth[n]) / shown[n].std_coloured for n in own.MAIN if shown[n].identifiable]
    return kind, f"WRONG: recommended, {max(misses):.1f} bounds" if max(misses, default=0.0) > WRONG else "recommended"


def main(first: int, last: int) -> None:
    """Run the starts of a range, and print the table over them."""
    endings: Counter[tuple[str, str]] = Counter()
    for k in range(first, last):
        kind, text = ending(k)
        endings[kind, text.partition(":")[0]] += 1
        print(k, kind, text[:200], flush=True)
    print("| kind | starts | refused | none | recommended, right | wrong |\n|---|---|---|---|---|---|")
    for kind in KINDS:
        counts = [endings[kind, t] for t in ("refused", "none", "recommended", "WRONG")]
        print("|", " | ".join(map(str, (kind, sum(counts), *counts))), "|")


if __name__ == "__main__":
    main(*(map(int, sys.argv[1:3]) if len(sys.argv) > 2 else (0, ALL)))
