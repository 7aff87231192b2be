"""From the truth of the flight to what each chip is shown: place on the airframe, flow, scale, bias, lag.

The world is looked at on a fixed grid, ahead of the chips that read it; between grid points signals are straight lines
(switches and pulses hold). So what the chips see does not depend on who reads which chip when. White noise is added where
a chip takes its sample, each sensor from a random stream of its own.
"""

import math
import zlib
from collections import deque
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from daq.utilities.constants import GAS_CONSTANT, HEAT_RATIO
from firmware_sim.hardware.registers.chip import Inputs
from firmware_sim.hardware.sensing.sensor_models import (
    AT,
    NAU7802_GAIN,
    REFERENCE_TEMPERATURE,
    SIGNALS,
    SensorModels,
    TriadModel,
    VaneModel,
)
from firmware_sim.hardware.sensing.units import individual
from firmware_sim.world.truth import Truth

Array = NDArray[np.float64]

GRID_S = 0.005
HISTORY_S = 4.0  # how far back a chip may still look
LOWEST_SPEED = 3.0  # m/s; below this the rotation of a vane's place is not divided by ever smaller speeds
SUPPLY_NOMINAL_V = 5.0

_HELD = AT["pwm_1"]  # from here on signals hold between grid points


class TruthSource(Protocol):
    """A world or a bench: gives the truth at ever later times."""

    def advance(self, to_time: float) -> Truth:
        """The truth at `to_time` [s], which never goes back."""
        ...


class Instruments:
    """The instruments of one aircraft, looking at one truth source.

    models: what they are like. seed: of the random streams. origin_ns: monotonic time at which the source's time is zero.
    """

    def __init__(self, source: TruthSource, models: SensorModels, seed: int, origin_ns: int = 0) -> None:
        self.models = models = individual(models)
        self.origin_ns = origin_ns
        self._source = source
        self._seed = seed
        self._accel_bias = self._bias("accel", models.imu.accel)
        self._gyro_bias = self._bias("gyro", models.imu.gyro)
        self._mag_bias = self._bias("mag", models.mag.field)
        self._alpha = _VaneDynamics(models.alpha_vane.frequency_hz, models.alpha_vane.damping)
        self._beta = _VaneDynamics(models.beta_vane.frequency_hz, models.beta_vane.damping)
        self._pitot_line: float | None = None
        self._rows: list[Array] = []
        self._late = [(AT[name], round(delay / GRID_S)) for name, delay in models.delays.items()]
        self._prompt: deque[Array] = deque(maxlen=1 + max((steps for _, steps in self._late), default=0))
        self._first = 0  # grid index of the oldest row kept
        self._last_time_ns = -1
        self._last: Array = np.empty(0)

    def generator(self, name: str) -> np.random.Generator:
        """The random stream that belongs to `name`."""
        return np.random.default_rng([self._seed, zlib.crc32(name.encode())])

    def at(self, time_ns: int) -> Array:
        """All SIGNALS at a monotonic time, (signals,). Times before the origin show the start."""
        if time_ns == self._last_time_ns:
            return self._last
        position = max((time_ns - self.origin_ns) * 1e-9 / GRID_S, 0.0)
        k = int(position)
        while self._first + len(self._rows) < k + 2:
            self._look()
        if k < self._first:
            raise ValueError(
                f"{time_ns} ns lies more than {HISTORY_S} s before the newest signal; nothing is kept that long"
            )
        first_row, second_row = self._rows[k - self._first], self._rows[k + 1 - self._first]
        share = position - k
        row = first_row + share * (second_row - first_row)
        row[_HELD:] = first_row[_HELD:]
        self._last_time_ns, self._last = time_ns, row
        return row

    def inputs(self, *names: str) -> Inputs:
        """The named signals as a function of monotonic time."""
        indices = [AT[name] for name in names]
        if len(indices) == indices[-1] - indices[0] + 1:
            part = slice(indices[0], indices[-1] + 1)
            return lambda time_ns: self.at(time_ns)[part]
        return lambda time_ns: self.at(time_ns)[indices]

    @property
    def biases(self) -> dict[str, Array]:
        """Accelerometer, gyro and magnetometer biases of this power-up, body axes, (3,) each."""
        return {"accel": self._accel_bias, "gyro": self._gyro_bias, "mag": self._mag_bias}

    def _bias(self, name: str, triad: TriadModel) -> Array:
        return np.array(triad.bias) + triad.turn_on * self.generator(f"{name} turn-on").standard_normal(3)

    def _look(self) -> None:
        k = self._first + len(self._rows)
        row = self._signals(self._source.advance(k * GRID_S))
        if self._late:
            self._prompt.append(row)
            row = row.copy()
            for signal, steps in self._late:
                row[signal] = self._prompt[max(len(self._prompt) - 1 - steps, 0)][signal]
        self._rows.append(row)
        if len(self._rows) > 2 * HISTORY_S / GRID_S:
            drop = round(HISTORY_S / GRID_S)
            del self._rows[:drop]
            self._first += drop

    def _signals(self, truth: Truth) -> Array:
        m = self.models
        row = np.empty(len(SIGNALS))
        row[0:3] = self._triad(m.imu.accel, self._accel_bias, _at_imu(truth, m.imu.position), truth)
        s = truth.sensed
        row[3:6] = self._triad(m.imu.gyro, self._gyro_bias, np.array((s.p, s.q, s.r)), truth)
        row[6] = truth.temperature + m.imu.die_above_air_k
        row[7:10] = np.array(m.mag.field.matrix) @ np.array(truth.magnetic) + self._mag_bias
        supply = m.supply.sensor_v + m.supply.sensor_v_per_main_v * (truth.supply_voltage - 12.0)
        ratio = supply / SUPPLY_NOMINAL_V
        alpha, beta = self._local_flow(truth)
        shafts = self._alpha.step(alpha), self._beta.step(beta)
        for index, vane, angle in ((10, m.alpha_vane, shafts[0]), (11, m.beta_vane, shafts[1])):
            row[index] = ratio * (vane.centre_v + (vane.volts_per_rad + vane.cubic_v_per_rad3 * angle * angle) * angle)
        pots = ((12, m.elevon_left, s.arm_left), (13, m.elevon_right, s.arm_right), (14, m.rudder, s.arm_r))
        for index, pot, angle in pots:
            row[index] = ratio * (pot.centre_v + (pot.volts_per_rad + pot.cubic_v_per_rad3 * angle * angle) * angle)
        row[15] = truth.supply_voltage / m.supply.main_divider
        row[16] = supply / m.supply.sensor_divider
        row[17:22] = m.analog_v
        row[22] = self._pitot(truth, supply)
        row[23] = truth.temperature + m.pitot.die_above_air_k
        row[24] = truth.p_static + m.static.position_error * truth.p_dynamic + m.static.offset_pa
        row[25] = truth.temperature + m.static.die_above_air_k
        row[26] = (truth.thrust + m.thrust.zero_n) * m.thrust.counts_per_newton * 0.5 / (NAU7802_GAIN * 2**23)
        row[27:33] = (truth.latitude, truth.longitude, truth.altitude, *truth.velocity_ned)
        row[33:37] = (s.phi, s.theta, math.cos(s.psi), math.sin(s.psi))
        row[37:39] = shafts
        row[39:45] = truth.pulses_us
        row[39:45] *= 1e-6
        row[45:50] = truth.digital
        return row

    @staticmethod
    def _triad(triad: TriadModel, bias: Array, value: Array, truth: Truth) -> Array:
        warmth = truth.temperature - REFERENCE_TEMPERATURE
        reading: Array = np.array(triad.matrix) @ value + bias + np.array(triad.bias_per_kelvin) * warmth
        return reading

    def _local_flow(self, truth: Truth) -> tuple[float, float]:
        """Angles of the flow at the two vanes [rad]: free stream plus omega x r, then the aircraft's own influence."""
        s = truth.sensed
        speed = max(s.V, LOWEST_SPEED)
        u, v, w = (
            speed * math.cos(s.alpha) * math.cos(s.beta),
            speed * math.sin(s.beta),
            speed * math.sin(s.alpha) * math.cos(s.beta),
        )
        p, q, r = truth.rates
        x, y, z = self.models.alpha_vane.position
        alpha = math.atan2(w + p * y - q * x, u + q * z - r * y)
        x, y, z = self.models.beta_vane.position
        beta = math.atan2(v + r * x - p * z, u + q * z - r * y)
        a, b = self.models.alpha_vane, self.models.beta_vane
        return _stopped(a.wash_factor * alpha + a.wash_offset, a), _stopped(b.wash_factor * beta + b.wash_offset, b)

    def _pitot(self, truth: Truth, supply: float) -> float:
        m = self.models.pitot
        mach_squared = truth.sensed.V**2 / (HEAT_RATIO * GAS_CONSTANT * truth.temperature)
        rise = math.expm1(HEAT_RATIO / (HEAT_RATIO - 1.0) * math.log1p(0.5 * (HEAT_RATIO - 1.0) * mach_squared))
        # The static side of the sensor sees the error of the static port.
        impact = truth.p_static * rise * m.factor - self.models.static.position_error * truth.p_dynamic
        if m.lag_s > 0.0:
            old = impact if self._pitot_line is None else self._pitot_line
            impact = self._pitot_line = impact + (old - impact) * math.exp(-GRID_S / m.lag_s)
        return impact + m.offset_pa + m.offset_pa_per_v * (supply - SUPPLY_NOMINAL_V)


