"""Run the logger or its preflight check on real hardware: opens the devices and handles the process's signals."""

import logging
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from functools import partial
from itertools import count
from pathlib import Path
from types import FrameType
from typing import Any

from daq.acquisition.sampler import Sampler
from daq.actuation.actuation import Devices
from daq.actuation.pwm.heartbeat import FileHeartbeat
from daq.assembly import Assembly, HardwareEdge, assemble
from daq.clock import RealClock
from daq.config import LoggerConfig, load_config
from daq.contract.recordings.messages import LogLevel, Statistics
from daq.logger import Opening
from daq.recorder.storage import RealStorage
from daq.sensors.open import Hardware, open_hardware
from daq.service.checks import PreflightCheck, PreflightVerdict, RadioReport, listen_to_radio
from daq.service.preflight import Preflight, run_preflight
from daq.service.realtime import GarbageDiscipline, Notifier, prepare_process
from daq.telemetry.config import DownlinkConfig
from daq.telemetry.link import open_port
from daq.transport.ports import BytePort
from daq.transport.reconnecting_port import ReconnectingPort
from daq.utilities.errors import UserError
from daq.utilities.record_log import logged

_LOG = logging.getLogger("sideslip.service")
_STATUS_EVERY = 10  # watchdog messages, one a second
_SWITCH_INTERVAL_S = 0.0005  # of the interpreter between threads


class PreflightRefusal(UserError):
    """The preflight check says no-go."""


@dataclass(frozen=True, slots=True)
class RecordingOutcome:
    """How a recording ended."""

    statistics: Statistics
    directory: Path
    signal_name: str

    @property
    def exit_status(self) -> int:
        """0 when every scan was written, 1 when some were dropped or lost; 130 instead of 0 after Ctrl-C."""
        if self.statistics.dropped or self.statistics.lost:
            return 1
        return 130 if self.signal_name == signal.SIGINT.name else 0

    @property
    def text(self) -> str:
        """One line for the journal."""
        s = self.statistics
        return (
            f"{self.directory}: {s.written} scans written, {s.dropped} dropped, {s.lost} lost, {s.missed} slots missed"
            f" ({self.signal_name or 'ended'})"
        )

    def to_dict(self) -> dict[str, Any]:
        """The JSON object of `record --json`."""
        s = self.statistics
        return {
            "directory": str(self.directory),
            "session": s.session,
            "slots": s.slots,
            "written": s.written,
            "dropped": s.dropped,
            "lost": s.lost,
            "missed": s.missed,
            "late": s.late_scans,
            "text": self.text,
        }


def preflight_on_hardware(path: Path) -> Preflight:
    """Open the devices of the configuration and carry out the preflight check."""
    config, _ = load_config(path)
    clock = RealClock()
    with _opened(config, clock) as (hardware, radio, devices):
        return _preflight(config, clock, hardware, radio, devices)


def record_on_hardware(path: Path, *, override: str | None, skip_preflight: bool) -> RecordingOutcome:
    """Record until SIGTERM or SIGINT. Raises PreflightRefusal on a no-go without an override."""
    config, text = load_config(path)
    clock = RealClock()
    with logged(config.recorder.directories[0]), _opened(config, clock) as (hardware, radio, devices):
        table = None if skip_preflight else _preflight(config, clock, hardware, radio, devices)
        opening = _opening(table, override)
        opening += [
            Opening(LogLevel.WARNING, "hardware", f"{w}; it joins when it comes") for w in absent(hardware, radio)
        ]
        reason = without_sequencer(config, table)
        if reason is not None:
            config = config.model_copy(update={"sequencer": None})
            opening.append(Opening(LogLevel.WARNING, "sequencer", f"sequencer is off for this session: {reason}"))
        edge = HardwareEdge(
            clock,
            hardware.bus,
            hardware.gnss,
            "real",
            hardware.autopilot,
            hardware.pulse,
            radio,
            storage=RealStorage(),
            heartbeat=devices.heartbeat,
            override=devices.autopilot,
        )
        outcome = run_until_signal(config, text, edge, opening)
        _LOG.info("%s", outcome.text)
        return outcome


def run_until_signal(config: LoggerConfig, text: str, edge: HardwareEdge, opening: list[Opening]) -> RecordingOutcome:
    """Run the logger in this process until SIGTERM or SIGINT, feeding the watchdog."""
    prepare_process(config.scan)
    notifier = Notifier()
    with (
        _signals() as stop,
        _short_switch_interval(),
        GarbageDiscipline(enabled=config.scan.garbage_in_slack) as garbage,
    ):
        seconds = count()

        def every_second() -> None:
            notifier.alive(_status_line(assembly) if next(seconds) % _STATUS_EVERY == 0 else "")
            garbage.collect()

        def stop_requested() -> bool:
            if not stop():
                return False
            notifier.stopping()  # first: closing a recording on a bad card may take longer than the watchdog waits
            return True

        assembly = assemble(config, text, edge, opening=opening, housekeeping=every_second)
        garbage.freeze()
        notifier.ready(f"recording {assembly.session}")
        try:
            statistics = assembly.logger.run(stop_requested)
        finally:
            notifier.close()
            if assembly.link is not None:
                assembly.link.uplink.close()
    return RecordingOutcome(statistics, config.recorder.directories[0] / assembly.session, stop.name)


