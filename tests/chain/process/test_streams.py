"""Standard output and error, the terminal, and the disk under a verb: the work is done, old files stay, the status is right."""

import json
import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.conftest import ROOT

FLIGHT, RAW = ROOT / "recordings/cdfp_ld2.mcap", ROOT / "recordings/cdfp_ld2_raw.mcap"
COMMAND = f"{sys.executable} -m sideslip --quiet"


def shell(line: str, folder: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(["bash", "-c", line], cwd=folder, capture_output=True, text=True, timeout=120, check=False)


@pytest.mark.parametrize(
    ("end", "status"),
    [("> /dev/full", 2), (">&-", 0), ("2>&-", 0), (">&- 2>&-", 0), ("2> /dev/full", 0), ("<&- >&- 2>&-", 0)],
)
def test_a_stream_that_is_closed_or_full_changes_no_result(end: str, status: int, tmp_path: Path) -> None:
    done = shell(f"{COMMAND} info {RAW} --json out.json {end}", tmp_path)
    assert done.returncode == status
    assert json.loads((tmp_path / "out.json").read_text())["scans"] > 0
    assert "Traceback" not in done.stderr
    assert len(done.stderr.splitlines()) == (1 if end == "> /dev/full" else 0)


def test_a_reader_that_has_seen_enough_changes_no_result(tmp_path: Path) -> None:
    done = shell(f"{COMMAND} info {RAW} --json out.json | true; exit ${{PIPESTATUS[0]}}", tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    assert (tmp_path / "out.json").is_file()


def test_a_failed_check_on_a_full_stream_is_not_told_by_1(tmp_path: Path) -> None:
    (tmp_path / "cut.mcap").write_bytes(RAW.read_bytes()[:200_000])
    assert shell(f"{COMMAND} verify cut.mcap", tmp_path).returncode == 1
    assert shell(f"{COMMAND} verify cut.mcap > /dev/full", tmp_path).returncode == 2


def _smaller_files(limit: int) -> None:
    """No file longer than this: as on a disk that is full then, for whoever is root too."""
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))


WRITING = {
    "csv": f"export {FLIGHT} -o out.csv",
    "parquet": f"export {FLIGHT} -o out.parquet",
    "mat": f"export {FLIGHT} -o out.mat",
    "mcap": f"export {FLIGHT} -o out.mcap",
    "rrd": f"export {FLIGHT} -o out.rrd",
    "gpx": f"export {FLIGHT} -o out.gpx",
    "kml": f"export {FLIGHT} -o out.kml",
    "recover": f"recover {RAW} -o out.mcap",
    "calibrate": f"calibrate {RAW} -o out.mcap",
    "json": f"info {RAW} --json out.json",
    "rrd of view": f"view {FLIGHT} --view none --rrd out.rrd",
    "aircraft": "aircraft new glider -o out.toml",
}


@pytest.mark.parametrize("room", [0, 3000])
@pytest.mark.parametrize("what", WRITING)
def test_a_disk_without_room_leaves_the_old_file_and_one_sentence(what: str, room: int, tmp_path: Path) -> None:
    words = WRITING[what].split()
    out = tmp_path / next(w for w in words if w.startswith("out."))
    if what != "aircraft":
        out.write_text("OLD")
    done = subprocess.run(
        [sys.executable, "-m", "sideslip", *words],
        cwd=tmp_path, capture_output=True, text=True, timeout=120, check=False, preexec_fn=lambda: _smaller_files(room),
    )  # fmt: skip
    assert done.returncode == 2, done.stderr
    assert "Traceback" not in done.stderr
    assert out.name in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
    assert [p.name for p in tmp_path.iterdir()] == ([] if what == "aircraft" else [out.name])
    assert what == "aircraft" or out.read_text() == "OLD"


def _compiling(
    words: list[str], folder: Path, act: Callable[[], None] | None = None
) -> subprocess.CompletedProcess[str]:
    """Run Python with its compiled modules in `folder`."""
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
    environment["PYTHONPYCACHEPREFIX"] = str(folder)
    command = [sys.executable, *words]
    return subprocess.run(
        command, env=environment, cwd=ROOT, capture_output=True, text=True, preexec_fn=act, check=False
    )


CHECK = ["-m", "sideslip", "aircraft", "check", "cdfp"]


