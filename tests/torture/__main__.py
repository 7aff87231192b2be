"""`make torture MINUTES=60`: fuzz, kills, full disks, two at once, soak, in shares of the minutes given; prints the table of
docs/threat-model.md. `--part` runs some of them, `--times` as often as is said, whatever that takes. Not part of `make test`."""

import argparse
import datetime as dt
import random
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from itertools import combinations_with_replacement

from tests.torture.soak import soak
from tests.torture.trials import VERBS, Tally, full, ground_killed, killed, two

PARTS = ("killed", "full", "two", "ground", "soak", "fuzz")
FUZZ_A_MINUTE = 250  # cases, on an idle core
SOAK_PACE = 5.0  # simulated seconds a second
A_GROUND_S = 6.0  # seconds that one killed ground station takes
SLOW_VERBS = ("gap",)  # a minute of processor each: left out where time is short


def main() -> int:
    """Everything, as long as there is time; 1 where anything was found."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--part", action="append", choices=PARTS, help="only this; may be repeated")
    parser.add_argument("--verb", action="append", choices=list(VERBS), help="only this; may be repeated")
    parser.add_argument("--times", type=int, help="trials of each verb, pairs, or ground stations, in place of minutes")
    given = parser.parse_args()
    parts = given.part or PARTS
    share = given.minutes * 60.0 / len(parts)
    verbs = given.verb or [v for v in VERBS if share >= 300.0 or v not in SLOW_VERBS]
    rng, wrong = random.Random(given.seed), False
    today = dt.datetime.now(tz=dt.UTC).date()
    print(f"\n`python -m tests.torture {' '.join(sys.argv[1:])}`, {today}\n")
    print("| what | trials | faults | slowest [s] | most memory [MB] |\n|---|---|---|---|---|", flush=True)
    for part in parts:
        match part:
            case "killed" | "full":
                trial = killed if part == "killed" else full
                wrong |= _told(f"{part}, {{}}", _by_verb(trial, verbs, share, given.times, rng))
            case "two":
                wrong |= _told("two at once, {}", _pairs(verbs, share, given.times, rng))
            case "ground":
                times = given.times or max(2, round(share / A_GROUND_S))
                wrong |= _told("ground station killed{}", iter([("", ground_killed(times, rng))]))
            case "soak":
                wrong |= _soaked(share * SOAK_PACE, given.seed)
            case "fuzz":
                cases = max(100, round(FUZZ_A_MINUTE * share / 60.0))
                command = [
                    sys.executable,
                    "-m",
                    "tests.unit.fuzz.study",
                    "--cases",
                    str(cases),
                    "--seed",
                    str(given.seed),
                ]
                wrong |= subprocess.run(command, check=False).returncode != 0
    return 1 if wrong else 0


Rows = Iterator[tuple[str, Tally]]


def _told(what: str, rows: Rows) -> bool:
    """A row a verb and what went wrong, as it comes; whether anything did."""
    wrong = False
    for name, tally in rows:
        row = f"{tally.trials} | {len(tally.faults)} | {tally.slowest_s:.1f} | {tally.peak_mb:.0f}"
        print(f"| {what.format(name)} | {row} |", flush=True)
        for fault in tally.faults[:20]:
            print(f"  {fault}", flush=True)
        wrong |= bool(tally.faults)
    return wrong


def _soaked(seconds: float, seed: int) -> bool:
    end = soak(seconds, seed)
    grown = f"{end.grown / 1e6:+.1f} MB, {end.open_files:+d} files"
    print(f"| soak, {end.seconds:.0f} s simulated: {end.scans} scans | 1 | {end.lost} lost | | {grown} |", flush=True)
    return bool(end.lost or end.trouble)


def _by_verb(
    trial: Callable[[str, int, random.Random], Tally],
    verbs: list[str],
    seconds: float,
    times: int | None,
    rng: random.Random,
) -> Rows:
    """Trials of each verb: `times`, or as many as its share of the time has room for, at least one."""
    for verb in verbs:
        until, whole = time.monotonic() + seconds / len(verbs), Tally()
        while not whole.trials or (times is None and time.monotonic() < until):
            before = whole.trials
            whole.add(trial(verb, times or 5, rng))
            if whole.trials == before:
                whole.faults.append(f"{verb}: nothing to try; it writes no file")
                break
        yield verb, whole


def _pairs(verbs: list[str], seconds: float, times: int | None, rng: random.Random) -> Rows:
    """Every pair once, in an order of chance, as long as there is time; one row."""
    until, whole = time.monotonic() + seconds, Tally()
    pairs = list(combinations_with_replacement(verbs, 2))
    rng.shuffle(pairs)
    for one, other in pairs[:times]:
        if times is None and time.monotonic() > until:
            break
        whole.add(two(one, other))
    yield f"of {len(pairs)} pairs", whole


if __name__ == "__main__":
    sys.exit(main())
