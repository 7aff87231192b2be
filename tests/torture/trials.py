"""Verbs that write, killed at random instants, on a disk that fills, and two at once on one name."""

import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
import tomllib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from daq.utilities.durable import ENDING
from tests.torture.held import Ended, Held
from tests.torture.verbs import CUT_AT_AN_END, GROWING, NEW_ONLY, OWN_ONLY, VERBS, Inputs

LIMIT_S = 120.0
"""Of a trial, by the clock: a busy machine has ten of them at once."""
OLD = b"OLD CONTENT\n"
MCAP_END = b"\x89MCAP0\r\n"
TERMINATED = (signal.SIGTERM, signal.SIGHUP)


@dataclass
class Tally:
    """What became of the trials of one verb. faults: in words; none is what is wanted. slowest: by clock and processor."""

    trials: int = 0
    faults: list[str] = field(default_factory=list)
    slowest_s: float = 0.0
    slowest_cpu_s: float = 0.0
    peak_mb: float = 0.0

    def judge(self, what: str, wrong: bool) -> None:
        """One look at what was left."""
        if wrong:
            self.faults.append(what)

    def add(self, part: "Tally") -> None:
        """More of the same."""
        self.trials += part.trials
        self.faults += part.faults
        self.slowest_s = max(self.slowest_s, part.slowest_s)
        self.slowest_cpu_s = max(self.slowest_cpu_s, part.slowest_cpu_s)
        self.peak_mb = max(self.peak_mb, part.peak_mb)

    def ended(self, verb: str, end: Ended, hung: bool) -> None:
        """How one process ended."""
        self.slowest_s, self.peak_mb = max(self.slowest_s, end.seconds), max(self.peak_mb, end.peak_mb)
        self.slowest_cpu_s = max(self.slowest_cpu_s, end.cpu_s)
        self.judge(f"{verb}: hung", hung)
        self.judge(f"{verb}: traceback: {end.words[-300:]}", "Traceback" in end.words or "a mistake in" in end.words)


