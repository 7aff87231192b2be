"""BMP581 barometer at register level (Bosch BST-BMP581-DS004). Inputs: static pressure [Pa] and die temperature [K].

It compensates by itself. Oversampling and filter are taken in standby only; a rate that the oversampling does not allow clears
ODR_IS_VALID, and the chip runs as fast as it can.
"""

import numpy as np

from daq.utilities.constants import ZERO_CELSIUS
from firmware_sim.hardware.registers.chip import Inputs, RegisterChip, to_counts

RATES_HZ = (240.0, 218.5, 199.1, 179.2, 160.0, 149.3, 140.0, 129.8, 120.0, 110.1, 100.2, 89.6, 80.0, 70.0, 60.0, 50.055, 45.025,
            40.0, 35.0, 30.0, 25.005, 20.0, 15.0, 10.0, 5.0, 4.0, 3.0, 2.0, 1.0, 0.5, 0.25, 0.125)  # fmt: skip
POSSIBLE_HZ = (498.0, 374.0, 255.0, 155.0, 87.0, 46.0, 24.0, 12.0)  # by oversampling of the pressure
START_UP_NS = 2_000_000
STANDBY_ONLY = (0x30, 0x31, 0x36)
_RESET = {0x13: 0x00, 0x15: 0x00, 0x30: 0x23, 0x31: 0x00, 0x36: 0x00, 0x37: 0x70}


class Bmp581Chip(RegisterChip):
    """A BMP581; noise: standard deviation of a pressure sample [Pa] at eightfold oversampling, of a temperature [K].

    memory_fault: its non-volatile memory reports an error.
    """

    def __init__(self, inputs: Inputs, noise: tuple[float, float], rng: np.random.Generator) -> None:
        super().__init__()
        self._inputs, self._noise, self._rng = inputs, noise, rng
        self.memory_fault = False
        self.reset(0)
        self._reset_ns = -START_UP_NS

    def reset(self, now_ns: int) -> None:
        self._registers = dict(_RESET)
        self._reset_ns = self._started_ns = now_ns
        self._status, self._tick = 0x10, 0  # power-up or soft reset complete
        self._data = b"\x7f" * 6

    def answers(self, now_ns: int) -> bool:
        return self.powered and now_ns - self._reset_ns >= START_UP_NS

    def upset(self, register: int = 0x36, bits: int = 0x08) -> None:
        """Bits of a setting flip, as by an electrostatic discharge."""
        self._registers[register] ^= bits

    def write_register(self, register: int, value: int, now_ns: int) -> None:
        if register == 0x7E:
            if value == 0xB6:
                self.reset(now_ns)
        elif register not in STANDBY_ONLY or not self._registers[0x37] & 3:
            self._registers[register] = value
            if register == 0x37:
                self._started_ns, self._tick = now_ns, 0

    def read_register(self, register: int, now_ns: int) -> int:
        if register == 0x27:
            status, self._status = self._status, 0
            return status
        if 0x1D <= register <= 0x22:
            return self._data[register - 0x1D]
        fixed = {0x01: 0x50, 0x02: 0x32, 0x28: 0x06 if self.memory_fault else 0x02, 0x38: self._effective()}
        return fixed.get(register, self._registers.get(register, 0))

    def _effective(self) -> int:
        return (0x80 if self._wanted_hz() <= self._possible_hz() else 0) | self._registers[0x36] & 0x3F

    def _wanted_hz(self) -> float:
        return RATES_HZ[self._registers[0x37] >> 2 & 0x1F]

    def _possible_hz(self) -> float:
        return POSSIBLE_HZ[self._registers[0x36] >> 3 & 7]

    def latch(self, now_ns: int) -> None:
        if self._registers[0x37] & 3 != 1:
            return
        period_ns = 1e9 / min(self._wanted_hz(), self._possible_hz())
        tick = int((now_ns - self._started_ns) / period_ns)
        if tick <= self._tick:
            return
        self._tick = tick
        self._status |= self._registers[0x15] & 0x01
        time_ns = self._started_ns + round(tick * period_ns - 0.5e9 / self._possible_hz())
        if not self.frozen(time_ns):
            self._data = self._sample(time_ns)

    def _sample(self, time_ns: int) -> bytes:
        pascal, kelvin = self._inputs(time_ns)
        weaker = 2.0 ** ((3 - (self._registers[0x36] >> 3 & 7)) / 2)
        pascal += self._noise[0] * weaker * self._rng.standard_normal()
        celsius = kelvin - ZERO_CELSIUS + self._noise[1] * self._rng.standard_normal()
        warmth = to_counts(celsius * 65536.0, -(2**23), 2**23 - 1).to_bytes(3, "little", signed=True)
        if not self._registers[0x36] & 0x40:
            return warmth + b"\x7f" * 3
        return warmth + to_counts(pascal * 64.0, 0, 2**24 - 1).to_bytes(3, "little")
