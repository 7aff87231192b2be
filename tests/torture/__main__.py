"""`make torture MINUTES=60`: fuzz, kills, full disks, two at once, soak, in shares of the minutes given; prints the table of
docs/threat-model.md. Not part of `make test`."""

import argparse
import datetime as dt
import random
import subprocess
import sys
import time
from collections.abc import Callable
from itertools import combinations_with_replacement

from tests.torture.soak import soak
from tests.torture.trials import VERBS, Tally, full, ground_killed, killed, two

FUZZ_A_MINUTE = 250  # cases, on an idle core
SOAK_PACE = 5.0  # simulated seconds a second


def main() -> int:
    """Everything, as long as there is time; 1 where anything was found."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    rng = random.Random(given.seed)
    share = given.minutes * 60.0 / 6.0
    rows = {
        "killed": _by_verb(killed, share, rng),
        "disk full": _by_verb(full, share, rng),
        "two at once": _pairs(share, rng),
        "ground killed": ground_killed(max(2, round(share / 6.0)), rng),
    }
    today = dt.datetime.now(tz=dt.UTC).date()
    print(f"\n`make torture MINUTES={given.minutes:g}`, seed {given.seed}, {today}\n")
    print("| what | trials | faults | slowest [s] |\n|---|---|---|---|")
    for name, tally in rows.items():
        print(f"| {name} | {tally.trials} | {len(tally.faults)} | {tally.slowest_s:.1f} |")
    found = soak(share * SOAK_PACE, given.seed)
    print(
        f"| soak, {found.seconds:.0f} s simulated: {found.scans} scans | 1 | {found.lost} lost | {found.grown / 1e6:+.1f} MB |"
    )
    for tally in rows.values():
        for fault in tally.faults[:20]:
            print(f"  {fault}")
    cases = max(100, round(FUZZ_A_MINUTE * share / 60.0))
    fuzz = subprocess.run(
        [sys.executable, "-m", "tests.unit.fuzz.study", "--cases", str(cases), "--seed", str(given.seed)], check=False
    )
    return 1 if any(t.faults for t in rows.values()) or found.lost or fuzz.returncode else 0


def _by_verb(trial: Callable[[str, int, random.Random], Tally], seconds: float, rng: random.Random) -> Tally:
    """One trial of each verb after the other, until the time is over; each verb at least once."""
    until, whole, first = time.monotonic() + seconds, Tally(), True
    while first or time.monotonic() < until:
        for verb in VERBS:
            if not first and time.monotonic() > until:
                break
            if first and verb == "gap" and seconds < 300.0:
                continue  # a minute of processor each
            _add(whole, trial(verb, 1, rng))
        first = False
    return whole


def _pairs(seconds: float, rng: random.Random) -> Tally:
    until, whole = time.monotonic() + seconds, Tally()
    pairs = list(combinations_with_replacement(VERBS, 2))
    rng.shuffle(pairs)
    for one, other in pairs:
        if time.monotonic() > until:
            break
        _add(whole, two(one, other))
    return whole


def _add(whole: Tally, part: Tally) -> None:
    whole.trials += part.trials
    whole.faults += part.faults
    whole.slowest_s = max(whole.slowest_s, part.slowest_s)


if __name__ == "__main__":
    sys.exit(main())
