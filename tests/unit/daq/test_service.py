"""The service edge: systemd notification, scheduling rights, signals, and what importing the logger drags in."""

import configparser
import gc
import os
import signal
import socket
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from daq.assembly import HardwareEdge
from daq.clock import RealClock
from daq.config import ConfigError, ScanConfig, parse_config
from daq.contract.recordings.accounting import verify
from daq.contract.recordings.messages import Statistics
from daq.contract.recordings.reading import read_recording
from daq.contract.recordings.recording import RecordingError
from daq.recorder.recorder import Recorder
from daq.service import realtime
from daq.service.realtime import Notifier
from daq.service.run import run_until_signal
from tests.support.paths import ROOT


def test_notifications_reach_the_socket_systemd_names(tmp_path: Path) -> None:
    path = str(tmp_path / "notify")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as systemd:
        systemd.bind(path)
        notifier = Notifier({"NOTIFY_SOCKET": path})
        notifier.ready("recording x")
        notifier.alive("20 scans")
        notifier.stopping()
        got = [systemd.recv(200).decode() for _ in range(3)]
        notifier.close()
    assert got == ["READY=1\nSTATUS=recording x", "WATCHDOG=1\nSTATUS=20 scans", "STOPPING=1"]


def test_notifications_without_systemd_or_with_it_gone(tmp_path: Path) -> None:
    Notifier({}).alive()
    notifier = Notifier({"NOTIFY_SOCKET": str(tmp_path / "absent")})
    notifier.alive()
    assert notifier.lost == 1
    notifier.close()


def test_abstract_socket_names() -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as systemd:
        systemd.bind("\0sideslip-test-notify")
        notifier = Notifier({"NOTIFY_SOCKET": "@sideslip-test-notify"})
        notifier.alive()
        assert systemd.recv(100) == b"WATCHDOG=1"
        notifier.close()


def test_missing_rights_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(*_: object) -> None:
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "sched_setscheduler", refused)
    with pytest.raises(ConfigError, match=r"scan\.realtime_priority 50: not permitted"):
        realtime.prepare_process(ScanConfig(realtime_priority=50))


def test_garbage_is_collected_when_asked_only() -> None:
    assert gc.isenabled()
    with realtime.GarbageDiscipline(enabled=True) as garbage:
        assert not gc.isenabled()
        cycle: list[object] = []
        cycle.append(cycle)
        del cycle
        garbage.freeze()
        assert gc.get_freeze_count() > 0
        before = gc.get_stats()[1]["collections"]
        for _ in range(10):
            garbage.collect()
        assert gc.get_stats()[1]["collections"] == before + 1, "one look at the young objects in ten seconds"
    assert gc.isenabled()
    assert gc.get_freeze_count() == 0


def recorded_scans(folder: Path) -> int:
    """Scans on disk so far, of a recording that is still being written."""
    files = sorted(folder.rglob("*.mcap"))
    try:
        return len(read_recording(files[0], salvage=True).numbers) if files else 0
    except RecordingError:  # the file has only just been opened
        return 0


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_ends_the_recording_in_order(tmp_path: Path, number: signal.Signals) -> None:
    """With no sensor fitted at all: the logger still runs, records that everything is off, and ends when told."""
    text = '[recorder]\ndirectories = ["rec"]\n[scan]\nrate_hz = 100\n[sensors]\n'
    config = parse_config(text, tmp_path / "logger.toml")
    before = signal.getsignal(number)

    def when_it_has_recorded() -> None:
        for _ in range(1200):  # a busy machine may take long to record a second
            if recorded_scans(tmp_path / "rec") > 20:
                break
            threading.Event().wait(0.05)
        os.kill(os.getpid(), number)

    timer = threading.Thread(target=when_it_has_recorded, name="signal")
    timer.start()
    outcome = run_until_signal(config, text, HardwareEdge(RealClock(), None, None, "simulated"), [])
    timer.join()
    assert signal.getsignal(number) is before
    assert outcome.signal_name == number.name
    assert outcome.exit_status == (130 if number is signal.SIGINT else 0), outcome.text
    result = verify(outcome.directory)
    assert result.ok
    assert result.scans == outcome.statistics.written > 10
    assert outcome.to_dict()["written"] == result.scans


