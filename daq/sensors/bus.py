"""The smallest interface where real and simulated hardware differ: one I2C bus and one serial port.

`I2cBus` is the part of `smbus2.SMBus` that drivers call, `SerialPortCalls` that of `serial.Serial`. The real classes satisfy
both, and the simulated aircraft has its own; drivers do not know which they use. Every failed transfer raises `OSError`
(pyserial's `SerialException` is one too). `daq.sensors.open` opens the devices.
"""

import errno
from collections.abc import Sequence
from functools import cache
from typing import Any, Protocol, runtime_checkable

from smbus2 import i2c_msg

BLOCK_LIMIT = 32
"""Longest SMBus block read or write [bytes]."""

NACK_ERRNOS = frozenset({errno.EREMOTEIO, errno.ENXIO, errno.EIO})
"""Errors of Linux adapters without an acknowledge: 121 (bcm2835), 6 (designware), 5 (clock-stretch upset)."""

TIMEOUT_ERRNOS = frozenset({errno.ETIMEDOUT, errno.EAGAIN, errno.EBUSY})
"""Errors of Linux adapters while SCL or SDA is held: 110; 11 and 16 for lost arbitration and a busy bus."""


@runtime_checkable
class I2cBus(Protocol):
    """The calls of `smbus2.SMBus` (0.5 and later) that drivers use; each raises OSError when the transfer fails."""

    def read_byte_data(self, i2c_addr: int, register: int, /) -> int:
        """Read one byte from a register."""

    def write_byte_data(self, i2c_addr: int, register: int, value: int, /) -> None:
        """Write one byte to a register."""

    def read_i2c_block_data(self, i2c_addr: int, register: int, length: int, /) -> list[int]:
        """Read `length` bytes (at most 32) from consecutive registers in one transaction."""

    def write_i2c_block_data(self, i2c_addr: int, register: int, data: Sequence[int], /) -> None:
        """Write bytes (at most 32) to consecutive registers in one transaction."""

    def i2c_rdwr(self, *i2c_msgs: Any) -> None:
        """Make one combined transaction of `smbus2.i2c_msg` messages; read messages are filled in place."""

    def close(self) -> None:
        """Release the bus."""


@runtime_checkable
class SerialPortCalls(Protocol):
    """The calls of `serial.Serial` that drivers use, the port opened non-blocking (`timeout=0`)."""

    @property
    def in_waiting(self) -> int:
        """Number of received bytes that a read returns without waiting."""

    def read(self, size: int = 1, /) -> bytes:
        """Return at most `size` received bytes, none when none have arrived."""

    def write(self, data: bytes, /) -> int | None:
        """Queue bytes for sending; returns how many were taken."""

    def close(self) -> None:
        """Release the port."""


def read_raw(bus: I2cBus, address: int, count: int) -> bytes:
    """Read `count` bytes from a chip that has no register pointer (a plain read transaction)."""
    message = _read_message(address, count)
    bus.i2c_rdwr(message)
    data: bytes = message.buf[:count]
    return data


@cache
def _read_message(address: int, count: int) -> i2c_msg:
    """A message that every transfer fills again; making one takes longer than sending it."""
    return i2c_msg.read(address, count)


def read_words(bus: I2cBus, address: int, first: int, second: int) -> tuple[int, int]:
    """Read two registers of 16 bits, high byte first, in one transaction."""
    messages = _word_messages(address, first, second)
    bus.i2c_rdwr(*messages)
    (high_1, low_1), (high_2, low_2) = messages[1].buf[:2], messages[3].buf[:2]
    return high_1 << 8 | low_1, high_2 << 8 | low_2


@cache
def _word_messages(address: int, first: int, second: int) -> tuple[i2c_msg, ...]:
    return (
        *(i2c_msg.write(address, [first]), i2c_msg.read(address, 2)),
        *(i2c_msg.write(address, [second]), i2c_msg.read(address, 2)),
    )


def write_raw(bus: I2cBus, address: int, data: bytes) -> None:
    """Write bytes to a chip without a register byte of their own (a plain write transaction)."""
    bus.i2c_rdwr(i2c_msg.write(address, data))
