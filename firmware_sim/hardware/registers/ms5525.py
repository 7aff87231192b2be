"""MS5525DSO-PP001DS at command level (TE Connectivity MS5525DSO, 2017). Inputs: differential pressure [Pa], temperature [K].

Commands: reset, conversion of pressure or temperature at five oversamplings, result, eight words of PROM. A result that is read
too early, or twice, is zero. The counts are those from which the data sheet's compensation returns the inputs.
"""

from daq.utilities.constants import PSI, ZERO_CELSIUS
from firmware_sim.hardware.registers.chip import Inputs, PoweredChip, to_counts

RELOAD_NS = 2_800_000
CONVERSION_NS = (600_000, 1_170_000, 2_280_000, 4_540_000, 9_040_000)
UNIT_PROM = (0x2531, 36402, 39473, 40393, 29523, 29854, 21917)
"""PROM of one chip: factory data and six coefficients."""


def crc4(words: tuple[int, ...]) -> int:
    """The CRC in the last word's lowest bits: remainder of 14 bytes and a zero divided by x^4 + x + 1."""
    bits = 0
    for word in words:
        bits = bits << 16 | word
    bits <<= 12
    for position in range(123, 3, -1):
        if bits >> position & 1:
            bits ^= 0b10011 << (position - 4)
    return bits & 0xF


class Ms5525Chip(PoweredChip):
    """An MS5525DSO. damaged: whether a bit of its PROM has flipped."""

    def __init__(self, inputs: Inputs) -> None:
        super().__init__()
        self._inputs = inputs
        self.damaged = False
        self.reset(0)
        self._reset_ns = -RELOAD_NS

    def reset(self, now_ns: int) -> None:
        self._reset_ns = now_ns
        self._command = 0
        self._conversion: tuple[int, int] | None = None  # command of the conversion and its start [ns]

    def answers(self, now_ns: int) -> bool:
        return self.powered and now_ns - self._reset_ns >= RELOAD_NS

    def write(self, data: bytes, now_ns: int) -> None:
        if not data:
            return
        self._command = data[0]
        if self._command == 0x1E:
            self.reset(now_ns)
        elif self._command & 0xE1 == 0x40:
            self._conversion = self._command, now_ns

    def read(self, count: int, now_ns: int) -> bytes:
        if 0xA0 <= self._command <= 0xAE:
            return self._prom()[(self._command - 0xA0) // 2].to_bytes(2, "big")[:count]
        value = 0
        if self._command == 0 and self._conversion is not None:
            command, start_ns = self._conversion
            duration_ns = CONVERSION_NS[min((command & 0xF) // 2, 4)]
            if now_ns - start_ns >= duration_ns:
                value = self._converted(start_ns + duration_ns // 2)[command >> 4 == 5]
                self._conversion = None
        return value.to_bytes(3, "big")[:count]

    def _prom(self) -> tuple[int, ...]:
        words = (*UNIT_PROM, crc4(UNIT_PROM))
        return words if not self.damaged else (*words[:3], words[3] ^ 0x0040, *words[4:])

    def _converted(self, time_ns: int) -> tuple[int, int]:
        """D1 and D2 at a time [ns], from the inverse of the PP001DS's first-order compensation."""
        pascal, kelvin = self._inputs(time_ns)
        _, c1, c2, c3, c4, c5, c6 = UNIT_PROM
        difference = round((kelvin - ZERO_CELSIUS - 20.0) * 100.0 * 2**21 / c6)  # dT of the data sheet
        offset = c2 * 2**17 + c4 * difference / 2**5
        slope = c1 * 2**15 + c3 * difference / 2**7
        d1 = (pascal / PSI * 1e4 * 2**15 + offset) * 2**21 / slope
        return to_counts(d1, 0, 2**24 - 1), to_counts(difference + c5 * 2**7, 0, 2**24 - 1)
