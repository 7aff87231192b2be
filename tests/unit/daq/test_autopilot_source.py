"""An autopilot as the source of samples, spoken by pymavlink at its other end: values, times, rates, refusals."""

import math
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v10 import common as v1
from pymavlink.dialects.v20 import common as v2

from daq.contract.channels import CHANNEL_BY_NAME
from daq.contract.scan import SensorState
from daq.sensors.autopilot import AutopilotGroup, MavlinkServo
from daq.sensors.autopilot_line import AutopilotLine, SenderClock, frames
from daq.sensors.base import Driver, DriverContext, SelfTestError
from daq.sensors.config import SensorsConfig, build_drivers
from daq.sensors.timebase import TimeBase
from tests.unit.daq.fakes import FakePort

WIDTHS = (1500, 1490, 1510, 1100, 1501, 1502, 0, 0)
MS, SECOND = 1_000_000, 1_000_000_000
BOOT_MS = 71_000
ALL = ("imu", "mag", "attitude", "pitot", "static", "capture", "gnss")


class Wire:
    """Drivers of groups, and pymavlink as the autopilot of system 7, whose clock began BOOT_MS before ours."""

    def __init__(self, *groups: str, table: dict[str, Any] | None = None, dialect: Any = v2) -> None:
        self.port, self.now_ns = FakePort(), SECOND
        sections = table or {"autopilot": {"device": "ttyX"}, **{g: {"driver": "autopilot"} for g in groups}}
        self.config = SensorsConfig.model_validate(sections)
        self.timebase = TimeBase(0, 50 * MS)
        context = DriverContext(None, None, self.port, lambda: self.now_ns, self.timebase, self.config.section)
        self.drivers: dict[str, Driver] = build_drivers(self.config, context)
        self.mav = dialect.MAVLink(None, srcSystem=7, srcComponent=1)

    @property
    def boot_ms(self) -> int:
        return BOOT_MS + self.now_ns // MS

    def say(self, message: Any) -> None:
        self.port.received += message.pack(self.mav)

    def beat(self) -> None:
        self.say(self.mav.heartbeat_encode(1, 3, 0, 0, 4))

    def servo(self, widths: tuple[int, ...] = WIDTHS, port: int = 0, boot_ms: int | None = None) -> None:
        stamp = (self.boot_ms if boot_ms is None else boot_ms) * 1000 & 0xFFFFFFFF
        self.say(self.mav.servo_output_raw_encode(stamp, port, *widths))

    def asked(self) -> list[Any]:
        data, self.port.sent = bytes(self.port.sent), bytearray()
        return v2.MAVLink(None).parse_buffer(data) or []


def capture(dialect: Any = v2) -> tuple[Wire, MavlinkServo]:
    wire = Wire(table={"capture": {"driver": "mavlink_servo"}}, dialect=dialect)
    driver = wire.drivers["capture"]
    assert isinstance(driver, MavlinkServo)
    return wire, driver


@pytest.mark.parametrize("dialect", [v1, v2])
def test_widths_in_tenths_of_microseconds(dialect: object) -> None:
    wire, driver = capture(dialect)
    wire.beat()
    wire.servo()
    reading = driver.read()
    assert reading.state is SensorState.OK
    assert [reading.values[f"pwm_{i}"] for i in range(1, 7)] == [15000, 14900, 15100, 11000, 15010, 15020]
    assert "digital_1" not in reading.values


def test_undriven_output_is_unset_and_said() -> None:
    wire, driver = capture()
    wire.servo((1500, 0, 1500, 1500, 0, 0, 0, 0))
    reading = driver.read()
    assert reading.state is SensorState.OUT_OF_RANGE
    assert reading.detail == "autopilot does not drive pwm_2"
    assert set(reading.values) == {"pwm_1", "pwm_3", "pwm_4"}


def test_auxiliary_port_and_other_components_are_not_the_autopilot() -> None:
    wire, driver = capture()
    wire.servo(port=1)
    wire.mav.srcComponent = 154
    wire.servo()
    assert driver.read().state is SensorState.STALE


def test_set_up_waits_for_the_message() -> None:
    wire, driver = capture()
    with pytest.raises(SelfTestError, match="no SERVO_OUTPUT_RAW"):
        for wait in driver.initialise():
            wire.now_ns += wait
    setup = driver.initialise()
    wire.now_ns += next(setup)
    wire.servo()
    with pytest.raises(StopIteration):
        next(setup)


