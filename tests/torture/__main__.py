"""`make torture MINUTES=60`: kills, full disks, two at once, a ground station killed, soak and fuzz; prints the table of
docs/threat-model.md. Not part of `make test`."""

import argparse
import datetime as dt
import random
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from contextlib import ExitStack
from itertools import combinations_with_replacement
from pathlib import Path

from tests.torture.soak import soak
from tests.torture.trials import Tally, Trials, ground_killed, shim, two
from tests.torture.verbs import VERBS, made_inputs

PARTS = ("killed", "full", "two", "ground", "soak", "fuzz")
FUZZ_A_MINUTE = 250  # cases, on an idle core
SOAK_PACE = 5.0  # simulated seconds a second
A_GROUND_S = 6.0  # seconds that one killed ground station takes
KILLS, WRITES = 50, 60
"""SIGKILLs a verb, and writes of a verb at which the disk is full, at most."""


def main() -> int:
    """All parts; 1 where anything was found."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--minutes", type=float, default=60.0, help="of soak and fuzz together; the other parts take theirs"
    )
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--part", action="append", choices=PARTS, help="only this; may be repeated")
    parser.add_argument("--verb", action="append", choices=list(VERBS), help="only this; may be repeated")
    parser.add_argument(
        "--beside", action="append", choices=list(VERBS), help="two at once: only pairs with one of these"
    )
    parser.add_argument("--kills", type=int, default=KILLS, help="of each verb and of ground stations")
    parser.add_argument("--writes", type=int, default=WRITES, help="of each verb at which the disk is full")
    given = parser.parse_args()
    parts, rng, wrong = given.part or PARTS, random.Random(given.seed), False
    share = given.minutes * 60.0 / 2.0
    today = dt.datetime.now(tz=dt.UTC).date()
    print(f"\n`python -m tests.torture {' '.join(sys.argv[1:])}`, {today}\n")
    print(
        "| what | trials | faults | slowest [s] | of it processor [s] | most memory [MB] |\n|---|---|---|---|---|---|",
        flush=True,
    )
    if {"killed", "full", "two"} & set(parts):
        limits = given.kills, given.writes
        wrong |= _verbs(given.verb or list(VERBS), parts, limits, given.beside or list(VERBS), rng)
    if "ground" in parts:
        wrong |= _told("ground station killed", ground_killed(given.kills, rng))
    if "soak" in parts:
        wrong |= _soaked(share * SOAK_PACE, given.seed)
    if "fuzz" in parts:
        cases = str(max(100, round(FUZZ_A_MINUTE * share / 60.0)))
        command = [sys.executable, "-m", "tests.unit.fuzz.study", "--cases", cases, "--seed", str(given.seed)]
        wrong |= subprocess.run(command, check=False).returncode != 0
    return 1 if wrong else 0


def _told(what: str, tally: Tally) -> bool:
    """A row and what went wrong; whether anything did."""
    row = f"{tally.trials} | {len(tally.faults)} | {tally.slowest_s:.1f} | {tally.slowest_cpu_s:.1f} | {tally.peak_mb:.0f}"
    print(f"| {what} | {row} |", flush=True)
    for fault in tally.faults[:20]:
        print(f"  {fault}", flush=True)
    return bool(tally.faults)


def _soaked(seconds: float, seed: int) -> bool:
    end = soak(seconds, seed)
    grown = f"{end.grown / 1e6:+.1f} MB, {end.open_files:+d} files"
    print(f"| soak, {end.seconds:.0f} s simulated: {end.scans} scans | 1 | {end.lost} lost | | | {grown} |", flush=True)
    return bool(end.lost or end.trouble)


def _verbs(
    verbs: list[str], parts: Sequence[str], limits: tuple[int, int], beside: list[str], rng: random.Random
) -> bool:
    """Each verb killed and on a full disk, so often; then every pair of them with one of `beside` at once."""
    wrong, held, (kills, writes) = False, list[Trials](), limits
    with tempfile.TemporaryDirectory(prefix="torture-") as name, ExitStack() as open_verbs:
        base = Path(name)
        inputs, library = made_inputs(base / "inputs"), shim(base)
        for verb in verbs:
            trials = Trials(verb, base, inputs, rng, library)
            if "killed" in parts:
                wrong |= _told(f"{verb}, killed", trials.killed(kills))
            if "full" in parts:
                wrong |= _told(f"{verb}, disk full", trials.full(writes))
            if "two" in parts:
                open_verbs.callback(trials.close)
                held.append(trials)
            else:
                trials.close()
        pairs = [p for p in combinations_with_replacement(held, 2) if {t.verb for t in p} & set(beside)]
        tally = Tally()
        for one, other in pairs:
            tally.add(two(one, other))
        if pairs:
            wrong |= _told(f"two at once, {len(pairs)} pairs", tally)
    return wrong


if __name__ == "__main__":
    sys.exit(main())
