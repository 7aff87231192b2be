"""The go/no-go table before a flight: sensors, values, timing, clock, card and radio, each with a sentence.

Nothing is assumed from the configuration: sensors are scanned for some seconds, the card is written to, the radio is
listened to. A no-go refuses the recording unless a person overrides it, and the override goes into the recording.
"""

import contextlib
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import Any

from daq.acquisition.health import GroupHealth, HealthSummary
from daq.acquisition.sampler import Sampler
from daq.actuation.actuation import Devices, findings
from daq.clock import NS, Clock
from daq.config import LoggerConfig
from daq.contract.scan import Scan, SensorState
from daq.recorder.storage import Storage, in_memory
from daq.service.checks import PreflightCheck, PreflightVerdict, RadioReport, graded, rest_checks, sender_checks
from daq.service.cross_checks import cross_checks
from daq.transport.autopilot_requests import AUTOPILOT

_LEVEL_SCANS = 10  # half a second at 20 Hz
_FIX_3D = 3
_CLOCK_WAIT_S = 10.0  # an autopilot tells the time twice a second, and its clock is believed after some of them
_PROBE_BYTES = 64 * 1024
_PROBE_WRITES = 8
_BYTES_PER_SCAN = 480  # of an uncompressed recording, with its share of the index


@dataclass(frozen=True, slots=True)
class Preflight:
    """The whole table."""

    checks: tuple[PreflightCheck, ...]

    @property
    def go(self) -> bool:
        """Whether nothing forbids the flight."""
        return all(c.verdict is not PreflightVerdict.NO_GO for c in self.checks)

    @property
    def failed(self) -> tuple[PreflightCheck, ...]:
        """The checks that forbid it."""
        return tuple(c for c in self.checks if c.verdict is PreflightVerdict.NO_GO)

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


def run_preflight(
    config: LoggerConfig,
    clock: Clock,
    sampler: Sampler,
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
        *cross_checks(config, scans, sampler.metadata),
        *sender_checks(config, scans, sampler.refusals()),
        _timing_check(config, lateness_us),
        _clock_check(config, clock, scans[-1], int(sampler.metadata().get("gnss.rollovers", 0))),
        *(_card_checks(config, clock, storage)),
        _calibration_check(config),
        _radio_check(config, radio),
        *id_checks(config),
        *_sequencer_checks(config, clock, sampler, devices),
    ]
    return Preflight(tuple(checks))


