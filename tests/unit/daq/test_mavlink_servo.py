"""Servo outputs from an autopilot, framed by pymavlink's own packer."""

import numpy as np
import pytest
from pymavlink.dialects.v10 import common as v1
from pymavlink.dialects.v20 import common as v2

from daq.contract.scan import SensorState
from daq.sensors.base import SelfTestError
from daq.sensors.capture import CaptureConfig
from daq.sensors.mavlink_servo import MavlinkServo, servo_frames
from tests.unit.daq.fakes import FakePort

WIDTHS = (1500, 1490, 1510, 1100, 1501, 1502, 0, 0)


def servo(dialect: object = v2, widths: tuple[int, ...] = WIDTHS, port: int = 0) -> bytes:
    link = dialect.MAVLink(None, srcSystem=1, srcComponent=1)  # type: ignore[attr-defined]
    return bytes(link.servo_output_raw_encode(123456, port, *widths).pack(link))


def heartbeat() -> bytes:
    link = v2.MAVLink(None, srcSystem=1, srcComponent=1)
    return bytes(link.heartbeat_encode(1, 3, 0, 0, 4).pack(link))


def make() -> tuple[MavlinkServo, FakePort, list[int]]:
    port, now = FakePort(), [10**9]
    return MavlinkServo(CaptureConfig(driver="mavlink_servo"), port, lambda: now[0]), port, now


@pytest.mark.parametrize("dialect", [v1, v2])
def test_widths_in_tenths_of_microseconds(dialect: object) -> None:
    driver, port, _ = make()
    port.received += heartbeat() + servo(dialect) + heartbeat()
    reading = driver.read()
    assert reading.state is SensorState.OK
    assert [reading.values[f"pwm_{i}"] for i in range(1, 7)] == [15000, 14900, 15100, 11000, 15010, 15020]
    assert "digital_1" not in reading.values


def test_undriven_output_is_unset_and_said() -> None:
    driver, port, _ = make()
    port.received += servo(widths=(1500, 0, 1500, 1500, 0, 0, 0, 0))
    reading = driver.read()
    assert reading.state is SensorState.OUT_OF_RANGE
    assert reading.detail == "autopilot does not drive pwm_2"
    assert set(reading.values) == {"pwm_1", "pwm_3", "pwm_4"}


def test_auxiliary_port_is_not_mistaken_for_the_main_one() -> None:
    driver, port, _ = make()
    port.received += servo(port=1)
    assert driver.read().state is SensorState.STALE


def test_silence_is_stale() -> None:
    driver, port, now = make()
    port.received += servo()
    driver.read()
    now[0] += 600_000_000
    assert driver.read().state is SensorState.STALE


def test_set_up_waits_for_the_message() -> None:
    driver, port, now = make()
    with pytest.raises(SelfTestError, match="no SERVO_OUTPUT_RAW"):
        for wait in driver.initialise():
            now[0] += wait
    setup = driver.initialise()
    now[0] += next(setup)
    port.received += servo()
    with pytest.raises(StopIteration):
        next(setup)


def test_only_damaged_frames_are_lost(rng: np.random.Generator) -> None:
    stream, intact = bytearray(), []
    for i in range(300):
        data = bytearray(servo(widths=(1000 + i, *WIDTHS[1:])))
        if rng.random() < 0.3:
            data[rng.integers(len(data))] ^= 1 << int(rng.integers(8))
        else:
            intact.append(1000 + i)
        stream += data + heartbeat()
    buffer, found = bytearray(), []
    for start in range(0, len(stream), 41):
        buffer += stream[start : start + 41]
        found += [int.from_bytes(p[4:6], "little") for p in servo_frames(buffer)]
    buffer += bytes(300)
    found += [int.from_bytes(p[4:6], "little") for p in servo_frames(buffer)]
    assert found == intact
