"""AS5600 magnetic encoder at register level (ams DS000365 v1-06). Input: shaft angle [rad], 0 at half a turn.

Reading ANGLE and RAW ANGLE the pointer goes from the lower byte back to the higher one. field_mt: of the magnet at the chip;
below 30 mT the gain is at its end and ML is set, above 90 mT MH, without a magnet neither MD nor an angle worth the name.
"""

import math
from collections.abc import Callable

from firmware_sim.hardware.registers.chip import Inputs, RegisterChip

ZMCO, CONF, STATUS, RAW_ANGLE, ANGLE, AGC, MAGNITUDE = 0x00, 0x07, 0x0B, 0x0C, 0x0E, 0x1A, 0x1B
NO_MAGNET_MT, LEAST_MT, MOST_MT = 8.0, 30.0, 90.0
START_UP_NS = 10_000_000


class As5600Chip(RegisterChip):
    """An AS5600; a power cycle forgets CONF."""

    def __init__(self, inputs: Inputs, field_mt: Callable[[int], float] = lambda now_ns: 55.0) -> None:
        super().__init__()
        self._inputs, self.field_mt = inputs, field_mt
        self.reset(0)
        self._reset_ns = -START_UP_NS

    def reset(self, now_ns: int) -> None:
        self._conf = [0, 0]
        self._raw = 0
        self._reset_ns = now_ns

    def answers(self, now_ns: int) -> bool:
        return self.powered and now_ns - self._reset_ns >= START_UP_NS

    def upset(self) -> None:
        """A bit of CONF flips, as by an electrostatic discharge."""
        self._conf[0] ^= 0x01

    def latch(self, now_ns: int) -> None:
        if not self.frozen(now_ns) and self.field_mt(now_ns) >= NO_MAGNET_MT:
            self._raw = round(float(self._inputs(now_ns)[0]) / math.tau * 4096 + 2048) % 4096

    def next_register(self, register: int) -> int:
        return {RAW_ANGLE + 1: RAW_ANGLE, ANGLE + 1: ANGLE, MAGNITUDE + 1: MAGNITUDE}.get(register, register + 1)

    def read_register(self, register: int, now_ns: int) -> int:
        field = self.field_mt(now_ns)
        if register == STATUS:
            return (field >= NO_MAGNET_MT) << 5 | (field < LEAST_MT) << 4 | (field > MOST_MT) << 3
        if register in (RAW_ANGLE, ANGLE):
            return self._raw >> 8
        if register in (RAW_ANGLE + 1, ANGLE + 1):
            return self._raw & 0xFF
        if register in (CONF, CONF + 1):
            return self._conf[register - CONF]
        return 0

    def write_register(self, register: int, value: int, now_ns: int) -> None:
        if register in (CONF, CONF + 1):
            self._conf[register - CONF] = value & (0x3F if register == CONF else 0xFF)