def test_a_full_disk_leaves_no_compiled_module_that_cannot_be_read(tmp_path: Path) -> None:
    """Python 3.11 leaves what fitted of one, and every later import of it ends in an EOFError."""
    assert _compiling(["-c", "import runpy, resource, sideslip.entry"], tmp_path).returncode == 0
    assert _compiling(CHECK, tmp_path, lambda: _smaller_files(3000)).returncode == 0
    done = _compiling(CHECK, tmp_path)
    assert done.returncode == 0, done.stderr


def test_a_compiled_module_cut_short_is_named_with_its_remedy(tmp_path: Path) -> None:
    assert _compiling(CHECK, tmp_path).returncode == 0
    module = next(tmp_path.rglob("aircraft_review.cpython-*.pyc"))
    module.write_bytes(module.read_bytes()[:3000])
    done = _compiling(CHECK, tmp_path)
    assert done.returncode == 2
    assert "__pycache__" in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1


@pytest.mark.parametrize("how", [signal.SIGTERM, signal.SIGHUP])
def test_a_verb_that_is_ended_by_a_signal_leaves_the_old_file_alone(how: signal.Signals, tmp_path: Path) -> None:
    program = (
        "import sys, time\nsys.argv[0] = 'sideslip'\nfrom sideslip.entry import main\nimport groundstation.export.run as w\n"
        "def slow(table, path, **_):\n"
        "    from daq.utilities.durable import whole_text\n"
        "    with whole_text(path) as f:\n"
        "        f.write('half'); print('writing', flush=True); time.sleep(60)\n"
        "w.write_csv = slow\n"
        f"main(['export', {str(FLIGHT)!r}, '-o', 'out.csv'])\n"
    )
    (tmp_path / "out.csv").write_text("OLD")
    verb = subprocess.Popen(
        [sys.executable, "-c", program], cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert verb.stdout is not None
    assert verb.stdout.readline() == "writing\n"
    verb.send_signal(how)
    _, said = verb.communicate(timeout=60)
    assert verb.returncode == 128 + how, said
    assert said == f"\nsideslip: ended by {how.name}; files are closed\n" or said.strip().endswith("files are closed")
    assert [p.name for p in tmp_path.iterdir()] == ["out.csv"]
    assert (tmp_path / "out.csv").read_text() == "OLD"


def _ground(folder: Path, stdout: int, seconds: float) -> "subprocess.Popen[bytes]":
    (folder / "g.toml").write_text("[link]\nports = []\n")
    (folder / "g.toml").write_text('[link]\nports = ["udpin:127.0.0.1:0"]\n')
    command = [sys.executable, "-m", "sideslip", "ground", "g.toml", "--out", "s", "--duration", str(seconds)]
    return subprocess.Popen(
        [*command, "--json", "g.json"], cwd=folder, stdout=stdout, stdin=subprocess.DEVNULL, stderr=subprocess.PIPE
    )


def _begun(folder: Path) -> None:
    log = folder / "s" / "ground.log"
    for _ in range(600):
        if log.is_file() and "listening" in log.read_text():
            return
        time.sleep(0.05)
    raise AssertionError("the ground station did not begin")


@pytest.mark.parametrize("what", ["reader gone", "reader asleep", "terminal gone", "stopped"])
def test_the_ground_station_goes_on_whatever_becomes_of_its_terminal(what: str, tmp_path: Path) -> None:
    reading, writing = os.pipe()
    station = _ground(tmp_path, writing, 3.0)
    os.close(writing)
    try:
        _begun(tmp_path)
        if what == "reader gone":
            os.close(reading)
        if what == "terminal gone":
            station.send_signal(signal.SIGHUP)
        if what == "stopped":  # Ctrl-Z and fg
            station.send_signal(signal.SIGSTOP)
            time.sleep(1.0)
            station.send_signal(signal.SIGCONT)
        _, said = station.communicate(timeout=60)
    finally:
        station.kill()
        station.wait()
        if what != "reader gone":
            os.close(reading)
    assert (station.returncode, said) == (0, b"")
    assert json.loads((tmp_path / "g.json").read_text())["scans_received"] == 0
    assert "0 scans received" in (tmp_path / "s" / "ground.log").read_text()


def test_a_second_ground_station_is_refused_the_folder_of_the_first(tmp_path: Path) -> None:
    first = _ground(tmp_path, subprocess.DEVNULL, 20.0)
    try:
        _begun(tmp_path)
        second = _ground(tmp_path, subprocess.DEVNULL, 1.0)
        _, said = second.communicate(timeout=60)
    finally:
        first.terminate()
        first.communicate(timeout=60)
    assert second.returncode == 2
    assert said.decode().strip() == (
        "sideslip: s: another ground station writes there; give this one another folder with --out"
    )
