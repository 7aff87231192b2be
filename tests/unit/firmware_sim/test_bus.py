"""The simulated bus: the calls of smbus2, its timing, and its errors as Linux reports them."""

import errno
import inspect

import pytest
import smbus2
from smbus2 import i2c_msg

from firmware_sim.hardware.bus import BusModel, Disturbance, SimulatedBus
from tests.unit.firmware_sim.hardware import CountingClock


class Memory:
    """A 256-byte memory with a pointer."""

    def __init__(self) -> None:
        self.bytes = bytearray(range(256))
        self.pointer = 0
        self.here = True
        self.latched_ns = 0

    def answers(self, now_ns: int) -> bool:
        return self.here

    def write(self, data: bytes, now_ns: int) -> None:
        self.pointer = data[0]
        self.bytes[self.pointer : self.pointer + len(data) - 1] = data[1:]

    def read(self, count: int, now_ns: int) -> bytes:
        self.latched_ns = now_ns
        return bytes(self.bytes[self.pointer : self.pointer + count])

    def general_call(self, data: bytes, now_ns: int) -> None:
        self.bytes[:] = bytes(256)

    def set_power(self, on: bool, now_ns: int) -> None:
        self.here = on


def test_has_the_calls_of_smbus2_with_their_arguments() -> None:
    for name in (
        "read_byte_data",
        "write_byte_data",
        "read_i2c_block_data",
        "write_i2c_block_data",
        "i2c_rdwr",
        "close",
    ):
        real = inspect.signature(getattr(smbus2.SMBus, name)).parameters
        ours = inspect.signature(getattr(SimulatedBus, name)).parameters
        assert list(real) == list(ours)


def test_all_ways_to_move_bytes() -> None:
    chip = Memory()
    bus = SimulatedBus(CountingClock(), {0x50: chip})
    assert bus.read_byte_data(0x50, 7) == 7
    bus.write_byte_data(0x50, 7, 70)
    assert bus.read_i2c_block_data(0x50, 6, 3) == [6, 70, 8]
    bus.write_i2c_block_data(0x50, 10, [1, 2, 3])
    write, read = i2c_msg.write(0x50, [10]), i2c_msg.read(0x50, 3)
    bus.i2c_rdwr(write, read)
    assert list(read) == [1, 2, 3]
    bus.i2c_rdwr(i2c_msg.write(0x00, [0x06]))
    assert bus.read_byte_data(0x50, 0) == 0


def test_block_limit_of_smbus() -> None:
    bus = SimulatedBus(CountingClock(), {0x50: Memory()})
    with pytest.raises(ValueError, match="32"):
        bus.read_i2c_block_data(0x50, 0, 33)
    with pytest.raises(ValueError, match="32"):
        bus.write_i2c_block_data(0x50, 0, [0] * 33)


@pytest.mark.parametrize(("count", "microseconds"), [(14, 390.0), (9, 278.0), (1, 98.0)])
def test_wire_time_of_register_reads(count: int, microseconds: float) -> None:
    """Published budget of this bus at 400 kHz: 14 bytes 390 us, 9 bytes 278 us, 1 byte 98 us."""
    clock = CountingClock()
    bus = SimulatedBus(clock, {0x50: Memory()}, BusModel(overhead_us=0.0))
    bus.read_i2c_block_data(0x50, 0, count)
    assert clock.now_ns * 1e-3 == pytest.approx(microseconds, rel=0.05)
    assert bus.busy_ns == clock.now_ns


def test_slower_bus_and_overhead() -> None:
    times = []
    for model in (BusModel(overhead_us=0.0), BusModel(overhead_us=0.0, frequency_hz=100e3), BusModel(overhead_us=60.0)):
        clock = CountingClock()
        SimulatedBus(clock, {0x50: Memory()}, model).read_byte_data(0x50, 0)
        times.append(clock.now_ns)
    assert times[1] == pytest.approx(4 * times[0])
    assert times[2] - times[0] == pytest.approx(60_000)


def test_data_are_latched_within_the_transfer() -> None:
    clock, chip = CountingClock(), Memory()
    SimulatedBus(clock, {0x50: chip}, BusModel(overhead_us=50.0)).read_i2c_block_data(0x50, 0, 30)
    assert 50_000 < chip.latched_ns < clock.now_ns - 600_000


def test_nobody_there() -> None:
    clock = CountingClock()
    bus = SimulatedBus(clock, {})
    with pytest.raises(OSError, match="Remote I/O") as caught:
        bus.read_byte_data(0x50, 0)
    assert caught.value.errno == errno.EREMOTEIO
    assert clock.now_ns < 150_000  # a refused address costs next to nothing


def test_held_line_costs_the_timeout() -> None:
    clock = CountingClock()
    bus = SimulatedBus(clock, {0x50: Memory()}, BusModel(timeout_ms=10.0), lambda address, now: Disturbance(held=True))
    with pytest.raises(OSError, match="timed out") as caught:
        bus.read_byte_data(0x50, 0)
    assert caught.value.errno == errno.ETIMEDOUT
    assert clock.now_ns == pytest.approx(10e6, rel=0.02)


def test_stretched_transfer() -> None:
    times = []
    for stretch in (1.0, 5.0):
        clock = CountingClock()
        model = BusModel(overhead_us=0.0)
        bus = SimulatedBus(clock, {0x50: Memory()}, model, lambda address, now, s=stretch: Disturbance(stretch=s))
        bus.read_i2c_block_data(0x50, 0, 14)
        times.append(clock.now_ns)
    assert times[1] == pytest.approx(5 * times[0], rel=1e-3)


def test_closed() -> None:
    bus = SimulatedBus(CountingClock(), {0x50: Memory()})
    bus.close()
    with pytest.raises(OSError, match="Bad file"):
        bus.read_byte_data(0x50, 0)
