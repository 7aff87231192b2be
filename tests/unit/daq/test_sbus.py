"""SBUS: frames against a published one, the driver over a pseudo-terminal that is opened as the logger opens its port."""

import os
import termios
import time
from collections.abc import Iterator

import numpy as np
import pytest
from pydantic import ValidationError

from daq.clock import RealClock
from daq.contract.scan import SensorState
from daq.sensors.base import DriverContext, SelfTestError
from daq.sensors.capture import CaptureConfig
from daq.sensors.config import SensorsConfig
from daq.sensors.open import open_hardware
from daq.sensors.sbus import Sbus, SbusParser, parse_frame
from daq.sensors.timebase import TimeBase
from firmware_sim.hardware.registers.sbus import SbusReceiver, frame_of
from firmware_sim.hardware.serial import PseudoTerminal
from tests.unit.firmware_sim.hardware import steady

MS = 1_000_000
WIDTHS = (0.0011, 0.0015, 0.00188, 0.00102, 0.0015, 0.0019)
# all sticks centred at 992 counts: 992 = 0b01111100000, sixteen times, written out by hand for two channels and repeated
CENTRED = bytes.fromhex("0f" + "e0031ff8c0073ef0810f7c" * 2 + "0000")


class CountingReceiver(SbusReceiver):
    """How many bytes it has sent."""

    sent = 0

    def bytes_until(self, now_ns: int) -> bytes:
        data = super().bytes_until(now_ns)
        self.sent += len(data)
        return data


class Line:
    """A receiver behind a pseudo-terminal, and the driver on the port that the logger's own edge opened."""

    def __init__(self) -> None:
        self.now_ns = 10**9
        self.receiver = CountingReceiver(steady(*WIDTHS), self.now_ns)
        self.terminal = PseudoTerminal(self.receiver)
        config = SensorsConfig.model_validate({"capture": {"driver": "sbus", "device": self.terminal.path}})
        self.hardware = open_hardware(config, RealClock())
        context = DriverContext(
            None, None, self.hardware.autopilot, lambda: self.now_ns, TimeBase(0, 50 * MS), config.section
        )
        self.driver = Sbus.build("capture", context)

    def wait(self, duration_ns: int) -> None:
        """Let time pass, and the kernel carry the bytes from one side of the terminal to the other."""
        port = self.hardware.autopilot
        assert port is not None
        waiting, begun = port.in_waiting, self.receiver.sent
        self.now_ns += duration_ns
        self.terminal.pump(self.now_ns)
        until = time.monotonic() + 5.0
        while port.in_waiting < waiting + self.receiver.sent - begun and time.monotonic() < until:
            time.sleep(0.001)

    def set_up(self) -> None:
        for pause in self.driver.initialise():
            self.wait(pause)


@pytest.fixture
def line() -> Iterator[Line]:
    made = Line()
    yield made
    made.hardware.close()
    made.terminal.close()


def test_a_centred_frame_by_hand() -> None:
    frame = parse_frame(CENTRED)
    assert frame is not None
    assert frame == ((992,) * 16, False, False)
    assert frame_of((0.001495,) * 6, 0) == CENTRED


def test_widths_and_port_settings(line: Line) -> None:
    assert line.hardware.bus is None
    line.set_up()
    line.wait(50 * MS)
    reading = line.driver.read()
    assert reading.state is SensorState.OK
    assert [reading.values[f"pwm_{i}"] * 1e-7 for i in range(1, 7)] == pytest.approx(WIDTHS, abs=0.4e-6)
    assert reading.time_ns == line.now_ns - 10 * MS
    with open(os.open(line.terminal.path, os.O_RDONLY | os.O_NOCTTY), "rb") as file:
        flags = termios.tcgetattr(file)[2]
    assert flags & termios.CSTOPB
    assert line.driver.max_rate_hz < 1000 / 14


@pytest.mark.parametrize(
    ("flags", "state", "words"),
    [
        (0x04, SensorState.STALE, "lost a frame"),
        (0x0C, SensorState.OUT_OF_RANGE, "failsafe"),
        (0x08, SensorState.OUT_OF_RANGE, "failsafe"),
    ],
)  # fmt: skip
def test_flags(line: Line, flags: int, state: SensorState, words: str) -> None:
    line.set_up()
    line.receiver.flags = lambda now_ns: flags
    line.wait(50 * MS)
    reading = line.driver.read()
    assert reading.state is state
    assert words in reading.detail


def test_silence_and_return(line: Line) -> None:
    line.set_up()
    line.receiver.garble = lambda data, now_ns: b""
    line.wait(50 * MS)
    line.driver.read()
    line.wait(50 * MS)
    assert line.driver.read().state is SensorState.STALE
    line.wait(600 * MS)
    assert (line.driver.read().state, line.driver.read().detail) == (SensorState.ABSENT, "SBUS receiver is silent")
    line.receiver.garble = lambda data, now_ns: data
    line.wait(100 * MS)
    assert line.driver.read().state is SensorState.OK


def test_signal_that_is_not_inverted(line: Line) -> None:
    line.receiver.garble = lambda data, now_ns: bytes(b ^ 0xFF for b in data)
    with pytest.raises(SelfTestError, match="no SBUS: is the signal inverted"):
        line.set_up()


def test_lost_bytes_never_make_a_frame_of_other_values() -> None:
    rng = np.random.default_rng(8)
    parser, sent, taken = SbusParser(), [], []
    for _ in range(400):
        widths = tuple(rng.uniform(0.001, 0.002, 6))
        data = frame_of(widths, 0)
        sent.append(parse_frame(data))
        if rng.random() < 0.2:
            cut = int(rng.integers(0, 25))
            data = data[:cut] + data[cut + 1 :]
        taken += list(parser.feed(data))
    assert len(taken) > 200
    wrong = [frame for frame in taken if frame not in sent]
    assert len(wrong) <= len(taken) // 100


def test_beside_an_autopilot_it_is_refused() -> None:
    sections = {"autopilot": {}, "imu": {"driver": "autopilot"}, "capture": {"driver": "sbus"}}
    with pytest.raises(ValidationError, match="capture listens on a port of its own"):
        SensorsConfig.model_validate(sections)
    assert CaptureConfig(driver="sbus").device
