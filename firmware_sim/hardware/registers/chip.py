"""What register-based chips have in common: a pointer that a write sets and that runs on while bytes are moved."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

Inputs = Callable[[int], Sequence[float] | NDArray[np.float64]]
"""Physical inputs of a chip at a monotonic time [ns]; each chip says which and in which units."""


def never(now_ns: int) -> bool:
    """No, at any time."""
    return False


class PoweredChip(ABC):
    """A chip on the bus that answers while it has power, and comes up with its reset values. Times: the bus's clock [ns].

    frozen: whether its measuring part has died at a time, so that it goes on answering with its last sample.
    """

    frozen: Callable[[int], bool]

    def __init__(self) -> None:
        self.powered = True
        self.frozen = never

    def answers(self, now_ns: int) -> bool:
        """Whether the chip acknowledges its address now."""
        return self.powered

    @abstractmethod
    def write(self, data: bytes, now_ns: int) -> None:
        """Take the bytes of one write."""

    @abstractmethod
    def read(self, count: int, now_ns: int) -> bytes:
        """The bytes of one read."""

    def general_call(self, data: bytes, now_ns: int) -> None:
        """Take bytes sent to everybody."""
        return

    def set_power(self, on: bool, now_ns: int) -> None:
        """Power comes or goes."""
        if on and not self.powered:
            self.reset(now_ns)
        self.powered = on

    def reset(self, now_ns: int) -> None:
        """Bring all registers to their reset values."""
        raise NotImplementedError


class RegisterChip(PoweredChip):
    """A chip with 8-bit registers and an auto-incrementing pointer."""

    def __init__(self) -> None:
        super().__init__()
        self._pointer = 0

    def write(self, data: bytes, now_ns: int) -> None:
        if not data:
            return
        self._pointer = data[0]
        for value in data[1:]:
            self.write_register(self._pointer, value, now_ns)
            self._pointer = (self._pointer + 1) & 0xFF

    def read(self, count: int, now_ns: int) -> bytes:
        self.latch(now_ns)
        answer = bytearray(count)
        for i in range(count):
            answer[i] = self.read_register(self._pointer, now_ns)
            self._pointer = self.next_register(self._pointer)
        return bytes(answer)

    def latch(self, now_ns: int) -> None:
        """Bring the data registers up to the newest sample; called once at the start of each read."""
        return

    def next_register(self, register: int) -> int:
        """The register read after `register` in a burst."""
        return (register + 1) & 0xFF

    def read_register(self, register: int, now_ns: int) -> int:
        """The byte of one register."""
        raise NotImplementedError

    def write_register(self, register: int, value: int, now_ns: int) -> None:
        """Take a byte into one register."""
        raise NotImplementedError


def to_counts(value: float, low: int, high: int) -> int:
    """A value in counts, rounded to the nearest and clipped as the converter clips."""
    if not np.isfinite(value):
        return low
    return min(max(round(value), low), high)
