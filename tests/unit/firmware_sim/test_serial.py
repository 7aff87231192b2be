"""Serial ports: bytes come when their time has come, in memory and over a real pseudo-terminal; the GPS behind them."""

import struct

import pytest
import serial
from pymavlink.dialects.v20 import common

from firmware_sim.hardware.autopilots.servo_reports import Autopilot
from firmware_sim.hardware.registers import ublox
from firmware_sim.hardware.sensing.gnss import BAUD, GnssReceiver
from firmware_sim.hardware.sensing.instruments import Instruments
from firmware_sim.hardware.sensing.sensor_models import SensorModels
from firmware_sim.hardware.serial import BUFFER_BYTES, PseudoTerminal, SimulatedSerial
from tests.unit.firmware_sim.hardware import CountingClock, Still, truth_at_rest

START_UTC_NS = 1_780_000_000_000_000_000
QUIET = {"configured": True, "horizontal_m": 0.0, "vertical_m": 0.0, "velocity_m_s": 0.0, "clock_drift_ppm": 0.0}


def receiver(**gnss: object) -> GnssReceiver:
    truth = truth_at_rest(latitude=26.5, longitude=80.2, altitude=70.0, velocity_ned=(12.0, -3.0, 1.0))
    models = SensorModels().altered(gnss={**QUIET, **gnss})
    return GnssReceiver(Instruments(Still(truth), models, 1), START_UTC_NS)


class Chatter:
    """Sends a byte each millisecond and remembers what it hears."""

    def __init__(self) -> None:
        self.sent = 0
        self.heard = b""

    def bytes_until(self, now_ns: int) -> bytes:
        due = now_ns // 1_000_000
        data = bytes(i & 0xFF for i in range(self.sent, due))
        self.sent = due
        return data

    def receive(self, data: bytes, now_ns: int) -> None:
        self.heard += data


def test_in_memory() -> None:
    clock, talker = CountingClock(), Chatter()
    port = SimulatedSerial(talker, clock.monotonic_ns)
    assert port.read(10) == b""
    clock.wait_ms(5)
    assert port.in_waiting == 5
    assert port.read(3) == bytes((0, 1, 2))
    assert port.write(b"hello") == 5
    assert talker.heard == b"hello"
    clock.wait_ms(BUFFER_BYTES + 100)
    assert port.in_waiting == BUFFER_BYTES  # as a tty, it forgets what nobody reads
    assert port.overrun == 102
    port.close()
    with pytest.raises(OSError, match="closed"):
        port.read()


def test_over_a_real_pseudo_terminal() -> None:
    clock, talker = CountingClock(), Chatter()
    terminal = PseudoTerminal(talker)
    device = serial.Serial(terminal.path, 115_200, timeout=2.0)
    try:
        clock.wait_ms(256)
        terminal.pump(clock.now_ns)
        assert device.read(256) == bytes(range(256))  # all byte values pass: the line is raw
        device.write(bytes(range(256)))
        device.flush()
        terminal.pump(clock.now_ns)
        assert talker.heard == bytes(range(256))
    finally:
        device.close()
        terminal.close()


def test_a_fix_arrives_after_its_latency_byte_by_byte() -> None:
    gnss = receiver(latency_ms=50.0)
    assert gnss.bytes_until(150_000_000) == b""  # the fix of 100 ms leaves at 150 ms
    first = gnss.bytes_until(150_000_000 + round(49.5 * 10e9 / BAUD))
    assert len(first) == 49
    rest = gnss.bytes_until(150_000_000 + round(100.5 * 10e9 / BAUD))
    message = first + rest
    assert len(message) == 100
    assert message[-2:] == ublox.fletcher(message[2:-2])
    assert struct.unpack_from("<I", message, 6)[0] % 1000 == 100  # fixes lie on whole tenths of a GPS second
    assert struct.unpack_from("<3i", message, 6 + 48) == (12_000, -3_000, 1_000)


def test_rate_and_silence() -> None:
    assert len(receiver().bytes_until(1_060_000_000)) == 1000
    assert receiver(configured=False).bytes_until(3_000_000_000) == b""


def test_no_fix_is_said() -> None:
    gnss = receiver(first_fix_s=5.0)
    message = gnss.bytes_until(170_000_000)[:100]
    assert message[6 + 20] == 0
    assert message[6 + 11] == 0


def test_power_dip_costs_fixes_and_settings() -> None:
    gnss = receiver(configured=False)
    gnss.receive(ublox.frame((0x06, 0x01), bytes((0x01, 0x07, 1))), 0)
    assert ublox.frame((0x05, 0x01), b"\x06\x01") in gnss.bytes_until(1_000_000_000)
    assert len(gnss.bytes_until(1_070_000_000)) == 100
    gnss.set_power(False, 1_100_000_000)
    assert gnss.bytes_until(2_500_000_000) == b""
    gnss.set_power(True, 2_500_000_000)
    assert gnss.bytes_until(6_000_000_000) == b""  # it has forgotten that it should speak


def test_wandering_position_has_the_stated_spread() -> None:
    truth = truth_at_rest(latitude=0.0, longitude=0.0, altitude=0.0)
    models = SensorModels().altered(gnss={**QUIET, "horizontal_m": 2.0, "drift_time_s": 0.2})
    gnss = GnssReceiver(Instruments(Still(truth), models, 5), START_UTC_NS)
    data = b"".join(gnss.bytes_until(k * 100_000_000) for k in range(1500))
    north = [struct.unpack_from("<i", data, i + 6 + 28)[0] * 1e-7 * 111_195 for i in range(0, len(data) - 100, 100)]
    spread = (sum(n * n for n in north) / len(north)) ** 0.5
    assert spread == pytest.approx(2.0, rel=0.15)


def test_pulse_per_second_marks_whole_seconds_of_utc() -> None:
    """The logger's clock runs 4 ppm slow: after 100 s of it, UTC has gained 0.4 ms, and the edges come earlier by that."""
    gnss = receiver(clock_drift_ppm=4.0)
    for second in (1, 50, 100):
        edge = second * 1_000_000_000 - second * 4_000
        assert gnss.newest_pulse(edge - 1000) != gnss.newest_pulse(edge + 100_000)
        stamped = gnss.newest_pulse(edge + 100_000)
        assert stamped is not None
        assert 0 < stamped - edge < 20_000
    gnss.set_power(False, 100_500_000_000)
    assert gnss.newest_pulse(101_200_000_000) is None


def test_autopilot_is_understood_by_pymavlink() -> None:
    truth = truth_at_rest(pulses_us=(1500.0, 1234.4, 1000.0, 2000.0, 0.0, 1750.0))
    autopilot = Autopilot(Instruments(Still(truth), SensorModels(), 1))
    data = b"".join(autopilot.bytes_until(k * 10_000_000) for k in range(300))
    messages = common.MAVLink(None).parse_buffer(data)
    servo = [m for m in messages if m.get_type() == "SERVO_OUTPUT_RAW"]
    assert len(servo) == pytest.approx(60, abs=1)
    assert len([m for m in messages if m.get_type() == "HEARTBEAT"]) == 3
    widths = [getattr(servo[-1], f"servo{i}_raw") for i in range(1, 9)]
    assert widths == [1500, 1234, 1000, 2000, 0, 1750, 0, 0]
