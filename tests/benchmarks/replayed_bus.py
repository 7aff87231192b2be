"""A sensor bus and a GPS port that answer with what was once recorded: the logger is measured without a simulator beside it."""

import json
import os
import time
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from ctypes import addressof, memmove
from itertools import cycle
from math import ceil
from pathlib import Path
from typing import Any

import smbus2

from daq.sensors import transfers
from daq.sensors.ubx import NAV_PVT, UbxParser, frame

# Status polls are answered "ready" once the scans run: the replay has no conversions that could be under way.
READY_BIT = {
    **{(address, 1, 2): 0x80 for address in (0x48, 0x49, 0x4A)},  # ADS1115 configuration
    (0x2A, 0x00, 1): 0x20,  # NAU7802 conversion ready
    (0x0C, 0x10, 9): 0x01,  # AK09916 data ready
    (0x77, 0x03, 7): 0x60,  # BMP390 pressure and temperature ready
    (0x68, 0x1A, 1): 0x01,  # ICM-20948 data ready
}

Question = tuple[int, int, int]
"""Address, register (-1 for a plain read) and length."""

Answers = dict[Question, list[list[int]]]

_FIX_INTERVAL_NS = 100_000_000


class RecordingBus:
    """Passes calls on to a bus and keeps every answer by what was asked."""

    def __init__(self, bus: Any) -> None:
        self._bus = bus
        self.setup: defaultdict[Question, list[list[int]]] = defaultdict(list)
        self.steady: defaultdict[Question, list[list[int]]] = defaultdict(list)
        self.answers = self.setup

    def scans_begin(self) -> None:
        """From here on the answers are those of scans."""
        self.answers = self.steady

    def read_byte_data(self, address: int, register: int, /) -> int:
        value: int = self._bus.read_byte_data(address, register)
        self.answers[address, register, 1].append([value])
        return value

    def read_i2c_block_data(self, address: int, register: int, length: int, /) -> list[int]:
        values: list[int] = self._bus.read_i2c_block_data(address, register, length)
        self.answers[address, register, length].append(values)
        return values

    def write_byte_data(self, address: int, register: int, value: int, /) -> None:
        self._bus.write_byte_data(address, register, value)

    def write_i2c_block_data(self, address: int, register: int, data: Sequence[int], /) -> None:
        self._bus.write_i2c_block_data(address, register, data)

    def i2c_rdwr(self, *messages: Any) -> None:
        self._bus.i2c_rdwr(*messages)
        for question, m in _questions(messages):
            self.answers[question].append(list(m))

    def close(self) -> None:
        self._bus.close()

    def save(self, path: Path, fix: bytes) -> None:
        """Keep the answers, and one NAV-PVT payload, as JSON."""
        for key, bits in READY_BIT.items():
            self.steady[key] = [a for a in self.steady[key] if a[0] & bits == bits]
        kept = {name: list(table.items()) for name, table in (("setup", self.setup), ("steady", self.steady))}
        path.write_text(json.dumps({**kept, "fix": fix.hex()}))


class RecordingPort:
    """Passes calls on to a serial port and keeps the newest NAV-PVT payload that came through it."""

    def __init__(self, port: Any) -> None:
        self._port = port
        self._parser = UbxParser()
        self.fix = b""

    @property
    def in_waiting(self) -> int:
        waiting: int = self._port.in_waiting
        return waiting

    def read(self, size: int = 1, /) -> bytes:
        data: bytes = self._port.read(size)
        for kind, payload in self._parser.feed(data):
            if kind == NAV_PVT:
                self.fix = payload
        return data

    def write(self, data: bytes, /) -> int | None:
        taken: int | None = self._port.write(data)
        return taken


class ReplayedBus:
    """Answers each question with the recorded answers in turn: those of the set-up once, those of scans over and over.

    It runs in the measured process, so an answer is one look-up and one step of a ready cycle.
    """

    def __init__(self, path: Path) -> None:
        kept = json.loads(path.read_text())
        self._setup: Answers = {tuple(key): answers for key, answers in kept["setup"]}
        self.scan_answers: Answers = {tuple(key): answers for key, answers in kept["steady"] if answers}
        self._scans: Answers = {**self._setup, **self.scan_answers}
        self._next = _in_turn(self._setup)

    def scans_begin(self) -> None:
        """From here on scans ask."""
        self._next = _in_turn(self._scans)

    def read_byte_data(self, address: int, register: int, /) -> int:
        return self._next[address, register, 1]()[0]

    def read_i2c_block_data(self, address: int, register: int, length: int, /) -> list[int]:
        return self._next[address, register, length]()

    def write_byte_data(self, address: int, register: int, value: int, /) -> None:
        pass

    def write_i2c_block_data(self, address: int, register: int, data: Sequence[int], /) -> None:
        pass

    def i2c_rdwr(self, *messages: Any) -> None:
        for question, m in _questions(messages):
            for i, byte in enumerate(self._next[question]()):
                m.buf[i] = byte

    def close(self) -> None:
        pass


