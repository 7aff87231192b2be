"""ICM-20948 accelerometer and gyro at register level (TDK DS-000189 rev. 1.3).

Inputs: specific force x y z [m/s2], angular rate x y z [rad/s], in the axes printed on the chip, and die temperature [K].
The low-pass filters are taken as first order: the ratio of noise bandwidth to 3 dB bandwidth of the datasheet's slow settings is
17.8 / 11.6 Hz = 1.53, and 1.57 for a first-order filter. Their time constant, hence their delay, is 1 / (2 pi f). White noise is
added after the filter, so that its standard deviation does not depend on the setting.
"""

import math

import numpy as np
from numpy.typing import NDArray

from daq.utilities.constants import GRAVITY, ZERO_CELSIUS
from firmware_sim.hardware.registers.chip import Inputs, RegisterChip

BASE_RATE_HZ = 1125.0
START_UP_NS = 35_000_000  # gyro start-up from sleep, typical
RESET_NS = 10_000_000

WHO_AM_I, USER_CTRL, PWR_MGMT_1, PWR_MGMT_2, INT_PIN_CFG = 0x00, 0x03, 0x06, 0x07, 0x0F
INT_STATUS_1, DATA, DATA_RDY_STATUS, BANK_SELECT = 0x1A, 0x2D, 0x74, 0x7F
GYRO_SMPLRT_DIV, GYRO_CONFIG_1, GYRO_CONFIG_2 = 0x00, 0x01, 0x02
ACCEL_SMPLRT_DIV_1, ACCEL_SMPLRT_DIV_2, ACCEL_CONFIG, ACCEL_CONFIG_2 = 0x10, 0x11, 0x14, 0x15

GYRO_BANDWIDTH_HZ = (196.6, 151.8, 119.5, 51.2, 23.9, 11.6, 5.7, 361.4)  # table 16, 3 dB
ACCEL_BANDWIDTH_HZ = (246.0, 246.0, 111.4, 50.4, 23.9, 11.5, 5.7, 473.0)  # table 18, 3 dB
GYRO_LSB_PER_DPS = (131.0, 65.5, 32.8, 16.4)
ACCEL_LSB_PER_G = (16384.0, 8192.0, 4096.0, 2048.0)
SELF_TEST_CODE = (0x62, 0x5E, 0x60)  # factory self-test responses of this unit, bank 1
_RESET_VALUES: tuple[dict[int, int], ...] = (
    {USER_CTRL: 0x00, PWR_MGMT_1: 0x41, PWR_MGMT_2: 0x00, INT_PIN_CFG: 0x00},
    dict(zip((0x02, 0x03, 0x04, 0x0E, 0x0F, 0x10), SELF_TEST_CODE + SELF_TEST_CODE, strict=True)),
    {GYRO_CONFIG_1: 0x01, ACCEL_CONFIG: 0x01},
    {},
)
_LONGEST_STEP_NS = 5_000_000  # of the filters
_FILTER_RESTART_NS = 500_000_000  # without a sample, after which the filters start at the input
_ACCEL_UNFILTERED_HZ, _GYRO_UNFILTERED_HZ = (
    1209.0,
    12106.0,
)  # 3 dB bandwidths with the filter bypassed, tables 16 and 18
_TEMPERATURE_HZ = 8.0  # bandwidth of the die temperature


