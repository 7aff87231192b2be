"""The go/no-go table before a flight: sensors, values, timing, clock, card and radio, each with a sentence.

Nothing is assumed from the configuration: sensors are scanned for some seconds, the card is written to, the radio is
listened to. A no-go refuses the recording unless a person overrides it, and the override goes into the recording.
"""

import contextlib
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import Any

from daq.acquisition.health import GroupHealth, HealthSummary
from daq.actuation.devices import Devices
from daq.actuation.trials import findings
from daq.clock import NS, Clock
from daq.config import LoggerConfig
from daq.contract.scan import Scan, SensorState
from daq.logger import SensorSource
from daq.recorder.storage import Storage, in_memory
from daq.service.checks import Check, Verdict
from daq.service.rest_checks import rest_checks

_LEVEL_SCANS = 10  # half a second at 20 Hz
_PROBE_BYTES = 64 * 1024
_PROBE_WRITES = 8
_BYTES_PER_SCAN = 480  # of an uncompressed recording, with its share of the index


@dataclass(frozen=True, slots=True)
class Preflight:
    """The whole table."""

    checks: tuple[Check, ...]

    @property
    def go(self) -> bool:
        """Whether nothing forbids the flight."""
        return all(c.verdict is not Verdict.NO_GO for c in self.checks)

    @property
    def failed(self) -> tuple[Check, ...]:
        """The checks that forbid it."""
        return tuple(c for c in self.checks if c.verdict is Verdict.NO_GO)

    def text(self) -> str:
        """The table for people."""
        rows = [f"{c.verdict.value:>8}  {c.name:<16} {c.text}" for c in self.checks]
        return "\n".join([*rows, f"{'GO' if self.go else 'NO-GO'}"])

    def to_dict(self) -> dict[str, Any]:
        """The JSON object of `preflight --json`."""
        return {
            "go": self.go,
            "checks": [{"check": c.name, "verdict": c.verdict.value, "text": c.text} for c in self.checks],
        }


@dataclass(frozen=True, slots=True)
class RadioReport:
    """What was heard from the radio: local and remote signal and noise [dBm], share of the send buffer free [%]."""

    rssi_dbm: float
    noise_dbm: float
    remote_rssi_dbm: float
    remote_noise_dbm: float
    free_percent: int


def run_preflight(
    config: LoggerConfig,
    clock: Clock,
    sampler: SensorSource,
    storage: Storage,
    radio: Callable[[], RadioReport | None] | None = None,
    devices: Devices | None = None,
) -> Preflight:
    """Carry out all checks; takes the time of `preflight.scans` scans and a few writes.

    radio: listens to the radio and reports, None when nothing was heard; left out where no radio is fitted.
    devices: what the sequencer drives, where one is configured; its trial then takes another second or two.
    """
    sampler.start()
    scans, lateness_us = _scan_for_a_while(config, clock, sampler)
    summary = sampler.health()
    checks = [
        *_sensor_checks(summary, scans),
        *rest_checks(config, scans),
        _timing_check(config, lateness_us),
        _clock_check(config, clock, scans[-1]),
        *(_card_checks(config, clock, storage)),
        _calibration_check(config),
        _radio_check(config, radio),
        *_sequencer_checks(config, clock, sampler, devices),
    ]
    return Preflight(tuple(checks))