class TimedBus(ReplayedBus):
    """A replayed bus whose transfers take time, in which the interpreter is given away as the kernel's driver gives it."""

    def __init__(self, path: Path, transfer_s: float) -> None:
        super().__init__(path)
        self._transfer_s = transfer_s

    def read_byte_data(self, address: int, register: int, /) -> int:
        time.sleep(self._transfer_s)
        return super().read_byte_data(address, register)

    def read_i2c_block_data(self, address: int, register: int, length: int, /) -> list[int]:
        time.sleep(self._transfer_s)
        return super().read_i2c_block_data(address, register, length)

    def write_byte_data(self, address: int, register: int, value: int, /) -> None:
        time.sleep(self._transfer_s)

    def write_i2c_block_data(self, address: int, register: int, data: Sequence[int], /) -> None:
        time.sleep(self._transfer_s)

    def i2c_rdwr(self, *messages: Any) -> None:
        time.sleep(self._transfer_s)
        super().i2c_rdwr(*messages)


class AnsweringKernel:
    """The real smbus2 upon answers: what it asks the kernel, a replayed bus answers, in less than any system call takes."""

    def __init__(self, bus: ReplayedBus) -> None:
        self._bus = bus
        self._address = 0
        self._kept: dict[int, tuple[Any, list[tuple[int, int, int, int]]]] = {}

    def open(self) -> smbus2.SMBus:
        """A bus of smbus2 whose calls come here; one a process."""
        made = smbus2.SMBus()
        made.fd = os.open(os.devnull, os.O_RDWR)
        made.funcs = smbus2.I2cFunc.I2C
        smbus2.smbus2.ioctl = transfers.ioctl = self._ioctl
        return made

    def _ioctl(self, fd: int, request: int, argument: Any) -> None:
        if request == smbus2.smbus2.I2C_SLAVE:
            self._address = argument
        elif request == smbus2.smbus2.I2C_RDWR:
            self._transact(argument)
        elif argument.read_write == smbus2.smbus2.I2C_SMBUS_READ:
            data = argument.data.contents
            if argument.size == smbus2.smbus2.I2C_SMBUS_BYTE_DATA:
                data.byte = self._bus.read_byte_data(self._address, argument.command)
            else:
                answer = bytes(self._bus.read_i2c_block_data(self._address, argument.command, data.byte))
                memmove(addressof(data) + 1, answer, len(answer))

    def _transact(self, data: Any) -> None:
        """Questions with their answers, taken apart once as the kernel does in C; the like comes again from who kept it."""
        if data.nmsgs == 1:
            self._bus.i2c_rdwr(*data.msgs[:1])
            return
        if id(data) not in self._kept:
            pairs = zip(data.msgs[: data.nmsgs : 2], data.msgs[1 : data.nmsgs : 2], strict=False)
            asked = [(q.addr, q.buf[0][0], a.len, addressof(a.buf.contents)) for q, a in pairs]
            self._kept[id(data)] = data, asked
        for address, register, length, at in self._kept[id(data)][1]:
            memmove(at, bytes(self._bus.read_i2c_block_data(address, register, length)), length)


def _questions(messages: Iterable[Any]) -> Iterator[tuple[Question, Any]]:
    """The messages that are read into, each with its address, the register written before it (-1: none) and its length."""
    register = -1
    for m in messages:
        if m.flags & 1:
            yield (m.addr, register, m.len), m
            register = -1
        else:
            register = m.buf[0][0] if m.len else -1


def _in_turn(answers: Answers) -> dict[Question, Callable[[], list[int]]]:
    return {question: cycle(given).__next__ for question, given in answers.items()}


class ReplayedReceiver:
    """A GPS port on which the recorded fix arrives ten times a second, with the time of its instant in it.

    The frames of `seconds` are made beforehand, so that their making is not counted as the logger's.
    """

    def __init__(self, path: Path, seconds: float) -> None:
        fix = bytearray.fromhex(json.loads(path.read_text())["fix"])
        begin = time.time_ns()
        self._frames = b"".join(_dated(fix, begin + i * _FIX_INTERVAL_NS) for i in range(ceil(seconds * 10)))
        self._length = len(frame(NAV_PVT, bytes(fix)))
        self._begin_ns = time.monotonic_ns() - (time.time_ns() - begin)
        self._at = 0

    @property
    def in_waiting(self) -> int:
        arrived = self._length * (1 + (time.monotonic_ns() - self._begin_ns) // _FIX_INTERVAL_NS)
        return min(arrived, len(self._frames)) - self._at

    def read(self, size: int = 1, /) -> bytes:
        data = self._frames[self._at : self._at + min(size, self.in_waiting)]
        self._at += len(data)
        return data

    def write(self, data: bytes, /) -> int | None:
        return len(data)

    def close(self) -> None:
        pass


def _dated(fix: bytearray, utc_ns: int) -> bytes:
    """The frame of a fix of another time."""
    t = time.gmtime(utc_ns // 10**9)
    fix[4:11] = t.tm_year.to_bytes(2, "little") + bytes(t[1:6])
    fix[16:20] = (utc_ns % 10**9).to_bytes(4, "little")
    return frame(NAV_PVT, bytes(fix))