class Icm20948Chip(RegisterChip):
    """An ICM-20948 that samples `inputs` at the configured rate.

    noise: standard deviation of accelerometer x y z [m/s2] and gyro x y z [rad/s] samples.
    """

    def __init__(self, inputs: Inputs, noise: tuple[float, ...], rng: np.random.Generator) -> None:
        super().__init__()
        self._inputs = inputs
        self._noise = np.array(noise)
        self._rng = rng
        self.reset(0)
        self._woken_ns = -RESET_NS
        self._reset_ns = -RESET_NS

    def reset(self, now_ns: int) -> None:
        self._banks = [dict(values) for values in _RESET_VALUES]
        self._bank = 0
        self._reset_ns = now_ns
        self._woken_ns = now_ns
        self._tick = -1
        self._read_tick = -1
        self._filtered: NDArray[np.float64] | None = None
        self._last_input: NDArray[np.float64] | None = None
        self._filtered_ns = now_ns
        self._data = bytes(14)

    @property
    def asleep(self) -> bool:
        """Whether the SLEEP bit is set, as it is after power-up."""
        return bool(self._banks[0][PWR_MGMT_1] & 0x40)

    def bypassed(self) -> bool:
        """Whether the auxiliary bus, and with it the magnetometer, is connected through to the main bus."""
        bank = self._banks[0]
        return self.powered and bool(bank[INT_PIN_CFG] & 0x02) and not bank[USER_CTRL] & 0x20

    def write_register(self, register: int, value: int, now_ns: int) -> None:
        if register == BANK_SELECT:
            self._bank = value >> 4 & 3
            return
        if now_ns - self._reset_ns < RESET_NS:
            return  # still coming out of reset
        bank = self._banks[self._bank]
        if self._bank == 0 and register == PWR_MGMT_1:
            if value & 0x80:
                self.reset(now_ns)
                return
            if self.asleep and not value & 0x40:
                self._woken_ns, self._tick, self._filtered = now_ns, -1, None
        bank[register] = value

    def read_register(self, register: int, now_ns: int) -> int:
        if register == BANK_SELECT:
            return self._bank << 4
        if self._bank:
            return self._banks[self._bank].get(register, 0)
        if register == WHO_AM_I:
            return 0xEA
        if register == PWR_MGMT_1 and now_ns - self._reset_ns < RESET_NS:
            return self._banks[0][PWR_MGMT_1] | 0x80
        if DATA <= register < DATA + 14:
            self._read_tick = self._tick
            return self._data[register - DATA]
        if register in (INT_STATUS_1, DATA_RDY_STATUS):
            fresh = self._tick > self._read_tick
            if register == INT_STATUS_1:
                self._read_tick = self._tick  # reading clears the interrupt
            return 0x01 if fresh else 0x00
        return self._banks[0].get(register, 0)

    def latch(self, now_ns: int) -> None:
        if self._bank or self.asleep or now_ns - self._woken_ns < START_UP_NS:
            return
        period = self._period_ns()
        tick = int((now_ns - self._woken_ns) // period)
        if tick <= self._tick:
            return
        self._tick = tick
        self._sample(self._woken_ns + round(tick * period))

    def _period_ns(self) -> float:
        bank = self._banks[2]
        if not bank[GYRO_CONFIG_1] & 0x01:
            return 1e9 / 9000.0
        return 1e9 * (1 + bank.get(GYRO_SMPLRT_DIV, 0)) / BASE_RATE_HZ

    def _sample(self, time_ns: int) -> None:
        self._advance_filter(time_ns)
        assert self._filtered is not None
        if self.frozen(time_ns):
            return
        disabled = self._banks[0].get(PWR_MGMT_2, 0)
        values = self._filtered[:6] + self._noise * self._rng.standard_normal(6)
        bank = self._banks[2]
        accel_scale = ACCEL_LSB_PER_G[bank[ACCEL_CONFIG] >> 1 & 3] / GRAVITY
        gyro_scale = GYRO_LSB_PER_DPS[bank[GYRO_CONFIG_1] >> 1 & 3] * 180.0 / math.pi
        counts = np.empty(7)
        counts[:3] = values[:3] * accel_scale + self._self_test(ACCEL_CONFIG_2, ACCEL_CONFIG, 2)
        counts[3:6] = values[3:6] * gyro_scale + self._self_test(GYRO_CONFIG_2, GYRO_CONFIG_1, 3)
        counts[6] = (self._filtered[6] - ZERO_CELSIUS - 21.0) * 333.87
        if disabled & 0x38:
            counts[:3] = 0.0
        if disabled & 0x07:
            counts[3:6] = 0.0
        self._data = np.clip(np.rint(counts), -32768, 32767).astype(">i2").tobytes()

    def _self_test(self, enable: int, config: int, shift: int) -> NDArray[np.float64]:
        """Shift of the three outputs [counts] while their self-test is switched on (DS-000189, 5.8)."""
        bits = self._banks[2].get(enable, 0) >> shift & 7
        if not bits:
            return np.zeros(3)
        full_scale = self._banks[2][config] >> 1 & 3
        response = 2620.0 / 2**full_scale * 1.01 ** (np.array(SELF_TEST_CODE) - 1.0)
        return response * np.array([bits >> 2 & 1, bits >> 1 & 1, bits & 1])

    def _advance_filter(self, time_ns: int) -> None:
        """Advance the low-pass filters to `time_ns`, with the input linear between steps."""
        if self._filtered is None or self._last_input is None or time_ns - self._filtered_ns > _FILTER_RESTART_NS:
            self._filtered = self._last_input = np.array(self._inputs(time_ns), float)
            self._filtered_ns = time_ns
            return
        steps = max(1, -((self._filtered_ns - time_ns) // _LONGEST_STEP_NS))
        h_ns = (time_ns - self._filtered_ns) / steps
        pole, ramp = self._filter_coefficients(h_ns * 1e-9)
        for i in range(1, steps + 1):
            new = np.array(self._inputs(self._filtered_ns + round(i * h_ns)), float)
            old = self._last_input
            self._filtered = pole * (self._filtered - old) + old + ramp * (new - old)
            self._last_input = new
        self._filtered_ns = time_ns

    def _cut_offs_hz(self) -> tuple[float, float]:
        """Half power of the low passes of accelerometer and gyro."""
        accel, gyro = self._banks[2][ACCEL_CONFIG], self._banks[2][GYRO_CONFIG_1]
        accel_hz = ACCEL_BANDWIDTH_HZ[accel >> 3 & 7] if accel & 1 else _ACCEL_UNFILTERED_HZ
        return accel_hz, GYRO_BANDWIDTH_HZ[gyro >> 3 & 7] if gyro & 1 else _GYRO_UNFILTERED_HZ

    def _filter_coefficients(self, h: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """exp(-h/tau) and 1 - tau/h (1 - exp(-h/tau)) of the seven inputs: exact response to a ramp."""
        accel_hz, gyro_hz = self._cut_offs_hz()
        key = (h, accel_hz, gyro_hz)
        if getattr(self, "_coefficient_key", None) != key:
            tau = 1.0 / (2.0 * math.pi * np.array([accel_hz] * 3 + [gyro_hz] * 3 + [_TEMPERATURE_HZ]))
            pole = np.exp(-h / tau)
            self._coefficients = (pole, 1.0 - tau / h * (1.0 - pole))
            self._coefficient_key = key
        return self._coefficients
