"""Minimal stand-ins for chips on a bus: a register file with an auto-incrementing pointer, nothing more.

They are scripted by the test with bytes worked out from the datasheet, and share no code with drivers or simulator.
"""

import ctypes
import errno
from collections.abc import Callable, Sequence
from typing import Any

READ_FLAG = 0x0001


class FakeChip:
    """256 registers; `written` keeps every write; hooks may change registers before a read or after a write."""

    def __init__(self, registers: dict[int, int] | None = None) -> None:
        self.registers = bytearray(256)
        for register, value in (registers or {}).items():
            self.registers[register] = value
        self.written: list[tuple[int, int]] = []
        self.plain = b""  # answer to a read without a register
        self.before_read: Callable[[int], None] = lambda register: None
        self.after_write: Callable[[int, int], None] = lambda register, value: None

    def put(self, register: int, data: bytes | Sequence[int]) -> None:
        for i, value in enumerate(data):
            self.registers[register + i] = value

    def write(self, register: int, data: Sequence[int]) -> None:
        for i, value in enumerate(data):
            self.written.append((register + i, value))
            self.registers[register + i] = value
            self.after_write(register + i, value)

    def read(self, register: int, count: int) -> list[int]:
        self.before_read(register)
        return list(self.registers[register : register + count])


class WordChip(FakeChip):
    """A chip with 16-bit registers (ADS1115); `converted` gives the conversion register for a configuration word."""

    def __init__(self, converted: Callable[[int], int]) -> None:
        super().__init__()
        self.word = 0x8583
        self.converted = converted
        self.busy_polls = 0

    def write(self, register: int, data: Sequence[int]) -> None:
        assert register == 1
        self.word = data[0] << 8 | data[1]
        self.written.append((register, self.word))

    def read(self, register: int, count: int) -> list[int]:
        value = self.converted(self.word) & 0xFFFF
        if register == 1:
            value = self.word | 0x8000
            if self.busy_polls:
                self.busy_polls -= 1
                value &= 0x7FFF
        return [value >> 8, value & 0xFF]


class FakeBus:
    """The five `smbus2.SMBus` calls over fake chips; a missing chip does not acknowledge."""

    def __init__(self, chips: dict[int, FakeChip]) -> None:
        self.chips = chips
        self.held = False
        self.transfers = 0
        self.fail_next: list[int] = []  # errno of coming transfers, in turn
        self.on_transfer: Callable[[], None] = lambda: None

    def _chip(self, address: int) -> FakeChip:
        self.transfers += 1
        self.on_transfer()
        if self.held:
            raise OSError(errno.ETIMEDOUT, "Connection timed out")
        if self.fail_next:
            number = self.fail_next.pop(0)
            if number:
                raise OSError(number, "Remote I/O error")
        if address not in self.chips:
            raise OSError(errno.EREMOTEIO, "Remote I/O error")
        return self.chips[address]

    def read_byte_data(self, i2c_addr: int, register: int, /) -> int:
        return self._chip(i2c_addr).read(register, 1)[0]

    def write_byte_data(self, i2c_addr: int, register: int, value: int, /) -> None:
        self._chip(i2c_addr).write(register, [value])

    def read_i2c_block_data(self, i2c_addr: int, register: int, length: int, /) -> list[int]:
        assert 0 < length <= 32, "SMBus blocks have at most 32 bytes"
        return self._chip(i2c_addr).read(register, length)

    def write_i2c_block_data(self, i2c_addr: int, register: int, data: Sequence[int], /) -> None:
        assert 0 < len(data) <= 32, "SMBus blocks have at most 32 bytes"
        self._chip(i2c_addr).write(register, data)

    def i2c_rdwr(self, *i2c_msgs: Any) -> None:
        register = None
        for message in i2c_msgs:
            chip = self._chip(message.addr)
            if message.flags & READ_FLAG:
                answer = chip.plain if register is None else bytes(chip.read(register, message.len))
                ctypes.memmove(message.buf, answer[: message.len].ljust(message.len, b"\xff"), message.len)
            else:
                (register,) = bytes(message)

    def close(self) -> None:
        return


class FakePort:
    """A serial port in memory."""

    def __init__(self) -> None:
        self.received = bytearray()
        self.sent = bytearray()
        self.gone = False

    @property
    def in_waiting(self) -> int:
        if self.gone:
            raise OSError(errno.EIO, "Input/output error")
        return len(self.received)

    def read(self, size: int = 1, /) -> bytes:
        data = bytes(self.received[:size])
        del self.received[:size]
        return data

    def write(self, data: bytes, /) -> int:
        if self.gone:
            raise OSError(errno.EIO, "Input/output error")
        self.sent += data
        return len(data)

    def close(self) -> None:
        return