def _stopped(angle: float, vane: VaneModel) -> float:
    return min(max(angle, -vane.stop_rad), vane.stop_rad)


def _at_imu(truth: Truth, position: tuple[float, float, float]) -> Array:
    """Specific force where the IMU sits: a + omega_dot x r + omega x (omega x r)."""
    s = truth.sensed
    force = np.array((s.ax, s.ay, s.az))
    if not any(position):
        return force
    r = np.array(position)
    rates = np.array(truth.rates)
    return np.asarray(force + np.cross(np.array(truth.rate_derivatives), r) + np.cross(rates, np.cross(rates, r)))


class _VaneDynamics:
    """Second-order response of a vane on the grid, by Tustin's rule; at low frequency the delay is exact."""

    def __init__(self, frequency_hz: float, damping: float) -> None:
        c = 1.0 / math.tan(math.pi * frequency_hz * GRID_S)  # prewarped: the natural frequency is kept
        low = 1.0 + 2.0 * damping * c + c * c
        self._gain = 1.0 / low
        self._a1 = 2.0 * (1.0 - c * c) / low
        self._a2 = (1.0 - 2.0 * damping * c + c * c) / low
        self._in: tuple[float, float] | None = None
        self._out = (0.0, 0.0)

    def step(self, angle: float) -> float:
        """The vane's angle at this grid point, the flow's angle given; it starts aligned with the flow."""
        if self._in is None:
            self._in, self._out = (angle, angle), (angle, angle)
        x1, x2 = self._in
        y1, y2 = self._out
        y = self._gain * (angle + 2.0 * x1 + x2) - self._a1 * y1 - self._a2 * y2
        self._in, self._out = (angle, x1), (y, y1)
        return y
