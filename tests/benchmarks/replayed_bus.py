"""A sensor bus that answers with what was once recorded: lets the logger be measured without a simulator beside it."""

import json
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path
from typing import Any


class RecordingBus:
    """Passes calls on to a bus and keeps every answer by what was asked."""

    def __init__(self, bus: Any) -> None:
        self._bus = bus
        self.answers: dict[str, list[list[int]]] = defaultdict(list)

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
        path.write_text(json.dumps(self.answers))


class ReplayedBus:
    """Answers each question with the recorded answers in turn, the later half of them over and over."""

    def __init__(self, path: Path) -> None:
        self._answers: dict[str, list[list[int]]] = json.loads(path.read_text())
        self._turn: dict[str, int] = defaultdict(int)

    def _next(self, key: str) -> list[int]:
        answers = self._answers[key]
        turn = self._turn[key]
        self._turn[key] = turn + 1 if turn + 1 < len(answers) else len(answers) // 2
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