def test_a_report_is_as_old_as_the_sender_says() -> None:
    wire, driver = capture()
    for _ in range(30):  # prompt ones: the clock is known
        wire.servo()
        wire.now_ns += 4 * MS
        driver.read()
        wire.now_ns += 31 * MS
    sent_ms, sent_ns = wire.boot_ms, wire.now_ns
    wire.now_ns += 160 * MS  # it lay in a buffer
    wire.servo((1700, *WIDTHS[1:]), boot_ms=sent_ms)
    reading = driver.read()
    assert reading.values["pwm_1"] == 17000
    assert reading.time_ns is not None
    assert abs(reading.time_ns - sent_ns) < 5 * MS
    wire.now_ns += 120 * MS  # nothing new: it stands, and grows old
    assert driver.read().time_ns == reading.time_ns
    wire.now_ns += 400 * MS
    stale = driver.read()
    assert stale.state is SensorState.STALE
    assert "0.7 s old" in stale.detail


def test_answers_to_timesync_tell_the_way_there_from_the_way_back() -> None:
    """25 ms there and 5 ms back: arrivals alone would put everything 5 ms late, an even split 10 ms early."""
    clock, true_offset = SenderClock(), -BOOT_MS * MS
    rng = np.random.default_rng(4)
    for k in range(200):
        now = SECOND + k * 50 * MS
        sent = now - 5 * MS - int(rng.uniform(0, 40e6))
        clock.stamp(sent - true_offset, now)
        if k % 5 == 0:
            asked = now - 50 * MS
            clock.answered(asked + 5 * MS + int(rng.uniform(0, 8e6)) - true_offset, asked, now)
    assert abs(clock.offset_ns - true_offset) < 2 * MS
    assert abs(clock.offset_ns - true_offset) <= clock.accuracy_ns


def test_stamps_that_wrap_and_a_restart() -> None:
    wire, driver = capture()
    wrap_ms = 2**32 // 1000
    start_ns = wire.now_ns
    for _ in range(40):
        wire.servo(boot_ms=wrap_ms - 1000 + (wire.now_ns - start_ns) // MS)
        reading = driver.read()
        assert reading.time_ns is not None
        assert abs(reading.time_ns - wire.now_ns) < 6 * MS
        wire.now_ns += 50 * MS
    for start_ms in (30_000_000 % wrap_ms, 100, 900):  # the last one within a second of the one before it
        for k in range(30):
            wire.servo(boot_ms=start_ms + 50 * k)
            reading = driver.read()
            wire.now_ns += 50 * MS
        assert reading.time_ns is not None
        assert abs(reading.time_ns - wire.now_ns) < 60 * MS


def test_only_damaged_frames_are_lost(rng: np.random.Generator) -> None:
    wire, _ = capture()
    stream, intact = bytearray(), []
    for i in range(300):
        wire.port.received.clear()
        wire.servo((1000 + i, *WIDTHS[1:]))
        data = bytearray(wire.port.received)
        if rng.random() < 0.3:
            data[rng.integers(len(data))] ^= 1 << int(rng.integers(8))
        else:
            intact.append(1000 + i)
        stream += data + wire.mav.sys_status_encode(0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0).pack(wire.mav)
    buffer, found = bytearray(), []
    for start in range(0, len(stream), 41):
        buffer += stream[start : start + 41]
        found += [int.from_bytes(p[4:6], "little") for *_, p in frames(buffer)]
    buffer += bytes(300)
    found += [int.from_bytes(p[4:6], "little") for *_, p in frames(buffer)]
    assert found == intact


def test_every_group_in_si() -> None:
    wire = Wire(*ALL)
    wire.beat()
    force, rate, field = (0.5, -1.25, -9.4), (0.31, -0.02, 0.11), (0.21, -0.05, 0.43)
    boot_ms = wire.boot_ms
    wire.say(wire.mav.highres_imu_encode(boot_ms * 1000, *force, *rate, *field, 950.2, 4.0, 500.0, 31.5, 0xFFFF))
    wire.say(wire.mav.attitude_encode(boot_ms, 0.3, -0.1, 2.5, *rate))
    wire.say(wire.mav.scaled_pressure_encode(boot_ms, 951.234, 1.875, 2550))
    wire.say(wire.mav.gps_raw_int_encode(0, 3, 1, 1, 1, 70, 80, 0, 0, 11, h_acc=900, v_acc=1500, vel_acc=120))
    wire.say(wire.mav.global_position_int_encode(boot_ms, 265_000_001, 802_000_002, 151_250, 0, 1234, -567, 89, 0))
    wire.say(wire.mav.system_time_encode(1_780_000_000_000_000, boot_ms))
    wire.servo()
    values, facts = {}, {}
    for group, driver in wire.drivers.items():
        reading = driver.read()
        assert reading.state is SensorState.OK, (group, reading.detail)
        assert reading.time_ns is not None
        values.update(reading.values)
        facts[group] = driver.metadata()
        assert facts[group]["stamped"] == "sender"
    row = CHANNEL_BY_NAME
    for axis, f, w, m in zip("xyz", force, rate, field, strict=True):
        assert values[f"accel_{axis}"] * float(facts["imu"]["accel_scale_m_s2"]) == pytest.approx(f, abs=2e-3)
        assert values[f"gyro_{axis}"] * float(facts["imu"]["gyro_scale_rad_s"]) == pytest.approx(w, abs=2e-4)
        assert values[f"mag_{axis}"] * (row[f"mag_{axis}"].scale or 0) == pytest.approx(m * 1e-4, abs=1e-7)
    w, x, y, z = (values[f"quaternion_{a}"] / 32767 for a in "wxyz")
    assert math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)) == pytest.approx(0.3, abs=1e-4)
    assert math.asin(2 * (w * y - z * x)) == pytest.approx(-0.1, abs=1e-4)
    assert math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)) == pytest.approx(2.5, abs=1e-4)
    pitot = values["pitot_pressure"] * float(facts["pitot"]["scale_pa"]) + float(facts["pitot"]["offset_pa"])
    assert pitot == pytest.approx(187.5, abs=0.6)
    assert values["static_pressure"] * float(facts["static"]["scale_pa"]) == pytest.approx(95123.4, abs=0.02)
    assert (values["gnss_fix"], values["height_msl_mm"], values["velocity_north_mm"]) == (3, 151_250, 12_340)
    assert (values["horizontal_accuracy_mm"], values["speed_accuracy_mm"]) == (900, 120)
    assert wire.timebase.utc(wire.now_ns)[0] / 1e9 == pytest.approx(1_780_000_000, abs=0.02)
    assert wire.drivers["gnss"].read().values == {}  # a fix is in one scan only


