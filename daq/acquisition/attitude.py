"""Onboard attitude from gyro, accelerometer and magnetometer by the complementary filter of imufusion.

Axes: body x forward, y right, z down; earth north, east, down. The quaternion (w, x, y, z) is the usual aerospace one:
phi = atan2(2(wx + yz), 1 - 2(x^2 + y^2)), theta = asin(2(wy - zx)), psi = atan2(2(wz + xy), 1 - 2(y^2 + z^2)).
Filter: S. Madgwick, "AHRS algorithms and calibration solutions to facilitate new applications using low-cost MEMS",
PhD thesis, University of Bristol 2014, chapter 7, with its rejection of accelerations and magnetic disturbances.

The filter itself runs in its north-west-up convention, whose accelerometer sign (level reads +1 g upward) has been the
same in all releases of imufusion; that of its north-east-down one changed. Half a turn about x leads from one to the other.

Three things are added for aircraft. The gyro is integrated by the implicit Adams rule of third order: at 20 Hz the end
value alone would lead by 25 ms, and straight lines between samples would round every rolling edge. An accelerometer's
plumb line leans with every acceleration of the path, in turns, launches and sideslips; that acceleration is taken off
(`daq.sensors.gravity_reference`). And the filter begins aligned with the first sample instead of level and north,
weighs what follows like a mean of all there was, and says `INITIALISING` until that has settled.
"""

import math
from collections import deque
from dataclasses import dataclass
from enum import IntFlag
from struct import Struct

import imufusion
import numpy as np

from daq.sensors.config import AttitudeConfig
from daq.sensors.gravity_reference import AirPath, GroundVelocity, VelocityFix
from daq.sensors.vectors import UNTURNED, ZERO, Axes, Vector, cross, plus, times, turned
from daq.utilities.constants import GRAVITY

SCALE = 32767

Quaternion = tuple[float, float, float, float]
_INPUTS = Struct("=9f")  # what the filter computes in
_DEGREES, _RADIANS = 180.0 / math.pi, math.pi / 180.0
_COMPONENTS = ("quaternion_w", "quaternion_x", "quaternion_y", "quaternion_z")


class AttitudeStatus(IntFlag):
    """Bits of the channel `attitude_status`."""

    INITIALISING = 1
    RATE_RECOVERY = 2
    ACCELERATION_REJECTED = 4
    MAGNETIC_REJECTED = 8
    MAGNETOMETER_USED = 16


_STATUSES = tuple(AttitudeStatus(bits) for bits in range(32))  # flags are objects, and slow to make
_INITIALISING, _RATE_RECOVERY, _ACCELERATION_REJECTED, _MAGNETIC_REJECTED, _MAGNETOMETER_USED = (
    int(flag) for flag in AttitudeStatus
)


@dataclass(frozen=True, slots=True)
class Attitude:
    """Quaternion (w, x, y, z), north-east-down to body, and the filter's flags."""

    quaternion: Quaternion
    status: AttitudeStatus

    @property
    def initialising(self) -> bool:
        """Whether the filter is still finding its level."""
        return int(self.status) & (_INITIALISING | _RATE_RECOVERY) != 0

    def counts(self) -> dict[str, int]:
        """The recorded channels: components times 32767, and the status byte."""
        counts = {name: round(SCALE * v) for name, v in zip(_COMPONENTS, self.quaternion, strict=True)}
        counts["attitude_status"] = int(self.status)
        return counts


