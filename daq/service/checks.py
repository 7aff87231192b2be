"""Checks of the go/no-go table at rest: level attitude, no airspeed, age of an autopilot's samples, radio signal.

Each line has measured value, limit and remedy. A SiK radio reports its signal once a heartbeat has passed through it; the signal
in dBm is RSSI / 1.9 - 127 (SiK firmware, Si4463 scale).
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from enum import StrEnum
from itertools import pairwise

from daq.acquisition.air_truth import BROKEN_PA, OFFSET_PA, Scales, level, pitot_at_rest
from daq.clock import NS, Clock
from daq.config import LoggerConfig
from daq.contract.scan import Scan, SensorState
from daq.sensors.standstill import LEAST_SCANS, counts, motion_evidence
from daq.transport.mavlink_codec import RADIO_STATUS_ID, FrameDecoder, FrameEncoder, MavlinkFrame
from daq.transport.ports import BytePort


class PreflightVerdict(StrEnum):
    """Result of a preflight check."""

    GO = "go"
    CAUTION = "caution"
    NO_GO = "no-go"


@dataclass(frozen=True, slots=True)
class PreflightCheck:
    """One line of the table. of_sequencer: whether it concerns the sequencer, which moves the controls."""

    name: str
    verdict: PreflightVerdict
    text: str
    of_sequencer: bool = False


def graded(name: str, passed: bool, text: str, failure: PreflightVerdict = PreflightVerdict.NO_GO) -> PreflightCheck:
    """A line with GO where the check passed, otherwise with `failure`."""
    return PreflightCheck(name, PreflightVerdict.GO if passed else failure, text)


def rest_checks(config: LoggerConfig, scans: Sequence[Scan]) -> Iterator[PreflightCheck]:
    """Check level attitude and pitot offset; a caution instead of both while the aircraft moves."""
    scales = Scales(config.sensors)
    motion = motion_evidence(scans)
    if motion:
        yield PreflightCheck(
            "at rest",
            PreflightVerdict.CAUTION,
            f"{motion}: level and pitot zero were not looked at; leave the aircraft alone",
        )
        return
    attitude = level(scans, scales)
    if attitude is not None:
        yield graded("level", *attitude)
    if len(counts(scans, "pitot_pressure")) >= LEAST_SCANS:
        yield from _pitot(config, scans, scales)


def _pitot(config: LoggerConfig, scans: Sequence[Scan], scales: Scales) -> Iterator[PreflightCheck]:
    rest = pitot_at_rest(scans, scales)
    if rest is None:
        return
    reads = f"pitot reads {rest.words} while GPS and gyro say at rest (limit {OFFSET_PA:.0f} Pa)"
    if abs(rest.offset_pa) <= OFFSET_PA:
        yield PreflightCheck("pitot zero", PreflightVerdict.GO, reads)
    elif abs(rest.offset_pa) > BROKEN_PA:
        text = f"{reads}, more than any zero ({BROKEN_PA:.0f} Pa); look for a kinked tube, or correct sensors.pitot.range_pa"
        yield PreflightCheck("pitot zero", PreflightVerdict.NO_GO, text)
    elif not rest.steady:
        yield PreflightCheck(
            "pitot zero", PreflightVerdict.CAUTION, f"{reads}, unsteady: wind? Cover the tube and repeat, then zero it"
        )
    elif config.preflight.auto_zero:
        yield PreflightCheck(
            "pitot zero", PreflightVerdict.CAUTION, f"{reads}: zero it, or leave it at rest for 5 s and the logger does"
        )
    else:
        yield PreflightCheck("pitot zero", PreflightVerdict.NO_GO, f"{reads}: zero it (`zero` at the ground station)")


OLDEST_S = 0.15
"""Greatest age of an autopilot's samples [s]: three scans at 20 Hz; with older ones the sequencer would act on a past
attitude."""
_LEAST_SHARE = 0.9
"""Least share of scans with a new sample: an autopilot at three quarters of the scan rate leaves every fourth without one."""


def sender_checks(config: LoggerConfig, scans: Sequence[Scan], refusals: Mapping[str, str]) -> Iterator[PreflightCheck]:
    """Check rate and age of the samples of an autopilot. refusals: group -> which request it refused (`Sampler.refusals`)."""
    span_s = scans[-1].time - scans[0].time
    for group in config.sensors.from_sender:
        dated = [
            s
            for s in scans
            if group in s.groups and s.groups[group].state in (SensorState.OK, SensorState.OUT_OF_RANGE)
        ]
        stamps = sorted(round(s.time * 1e3 + s.groups[group].offset_us * 1e-3) for s in dated)
        if group == "gnss" or len(stamps) < 2:
            continue
        rate = sum(b - a > 1 for a, b in pairwise(stamps)) / span_s
        ages = sorted(-s.groups[group].offset_us * 1e-3 for s in dated)
        age = ages[int(0.95 * (len(ages) - 1))]
        least = _LEAST_SHARE * config.scan.rate_hz
        text = f"{rate:.1f} samples a second (at least {least:.0f}), 95 % no older than {age:.0f} ms (limit {OLDEST_S * 1e3:.0f})"
        passed = rate >= least and age <= OLDEST_S * 1e3
        if not passed:
            remedy = "raise the autopilot's stream and baud rate, or lower scan.rate_hz"
            text += f"; {refusals.get(group) or remedy}"
        failure = PreflightVerdict.NO_GO if config.sensors.section(group).required else PreflightVerdict.CAUTION
        yield graded(f"{group} time", passed, text, failure)


_STEP_NS = NS // 20
_READ_BYTES = 4096  # in a step: fourteen times what a radio at 57600 baud delivers in one
_FIXED_WING, _STANDBY, _MAVLINK_2 = 1, 3, 3  # MAV_TYPE, MAV_STATE, version in HEARTBEAT


@dataclass(frozen=True, slots=True)
class RadioReport:
    """A report of the radio: local and remote signal and noise [dBm], free share of its send buffer [%]."""

    rssi_dbm: float
    noise_dbm: float
    remote_rssi_dbm: float
    remote_noise_dbm: float
    free_percent: int


def listen_to_radio(
    port: BytePort, clock: Clock, *, seconds: float = 3.0, system_id: int = 1, component_id: int = 191
) -> RadioReport | None:
    """Send heartbeats and wait for the radio's report; None when none comes within `seconds` [s]."""
    decoder = FrameDecoder()
    encoder = FrameEncoder(system_id, component_id)
    start = now_ns = clock.monotonic_ns()
    next_heartbeat = start
    while now_ns - start < seconds * NS:
        with suppress(OSError):  # the port is away; it may come back
            if now_ns >= next_heartbeat:
                next_heartbeat += NS
                port.write(
                    encoder.message("HEARTBEAT", type=_FIXED_WING, system_status=_STANDBY, mavlink_version=_MAVLINK_2)
                )
            for item in decoder.feed(port.read(_READ_BYTES)):
                if isinstance(item, MavlinkFrame) and item.msg_id == RADIO_STATUS_ID:
                    return _report(item)
        clock.sleep_until(now_ns + _STEP_NS)
        now_ns = clock.monotonic_ns()
    return None


def _report(frame: MavlinkFrame) -> RadioReport:
    fields = frame.fields()
    dbm = {name: _dbm(fields[name]) for name in ("rssi", "noise", "remrssi", "remnoise")}
    return RadioReport(dbm["rssi"], dbm["noise"], dbm["remrssi"], dbm["remnoise"], int(str(fields["txbuf"])))


def _dbm(count: object) -> float:
    return int(str(count)) / 1.9 - 127