def test_rough_imu_where_there_is_no_fine_one() -> None:
    wire = Wire("imu")
    wire.beat()
    driver = wire.drivers["imu"]
    driver.read()
    command = next(m for m in wire.asked() if m.get_type() == "COMMAND_LONG")
    assert (command.command, command.param1, command.param2) == (511, 105.0, pytest.approx(33_333, abs=1))
    wire.say(wire.mav.command_ack_encode(511, 3))
    wire.now_ns += 50 * MS
    driver.read()
    command = next(m for m in wire.asked() if m.get_type() == "COMMAND_LONG")
    assert command.param1 == 27.0
    wire.say(wire.mav.raw_imu_encode(wire.boot_ms * 1000, 0, 0, -1000, 500, 0, 0, 0, 0, 0))
    reading = driver.read()
    assert reading.values["accel_z"] == -4096
    assert reading.values["gyro_x"] == round(math.degrees(0.5) * 65.5)


def test_a_denied_rate_is_said_with_its_cure_and_a_slower_one_asked() -> None:
    wire = Wire("attitude")
    wire.beat()
    driver = wire.drivers["attitude"]
    driver.read()
    wire.asked()
    wire.say(wire.mav.statustext_encode(4, b"Requested rate for message ID 30 too fast. Increase"))
    wire.say(wire.mav.command_ack_encode(511, 2))
    wire.now_ns += 50 * MS
    driver.read()
    command = next(m for m in wire.asked() if m.get_type() == "COMMAND_LONG")
    assert (command.param1, command.param2) == (30.0, 50_000.0)
    assert "ATTITUDE at 30 Hz is denied: SCHED_LOOP_RATE of at least 38 grants it (Requested rate" in driver.refusal


def test_groups_of_one_message_ask_for_it_once() -> None:
    wire = Wire("pitot", "static")
    wire.beat()
    for driver in wire.drivers.values():
        assert isinstance(driver, AutopilotGroup)
        driver.read()
        wire.say(wire.mav.command_ack_encode(511, 0))
        wire.say(wire.mav.scaled_pressure_encode(wire.boot_ms, 950.0, 0.0, 2000))
    assert sum(m.get_type() == "COMMAND_LONG" for m in wire.asked()) == 1


def test_time_before_a_fix_is_no_time() -> None:
    wire = Wire("gnss")
    wire.say(wire.mav.system_time_encode(4_000_000, wire.boot_ms))
    wire.say(wire.mav.global_position_int_encode(wire.boot_ms, 1, 2, 3, 0, 0, 0, 0, 0))
    wire.say(wire.mav.gps_raw_int_encode(0, 1, 0, 0, 0, 0, 0, 0, 0, 0))
    reading = wire.drivers["gnss"].read()
    assert reading.state is SensorState.RECOVERING
    assert wire.timebase.utc(wire.now_ns) == (0, 0)


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ({"imu": {"driver": "autopilot"}}, "imu comes from the autopilot; add"),
        (
            {"autopilot": {}, "imu": {"driver": "autopilot"}, "capture": {"driver": "mavlink_servo"}},
            "capture listens on a port of its own",
        ),
    ],
)
def test_configurations_that_have_no_line(table: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        SensorsConfig.model_validate(table)


def test_junk_never_raises(rng: np.random.Generator) -> None:
    port, now = FakePort(), [SECOND]
    line = AutopilotLine(port, lambda: now[0], "ttyX")
    for _ in range(200):
        port.received += rng.integers(0, 256, 300, np.uint8).tobytes()
        line.poll()
        now[0] += 50 * MS
