"""A sensor bus and a GPS port that answer with what was once recorded: the logger is measured without a simulator beside it."""

import json
import time
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path
from typing import Any

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
        for m in messages:
            if m.flags & 1:
                self.answers[m.addr, -1, m.len].append(list(m))

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
    """Answers each question with the recorded answers in turn: those of the set-up once, those of scans over and over."""

    def __init__(self, path: Path) -> None:
        kept = json.loads(path.read_text())
        self._setup: Answers = {tuple(key): answers for key, answers in kept["setup"]}
        steady: Answers = {tuple(key): answers for key, answers in kept["steady"]}
        self._scans: Answers = {**self._setup, **{k: v for k, v in steady.items() if v}}
        self._answers = self._setup
        self._turn: dict[Question, int] = defaultdict(int)

    def scans_begin(self) -> None:
        """From here on scans ask."""
        self._answers = self._scans
        self._turn.clear()

    def _next(self, question: Question) -> list[int]:
        answers = self._answers[question]
        turn = self._turn[question]
        self._turn[question] = (turn + 1) % len(answers)
        return answers[turn]

    def read_byte_data(self, address: int, register: int, /) -> int:
        return self._next((address, register, 1))[0]

    def read_i2c_block_data(self, address: int, register: int, length: int, /) -> list[int]:
        return self._next((address, register, length))

    def write_byte_data(self, address: int, register: int, value: int, /) -> None:
        pass

    def write_i2c_block_data(self, address: int, register: int, data: Sequence[int], /) -> None:
        pass

    def i2c_rdwr(self, *messages: Any) -> None:
        for m in messages:
            if m.flags & 1:
                for i, byte in enumerate(self._next((m.addr, -1, m.len))):
                    m.buf[i] = byte

    def close(self) -> None:
        pass


class ReplayedReceiver:
    """A GPS port on which the recorded fix arrives ten times a second, with the time of now in it."""

    def __init__(self, path: Path) -> None:
        self._fix = bytearray.fromhex(json.loads(path.read_text())["fix"])
        self._next_ns = time.monotonic_ns()
        self._bytes = b""

    @property
    def in_waiting(self) -> int:
        now = time.monotonic_ns()
        if now >= self._next_ns:
            self._next_ns += _FIX_INTERVAL_NS
            self._bytes += self._made_now()
        return len(self._bytes)

    def _made_now(self) -> bytes:
        utc = time.time_ns()
        t = time.gmtime(utc // 10**9)
        self._fix[4:11] = t.tm_year.to_bytes(2, "little") + bytes(t[1:6])
        self._fix[16:20] = (utc % 10**9).to_bytes(4, "little")
        return frame(NAV_PVT, bytes(self._fix))

    def read(self, size: int = 1, /) -> bytes:
        data, self._bytes = self._bytes[:size], self._bytes[size:]
        return data

    def write(self, data: bytes, /) -> int | None:
        return len(data)

    def close(self) -> None:
        pass