def _scan_for_a_while(config: LoggerConfig, clock: Clock, sampler: Sampler) -> tuple[list[Scan], list[int]]:
    period = config.scan.period_ns
    start = clock.monotonic_ns() + period
    scans: list[Scan] = []
    lateness: list[int] = []
    for number in count():
        if number >= config.preflight.scans and not _clock_comes(scans, start):
            break
        deadline = start + number * period
        clock.sleep_until(deadline)
        lateness.append((clock.monotonic_ns() - deadline) // 1000)
        scans.append(sampler.finish(sampler.take(number, deadline)))
    return scans, lateness


def _clock_comes(scans: list[Scan], start_ns: int) -> bool:
    """Whether a receiver with a fix is still about to tell the time."""
    if scans[-1].time_utc_ns or scans[-1].time_monotonic_ns - start_ns > _CLOCK_WAIT_S * NS:
        return False
    return any(s.values.get("gnss_fix", 0) >= _FIX_3D for s in scans)


def _sensor_checks(summary: HealthSummary, scans: list[Scan]) -> Iterable[PreflightCheck]:
    if summary.bus_fault:
        yield PreflightCheck(
            "bus", PreflightVerdict.NO_GO, f"{summary.bus_fault}; look for a short or a chip without supply"
        )
    for health in summary.groups:
        if health.state is not SensorState.OFF:
            yield _sensor_check(health, scans)


def _sensor_check(health: GroupHealth, scans: list[Scan]) -> PreflightCheck:
    """A sensor passes when it is well at the end and was in nearly all of the second half of the scans.

    The attitude filter needs seconds to find its level, whatever the sensors do: of it the last scans count.
    """
    first = len(scans) - _LEVEL_SCANS if health.group == "attitude" else len(scans) // 2
    states = [s.groups[health.group].state for s in scans[max(0, first) :] if health.group in s.groups]
    ok_count = sum(1 for s in states if s is SensorState.OK)
    steady = bool(states) and ok_count >= 0.9 * len(states)
    failure = PreflightVerdict.NO_GO if health.required else PreflightVerdict.CAUTION
    if health.state is SensorState.OK and steady:
        return PreflightCheck(health.group, PreflightVerdict.GO, health.words)
    if health.state is SensorState.OK or (health.group == "gnss" and health.state is SensorState.STALE and ok_count):
        return PreflightCheck(
            health.group,
            PreflightVerdict.CAUTION,
            f"{health.words}, but well in only {ok_count} of {len(states)} scans",
        )
    return PreflightCheck(health.group, failure, health.words)


def _timing_check(config: LoggerConfig, lateness_us: list[int]) -> PreflightCheck:
    p99_ms = sorted(lateness_us)[int(0.99 * (len(lateness_us) - 1))] / 1000
    limit = config.preflight.lateness_p99_ms
    text = f"99 % of scans begin within {p99_ms:.2f} ms of their deadline (limit {limit:g} ms)"
    return graded("timing", p99_ms <= limit, text)


def _clock_check(config: LoggerConfig, clock: Clock, last: Scan, rolled_over: int = 0) -> PreflightCheck:
    limit = config.preflight.time_accuracy_ms
    failure = PreflightVerdict.NO_GO if config.preflight.require_time else PreflightVerdict.CAUTION
    if not last.time_utc_ns:
        return PreflightCheck(
            "clock", failure, "UTC is not known: no resolved GPS time yet; wait for a fix under open sky"
        )
    accuracy = last.utc_accuracy_ns / 1e6
    if accuracy > limit:
        text = (
            f"UTC is known to {accuracy:.2f} ms only (limit {limit:g} ms); wait, or connect the pulse-per-second line"
        )
        return PreflightCheck("clock", failure, text)
    if rolled_over:
        text = (
            f"UTC known to {accuracy:.3g} ms; the receiver's own date is {rolled_over * 1024} weeks early, its week number has"
            " rolled over: corrected in the recording; update its firmware"
        )
        return PreflightCheck("clock", PreflightVerdict.CAUTION, text)
    offset_s = (clock.utc_ns() - clock.monotonic_ns() + last.time_monotonic_ns - last.time_utc_ns) / NS
    if abs(offset_s) > 2:
        text = f"UTC known to {accuracy:.3g} ms; this computer's own clock is {offset_s:+.0f} s off, which file names will show"
        return PreflightCheck("clock", PreflightVerdict.CAUTION, text)
    return PreflightCheck("clock", PreflightVerdict.GO, f"UTC from GPS, known to {accuracy:.3g} ms")


def _card_checks(config: LoggerConfig, clock: Clock, storage: Storage) -> Iterable[PreflightCheck]:
    for i, directory in enumerate(config.recorder.directories):
        name = "card" if i == 0 else f"card {i + 1}"
        try:
            free = storage.free_bytes(directory)
            slowest_ms = _probe(storage, clock, directory / ".preflight")
        except OSError as error:
            failure = PreflightVerdict.NO_GO if i == 0 else PreflightVerdict.CAUTION
            yield PreflightCheck(name, failure, f"{directory}: cannot be written ({error.strerror or error})")
            continue
        hours = free / (_BYTES_PER_SCAN * config.scan.rate_hz) / 3600
        text = f"{directory}: {free / 1e6:.0f} MB free, enough for {hours:.1f} h; slowest write and sync {slowest_ms:.0f} ms"
        roomy = free >= config.preflight.free_space_mb * 1e6
        fast = slowest_ms <= config.preflight.write_latency_ms
        if not roomy:
            text += f" (at least {config.preflight.free_space_mb:g} MB wanted)"
        if not fast:
            text += f" (at most {config.preflight.write_latency_ms:g} ms wanted)"
        lasting = not in_memory(directory)
        if not lasting:
            text += "; it lies in memory and goes with the power: is the card mounted?"
        failure = PreflightVerdict.NO_GO if i == 0 and not (roomy and lasting) else PreflightVerdict.CAUTION
        yield graded(name, roomy and fast and lasting, text, failure)


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
    config: LoggerConfig, clock: Clock, sampler: Sampler, devices: Devices | None
) -> Iterable[PreflightCheck]:
    if config.sequencer is None:
        return
    if devices is None:
        yield PreflightCheck(
            "sequencer", PreflightVerdict.NO_GO, "nothing of it is open; set sequencer.heartbeat", True
        )
        return
    numbers = count(config.preflight.scans)

    def take_scan() -> Scan:
        return sampler.finish(sampler.take(next(numbers), clock.monotonic_ns()))

    for finding in findings(config.sequencer, devices, take_scan):
        yield PreflightCheck(
            finding.what,
            PreflightVerdict.GO if finding.well else PreflightVerdict.NO_GO,
            finding.text,
            of_sequencer=True,
        )


def _calibration_check(config: LoggerConfig) -> PreflightCheck:
    if config.calibration is None:
        return PreflightCheck(
            "calibration",
            PreflightVerdict.GO,
            "none is embedded (key calibration): the set at the ground station counts",
        )
    return PreflightCheck(
        "calibration", PreflightVerdict.GO, f"files of {config.calibration.name} will be embedded in every recording"
    )


def _radio_check(config: LoggerConfig, radio: Callable[[], RadioReport | None] | None) -> PreflightCheck:
    failure = PreflightVerdict.NO_GO if config.preflight.require_radio else PreflightVerdict.CAUTION
    if radio is None:
        required = config.preflight.require_radio
        return PreflightCheck("radio", failure if required else PreflightVerdict.GO, "no downlink configured")
    report = radio()
    if report is None:
        return PreflightCheck(
            "radio", failure, "nothing heard from the radio; is it powered, and is the ground station on?"
        )
    margin = min(report.rssi_dbm - report.noise_dbm, report.remote_rssi_dbm - report.remote_noise_dbm)
    limit = config.preflight.radio_margin_db
    text = f"signal {margin:.0f} dB above noise at the weaker end (limit {limit:g} dB), buffer {report.free_percent} % free"
    return graded("radio", margin >= limit, text, failure)


def id_checks(config: LoggerConfig) -> Iterator[PreflightCheck]:
    """Nothing, or that the downlink would speak as the autopilot beside it: a station then takes two senders for one, and one
    of them for lost."""
    ours, sensors = config.downlink, config.sensors
    beside = bool(sensors.from_sender) or (config.sequencer is not None and config.sequencer.through == "ardupilot")
    if ours is not None and beside and AUTOPILOT in (ours.component_id, ours.data_component_id):
        words = f"component {AUTOPILOT} is the autopilot's own: leave out downlink.component_id (191) and data_component_id (192)"
        yield PreflightCheck("radio ids", PreflightVerdict.CAUTION, words)
