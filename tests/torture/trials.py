"""Verbs that write, killed at random instants, on a disk that fills, and two at once on one name."""

import os
import random
import resource
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

from daq.utilities.durable import ENDING
from tests.conftest import ROOT

LIMIT_S = 120.0
FLIGHT, RAW = ROOT / "recordings/cdfp_ld2.mcap", ROOT / "recordings/cdfp_ld2_raw.mcap"
OLD = b"OLD CONTENT\n"
VERBS: dict[str, list[str]] = {
    **{f"export {e}": ["export", str(FLIGHT), "-o", f"out.{e}"] for e in ("csv", "parquet", "mat", "mcap", "rrd", "kml")},
    "calibrate": ["calibrate", str(RAW), "-o", "out.mcap"],
    "recover": ["recover", str(RAW), "-o", "out.mcap"],
    "info --json": ["info", str(RAW), "--json", "out.json"],
    "check --report": ["check", str(FLIGHT), "--report", "report", "--json", "out.json"],
    "aircraft new": ["aircraft", "new", "glider", "-o", "out.toml"],
    "estimate": ["estimate", str(FLIGHT), "--method", "ls", "--json", "out.json", "--save-model", "model.toml"],
    "design": ["design", "--model", "lateral", "--aircraft", "cdfp", "--kind", "doublet", "--time", "10", "-o", "out.toml"],
    "campaign": ["campaign", str(FLIGHT), "--method", "ls", "--serial", "--out", "data"],
    "match": ["match", "MODEL", str(FLIGHT), "--json", "out.json", "--figure", "out.png"],
    "fly": ["fly", "quiet", "--speed", "max", "--out", "flown"],
    "gap": ["gap", str(FLIGHT), "--json", "out.json"],
}  # fmt: skip
NEW_ONLY = ("recover", "aircraft new")  # refuse a name that is there


@dataclass
class Tally:
    """What became of the trials of one verb. faults: in words; none is what is wanted."""

    trials: int = 0
    faults: list[str] = field(default_factory=list)
    slowest_s: float = 0.0
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
        self.peak_mb = max(self.peak_mb, part.peak_mb)


def _started(verb: str, folder: Path, words: Mapping[str, str] | None = None) -> "subprocess.Popen[bytes]":
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "PYTHONDONTWRITEBYTECODE": "1", **(words or {})}
    return subprocess.Popen(
        [sys.executable, "-m", "sideslip", *(str(_model()) if w == "MODEL" else w for w in VERBS[verb])],
        cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=environment,
    )  # fmt: skip


@cache
def _model() -> Path:
    """A model file for verbs that want one; it stays until this program ends."""
    from estimation.models.load import load_model, write_model

    path = Path(tempfile.mkdtemp(prefix="torture-")) / "model.toml"
    write_model(load_model("lateral", "cdfp"), path)
    return path


def _old(verb: str, folder: Path) -> list[Path]:
    """The files that stood there before."""
    if verb in NEW_ONLY:
        return []
    found = [folder / w for w in VERBS[verb] if w.startswith("out.")]
    for path in found:
        path.write_bytes(OLD)
    return found


