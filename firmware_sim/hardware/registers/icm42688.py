"""ICM-42688-P at register level (TDK DS-000347 rev. 1.7): other registers around what an ICM-20948 measures.

The user's filters act at the orders and bandwidths of the registers: first order exactly, higher ones as that of the same delay.
Until both parts run, and after a reset, data registers hold -32768.
"""

import math
import struct

from daq.utilities.constants import GRAVITY, ZERO_CELSIUS
from firmware_sim.hardware.registers.chip import to_counts
from firmware_sim.hardware.registers.icm20948 import Icm20948Chip

RATES_HZ = {3: 8000.0, 4: 4000.0, 5: 2000.0, 6: 1000.0, 7: 200.0, 8: 100.0, 9: 50.0, 10: 25.0, 11: 12.5, 15: 500.0}
DIVIDERS = (2, 4, 5, 8, 10, 16, 20, 40)
SLOWEST_FILTER_HZ = 400.0  # bandwidths follow the rate down to this one
GYRO_START_NS = 30_000_000
_RESET_BANKS: tuple[dict[int, int], ...] = (
    {0x4C: 0x30, 0x4D: 0x91, 0x4E: 0x00, 0x4F: 0x06, 0x50: 0x06, 0x51: 0x16, 0x52: 0x11, 0x53: 0x0D},
    {0x0B: 0xA0, 0x0C: 0x0D, 0x0D: 0xAA, 0x0E: 0x80},
    {0x03: 0x30, 0x04: 0x40, 0x05: 0x62},
    {},
    {},
)
_NOTHING = struct.pack(">7h", *[-32768] * 7)


class Icm42688Chip(Icm20948Chip):
    """An ICM-42688-P that samples `inputs` at the configured rate."""

    def reset(self, now_ns: int) -> None:
        super().reset(now_ns)
        self._banks = [dict(values) for values in _RESET_BANKS]
        self._data = _NOTHING
        self._reset_done = True

    @property
    def asleep(self) -> bool:
        """Whether accelerometer or gyro are off."""
        return self._banks[0][0x4E] & 0x0F != 0x0F

    def bypassed(self) -> bool:
        """There is no auxiliary bus."""
        return False

    def upset(self, bank: int = 0, register: int = 0x4F, bits: int = 0x20) -> None:
        """Bits of a setting flip, as by an electrostatic discharge."""
        self._banks[bank][register] ^= bits

    def write_register(self, register: int, value: int, now_ns: int) -> None:
        if register == 0x76:
            self._bank = min(value & 7, 4)
        elif self._bank == 0 and register == 0x11:
            if value & 1:
                self.reset(now_ns)
        else:
            was_asleep = self.asleep
            self._banks[self._bank][register] = value
            if was_asleep and not self.asleep:
                self._woken_ns, self._tick, self._read_tick, self._filtered = now_ns, -1, -1, None

    def read_register(self, register: int, now_ns: int) -> int:
        if register == 0x76:
            return self._bank
        if self._bank:
            return self._banks[self._bank].get(register, 0)
        if register == 0x75:
            return 0x47
        if register == 0x2D:
            status = (self._tick > self._read_tick) << 3 | self._reset_done << 4
            self._read_tick, self._reset_done = self._tick, False
            return status
        if 0x1D <= register < 0x2B:
            return self._data[register - 0x1D]
        return self._banks[0].get(register, 0)

    def latch(self, now_ns: int) -> None:
        if not self._bank and not self.asleep and now_ns - self._woken_ns >= GYRO_START_NS:
            super().latch(now_ns)

    def _rates_hz(self) -> tuple[float, float]:
        """Samples a second of accelerometer and gyro."""
        bank = self._banks[0]
        return RATES_HZ.get(bank[0x50] & 0xF, 1000.0), RATES_HZ.get(bank[0x4F] & 0xF, 1000.0)

    def _period_ns(self) -> float:
        return 1e9 / max(self._rates_hz())

    def _cut_offs_hz(self) -> tuple[float, float]:
        bank = self._banks[0]
        chosen = (bank[0x52] >> 4, bank[0x52] & 0xF)
        orders = (bank[0x53] >> 3 & 3, bank[0x51] >> 2 & 3)
        accel, gyro = (
            max(rate, SLOWEST_FILTER_HZ if code else 0.0)
            / DIVIDERS[min(code, 7)]
            / (1.0, math.sqrt(2.0), 2.0, 2.0)[order]
            for rate, code, order in zip(self._rates_hz(), chosen, orders, strict=True)
        )
        return accel, gyro

    def _sample(self, time_ns: int) -> None:
        self._advance_filter(time_ns)
        assert self._filtered is not None
        if self.frozen(time_ns):
            return
        values = self._filtered[:6] + self._noise * self._rng.standard_normal(6)
        bank = self._banks[0]
        accel = 2048.0 * 2 ** (bank[0x50] >> 5) / GRAVITY
        gyro = (16.4, 32.8, 65.5, 131.0, 262.0, 524.3, 1048.6, 2097.2)[bank[0x4F] >> 5] * 180.0 / math.pi
        counts = [(self._filtered[6] - ZERO_CELSIUS - 25.0) * 132.48, *(values[:3] * accel), *(values[3:] * gyro)]
        self._data = struct.pack(">7h", *(to_counts(float(c), -32768, 32767) for c in counts))
