"""The plug is pulled at random instants, again and again with one card: what is lost, what is left, is the next start well."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tests.rig.bench import Bench
from tests.rig.judge import Session, judge, mounted, sessions
from tests.rig.machine import Image, Machine
from tests.rig.page import PAGE, make_card
from tests.rig.trials import UP_LIMIT_S, Power

WHILE_STARTING = 0.2
"""Share of cuts at any instant of the start; the others come while scans are recorded."""
STARTING_S, RECORDING_S = 100.0, 20.0
CARD_MB = 256


@dataclass(frozen=True, slots=True)
class Cut:
    """One cut. after_s: since the power came. session: what it left of the session under way, None when there was none."""

    starting: bool
    after_s: float
    cut_s: float
    session: Session | None
    wrong: tuple[str, ...]

    @property
    def lost_s(self) -> float | None:
        """From the last scan on the card to the cut [s]."""
        if self.session is None or self.session.last_s is None:
            return None
        return self.cut_s - self.session.last_s


def pull_plugs(
    image: Image, folder: Path, count: int, rng: np.random.Generator, note: Callable[[str, bool, str, float], None]
) -> list[Cut]:
    """`count` cuts with one card; `note` is told about each."""
    card = make_card(PAGE, folder / "card.img", CARD_MB)
    before: dict[str, str] = {}
    cuts = []
    with Bench(folder) as bench:
        for number in range(count):
            starting = bool(rng.random() < WHILE_STARTING)
            share = float(rng.random())
            began = time.monotonic()
            after_s = _cut_once(image, folder, card, bench, starting, share)
            cut_s = time.monotonic()
            with mounted(card) as root:
                now = sessions(root)
                new = sorted(now.keys() - before.keys())
                ends = [None] * (len(new) - 1) + [cut_s]
                found = [judge(root / "recordings" / n, bench.readings, end) for n, end in zip(new, ends, strict=False)]
            wrong = [f"{s.name}: {w}" for s in found for w in s.wrong]
            wrong += [f"session {name} is no longer what it was" for name in before if before[name] != now.get(name)]
            if not starting and not any(s.scans for s in found):
                wrong.append("scans were taken, but none is on the card")
            cut = Cut(starting, after_s, cut_s, found[-1] if found else None, tuple(wrong))
            note(f"cut {number + 1}", not wrong, _words(cut), time.monotonic() - began)
            cuts.append(cut)
            before = now
            bench.readings.clear()
            bench.power_cycle()
    return cuts


def _cut_once(image: Image, folder: Path, card: Path, bench: Bench, starting: bool, share: float) -> float:
    """Switch on, wait for the instant, pull the plug; the seconds between."""
    with Machine(image, folder, card, lean=True) as machine:
        if starting:
            time.sleep(share * STARTING_S)
        else:
            machine.wait_for_agent()
            machine.wait_until("systemctl -q is-active sideslip", UP_LIMIT_S)
            Power(machine, bench).wait_for_scans(2)
            time.sleep(share * RECORDING_S)
        return time.monotonic() - machine.started


def _words(cut: Cut) -> str:
    when = f"{cut.after_s:.0f} s after power-on{', while starting' if cut.starting else ''}"
    if cut.wrong:
        return f"{when}: {'; '.join(cut.wrong)}"
    if cut.session is None:
        return f"{when}: no session yet"
    if cut.lost_s is None:
        return f"{when}: {cut.session.scans} scans"
    s = cut.session
    return f"{when}: {s.scans} scans, {s.readings_lost} lost; the last is {cut.lost_s:.2f} s older than the cut"


def table_of(cuts: Sequence[Cut]) -> str:
    """The cuts in a few lines of a table."""
    lost = sorted(c.lost_s for c in cuts if c.lost_s is not None)
    scans = sorted(c.session.readings_lost for c in cuts if c.session is not None and c.lost_s is not None)
    rows = [
        ("cuts", f"{len(cuts)}, of them {sum(c.starting for c in cuts)} while starting"),
        ("with something wrong", str(sum(bool(c.wrong) for c in cuts))),
        ("sessions with scans", str(len(lost))),
    ]
    if lost:
        rows += [
            ("time lost, median and largest", f"{lost[len(lost) // 2]:.2f} s, {lost[-1]:.2f} s"),
            ("scans lost, median and largest", f"{scans[len(scans) // 2]}, {scans[-1]}"),
        ]
    return "\n".join(["| | |", "|---|---|", *(f"| {name} | {value} |" for name, value in rows)])