def _status_line(assembly: Assembly) -> str:
    s = assembly.logger.statistics()
    if s is None:
        return "not recording"
    return f"{s.written} scans written, {s.dropped} dropped, {s.lost} lost; {assembly.sampler.health().words}"


def _preflight(
    config: LoggerConfig, clock: RealClock, hardware: Hardware, radio: BytePort | None, devices: Devices
) -> Preflight:
    sampler = Sampler(
        config.sensors,
        hardware.bus,
        hardware.gnss,
        clock,
        rate_hz=config.scan.rate_hz,
        autopilot=hardware.autopilot,
        pulse=hardware.pulse,
    )
    probe: Callable[[], RadioReport | None] | None = None
    if radio is not None:
        ours = config.downlink or DownlinkConfig()
        probe = partial(listen_to_radio, radio, clock, system_id=ours.system_id, component_id=ours.component_id)
    table = run_preflight(config, clock, sampler, RealStorage(), probe, devices)
    missing = (
        PreflightCheck("hardware", PreflightVerdict.CAUTION, f"{reason}; it joins when it comes")
        for reason in absent(hardware, radio)
    )
    return replace(table, checks=(*table.checks, *missing))


def _opening(table: Preflight | None, override: str | None) -> list[Opening]:
    """The first messages of the recording, on its preflight check; PreflightRefusal on a no-go without an override."""
    if table is None:
        return [Opening(LogLevel.WARNING, "preflight", "skipped by the operator")]
    if table.go:
        return [Opening(LogLevel.INFO, "preflight", "go")]
    reasons = "; ".join(f"{c.name}: {c.text}" for c in table.failed)
    if override is None:
        raise PreflightRefusal(f"no-go: {reasons}; correct it, or record all the same with --override REASON")
    return [Opening(LogLevel.WARNING, "preflight", f"no-go overridden ({override}): {reasons}")]


def without_sequencer(config: LoggerConfig, table: Preflight | None) -> str | None:
    """Why a configured sequencer is left out of this session; None when it need not be.

    An override is for recording in spite of a faulty sensor; it never admits a faulty sequencer, which moves the controls.
    """
    if config.sequencer is None:
        return None
    if table is None:
        return "the preflight check was skipped"
    faults = [f"{c.name}: {c.text}" for c in table.failed if c.of_sequencer]
    return "; ".join(faults) or None


class _Stop:
    """Becomes true at the first signal."""

    def __init__(self) -> None:
        self.name = ""

    def __call__(self) -> bool:
        return bool(self.name)

    def set(self, number: int, _: FrameType | None) -> None:
        self.name = signal.Signals(number).name


@contextmanager
def _signals() -> Iterator[_Stop]:
    stop = _Stop()
    handlers: dict[signal.Signals, Any] = {s: signal.signal(s, stop.set) for s in (signal.SIGTERM, signal.SIGINT)}
    handlers[signal.SIGHUP] = signal.signal(
        signal.SIGHUP, signal.SIG_IGN
    )  # the recording goes on when its terminal closes
    try:
        yield stop
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)


@contextmanager
def _short_switch_interval() -> Iterator[None]:
    """Return the interpreter lock to the scan loop within half a millisecond while other threads compute.

    Each bus transfer releases the lock, and there are some 45 in a scan: with Python's usual interval of 5 ms, a thread that
    lists files or compresses an answer would make a scan last four periods.
    """
    interval = sys.getswitchinterval()
    sys.setswitchinterval(_SWITCH_INTERVAL_S)
    try:
        yield
    finally:
        sys.setswitchinterval(interval)


@contextmanager
def _opened(config: LoggerConfig, clock: RealClock) -> Iterator[tuple[Hardware, BytePort | None, Devices]]:
    with ExitStack() as opened:
        hardware = open_hardware(config.sensors, clock)
        opened.callback(hardware.close)
        radio = _open_radio(config)
        if radio is not None:
            opened.callback(radio.close)
        yield hardware, radio, _devices(config, clock, hardware, opened)


def _devices(config: LoggerConfig, clock: RealClock, hardware: Hardware, opened: ExitStack) -> Devices:
    """The opened devices that the sequencer drives; none without a sequencer."""
    heartbeat = autopilot = None
    if config.sequencer is not None and config.sequencer.through == "ardupilot":
        autopilot = open_port(config.sequencer.autopilot.port)
        opened.callback(autopilot.close)
    elif config.sequencer is not None:
        heartbeat = FileHeartbeat(config.sequencer.heartbeat)
        opened.callback(heartbeat.close)
    return Devices(hardware.bus, heartbeat, clock, autopilot)


def absent(hardware: Hardware, radio: BytePort | None) -> list[str]:
    """A sentence on each device that was absent at the start."""
    radio_fault = radio.why_away if isinstance(radio, ReconnectingPort) else ""
    return [*hardware.absent, *([f"radio: {radio_fault}"] if radio_fault else [])]


def _open_radio(config: LoggerConfig) -> BytePort | None:
    return open_port(config.downlink.port) if config.downlink is not None and config.downlink.port else None
