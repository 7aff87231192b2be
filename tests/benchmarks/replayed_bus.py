"""A sensor bus that answers with what was once recorded: lets the logger be measured without a simulator beside it."""

import json
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path
from typing import Any

# Status polls are answered "ready" once the scans run: the replay has no conversions that could be under way.
READY_BIT = {
    **{f"block {address} 1 2": 0x80 for address in (0x48, 0x49, 0x4A)},  # ADS1115 configuration
    "byte 42 0": 0x20,  # NAU7802 conversion ready
    "byte 12 16": 0x01,  # AK09916 data ready
    "byte 119 3": 0x20,  # BMP390 pressure ready
}


class RecordingBus:
    """Passes calls on to a bus and keeps every answer by what was asked."""

    def __init__(self, bus: Any) -> None:
        self._bus = bus
        self.setup: defaultdict[str, list[list[int]]] = defaultdict(list)
        self.steady: defaultdict[str, list[list[int]]] = defaultdict(list)
        self.answers = self.setup

    def scans_begin(self) -> None:
        """From here on the answers are those of scans."""
        self.answers = self.steady

    def read_byte_data(self, address: int, register: int, /) -> int:
        value: int = self._bus.read_byte_data(address, register)
        self.answers[f"byte {address} {register}"].append([value])
        return value

    def read_i2c_block_data(self, address: int, register: int, length: int, /) -> list[int]:
        values: list[int] = self._bus.read_i2c_block_data(address, register, length)
        self.answers[f"block {address} {register} {length}"].append(values)
        return values

    def write_byte_data(self, address: int, register: int, value: int, /) -> None:
        self._bus.write_byte_data(address, register, value)

    def write_i2c_block_data(self, address: int, register: int, data: Sequence[int], /) -> None:
        self._bus.write_i2c_block_data(address, register, data)

    def i2c_rdwr(self, *messages: Any) -> None:
        self._bus.i2c_rdwr(*messages)
        for m in messages:
            if m.flags & 1:
                self.answers[f"raw {m.addr} {m.len}"].append(list(m))

    def close(self) -> None:
        self._bus.close()

    def save(self, path: Path) -> None:
        """Keep the answers as JSON."""
        for key, bit in READY_BIT.items():
            self.steady[key] = [a for a in self.steady[key] if a[0] & bit]
        path.write_text(json.dumps({"setup": self.setup, "steady": self.steady}))


class ReplayedBus:
    """Answers each question with the recorded answers in turn: those of the set-up once, those of scans over and over."""

    def __init__(self, path: Path) -> None:
        kept = json.loads(path.read_text())
        self._setup: dict[str, list[list[int]]] = kept["setup"]
        self._steady: dict[str, list[list[int]]] = kept["steady"]
        self._turn: dict[str, int] = defaultdict(int)
        self._scans = False

    def scans_begin(self) -> None:
        """From here on scans ask."""
        self._scans = True
        self._turn.clear()

    def _next(self, key: str) -> list[int]:
        answers = (self._steady if self._scans else self._setup).get(key) or self._setup[key]
        turn = self._turn[key]
        self._turn[key] = (turn + 1) % len(answers)
        return answers[turn]

    def read_byte_data(self, address: int, register: int, /) -> int:
        return self._next(f"byte {address} {register}")[0]

    def read_i2c_block_data(self, address: int, register: int, length: int, /) -> list[int]:
        return list(self._next(f"block {address} {register} {length}"))

    def write_byte_data(self, address: int, register: int, value: int, /) -> None:
        pass

    def write_i2c_block_data(self, address: int, register: int, data: Sequence[int], /) -> None:
        pass

    def i2c_rdwr(self, *messages: Any) -> None:
        for m in messages:
            if m.flags & 1:
                for i, byte in enumerate(self._next(f"raw {m.addr} {m.len}")):
                    m.buf[i] = byte

    def close(self) -> None:
        pass
