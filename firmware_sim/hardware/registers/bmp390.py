"""BMP390 barometer at register level (Bosch BST-BMP390-DS002-07).

Inputs: static pressure [Pa] and die temperature [K]. The raw 24-bit values are found by inverting the compensation
polynomials of the datasheet (8.4 to 8.6) for this unit's calibration bytes: a quadratic in the raw temperature, a cubic in
the raw pressure. A driver that reads the bytes and applies the polynomials gets the pressure back.
"""

import math
import struct

import numpy as np

from daq.utilities.constants import ZERO_CELSIUS
from firmware_sim.hardware.registers.chip import Inputs, RegisterChip, to_counts

CHIP_ID, REV_ID, ERR, STATUS, DATA, SENSOR_TIME, EVENT, INT_STATUS = 0x00, 0x01, 0x02, 0x03, 0x04, 0x0C, 0x10, 0x11
PWR_CTRL, OSR, ODR, CONFIG, CALIBRATION, CMD = 0x1B, 0x1C, 0x1D, 0x1F, 0x31, 0x7E
SOFT_RESET, SKIPPED = 0xB6, 0x800000
SENSOR_TIME_HZ = 25_600.0
START_UP_NS = 2_000_000

# T1 T2 T3 P1..P11 as stored (BST-BMP390-DS002-07, table 24); pressure values of a unit whose coefficients were published
# by a user of the chip, temperature values typical.
CALIBRATION_FORMAT = "<HHbhhbbHHbbhbb"
UNIT_CALIBRATION = (27830, 18959, -10, 7274, 5903, 6, 1, 19286, 23366, 3, -6, 3951, 6, -11)


def calibration_bytes(values: tuple[int, ...] = UNIT_CALIBRATION) -> bytes:
    """The 21 bytes from register 0x31."""
    return struct.pack(CALIBRATION_FORMAT, *values)


def trimming_checksum(data: bytes) -> int:
    """What is stored at 0x30, bit by bit: shifted left through 0x1D, begun with 0xFF, inverted at the end."""
    register = 0xFF
    for byte in data:
        for bit in range(7, -1, -1):
            carry = register >> 7 ^ byte >> bit & 1
            register = (register << 1 & 0xFF) ^ (0x1D if carry else 0)
    return register ^ 0xFF


class Trimming:
    """The compensation polynomials of one unit, and their inverses."""

    def __init__(self, values: tuple[int, ...] = UNIT_CALIBRATION) -> None:
        t1, t2, t3, p1, p2, p3, p4, p5, p6, p7, p8, p9, p10, p11 = values
        self.t = (t1 * 2.0**8, t2 / 2.0**30, t3 / 2.0**48)
        self.linear = ((p1 - 2**14) / 2.0**20, (p2 - 2**14) / 2.0**29, p3 / 2.0**32, p4 / 2.0**37)
        self.constant = (p5 * 2.0**3, p6 / 2.0**6, p7 / 2.0**8, p8 / 2.0**15)
        self.square = (p9 / 2.0**48, p10 / 2.0**48)
        self.cube = p11 / 2.0**65

    def raw_temperature(self, celsius: float) -> float:
        """Raw temperature at which the compensated one is `celsius`: the root near t1 of the quadratic."""
        t1, t2, t3 = self.t
        return t1 + 2.0 * celsius / (t2 + math.sqrt(t2 * t2 + 4.0 * t3 * celsius))

    def pressure_polynomial(self, celsius: float) -> tuple[float, float, float, float]:
        """Coefficients c0..c3 of the pressure [Pa] as a cubic in the raw pressure at this temperature."""
        c = celsius
        k, m = self.constant, self.linear
        c0 = k[0] + c * (k[1] + c * (k[2] + c * k[3]))
        c1 = m[0] + c * (m[1] + c * (m[2] + c * m[3]))
        return c0, c1, self.square[0] + self.square[1] * c, self.cube

    def raw_pressure(self, pascal: float, celsius: float) -> float:
        """Raw pressure at which the compensated one is `pascal`, by Newton's method on the cubic."""
        c0, c1, c2, c3 = self.pressure_polynomial(celsius)
        raw = (pascal - c0) / c1
        for _ in range(20):
            value = c0 + raw * (c1 + raw * (c2 + raw * c3)) - pascal
            change = value / (c1 + raw * (2.0 * c2 + raw * 3.0 * c3))
            raw -= change
            if abs(change) < 1e-4:
                break
        return raw


