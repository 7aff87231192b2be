"""`python -m tests.rig`: build the computer from the page, boot it, try it, pull its plug; ends with a table.

Needs root, and of Debian qemu-system-x86, debootstrap and e2fsprogs; without them it says so and does nothing. All it makes is in
`build/rig`: 4 GB of disk.
"""

import argparse
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from tests.rig.bench import Bench
from tests.rig.boots import start_often
from tests.rig.cuts import Cut, pull_plugs, table_of
from tests.rig.image import ROOT, build
from tests.rig.judge import Session, judge, keep, mounted, sessions
from tests.rig.machine import Image, Machine, RigError
from tests.rig.page import PAGE, make_card
from tests.rig.trials import ONE_BOOT, Power, no_room

BUILD = ROOT / "build" / "rig"
CARD_MB = 256
INSTALL = "apt-get install --no-install-recommends qemu-system-x86 debootstrap e2fsprogs"


def missing() -> str:
    """Why the rig cannot run here; empty if it can."""
    absent = [p for p in ("qemu-system-x86_64", "debootstrap", "mke2fs") if shutil.which(p) is None]
    if absent:
        return f"{', '.join(absent)} not found; {INSTALL}"
    if os.geteuid() != 0:
        return "the image is made with chroot and mount: be root"
    return ""


class Report:
    """Rows as they come, on the screen and in a file."""

    def __init__(self) -> None:
        self.rows: list[dict[str, object]] = []

    def add(self, trial: str, passed: bool, text: str, took_s: float) -> None:
        """One trial."""
        self.rows.append({"trial": trial, "passed": passed, "text": text, "seconds": round(took_s)})
        print(f"| {trial} | {'passed' if passed else 'FAILED'} | {text} | {took_s:.0f} s |", flush=True)
        (BUILD / "result.json").write_text(json.dumps(self.rows, indent=1))

    def run(self, trial: str, do: Callable[[], str]) -> None:
        """Carry a trial out; one that fails does not end the others."""
        started = time.monotonic()
        try:
            self.add(trial, True, do(), time.monotonic() - started)
        except RigError as error:
            self.add(trial, False, str(error), time.monotonic() - started)


def try_all(image: Image, folder: Path, report: Report, only: str) -> None:
    """The trials that do not need the plug, and what is on the card after them."""
    card = make_card(PAGE, folder / "card.img", CARD_MB)
    with Bench(folder, "cdfp_ld1") as bench:
        with Machine(image, folder, card) as machine:
            machine.wait_for_agent()
            power = Power(machine, bench)
            for name, trial in ONE_BOOT.items():
                if re.search(only, name):
                    report.run(name, lambda trial=trial: trial(power))  # type: ignore[misc]
            machine.run("systemctl stop sideslip; sync")
        with mounted(card) as root:
            found = [judge(root / "recordings" / name, bench.readings, None) for name in sessions(root)]
            longest = max(found, key=lambda s: s.scans)
            keep(root / "recordings" / longest.name, BUILD / "flight")
        wrong = [f"{s.name}: {w}" for s in found for w in s.wrong]
        report.add("what these left on the card", not wrong, "; ".join(wrong) or _summary(found), 0.0)
        for name, options in (("card read-only", {"read_only": True}), ("card at home", {})):
            if re.search(only, name):
                with Machine(image, folder, card if options else None, **options) as machine:
                    machine.wait_for_agent()
                    report.run(name, lambda machine=machine: no_room(Power(machine, bench)))  # type: ignore[misc]


def _summary(found: list[Session]) -> str:
    sound = sum(s.ok for s in found)
    return f"{len(found)} sessions, {sum(s.scans for s in found)} scans, {sound} sessions sound, all others recovered"


def estimated() -> str:
    """The flight's session through calibrate and estimate."""
    out = BUILD / "flight.mcap"
    out.unlink(missing_ok=True)
    for words in (["calibrate", str(BUILD / "flight"), "-o", str(out)], ["estimate", str(out), "--method", "ls"]):
        command = [sys.executable, "-c", "from sideslip import main; main()", *words]
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
        if done.returncode not in (0, 1):
            raise RigError(f"sideslip {words[0]} ended with {done.returncode}: {done.stderr[-600:]}")
    (BUILD / "estimate.txt").write_text(done.stdout)
    return next((line.strip() for line in done.stdout.splitlines() if "recommended" in line), "no recommendation")


def main() -> int:
    """Everything; 1 when a trial failed, 0 also where the rig cannot run."""
    parser = argparse.ArgumentParser(prog="python -m tests.rig", description=__doc__)
    parser.add_argument("--cuts", type=int, default=10, help="power cuts (2 min each)")
    parser.add_argument(
        "--boots",
        type=int,
        default=0,
        help="starts with parts absent, late or pulled (2 min each, 7 on a busy machine)",
    )
    parser.add_argument("--seed", type=int, default=1, help="of their instants and orders")
    parser.add_argument("--only", default="", help="trials whose name has this pattern in it; '-' for none")
    given = parser.parse_args()
    if why := missing():
        print(f"rig: skipped: {why}")
        return 0
    started = time.monotonic()
    image = build(BUILD)
    report = Report()
    with tempfile.TemporaryDirectory(prefix="sideslip-rig-") as name:
        folder = Path(name)
        try:
            if given.only != "-":
                try_all(image, folder, report, given.only)
                if any(row["trial"] == "flight" for row in report.rows):
                    report.run("flight estimated", estimated)
            cuts: list[Cut] = []
            if given.cuts:
                (folder / "cuts").mkdir()
                cuts = pull_plugs(image, folder / "cuts", given.cuts, np.random.default_rng(given.seed), report.add)
                print(table_of(cuts))
            if given.boots:
                (folder / "starts").mkdir()
                start_often(image, folder / "starts", given.boots, given.seed, report.add)
        except RigError as error:
            report.add("rig", False, str(error), time.monotonic() - started)
    failed = [r for r in report.rows if not r["passed"]]
    print(f"{len(report.rows)} rows, {len(failed)} failed, {(time.monotonic() - started) / 60:.0f} min")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
