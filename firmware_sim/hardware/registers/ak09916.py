"""AK09916 magnetometer at register level (AKM AK09916, MS1547-E-02), reached through the ICM-20948's bypass.

Inputs: magnetic field x y z [T] in the axes of the AK09916 die (in the ICM-20948: x as printed, y and z reversed).
"""

import numpy as np

from firmware_sim.hardware.registers.chip import Inputs, RegisterChip, to_counts
from firmware_sim.hardware.registers.icm20948 import Icm20948Chip

TESLA_PER_COUNT = 0.15e-6
OVERFLOW_T = 4912e-6
WIA1, WIA2, ST1, HXL, TMPS, ST2, CNTL2, CNTL3 = 0x00, 0x01, 0x10, 0x11, 0x17, 0x18, 0x31, 0x32
_CONTINUOUS_HZ = {0x02: 10.0, 0x04: 20.0, 0x06: 50.0, 0x08: 100.0}
_SINGLE, _SINGLE_NS = 0x01, 7_200_000


class Ak09916Chip(RegisterChip):
    """An AK09916 behind `host`; noise: standard deviation of a sample [T]."""

    def __init__(self, host: Icm20948Chip, inputs: Inputs, noise: float, rng: np.random.Generator) -> None:
        super().__init__()
        self._host = host
        self._inputs = inputs
        self._noise = noise
        self._rng = rng
        self.reset(0)

    def answers(self, now_ns: int) -> bool:
        return self.powered and self._host.bypassed()

    def reset(self, now_ns: int) -> None:
        self._mode = 0
        self._started_ns = now_ns
        self._tick = 0
        self._ready = self._overrun = self._locked = self._overflow = False
        self._counts = bytes(6)

    def write_register(self, register: int, value: int, now_ns: int) -> None:
        if register == CNTL3 and value & 0x01:
            self.reset(now_ns)
        elif register == CNTL2:
            self._mode = value & 0x1F
            self._started_ns, self._tick = now_ns, 0

    def read_register(self, register: int, now_ns: int) -> int:
        if register == WIA1:
            return 0x48
        if register == WIA2:
            return 0x09
        if register == ST1:
            return self._ready | self._overrun << 1
        if HXL <= register < HXL + 6:
            self._locked = True  # until ST2 is read the registers are held
            self._ready = False
            return self._counts[register - HXL]
        if register == ST2:
            self._locked = self._ready = self._overrun = False
            return 0x08 if self._overflow else 0x00
        if register == CNTL2:
            return self._mode
        return 0

    def next_register(self, register: int) -> int:
        if register == ST2:
            return WIA1
        return register + 1

    def latch(self, now_ns: int) -> None:
        if self._mode == _SINGLE:
            if now_ns - self._started_ns >= _SINGLE_NS:
                self._sample(self._started_ns + _SINGLE_NS)
                self._mode = 0
            return
        rate = _CONTINUOUS_HZ.get(self._mode)
        if rate is None:
            return
        tick = int((now_ns - self._started_ns) * 1e-9 * rate)
        if tick <= self._tick:
            return
        if self._locked:
            self._overrun = True
        else:
            self._overrun = self._overrun or self._ready or tick > self._tick + 1
            self._sample(self._started_ns + round(tick * 1e9 / rate))
        self._tick = tick

    def _sample(self, time_ns: int) -> None:
        self._ready = True
        if self.frozen(time_ns):
            return
        field = np.array(self._inputs(time_ns)) + self._noise * self._rng.standard_normal(3)
        self._overflow = bool(np.abs(field).sum() >= OVERFLOW_T)
        counts = [to_counts(value / TESLA_PER_COUNT, -32752, 32752) for value in field]
        self._counts = b"".join(count.to_bytes(2, "little", signed=True) for count in counts)
