"""The downlink: exact average rate, byte budget, heartbeat always, radio adaptation within bounds, honest books."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from pydantic import ValidationError

from daq.clock import NS, SimulatedClock
from daq.contract.link.wire import SCAN_FAST_ID, layouts, unpack_scan
from daq.contract.scan import GroupStatus, Scan, SensorState
from daq.telemetry.config import HEARTBEAT_BYTES, SCAN_FRAME_BYTES, DisplayConfig, DownlinkConfig
from daq.telemetry.downlink import Downlink
from daq.transport.mavlink_codec import FrameDecoder, MavlinkFrame, frames_of, padded
from daq.transport.signing import Signer
from firmware_sim.hardware.registers.bmp390 import calibration_bytes
from tests.support.link_rig import PERIOD_NS, quiet_scan, random_scan

KEY = bytes(range(32))
NEAR_THE_GROUND = {"static_pressure": 6_400_000, "static_temperature": 8_400_000}
"""Counts of a pressure chip with the coefficients of the simulated one."""


class Wire:
    """A port that takes so many bytes a call (None: all)."""

    def __init__(self, room: int | None = None) -> None:
        self.room = room
        self.data = b""

    def read(self, limit: int = 65536) -> bytes:
        return b""

    def write(self, data: bytes) -> int:
        taken = len(data) if self.room is None else min(self.room, len(data))
        self.data += data[:taken]
        return taken

    def close(self) -> None:
        pass


FIX = {"gnss_fix": 3, "latitude_e7": -899_999_999, "longitude_e7": -1_799_999_999, "height_msl_mm": -(2**30)}


def fly(downlink: Downlink, clock: SimulatedClock, seconds: float, *, worst: bool = False, first: int = 0) -> None:
    rng = np.random.default_rng(5)
    for n in range(first, first + round(seconds * 20)):
        clock.advance(PERIOD_NS)
        now = clock.monotonic_ns()
        scan: Scan = random_scan(n, rng, time_ns=now) if worst else quiet_scan(n, rng, time_ns=now)
        known = FIX if worst else NEAR_THE_GROUND  # a position that the receiver vouches for is sent too
        groups = {**scan.groups, "gnss": GroupStatus(SensorState.OK)} if worst else scan.groups
        scan = replace(scan, values={**scan.values, **known}, groups=groups)
        downlink.offer(scan)
        downlink.service(now)


def number_of(frame: MavlinkFrame) -> int:
    layout = layouts()[frame.msg_id]
    return unpack_scan(layout, padded(frame.payload, layout.size)).number


def frames(wire: Wire) -> list[MavlinkFrame]:
    return frames_of(FrameDecoder().feed(wire.data))


def make(wire: Wire, clock: SimulatedClock, *, signed: bool = False, **settings: object) -> Downlink:
    signer = Signer(KEY, clock.utc_ns, link_id=1) if signed else None
    config = DownlinkConfig(**settings)  # type: ignore[arg-type]
    return Downlink(config, wire, clock, boot=5, signer=signer, facts=lambda: {"static.nvm": calibration_bytes().hex()})


@pytest.mark.parametrize("rate", [2.0, 11.5, 12.0])
def test_average_rate_is_exact(rate: float) -> None:
    wire, clock = Wire(), SimulatedClock(NS)
    fly(make(wire, clock, rate_hz=rate), clock, 60)
    sent = sum(f.msg_id == SCAN_FAST_ID for f in frames(wire))
    assert abs(sent - 60 * rate) <= 1


@pytest.mark.parametrize("worst", [False, True])
def test_default_fits_a_signed_error_corrected_radio(worst: bool) -> None:
    wire, clock = Wire(), SimulatedClock(1_800_000_000 * NS)
    downlink = make(wire, clock, signed=True)
    fly(downlink, clock, 60, worst=worst)
    found = Counter(f.name for f in frames(wire))
    assert len(wire.data) <= 60 * 1636 + 600
    assert found["SCAN_FAST"] >= 60 * 11.5 - 1
    assert downlink.send_queue.scans_dropped == 0
    assert found["HEARTBEAT"] == 60
    for name, rate_hz in (("ATTITUDE", 0.4), ("GLOBAL_POSITION_INT", 0.4), ("GPS_RAW_INT", 0.2)):
        assert found[name] >= 0.9 * 60 * rate_hz - 1, found
    assert found["SCAN_SLOW"] >= 55
    assert found["SCAN_RARE"] >= 45
    assert max(len(f.raw) for f in frames(wire) if f.msg_id == SCAN_FAST_ID) <= SCAN_FRAME_BYTES


SHOWN = DisplayConfig(
    pitot_zero_count=8000,
    pitot_pa_per_count=1.0,
    alpha_zero_count=0,
    alpha_rad_per_count=1e-4,
    beta_zero_count=0,
    beta_rad_per_count=1e-4,
)
"""With numbers for all messages, so that all are sent; at rest in the tests, `quiet_scan` flies 150 Pa of pitot pressure."""


@pytest.mark.parametrize("rate", [11.0, 11.5, 12.0])
def test_all_standard_messages_together_leave_scans_their_rate_and_none_starves(rate: float) -> None:
    wire, clock = Wire(), SimulatedClock(1_800_000_000 * NS)
    downlink = make(wire, clock, signed=True, rate_hz=rate, display=SHOWN, supply_volts_per_count=0.1)
    fly(downlink, clock, 120)
    found = Counter(f.name for f in frames(wire))
    assert len(wire.data) <= 120 * 1636 + 600
    assert found["SCAN_FAST"] >= 120 * rate - 1
    assert downlink.send_queue.scans_dropped == 0
    assert found["HEARTBEAT"] == 120
    c = downlink.config
    often = {"VFR_HUD": c.display_rate_hz, "AOA_SSA": c.display_rate_hz, "GLOBAL_POSITION_INT": c.display_rate_hz}
    seldom = dict.fromkeys(("SCALED_PRESSURE", "SERVO_OUTPUT_RAW", "BATTERY_STATUS", "WIND_COV"), c.extra_rate_hz)
    status = {
        "SYS_STATUS": c.sys_status_rate_hz,
        "GPS_RAW_INT": c.gps_raw_rate_hz,
        "LINK_STATISTICS": c.statistics_rate_hz,
    }
    for name, wanted in {"ATTITUDE": c.attitude_rate_hz, **often, **seldom, **status}.items():
        late = 3 if name == "WIND_COV" else 1  # it is told when it has been seen for 20 s
        assert found[name] >= (0.95 if rate < 12 else 0.75) * 120 * wanted - late, (name, found)


def test_very_many_named_values_crowd_nothing_out() -> None:
    wire, clock = Wire(), SimulatedClock(1_800_000_000 * NS)
    downlink = make(wire, clock, signed=True)
    for i in range(64):
        downlink.messages.set_named(f"value_{i}", i)
    fly(downlink, clock, 60)
    found = Counter(f.name for f in frames(wire))
    assert found["SCAN_FAST"] >= 60 * 11.5 - 1
    assert found["NAMED_VALUE_FLOAT"] >= 20
    assert found["ATTITUDE"] >= 0.7 * 60 * 0.4 - 1
    assert found["SYS_STATUS"] >= 0.7 * 60 * 0.2 - 1


def test_a_station_has_seen_each_message_within_seconds() -> None:
    wire, clock = Wire(), SimulatedClock(1_800_000_000 * NS)
    fly(make(wire, clock, display=SHOWN, supply_volts_per_count=0.1), clock, 4)
    found = {f.name for f in frames(wire)}
    assert found >= {"VFR_HUD", "AOA_SSA", "GLOBAL_POSITION_INT", "BATTERY_STATUS", "SERVO_OUTPUT_RAW", "SYS_STATUS"}


def test_configuration_beyond_the_budget_is_refused_with_the_rate_that_fits() -> None:
    with pytest.raises(ValidationError, match=r"allows at most 13\.6 Hz"):
        DownlinkConfig(rate_hz=20)
    assert HEARTBEAT_BYTES == 34


def test_heartbeat_goes_on_through_a_port_that_hardly_takes_anything() -> None:
    wire, clock = Wire(room=7), SimulatedClock(NS)
    downlink = make(wire, clock)
    fly(downlink, clock, 30)
    found = Counter(f.name for f in frames(wire))
    # 7 bytes a scan are 140 bytes/s: a heartbeat of 21 bytes every second fits, most scans do not.
    assert found["HEARTBEAT"] >= 25
    assert downlink.send_queue.scans_dropped > 200
    assert len(downlink.sent) == found["SCAN_FAST"]


def test_sent_map_tells_sent_from_dropped_from_waiting() -> None:
    wire, clock = Wire(room=40), SimulatedClock(NS)
    downlink = make(wire, clock)
    fly(downlink, clock, 30)
    received = {number_of(f) for f in frames(wire) if f.msg_id == SCAN_FAST_ID}
    assert set(downlink.sent) == received
    assert downlink.settled < 599
    assert not {n for n in received if n > downlink.settled}


def test_dropped_frames_leave_no_gap_in_the_sequence() -> None:
    wire, clock = Wire(room=40), SimulatedClock(NS)
    fly(make(wire, clock), clock, 30)
    sequences: dict[int, list[int]] = {}
    for frame in frames(wire):
        sequences.setdefault(frame.component, []).append(frame.sequence)
    assert len(sequences) == 2  # stock messages and Sideslip's own
    for counts in sequences.values():
        assert all((b - a) & 255 == 1 for a, b in zip(counts, counts[1:], strict=False))


def test_rate_follows_the_radio_between_2_hz_and_the_configured_rate() -> None:
    wire, clock = Wire(), SimulatedClock(NS)
    downlink = make(wire, clock)
    fly(downlink, clock, 2)
    now = clock.monotonic_ns()
    downlink.radio_status(10, now)
    assert downlink.rate_hz == pytest.approx(5.75)
    downlink.radio_status(10, now + 1000)  # a burst of reports counts once
    assert downlink.rate_hz == pytest.approx(5.75)
    for i in range(1, 6):
        downlink.radio_status(0, now + i * NS)
    assert downlink.rate_hz == 2.0
    wire.data = b""
    fly(downlink, clock, 4, first=40)
    assert Counter(f.name for f in frames(wire))["HEARTBEAT"] == 4
    for i in range(30):
        downlink.radio_status(95, clock.monotonic_ns() + i * NS)
    assert downlink.rate_hz == 11.5


def test_a_silent_radio_is_not_feared_for_ever() -> None:
    wire, clock = Wire(), SimulatedClock(NS)
    downlink = make(wire, clock)
    fly(downlink, clock, 1)
    for i in range(5):
        downlink.radio_status(0, clock.monotonic_ns() + i * NS)
    fly(downlink, clock, 60, first=20)
    assert downlink.rate_hz == 11.5


def test_slow_parts_go_before_the_fast_part_of_the_same_scan() -> None:
    wire, clock = Wire(), SimulatedClock(NS)
    fly(make(wire, clock), clock, 5)
    slow = [i for i, f in enumerate(frames(wire)) if f.name == "SCAN_SLOW"]
    assert len(slow) >= 4
    for i in slow:
        following = next(f for f in frames(wire)[i:] if f.msg_id == SCAN_FAST_ID)
        assert number_of(frames(wire)[i]) == number_of(following)