def _ended(process: "subprocess.Popen[bytes]", tally: Tally, verb: str) -> str:
    begun = time.monotonic()
    try:
        _, said = process.communicate(timeout=LIMIT_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.communicate()
        tally.faults.append(f"{verb}: hung")
        return ""
    tally.slowest_s = max(tally.slowest_s, time.monotonic() - begun)
    tally.peak_mb = max(tally.peak_mb, resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1e3)
    words = said.decode("utf-8", "replace")
    tally.judge(f"{verb}: traceback: {words[-200:]}", "Traceback" in words)
    return words


def killed(verb: str, times: int, rng: random.Random) -> Tally:
    """SIGKILL at random instants: the old file stands or a whole new one does, and the next run clears what is left."""
    tally = Tally()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        whole = folder / "whole"
        whole.mkdir()
        begun = time.monotonic()
        _ended(_started(verb, whole), tally, verb)
        lasts = time.monotonic() - begun
        sizes = {p.name: p.stat().st_size for p in whole.iterdir() if p.is_file()}
        for n in range(times):
            here = folder / str(n)
            here.mkdir()
            old = _old(verb, here)
            process = _started(verb, here)
            time.sleep(rng.uniform(0.3, 1.05) * lasts)
            process.send_signal(signal.SIGKILL)
            process.communicate()
            tally.trials += 1
            for path in old:
                data = path.read_bytes() if path.exists() else b""
                new = abs(len(data) - sizes.get(path.name, 0)) <= 0.02 * len(data) + 200 and data != OLD
                tally.judge(f"{verb}: {path.name} of {len(data)} bytes is neither old nor new", data != OLD and not new)
        if verb not in NEW_ONLY:
            _ended(_started(verb, here), tally, verb)
            left = [p.name for p in here.rglob(f"*{ENDING}")]
            tally.judge(f"{verb}: left behind {left}", bool(left))
    return tally


def full(verb: str, most: int, rng: random.Random) -> Tally:
    """The disk is full from the first, the second, ... write on (of many, `most`): a status that says so, the old file."""
    tally = Tally()
    with tempfile.TemporaryDirectory() as name:
        shim, counts, room = _shim(Path(name)), Path(name) / "counts", Path(name) / "room"

        def once(at: int) -> tuple[int, str, list[Path]]:
            here = room / str(at)
            here.mkdir(parents=True)
            old = _old(verb, here)
            words = {
                "LD_PRELOAD": str(shim),
                "TORTURE_FOLDER": str(here),
                "TORTURE_FAIL_AT": str(at),
                "TORTURE_COUNT": str(counts),
            }
            process = _started(verb, here, words)
            said = _ended(process, tally, verb)
            return process.returncode, said, old

        _, _, new = once(0)
        sizes = {path.name: path.stat().st_size for path in new}
        writes = max((int(line) for line in counts.read_text().split()), default=0) if counts.exists() else 0
        for at in sorted(rng.sample(range(1, writes + 1), min(most, writes))):
            status, said, old = once(at)
            tally.trials += 1
            tally.judge(
                f"{verb}: status {status} with the disk full at write {at} of {writes}: {said[-200:]}",
                status not in (1, 2),
            )
            for path in old:
                data = path.read_bytes() if path.exists() else b""
                whole = data != OLD and abs(len(data) - sizes[path.name]) <= 0.02 * len(data) + 200
                tally.judge(f"{verb}: {path.name} destroyed at write {at} of {writes}", data != OLD and not whole)
            left = [p.name for p in (room / str(at)).rglob(f"*{ENDING}")]
            tally.judge(f"{verb}: left behind {left}", bool(left))
    return tally


def _shim(folder: Path) -> Path:
    """The library that makes a disk full, compiled."""
    made = folder / "full_disk.so"
    subprocess.run(
        ["cc", "-O1", "-shared", "-fPIC", "-o", made, Path(__file__).with_name("full_disk.c"), "-ldl"], check=True
    )
    return made


def two(one: str, other: str) -> Tally:
    """Two verbs at once in one folder, where they name the same file one of them has written it whole."""
    tally = Tally(1)
    with tempfile.TemporaryDirectory() as name:
        here = Path(name)
        both = [_started(v, here) for v in (one, other)]
        for process, verb in zip(both, (one, other), strict=True):
            said = _ended(process, tally, verb)
            allowed = (0, 1, 2) if verb in NEW_ONLY or verb == "campaign" else (0, 1)
            tally.judge(
                f"{one} beside {other}: {verb} ended with {process.returncode}: {said[-200:]}",
                process.returncode not in allowed,
            )
        left = [p.name for p in here.rglob(f"*{ENDING}")]
        tally.judge(f"{one} beside {other}: left behind {left}", bool(left))
    return tally


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
            [*command, "fly", "quiet", "--port", f"udp:127.0.0.1:{port}", "--out", "a", "--speed", "1"], **quiet
        )
        try:
            for _ in range(times):
                station = subprocess.Popen(
                    [*command, "ground", "g.toml", "--out", "s"], stdin=subprocess.DEVNULL, **quiet
                )
                time.sleep(rng.uniform(2.5, 6.0))
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
        finally:
            flying.kill()
            flying.communicate()
    return tally
