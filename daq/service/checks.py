"""Lines of the go/no-go table: at rest an aircraft is level and has no airspeed, and its radio is heard.

Each line: measured, limit, what to do. A SiK radio reports its signal once it has seen a heartbeat pass; signal in dBm is
RSSI / 1.9 - 127 (SiK firmware, Si4463 scale).
"""

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from enum import StrEnum

from daq.acquisition.air_truth import BROKEN_PA, OFFSET_PA, Scales, level, pitot_at_rest
from daq.clock import NS, Clock
from daq.config import LoggerConfig
from daq.contract.scan import Scan
from daq.sensors.standstill import LEAST_SCANS, counts, unrest
from daq.transport.mavlink_codec import RADIO_STATUS_ID, FrameDecoder, FrameEncoder, MavlinkFrame
from daq.transport.ports import BytePort


class PreflightVerdict(StrEnum):
    """What a check says."""

    GO = "go"
    CAUTION = "caution"
    NO_GO = "no-go"


@dataclass(frozen=True, slots=True)
class PreflightCheck:
    """One line of the table. of_sequencer: it concerns what moves the controls."""

    name: str
    verdict: PreflightVerdict
    text: str
    of_sequencer: bool = False


def graded(name: str, passed: bool, text: str, failure: PreflightVerdict = PreflightVerdict.NO_GO) -> PreflightCheck:
    """A line that says go where it passed."""
    return PreflightCheck(name, PreflightVerdict.GO if passed else failure, text)


def rest_checks(config: LoggerConfig, scans: Sequence[Scan]) -> Iterator[PreflightCheck]:
    """Level attitude and pitot offset; a caution instead of them while something moves."""
    scales = Scales(config.sensors)
    motion = unrest(scans)
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


_STEP_NS = NS // 20
_READ_BYTES = 4096  # a step: more than fourteen times what a radio at 57600 baud brings
_FIXED_WING, _STANDBY, _MAVLINK_2 = 1, 3, 3


@dataclass(frozen=True, slots=True)
class RadioReport:
    """What was heard from the radio: local and remote signal and noise [dBm], share of the send buffer free [%]."""

    rssi_dbm: float
    noise_dbm: float
    remote_rssi_dbm: float
    remote_noise_dbm: float
    free_percent: int


def listen_to_radio(
    port: BytePort, clock: Clock, *, seconds: float = 3.0, system_id: int = 1, component_id: int = 191
) -> RadioReport | None:
    """Send heartbeats and wait for the radio's report; None when there is none within `seconds`, or no port."""
    decoder = FrameDecoder()
    encoder = FrameEncoder(system_id, component_id)
    start = now_ns = clock.monotonic_ns()
    next_heartbeat = start
    while now_ns - start < seconds * NS:
        with suppress(OSError):  # a port that is away at present
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