class Trials:
    """One verb, held before its first write, in a folder that is new for each trial.

    base: a folder that several verbs may share; their trials go into `base`/here. rng: of instants and of writes chosen.
    """

    def __init__(self, verb: str, base: Path, inputs: Inputs, rng: random.Random, shim: Path) -> None:
        self.verb, self._base, self._rng = verb, base, rng
        self.here, whole = base / "here", base / f"whole {verb}"
        shutil.rmtree(self.here, ignore_errors=True)
        self.held = Held(inputs.words(verb), self.here, whole, shim)
        self._made = [p.relative_to(self.here) for p in self.here.rglob("*") if p.is_dir()]
        self.sizes = {str(p.relative_to(whole)): p.stat().st_size for p in whole.rglob("*") if p.is_file()}

    def close(self) -> None:
        self.held.close()

    def empty(self, *, old: bool = True) -> list[Path]:
        """A new folder, with what stood there before; those files."""
        shutil.rmtree(self.here, ignore_errors=True)
        for folder in (Path(), *self._made):  # what the verb has made before its first write
            (self.here / folder).mkdir()
        words = VERBS[self.verb].split()
        files = [self.here / w for w in words if w.startswith("out.")] if self.verb not in NEW_ONLY and old else []
        files += [self.here / "report/index.html"] if "report" in words and old else []
        for path in files:
            path.parent.mkdir(exist_ok=True)
            path.write_bytes(OLD)
        return files

    def once(self, tally: Tally, number: int | None = None, wait_s: float = 0.0, **environment: str) -> Ended:
        """Let the verb go on; a signal to be sent after a while, or none."""
        (pid,), ends, hung = self.held.go(**environment), threading.Event(), threading.Event()

        def watch() -> None:
            if number is not None and not ends.wait(wait_s):
                _signal(pid, number)
            if not ends.wait(LIMIT_S):
                hung.set()
                _signal(pid, signal.SIGKILL)

        watcher = threading.Thread(target=watch)
        watcher.start()
        end = self.held.ended()
        ends.set()
        watcher.join()
        tally.ended(self.verb, end, hung.is_set())
        return end

    def look(self, tally: Tally, old: list[Path], when: str, *, leftovers: bool) -> None:
        """Every file that has a name of its own is the old one or a whole new one. leftovers: may hidden ones be there."""
        for path in old:
            tally.judge(f"{self.verb}: {path.name} gone {when}", not path.exists())
        for path in self.here.rglob("*"):
            name = str(path.relative_to(self.here))
            if path.name.endswith(ENDING):
                tally.judge(f"{self.verb}: {name} left behind {when}", not leftovers)
            elif path.is_file() and not any(ENDING in part for part in path.parts):
                spoilt = not (path in old and path.read_bytes() == OLD) and not self._whole(path, name)
                tally.judge(f"{self.verb}: {name} of {path.stat().st_size} bytes is neither old nor new {when}", spoilt)

    def _whole(self, path: Path, name: str) -> bool:
        """Whether a file is all that it is to be: as long as that of the whole run, or sound by itself."""
        if path.suffix in GROWING or path.name.startswith(".") or "onboard" in path.parts:
            return True
        data = path.read_bytes()
        try:
            match path.suffix:
                case ".json":
                    return bool(json.loads(data))
                case ".toml":
                    return bool(tomllib.loads(data.decode()))
                case ".mcap":
                    return data.endswith(MCAP_END)
                case ".parquet":
                    return data[:4] == data[-4:] == b"PAR1"
                case ".csv" if path.name in CUT_AT_AN_END:
                    return data.endswith(b"\n") and len({line.count(b",") for line in data.splitlines()}) == 1
                case ".html":
                    return data.rstrip().endswith(b"</html>")
        except ValueError:
            return False
        return abs(len(data) - self.sizes.get(name, 0)) <= 0.02 * len(data) + 200

    def complete(self, old: list[Path]) -> bool:
        """Whether everything that the whole run wrote is there anew."""
        files = {str(p.relative_to(self.here)) for p in self.here.rglob("*") if p.is_file()}
        fresh = all(path.read_bytes() != OLD for path in old if path.exists())
        return fresh and all(name in files for name in self.sizes if Path(name).suffix not in GROWING)

    def killed(self, times: int) -> Tally:
        """SIGKILL at instants of chance from the first write on, and SIGTERM or SIGHUP in one of six: the old files stand or
        whole new ones do, and the verb started again there does its work and clears what is left."""
        tally = Tally()
        self.empty()
        lasts = self.once(tally).seconds
        for n in range(times + times // 5):
            kill = signal.SIGKILL if n < times else TERMINATED[n % 2]
            old = self.empty()
            end = self.once(tally, kill, self._rng.uniform(0.0, 1.05) * lasts)
            tally.trials += 1
            self.look(tally, old, f"after {kill.name}", leftovers=kill is signal.SIGKILL)
            wanted = (-kill, 128 + kill, self.held.status)
            tally.judge(f"{self.verb}: {kill.name}, status {end.status}: {end.words[-200:]}", end.status not in wanted)
            if n % 10 == 9:
                again = self.once(tally)
                allowed = (self.held.status, 2) if self.verb in NEW_ONLY else (self.held.status,)
                what = f"{self.verb}: started again, status {again.status}: {again.words[-200:]}"
                tally.judge(what, again.status not in allowed)
                self.look(tally, [], "after the next run", leftovers=False)
        return tally

    def full(self, most: int) -> Tally:
        """The disk is full from the first, the second, ... write on (of many, `most`, the first and last ten among them): status
        2 and the old files, or all was done."""
        tally, counts = Tally(), self._base / "counts"
        counts.unlink(missing_ok=True)
        self.empty()
        disk = {"TORTURE_FOLDER": str(self.here)}
        self.once(tally, TORTURE_COUNT=str(counts), TORTURE_FAIL_AT="0", **disk)
        writes = max((int(line) for line in counts.read_text().split()), default=0) if counts.exists() else 0
        tally.judge(f"{self.verb}: wrote nothing", not writes)
        every = list(range(1, writes + 1))
        chosen = every if writes <= most else sorted({*every[:10], *every[-10:], *self._rng.sample(every, most - 20)})
        for at in chosen:
            old = self.empty()
            end = self.once(tally, TORTURE_FAIL_AT=str(at), **disk)
            tally.trials += 1
            when = f"with the disk full from write {at} of {writes} on"
            wrong = end.status != 2 and not (end.status == self.held.status and self.complete(old))
            tally.judge(f"{self.verb}: status {end.status} {when}: {end.words[-200:]}", wrong)
            self.look(tally, old, when, leftovers=False)
        return tally


def _signal(pid: int, number: int) -> None:
    try:
        os.kill(pid, number)
    except ProcessLookupError:
        return


def shim(folder: Path) -> Path:
    """The library that makes a disk full, compiled."""
    made = folder / "full_disk.so"
    source = Path(__file__).with_name("full_disk.c")
    subprocess.run(["cc", "-O1", "-shared", "-fPIC", "-o", made, source, "-ldl"], check=True)
    return made


def two(one: Trials, other: Trials) -> Tally:
    """Two verbs go on at once from before their first writes, in one folder; each file is whole, of one of them."""
    tally = Tally(1)
    one.empty(old=False)
    for folder in other._made:
        (one.here / folder).mkdir(exist_ok=True)
    starts = one.held.go(2) if one is other else [*one.held.go(), *other.held.go()]
    for trial, pid in zip((one, other), starts, strict=True):
        timer = threading.Timer(LIMIT_S, _signal, (pid, signal.SIGKILL))
        timer.start()
        end = trial.held.ended()
        timer.cancel()
        tally.ended(trial.verb, end, end.status == -signal.SIGKILL)
        refused = (
            (2,) if trial.verb in (*NEW_ONLY, *OWN_ONLY) or one is other or _folders(one) & _folders(other) else ()
        )
        what = f"{one.verb} beside {other.verb}: {trial.verb} ended with {end.status}: {end.words[-200:]}"
        tally.judge(what, end.status not in (trial.held.status, *refused))
    for path in one.here.rglob("*"):
        name = str(path.relative_to(one.here))
        spoilt = path.is_file() and not any(t._whole(path, name) for t in (one, other))
        what = f"{one.verb} beside {other.verb}: {name} of {path.stat().st_size} bytes"
        tally.judge(what, spoilt or path.name.endswith(ENDING))
    return tally


def _folders(trial: Trials) -> set[str]:
    return {w for w in VERBS[trial.verb].split() if w in ("data", "flown", "folder", "session")}


def ground_killed(times: int, rng: random.Random) -> Tally:
    """A ground station killed at random instants while frames come: what its journal holds can be read, and it goes on there."""
    from groundstation.receiver.storage.session_log import SessionLog
    from tests.support.free_ports import free_port

    tally = Tally()
    with tempfile.TemporaryDirectory() as name:
        here, port, before = Path(name), free_port(), 0
        (here / "g.toml").write_text(f'[link]\nports = ["udpin:127.0.0.1:{port}"]\n')
        command = [sys.executable, "-m", "sideslip"]
        quiet: dict[str, Any] = {"stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE, "cwd": here}
        flying = subprocess.Popen(
            [*command, "fly", "long_flight", "--port", f"udp:127.0.0.1:{port}", "--out", "a", "--speed", "1"], **quiet
        )
        try:
            for n in range(times):
                station = subprocess.Popen(
                    [*command, "ground", "g.toml", "--out", "s"], stdin=subprocess.DEVNULL, **quiet
                )
                _listening(here / "s" / "ground.log", n + 1, station)
                time.sleep(rng.uniform(0.0, 4.0))
                tally.judge(f"ground: ended by itself: {station.poll()}", station.poll() is not None)
                station.kill()
                _, said = station.communicate()
                tally.judge(f"ground: traceback {said[-200:]!r}", b"Traceback" in said)
                tally.trials += 1
                held = 0
                for path in (here / "s").glob("*.journal"):
                    log = SessionLog(path)
                    held += len(list(log.scans()))
                    log.close()
                tally.judge(f"ground: {held} scans in the journals, {before} before", held < before)
                before = held
            last = subprocess.run(
                [*command, "ground", "g.toml", "--out", "s", "--duration", "5", "--json", "g.json"],
                check=False,
                **quiet,
            )
            on_disk = json.loads((here / "g.json").read_text())["scans_on_disk"]
            tally.judge(f"ground: in the end status {last.returncode}: {last.stderr[-200:]!r}", last.returncode != 0)
            tally.judge(f"ground: {on_disk} scans on the disk in the end, {before} before", on_disk < before)
        finally:
            flying.kill()
            flying.communicate()
    return tally


def _listening(log: Path, times: int, station: "subprocess.Popen[bytes]") -> None:
    """Wait until so many ground stations have said, in the log that they share, that they listen."""
    until = time.monotonic() + LIMIT_S
    while time.monotonic() < until and station.poll() is None:
        if log.is_file() and log.read_bytes().count(b"listening") >= times:
            return
        time.sleep(0.05)