class Bmp390Chip(RegisterChip):
    """A BMP390; noise: standard deviation of a pressure sample [Pa] and a temperature sample [K] before the IIR filter."""

    def __init__(self, inputs: Inputs, noise: tuple[float, float], rng: np.random.Generator) -> None:
        super().__init__()
        self._inputs = inputs
        self._noise = noise
        self._rng = rng
        self._trimming = Trimming()
        self._calibration = calibration_bytes()
        self.reset(0)
        self._reset_ns = -START_UP_NS

    def reset(self, now_ns: int) -> None:
        self._registers = {OSR: 0x02, ODR: 0x00, CONFIG: 0x00, PWR_CTRL: 0x00, 0x15: 0x02, 0x19: 0x02}
        self._reset_ns = now_ns
        self._tick = 0
        self._restart(now_ns)
        self._smooth: tuple[float, float] | None = None
        self._raw = (SKIPPED, SKIPPED)
        self._ready = 0
        self._event = 0x01  # power-on reset detected

    def answers(self, now_ns: int) -> bool:
        return self.powered and now_ns - self._reset_ns >= START_UP_NS

    def write_register(self, register: int, value: int, now_ns: int) -> None:
        if register == CMD:
            if value == SOFT_RESET:
                self.reset(now_ns)
            return
        self._registers[register] = value
        if register in (PWR_CTRL, ODR, OSR):
            self._restart(now_ns)

    def read_register(self, register: int, now_ns: int) -> int:
        if register == CHIP_ID:
            return 0x60
        if register == REV_ID:
            return 0x01
        if register == ERR:
            return 0x04 if self._rate_impossible() else 0x00
        if register == STATUS:
            return 0x10 | self._ready
        if DATA <= register < DATA + 6:
            value, byte = divmod(register - DATA, 3)
            self._ready &= ~(0x20 << value)
            return self._raw[value] >> 8 * byte & 0xFF
        if SENSOR_TIME <= register < SENSOR_TIME + 3:
            ticks = int((now_ns - self._reset_ns) * 1e-9 * SENSOR_TIME_HZ)
            return ticks >> 8 * (register - SENSOR_TIME) & 0xFF
        if register == EVENT:
            event, self._event = self._event, 0
            return event
        if register == CALIBRATION - 1:
            return trimming_checksum(calibration_bytes())
        if CALIBRATION <= register < CALIBRATION + len(self._calibration):
            return self._calibration[register - CALIBRATION]
        return self._registers.get(register, 0)

    def latch(self, now_ns: int) -> None:
        mode = self._registers[PWR_CTRL] >> 4 & 3
        if mode == 0 or self._rate_impossible():
            return
        if mode in (1, 2):  # forced: one measurement, then back to sleep
            ready_ns = self._started_ns + self._measurement_ns()
            if now_ns >= ready_ns:
                self._measure(ready_ns)
                self._registers[PWR_CTRL] &= ~0x30
            return
        period = self._period_ns()
        tick = int((now_ns - self._started_ns) // period)
        if tick - self._tick > 100:
            self._tick = tick - 1  # nobody has looked for long: older measurements no longer matter
        while self._tick < tick:
            self._tick += 1
            self._measure(self._started_ns + self._tick * period)

    def _restart(self, now_ns: int) -> None:
        self._started_ns = now_ns
        self._tick = 0

    def _period_ns(self) -> int:
        return 5_000_000 << min(self._registers[ODR] & 0x1F, 17)

    def _measurement_ns(self) -> int:
        osr, power = self._registers[OSR], self._registers[PWR_CTRL]
        pressure = 392 + 2020 * (1 << (osr & 7)) if power & 1 else 0
        temperature = 163 + 2020 * (1 << (osr >> 3 & 7)) if power & 2 else 0
        return (234 + pressure + temperature) * 1000

    def _rate_impossible(self) -> bool:
        return self._registers[PWR_CTRL] & 0x30 == 0x30 and self._measurement_ns() > self._period_ns()

    def _measure(self, time_ns: int) -> None:
        pascal, kelvin = self._inputs(time_ns)
        pascal += self._noise[0] * self._rng.standard_normal()
        celsius = kelvin - ZERO_CELSIUS + self._noise[1] * self._rng.standard_normal()
        p, t = self._trimming.raw_pressure(pascal, celsius), self._trimming.raw_temperature(celsius)
        osr, power = self._registers[OSR], self._registers[PWR_CTRL]
        coefficient = (1 << (self._registers[CONFIG] >> 1 & 7)) - 1
        if coefficient:
            old = self._smooth or (p, t)
            p = (old[0] * coefficient + p) / (coefficient + 1)
            t = (old[1] * coefficient + t) / (coefficient + 1)
            self._smooth = (p, t)
            bits = (24, 24)
        else:
            self._smooth = None
            bits = (16 + (osr & 7), 16 + (osr >> 3 & 7))
        if not self.frozen(time_ns):
            self._raw = (
                _quantised(p, bits[0]) if power & 1 else SKIPPED,
                _quantised(t, bits[1]) if power & 2 else SKIPPED,
            )
        self._ready |= (0x20 if power & 1 else 0) | (0x40 if power & 2 else 0)


def _quantised(raw: float, bits: int) -> int:
    step = 1 << max(0, 24 - bits)
    return to_counts(raw / step, 0, 2**24 // step - 1) * step
