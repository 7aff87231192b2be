"""The simulated sensor bus: the `smbus2.SMBus` calls that drivers use, served by simulated chips.

Every transfer advances the clock by its time on the wire plus that of the software, so that channels are read at realistic
offsets within a scan. Errors are those of Linux: a chip that does not acknowledge raises OSError(EREMOTEIO), a line held low
OSError(ETIMEDOUT) after the adapter's time-out.
Timing: nine clocks for each byte, two for start and stop (NXP UM10204 rev. 7, 3.1).
"""

import ctypes
import errno
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NoReturn

from pydantic import Field

from daq.clock import SimulatedClock
from firmware_sim.hardware.registers.chip import PoweredChip
from firmware_sim.tables import SimulatorTable

READ_FLAG = 0x0001  # I2C_M_RD of linux/i2c.h
GENERAL_CALL = 0x00
BLOCK_LIMIT = 32  # bytes in one SMBus block transfer


class BusModel(SimulatorTable):
    """Scenario table `[bus]`: how fast the bus and the machine behind it are."""

    frequency_hz: float = Field(default=400e3, gt=0.0, description="clock of the bus [Hz]")
    overhead_us: float = Field(default=60.0, ge=0.0, description="system call and driver time of each transfer [us]")
    timeout_ms: float = Field(
        default=10.0, gt=0.0, description="time after which the adapter gives up on a held line [ms]"
    )


@dataclass(frozen=True, slots=True)
class Disturbance:
    """The effect of a fault on one transfer."""

    refused: bool = False  # the address is not acknowledged
    held: bool = False  # a line is held low: the adapter times out
    stretch: float = 1.0  # the transfer takes this many times as long


def _no_disturbance(address: int, now_ns: int) -> Disturbance | None:
    return None


Message = Any  # smbus2.i2c_msg, or anything with addr, flags, len and buf


class SimulatedBus:
    """An I2C bus with chips on it, called as `smbus2.SMBus` is.

    chips: 7-bit address -> chip. disturb: (address, time [ns]) -> disturbance of a transfer, None for an undisturbed one.
    transfers, busy_ns: count and total duration of all transfers so far.
    """

    def __init__(
        self,
        clock: SimulatedClock,
        chips: Mapping[int, PoweredChip],
        model: BusModel | None = None,
        disturb: Callable[[int, int], Disturbance | None] = _no_disturbance,
    ) -> None:
        model = model or BusModel()
        self.chips = dict(chips)
        self.transfers = 0
        self.busy_ns = 0
        self.clock = clock
        self.disturb = disturb
        self.bit_ns = 1e9 / model.frequency_hz
        self.overhead_ns = model.overhead_us * 1e3
        self.timeout_ns = round(model.timeout_ms * 1e6)
        self._closed = False

    def read_byte_data(self, i2c_addr: int, register: int, force: bool | None = None) -> int:
        """One byte of a register."""
        return self._transfer(i2c_addr, bytes([register]), 1)[0]

    def write_byte_data(self, i2c_addr: int, register: int, value: int, force: bool | None = None) -> None:
        """One byte to a register."""
        self._transfer(i2c_addr, bytes([register, value]), 0)

    def read_i2c_block_data(self, i2c_addr: int, register: int, length: int, force: bool | None = None) -> list[int]:
        """Up to 32 bytes from a register on."""
        if not 0 < length <= BLOCK_LIMIT:
            raise ValueError(f"Desired block length over {BLOCK_LIMIT} bytes")
        return list(self._transfer(i2c_addr, bytes([register]), length))

    def write_i2c_block_data(
        self, i2c_addr: int, register: int, data: Sequence[int], force: bool | None = None
    ) -> None:
        """Up to 32 bytes to a register and those after it."""
        if len(data) > BLOCK_LIMIT:
            raise ValueError(f"Data length cannot exceed {BLOCK_LIMIT} bytes")
        self._transfer(i2c_addr, bytes([register, *data]), 0)

    def i2c_rdwr(self, *i2c_msgs: Message) -> None:
        """Messages in one transaction with repeated starts; read messages are filled in place."""
        with self._transaction() as transaction:
            for message in i2c_msgs:
                if message.flags & READ_FLAG:
                    _fill(message, transaction.segment(message.addr, None, message.len))
                else:
                    transaction.segment(message.addr, bytes(list(message)), 0)

    def close(self) -> None:
        """Close the bus; later transfers raise as on a closed file."""
        self._closed = True

    def __enter__(self) -> "SimulatedBus":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def set_power(self, on: bool) -> None:
        """Power all chips on or off at once, as a dip of the sensor supply does."""
        for chip in self.chips.values():
            chip.set_power(on, self.clock.monotonic_ns())

    def _transfer(self, address: int, data: bytes | None, count: int) -> bytes:
        with self._transaction() as transaction:
            return transaction.segment(address, data, count)

    def _transaction(self) -> "_Transaction":
        if self._closed:
            raise OSError(errno.EBADF, os.strerror(errno.EBADF))
        return _Transaction(self)


class _Transaction:
    """One bus transaction: its segments have their times within it; at its end the clock is advanced by its duration."""

    def __init__(self, bus: SimulatedBus) -> None:
        self._bus = bus
        self._start_ns = bus.clock.monotonic_ns()
        self._elapsed_ns = bus.overhead_ns

    def __enter__(self) -> "_Transaction":
        return self

    def __exit__(self, *_: object) -> None:
        duration_ns = round(self._elapsed_ns)
        self._bus.busy_ns += duration_ns
        self._bus.clock.advance(duration_ns)

    @property
    def _now_ns(self) -> int:
        return self._start_ns + round(self._elapsed_ns)

    def segment(self, address: int, data: bytes | None, count: int) -> bytes:
        """One addressed write, one read, or a write and a read joined by a repeated start."""
        bus = self._bus
        bus.transfers += 1
        bit_ns = bus.bit_ns
        disturbance = bus.disturb(address, self._now_ns)
        if disturbance is not None:
            if disturbance.held:
                self._elapsed_ns += bus.timeout_ns
                raise OSError(errno.ETIMEDOUT, os.strerror(errno.ETIMEDOUT))
            if disturbance.refused:
                self._refuse()
            bit_ns *= disturbance.stretch
        if address == GENERAL_CALL:
            return self._general_call(data or b"")
        chip = bus.chips.get(address)
        if chip is None or not chip.answers(self._now_ns):
            self._refuse()
        if data is not None:
            self._elapsed_ns += _bits(len(data)) * bit_ns
            chip.write(data, self._now_ns)
        if count == 0:
            return b""
        self._elapsed_ns += 10.0 * bit_ns  # start and address; the chip latches its data here
        answer = chip.read(count, self._now_ns)
        self._elapsed_ns += (_bits(count) - 10.0) * bit_ns
        return answer

    def _general_call(self, data: bytes) -> bytes:
        self._elapsed_ns += _bits(len(data)) * self._bus.bit_ns
        for chip in self._bus.chips.values():
            if chip.answers(self._now_ns):
                chip.general_call(data, self._now_ns)
        return b""

    def _refuse(self) -> NoReturn:
        self._elapsed_ns += 11.0 * self._bus.bit_ns
        raise OSError(errno.EREMOTEIO, os.strerror(errno.EREMOTEIO))


def _bits(byte_count: int) -> float:
    """Clock periods of a segment: address and bytes of nine each, start and stop."""
    return 9.0 * (byte_count + 1) + 2.0


def _fill(message: Message, data: bytes) -> None:
    ctypes.memmove(message.buf, data, len(data))
