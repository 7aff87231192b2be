"""The smallest interface where real and simulated hardware differ: one I2C bus and one serial port.

`I2cBus` is the part of `smbus2.SMBus` that the drivers call and `SerialPort` the part of `serial.Serial`; the real
classes satisfy both as they are, and a simulated aircraft supplies its own. Drivers are handed the object and never
learn which it is. Every failure on the wire arrives as `OSError` (pyserial's `SerialException` is one too).

Only the message type of smbus2 is used here, for the one chip that has no registers to address; opening a device is
left to `daq.sensors.open`.
"""

import errno
from collections.abc import Sequence
from functools import cache
from typing import Any, Protocol, runtime_checkable

from smbus2 import i2c_msg

BLOCK_LIMIT = 32
"""Longest SMBus block read or write [bytes]."""

NACK_ERRNOS = frozenset({errno.EREMOTEIO, errno.ENXIO, errno.EIO})
"""What Linux adapters report when nobody acknowledges: 121 (bcm2835), 6 (designware), 5 (clock-stretch upset)."""

TIMEOUT_ERRNOS = frozenset({errno.ETIMEDOUT, errno.EAGAIN, errno.EBUSY})
"""What Linux adapters report when SCL or SDA is held: 110, or 11 and 16 for lost arbitration and a busy bus."""


@runtime_checkable
class I2cBus(Protocol):
    """The calls of `smbus2.SMBus` (0.5 and later) that drivers use; each raises OSError when the transfer fails."""

    def read_byte_data(self, i2c_addr: int, register: int, /) -> int:
        """One byte from a register."""

    def write_byte_data(self, i2c_addr: int, register: int, value: int, /) -> None:
        """One byte to a register."""

    def read_i2c_block_data(self, i2c_addr: int, register: int, length: int, /) -> list[int]:
        """`length` bytes (at most 32) from consecutive registers in one transaction."""

    def write_i2c_block_data(self, i2c_addr: int, register: int, data: Sequence[int], /) -> None:
        """Bytes (at most 32) to consecutive registers in one transaction."""

    def i2c_rdwr(self, *i2c_msgs: Any) -> None:
        """One combined transaction of `smbus2.i2c_msg` messages; read messages are filled in place."""

    def close(self) -> None:
        """Release the bus."""


@runtime_checkable
class SerialPortCalls(Protocol):
    """The calls of `serial.Serial` that drivers use, the port opened non-blocking (`timeout=0`)."""

    @property
    def in_waiting(self) -> int:
        """Number of received bytes that a read returns without waiting."""

    def read(self, size: int = 1, /) -> bytes:
        """At most `size` received bytes; empty when there are none."""

    def write(self, data: bytes, /) -> int | None:
        """Queue bytes for sending; returns how many were taken."""

    def close(self) -> None:
        """Release the port."""


def read_raw(bus: I2cBus, address: int, count: int) -> bytes:
    """Read `count` bytes from a chip that has no register pointer (a plain read transaction)."""
    message = _reading(address, count)
    bus.i2c_rdwr(message)
    data: bytes = message.buf[:count]
    return data


@cache
def _reading(address: int, count: int) -> i2c_msg:
    """A message to be filled by a transfer, and again by the next; making one takes longer than sending it."""
    return i2c_msg.read(address, count)


def read_words(bus: I2cBus, address: int, one: int, other: int) -> tuple[int, int]:
    """Two registers of 16 bits in one transaction, the first byte of each the high one."""
    messages = _questions(address, one, other)
    bus.i2c_rdwr(*messages)
    (high, low), (high_of_other, low_of_other) = messages[1].buf[:2], messages[3].buf[:2]
    return high << 8 | low, high_of_other << 8 | low_of_other


@cache
def _questions(address: int, one: int, other: int) -> tuple[i2c_msg, ...]:
    return (
        *(i2c_msg.write(address, [one]), i2c_msg.read(address, 2)),
        *(i2c_msg.write(address, [other]), i2c_msg.read(address, 2)),
    )


def write_raw(bus: I2cBus, address: int, data: bytes) -> None:
    """Write bytes to a chip without a register byte of their own (a plain write transaction)."""
    bus.i2c_rdwr(i2c_msg.write(address, data))