class AttitudeFilter:
    """The filter and its memory; call `update` once for each IMU sample.

    rate_hz: nominal rate of the samples. gyro_range: where the gyro saturates [rad/s].
    """

    SLOWEST_FLIGHT = 8.0  # [m/s]
    LONGEST_STEP_S = 1.0  # after a longer gap the old attitude is worth nothing: start again
    SETTLING_S = 3.0
    FIRST_GAIN = 2.0  # [1/s]; falls as a mean's does, 1 / (time + 1 / FIRST_GAIN), to the configured one
    VELOCITY_GAIN = 3.0  # of the velocity, in those of the attitude: just short of critical damping

    def __init__(self, config: AttitudeConfig, rate_hz: float, gyro_range: float) -> None:
        self._config = config
        self._rate_hz, self._gyro_range_deg = rate_hz, math.degrees(gyro_range)
        self._ahrs = imufusion.Ahrs()
        # Rate, plumb line and field as the filter takes them, filled anew each time: to make arrays costs more than the update.
        self._memory = bytearray(_INPUTS.size)
        self._inputs = tuple(np.frombuffer(self._memory, np.float32).reshape(3, 3))
        self._gain = 0.0
        self._set_gain(self.FIRST_GAIN)
        self._begun: float | None = None
        self._settled = self._aided = False
        self._bias = imufusion.Bias()
        self._bias.set_settings(imufusion.BiasSettings(rate_hz, config.standstill_dps, config.standstill_s))
        self._offset = ZERO  # the bias as it is now [deg/s]
        self._hard_iron = times(1e-6, config.hard_iron_ut)
        half = math.radians(config.declination_deg) / 2
        self._declination = (math.cos(half), math.sin(half))
        self._time: float | None = None
        self._last_gyro: deque[Vector] = deque(maxlen=2)  # newest first
        self._standing: list[tuple[float, Vector]] = []
        self._bias_known = False
        self._air = AirPath()
        self._ground = GroundVelocity()
        self._axes = UNTURNED  # body to north-east-down, by the attitude held so far
        # velocities over ground say nothing to an aircraft that does not know where north is
        self._heading_known = False

    @property
    def gyro_bias(self) -> Vector:
        """Gyro bias found while standing still [rad/s]."""
        return times(_RADIANS, self._offset)

    def update(
        self,
        time: float,
        gyro: Vector,
        accel: Vector,
        mag: Vector | None = None,
        airspeed: float | None = None,
        fix: VelocityFix | None = None,
    ) -> Attitude:
        """Advance to `time` [s] with gyro [rad/s], specific force [m/s2], field [T] and airspeed [m/s].

        fix: a GPS velocity that has come in since the last sample, at the time at which the IMU showed its instant.
        """
        step = self._step(time)
        rate_deg = self._unbiased(time, times(_DEGREES, gyro), self._at_rest(airspeed))
        rate = times(_RADIANS, rate_deg)
        turn_rate = self._turn_rate(rate_deg, step)
        self._air.update(airspeed if self._config.airspeed_correction else None, step)
        field = None if mag is None or not self._config.use_magnetometer else plus(mag, self._hard_iron, -1.0)
        if step is None or self._begun is None:
            self._begun, self._settled = time, False
            self._align(self._air.static_force(accel, rate), field)
        else:
            if fix is not None or self._ground.fix_pending:
                self._ground.add_fix(fix)
            self._heading_known |= field is not None
            aided = self._heading_known and self._ground.known(time)
            if aided is not self._aided or not self._settled:
                self._aided = aided
                self._settled = time - self._begun >= self.SETTLING_S
                self._set_gain(self._gain_at(time - self._begun, aided))
            if aided:
                static_force = self._ground.static_force(self._axes, self.VELOCITY_GAIN * self._gain)
            else:
                static_force = self._air.static_force(accel, rate)
            self._ahrs.set_sample_period(step)
            self._advance(turn_rate, static_force, field)
        quaternion = self._quaternion()
        self._axes = _axes_of(quaternion)
        antenna = turned(self._axes, cross(rate, self._config.antenna_m))
        self._ground.advance(time, step or 0.0, self._axes, accel, self.VELOCITY_GAIN * self._gain, antenna)
        return Attitude(quaternion, self._status(time, field is not None))

    def _advance(self, rate_deg: Vector, down: Vector, field: Vector | None) -> None:
        rate, force, magnetic = self._inputs
        static_force = times(1.0 / GRAVITY, down)
        field_ut = times(1e6, field or ZERO)
        _INPUTS.pack_into(self._memory, 0, *_flip(rate_deg), *_flip(static_force), *_flip(field_ut))
        if field is None:
            self._ahrs.update_no_magnetometer(rate, force)
        else:
            self._ahrs.update(rate, force, magnetic)

    def _align(self, static_force: Vector, magnetic: Vector | None) -> None:
        """Begin where plumb line and compass point (Black 1964, "TRIAD"); without a compass, at heading zero."""
        self._ahrs.restart()
        self._ahrs.skip_startup()
        self._set_gain(self.FIRST_GAIN)
        self._ground.restart()
        self._heading_known = magnetic is not None
        gravity = np.array(static_force)
        z = -gravity / max(float(np.linalg.norm(gravity)), 1e-9)
        heading_vector = np.array((1.0, 0.0, 0.0) if magnetic is None else magnetic)
        y = np.cross(z, heading_vector)
        if np.linalg.norm(y) < 1e-9:
            return
        y /= np.linalg.norm(y)
        self._ahrs.set_quaternion(_quaternion_of(np.array((np.cross(y, z), y, z))) * (1.0, 1.0, -1.0, -1.0))

    def _gain_at(self, since_begin: float, aided: bool) -> float:
        configured = self._config.aided_gain if aided else self._config.gain
        if since_begin >= self.SETTLING_S:
            return configured
        return max(configured, 1.0 / (since_begin + 1.0 / self.FIRST_GAIN))

    def _set_gain(self, gain: float) -> None:
        if gain == self._gain:
            return
        self._gain, config = gain, self._config
        self._ahrs.set_settings(
            imufusion.AhrsSettings(
                self._rate_hz,
                imufusion.CONVENTION_NWU,
                gain,
                self._gyro_range_deg,
                config.acceleration_rejection_deg,
                config.magnetic_rejection_deg,
                config.rejection_timeout_s,
            )
        )

    def _step(self, time: float) -> float | None:
        """Time since the last sample [s]; None, and a restart, when there was none recently."""
        last, self._time = self._time, time
        if last is None or not 0.0 < time - last <= self.LONGEST_STEP_S:
            return None
        return time - last

    def _unbiased(self, time: float, rate_deg: Vector, at_rest: bool) -> Vector:
        """Rates less the bias [deg/s]. The first standstill sets the bias to its mean; later ones trim it slowly."""
        if not at_rest:
            self._standing.clear()
            return plus(rate_deg, self._offset, -1.0)
        x, y, z = self._bias.update(np.array(rate_deg)).tolist()
        self._note_offset()
        if self._bias_known:
            return x, y, z
        if max(abs(x), abs(y), abs(z)) > self._config.standstill_dps:
            self._standing.clear()
        self._standing.append((time, rate_deg))
        if time - self._standing[0][0] >= self._config.standstill_s:
            self._bias.set_offset(np.mean([rate for _, rate in self._standing], axis=0))
            self._note_offset()
            self._bias_known = True
            self._standing.clear()
            return plus(rate_deg, self._offset, -1.0)
        return x, y, z

    def _note_offset(self) -> None:
        x, y, z = self._bias.get_offset().tolist()
        self._offset = x, y, z

    def _turn_rate(self, rate_deg: Vector, step: float | None) -> Vector:
        """Rate that, held over the last step, turns the filter as far as the sampled rates did [deg/s].

        Mean by the implicit Adams rule, (5 w_k + 8 w_k-1 - w_k-2)/12, until there are three samples by the trapezoidal one
        (Hairer, Norsett, Wanner, Solving Ordinary Differential Equations I, III.1). The filter adds half the turn to a
        quaternion and normalises it, which turns it by the arctangent: undone here.
        """
        if step is None:
            self._last_gyro.clear()
        mean = rate_deg
        if len(self._last_gyro) == 1:
            mean = times(1 / 2, plus(rate_deg, self._last_gyro[0]))
        elif self._last_gyro:
            mean = times(5 / 12, plus(plus(rate_deg, self._last_gyro[0], 8 / 5), self._last_gyro[1], -1 / 5))
        self._last_gyro.appendleft(rate_deg)
        half = math.radians(math.hypot(*mean)) * (step or 0.0) / 2
        return times(math.tan(half) / half, mean) if 1e-6 < half < 0.5 else mean

    def _at_rest(self, airspeed: float | None) -> bool:
        """Whether the aircraft may stand still; a trimmed flight is as quiet to the gyro as the ground is."""
        return airspeed is None or airspeed < self.SLOWEST_FLIGHT

    def _quaternion(self) -> Quaternion:
        w, x, y_left, z_up = self._ahrs.get_quaternion().tolist()
        y, z = -y_left, -z_up
        c, s = self._declination  # turn about the vertical, from magnetic to true north
        q = (c * w - s * z, c * x - s * y, c * y + s * x, c * z + s * w)
        return q if q[0] >= 0 else (-q[0], -q[1], -q[2], -q[3])

    def _status(self, time: float, magnetic: bool) -> AttitudeStatus:
        flags, internal_states = self._ahrs.get_flags(), self._ahrs.get_internal_states()
        bits = 0
        if flags.startup or self._begun is None or time - self._begun < self.SETTLING_S:
            bits |= _INITIALISING
        if flags.overrange_recovery:
            bits |= _RATE_RECOVERY
        if internal_states.accelerometer_ignored:
            bits |= _ACCELERATION_REJECTED
        if magnetic:
            bits |= _MAGNETOMETER_USED
            if internal_states.magnetometer_ignored:
                bits |= _MAGNETIC_REJECTED
        return _STATUSES[bits]


def _flip(a: Vector) -> Vector:
    """Forward right down <-> forward left up, north east down <-> north west up."""
    return a[0], -a[1], -a[2]


def _axes_of(quaternion: Quaternion) -> Axes:
    """The rotation that turns body vectors to north-east-down."""
    w, x, y, z = quaternion
    return (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )


def _quaternion_of(axes: np.ndarray) -> np.ndarray:
    """Quaternion (w, x, y, z) of the attitude whose body components of north, east and down are the rows of (3, 3)."""
    (a, b, c), (d, e, f), (g, h, i) = axes
    candidates = np.array(
        (
            (1 + a + e + i, h - f, c - g, d - b),
            (h - f, 1 + a - e - i, b + d, c + g),
            (c - g, b + d, 1 - a + e - i, f + h),
            (d - b, c + g, f + h, 1 - a - e + i),
        )
    )
    largest = candidates[int(np.argmax(np.diag(candidates)))]  # the largest component: nothing is divided by little
    return np.asarray(largest / np.linalg.norm(largest))