def _scan_for_a_while(config: LoggerConfig, clock: Clock, sampler: SensorSource) -> tuple[list[Scan], list[int]]:
    period = config.scan.period_ns
    start = clock.monotonic_ns() + period
    scans, lateness = [], []
    for number in range(config.preflight.scans):
        deadline = start + number * period
        clock.sleep_until(deadline)
        lateness.append((clock.monotonic_ns() - deadline) // 1000)
        scans.append(sampler.finish(sampler.take(number, deadline)))
    return scans, lateness


def _sensor_checks(summary: HealthSummary, scans: list[Scan]) -> Iterable[Check]:
    if summary.bus_fault:
        yield Check("bus", Verdict.NO_GO, f"{summary.bus_fault}; look for a short or a chip without supply")
    for health in summary.groups:
        if health.state is not SensorState.OFF:
            yield _sensor_check(health, scans)


def _sensor_check(health: GroupHealth, scans: list[Scan]) -> Check:
    """A sensor passes when it is well at the end and was in nearly all of the second half of the scans.

    The attitude filter needs seconds to find its level, whatever the sensors do: of it the last scans count.
    """
    since = len(scans) - _LEVEL_SCANS if health.group == "attitude" else len(scans) // 2
    states = [s.groups[health.group].state for s in scans[max(0, since) :] if health.group in s.groups]
    well = sum(1 for s in states if s is SensorState.OK)
    steady = bool(states) and well >= 0.9 * len(states)
    bad = Verdict.NO_GO if health.required else Verdict.CAUTION
    if health.state is SensorState.OK and steady:
        return Check(health.group, Verdict.GO, health.words)
    if health.state is SensorState.OK or (health.group == "gnss" and health.state is SensorState.STALE and well):
        return Check(health.group, Verdict.CAUTION, f"{health.words}, but well in only {well} of {len(states)} scans")
    return Check(health.group, bad, health.words)


def _timing_check(config: LoggerConfig, lateness_us: list[int]) -> Check:
    worst = sorted(lateness_us)[int(0.99 * (len(lateness_us) - 1))] / 1000
    limit = config.preflight.lateness_p99_ms
    text = f"99 % of scans begin within {worst:.2f} ms of their deadline (limit {limit:g} ms)"
    return Check("timing", Verdict.GO if worst <= limit else Verdict.NO_GO, text)


def _clock_check(config: LoggerConfig, clock: Clock, last: Scan) -> Check:
    limit = config.preflight.time_accuracy_ms
    bad = Verdict.NO_GO if config.preflight.require_time else Verdict.CAUTION
    if not last.time_utc_ns:
        return Check("clock", bad, "UTC is not known: no resolved GPS time yet; wait for a fix under open sky")
    accuracy = last.utc_accuracy_ns / 1e6
    if accuracy > limit:
        text = (
            f"UTC is known to {accuracy:.2f} ms only (limit {limit:g} ms); wait, or connect the pulse-per-second line"
        )
        return Check("clock", bad, text)
    off = (clock.utc_ns() - clock.monotonic_ns() + last.time_monotonic_ns - last.time_utc_ns) / NS
    if abs(off) > 2:
        text = (
            f"UTC known to {accuracy:.3g} ms; this computer's own clock is {off:+.0f} s off, which file names will show"
        )
        return Check("clock", Verdict.CAUTION, text)
    return Check("clock", Verdict.GO, f"UTC from GPS, known to {accuracy:.3g} ms")


def _card_checks(config: LoggerConfig, clock: Clock, storage: Storage) -> Iterable[Check]:
    for i, directory in enumerate(config.recorder.directories):
        name = "card" if i == 0 else f"card {i + 1}"
        try:
            free = storage.free_bytes(directory)
            slowest_ms = _probe(storage, clock, directory / ".preflight")
        except OSError as error:
            bad = Verdict.NO_GO if i == 0 else Verdict.CAUTION
            yield Check(name, bad, f"{directory}: cannot be written ({error.strerror or error})")
            continue
        hours = free / (_BYTES_PER_SCAN * config.scan.rate_hz) / 3600
        text = f"{directory}: {free / 1e6:.0f} MB free, enough for {hours:.1f} h; slowest write and sync {slowest_ms:.0f} ms"
        enough = free >= config.preflight.free_space_mb * 1e6
        fast = slowest_ms <= config.preflight.write_latency_ms
        if not enough:
            text += f" (at least {config.preflight.free_space_mb:g} MB wanted)"
        if not fast:
            text += f" (at most {config.preflight.write_latency_ms:g} ms wanted)"
        lasting = not in_memory(directory)
        if not lasting:
            text += "; it lies in memory and goes with the power: is the card mounted?"
        bad = Verdict.NO_GO if i == 0 and not (enough and lasting) else Verdict.CAUTION
        verdict = Verdict.GO if enough and fast and lasting else bad
        yield Check(name, verdict, text)


def _probe(storage: Storage, clock: Clock, path: Path) -> float:
    """Slowest of a few writes with sync [ms]; the file is removed again."""
    slowest = 0
    with contextlib.suppress(FileNotFoundError):
        storage.remove(path)  # left behind when the power went during a check
    file = storage.create(path)
    try:
        for _ in range(_PROBE_WRITES):
            started = clock.monotonic_ns()
            file.write(bytes(_PROBE_BYTES))
            file.sync()
            slowest = max(slowest, clock.monotonic_ns() - started)
    finally:
        file.close()
        storage.remove(path)
    return slowest / 1e6


def _sequencer_checks(
    config: LoggerConfig, clock: Clock, sampler: SensorSource, devices: Devices | None
) -> Iterable[Check]:
    if config.sequencer is None:
        return
    if devices is None:
        yield Check("sequencer", Verdict.NO_GO, "nothing of it is open; set sequencer.heartbeat", True)
        return
    numbers = count(config.preflight.scans)

    def take_scan() -> Scan:
        return sampler.finish(sampler.take(next(numbers), clock.monotonic_ns()))

    for finding in findings(config.sequencer, devices, take_scan):
        yield Check(finding.what, Verdict.GO if finding.well else Verdict.NO_GO, finding.text, of_sequencer=True)


def _calibration_check(config: LoggerConfig) -> Check:
    if config.calibration is None:
        return Check("calibration", Verdict.CAUTION, "no calibration files: the recording will not carry its own")
    return Check("calibration", Verdict.GO, f"files of {config.calibration.name} will be embedded in every recording")


def _radio_check(config: LoggerConfig, radio: Callable[[], RadioReport | None] | None) -> Check:
    bad = Verdict.NO_GO if config.preflight.require_radio else Verdict.CAUTION
    if radio is None:
        wanted = config.preflight.require_radio
        return Check("radio", bad if wanted else Verdict.GO, "no downlink configured")
    report = radio()
    if report is None:
        return Check("radio", bad, "nothing heard from the radio; is it powered, and is the ground station on?")
    margin = min(report.rssi_dbm - report.noise_dbm, report.remote_rssi_dbm - report.remote_noise_dbm)
    limit = config.preflight.radio_margin_db
    text = f"signal {margin:.0f} dB above noise at the weaker end (limit {limit:g} dB), buffer {report.free_percent} % free"
    return Check("radio", Verdict.GO if margin >= limit else bad, text)