def test_systemd_is_told_of_the_end_before_the_recording_is_ended(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """To end a recording on a bad card takes up to a minute, without a sign of life: the watchdog must know by then."""
    config = parse_config('[recorder]\ndirectories = ["rec"]\n[scan]\nrate_hz = 100\n[sensors]\n', tmp_path / "l.toml")
    monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
    told: list[str] = []
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as systemd:
        systemd.bind(str(tmp_path / "notify"))
        systemd.setblocking(False)
        close = Recorder.close

        def closing(recorder: Recorder, timeout_s: float = 60.0) -> Statistics:
            while not told or told[-1] != "STOPPING=1":
                told.append(systemd.recv(500).decode())
            return close(recorder, timeout_s)

        monkeypatch.setattr(Recorder, "close", closing)
        clock = EndsItself()
        run_until_signal(config, "", HardwareEdge(clock, None, None, "simulated"), [])
    assert told[0].startswith("READY=1")
    assert told[1].startswith("WATCHDOG=1\nSTATUS=")
    assert told[-1] == "STOPPING=1"


class EndsItself(RealClock):
    """A clock that raises SIGTERM in this process after five waits."""

    waits = 0

    def sleep_until(self, monotonic_ns: int) -> None:
        super().sleep_until(monotonic_ns)
        self.waits += 1
        if self.waits == 5:
            signal.raise_signal(signal.SIGTERM)


def test_the_scan_loop_has_the_interpreter_back_soon_while_it_runs_and_nothing_is_changed_afterwards(
    tmp_path: Path,
) -> None:
    config = parse_config('[recorder]\ndirectories = ["rec"]\n[scan]\nrate_hz = 100\n[sensors]\n', tmp_path / "l.toml")
    seen: list[float] = []

    class Looks(EndsItself):
        def sleep_until(self, monotonic_ns: int) -> None:
            seen.append(sys.getswitchinterval())
            super().sleep_until(monotonic_ns)

    before = sys.getswitchinterval()
    run_until_signal(config, "", HardwareEdge(Looks(), None, None, "simulated"), [])
    assert max(seen) < 0.001 < before
    assert sys.getswitchinterval() == before


def test_unit_file_fits_the_service() -> None:
    parser = configparser.ConfigParser(strict=False, interpolation=None)
    parser.optionxform = str  # type: ignore[assignment,method-assign]
    parser.read(ROOT / "daq/service/sideslip.service")
    service = parser["Service"]
    assert service["Type"] == "notify"
    command = service["ExecStart"].split()
    assert command[:2] == ["/opt/sideslip/bin/sideslip", "record"]
    pages = {n: (ROOT / "docs" / f"{n}.md").read_text() for n in ("build", "install-companion")}
    for name, page in pages.items():
        assert command[2] in page, (
            f"who follows {name}.md has the service read another configuration than the one written"
        )
    assert f"daq/configs/cdfp.toml {command[2]}" in pages["install-companion"]
    assert float(service["WatchdogSec"]) > 2
    assert float(service["TimeoutStopSec"]) > 60, "longer than the recorder tries at the end"
    assert parser["Install"]["WantedBy"] == "multi-user.target"
    requiring = {"StateDirectory", "LogsDirectory", "WorkingDirectory", "CacheDirectory"}
    assert not requiring & set(service), "each requires the card's mount: without a card nothing would start"
    assert "var-lib-sideslip.mount" in parser["Unit"]["Wants"]


@pytest.mark.parametrize(
    "module", ["daq.logger", "daq.recorder.recorder", "daq.contract.recordings.accounting", "daq.commands"]
)
def test_importing_the_logger_drags_nothing_heavy_in(module: str) -> None:
    heavy = (
        "torch",
        "casadi",
        "rerun",
        "matplotlib",
        "scipy",
        "pyarrow",
        "firmware_sim",
        "groundstation",
        "estimation",
    )
    code = f"import sys, {module}; print(*[m for m in {heavy!r} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, check=True)
    assert done.stdout.split() == []
