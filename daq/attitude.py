"""Onboard attitude from gyro, accelerometer and magnetometer by the complementary filter of imufusion.

Axes: body x forward, y right, z down; earth north, east, down. The quaternion (w, x, y, z) is the usual aerospace one:
phi = atan2(2(wx + yz), 1 - 2(x^2 + y^2)), theta = asin(2(wy - zx)), psi = atan2(2(wz + xy), 1 - 2(y^2 + z^2)).
Filter: S. Madgwick, "AHRS algorithms and calibration solutions to facilitate new applications using low-cost MEMS",
PhD thesis, University of Bristol 2014, chapter 7, with its rejection of accelerations and magnetic disturbances.

The filter itself runs in its north-west-up convention, whose accelerometer sign (level reads +1 g upward) has been the
same in all releases of imufusion; that of its north-east-down one changed. Half a turn about x leads from one to the other.

Two things are added for aircraft. The gyro is integrated by the trapezoidal rule, because at 20 Hz the end value alone
would lead by 25 ms. And in a turn the accelerometer's plumb line leans into the turn, for as long as the turn lasts, and
in a launch backwards; the acceleration of the aircraft along its path, rates times airspeed and the airspeed's own
change, is therefore taken off when an airspeed is known.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntFlag

import imufusion
import numpy as np

from daq.sensors.config import AttitudeConfig

GRAVITY = 9.80665
SCALE = 32767

Vector = Sequence[float]
_FLIP = np.array((1.0, -1.0, -1.0))  # forward right down <-> forward left up, north east down <-> north west up


class AttitudeStatus(IntFlag):
    """Bits of the channel `attitude_status`."""

    INITIALISING = 1
    RATE_RECOVERY = 2
    ACCELERATION_REJECTED = 4
    MAGNETIC_REJECTED = 8
    MAGNETOMETER_USED = 16


@dataclass(frozen=True, slots=True)
class Attitude:
    """Quaternion (w, x, y, z), north-east-down to body, and the filter's flags."""

    quaternion: tuple[float, float, float, float]
    status: AttitudeStatus

    @property
    def initialising(self) -> bool:
        """Whether the filter is still finding its level."""
        return bool(self.status & (AttitudeStatus.INITIALISING | AttitudeStatus.RATE_RECOVERY))

    def counts(self) -> dict[str, int]:
        """The recorded channels: components times 32767, and the status byte."""
        scaled = {f"quaternion_{c}": round(SCALE * v) for c, v in zip("wxyz", self.quaternion, strict=True)}
        return {**scaled, "attitude_status": int(self.status)}


class AttitudeFilter:
    """The filter and its memory; call `update` once for each IMU sample.

    rate_hz: nominal rate of the samples. gyro_range: where the gyro saturates [rad/s].
    """

    SLOWEST_FLIGHT = 8.0  # [m/s]
    AIRSPEED_SMOOTHING_S = 0.4
    LONGEST_STEP_S = 1.0  # after a longer gap the old attitude is worth nothing: start again

    def __init__(self, config: AttitudeConfig, rate_hz: float, gyro_range: float) -> None:
        self._config = config
        settings = imufusion.AhrsSettings(
            rate_hz,
            imufusion.CONVENTION_NWU,
            config.gain,
            math.degrees(gyro_range),
            config.acceleration_rejection_deg,
            config.magnetic_rejection_deg,
            config.rejection_timeout_s,
        )
        self._ahrs = imufusion.Ahrs()
        self._ahrs.set_settings(settings)
        self._bias = imufusion.Bias()
        self._bias.set_settings(imufusion.BiasSettings(rate_hz, config.standstill_dps, config.standstill_s))
        self._magnetic_offset = np.array(config.hard_iron_ut) * 1e-6
        half = math.radians(config.declination_deg) / 2
        self._declination = (math.cos(half), math.sin(half))
        self._time: float | None = None
        self._last_gyro = np.zeros(3)
        self._standing: list[tuple[float, np.ndarray]] = []
        self._bias_known = False
        self._airspeed: float | None = None
        self._speeding_up = 0.0  # [m/s2]

    @property
    def gyro_bias(self) -> tuple[float, float, float]:
        """Gyro bias found while standing still [rad/s]."""
        x, y, z = np.radians(self._bias.get_offset())
        return float(x), float(y), float(z)

    def update(
        self, time: float, gyro: Vector, accel: Vector, mag: Vector | None = None, airspeed: float | None = None
    ) -> Attitude:
        """Advance to `time` [s] with gyro [rad/s], specific force [m/s2], field [T] and airspeed [m/s]."""
        rate = np.array(gyro, dtype=np.float64)
        step = self._step(time)
        rate_deg = self._unbiased(time, np.degrees(rate), self._at_rest(airspeed))
        mean_rate = rate_deg if step is None else (rate_deg + self._last_gyro) / 2
        self._last_gyro = rate_deg
        if step is not None:
            self._ahrs.set_sample_period(step)
        self._follow_airspeed(airspeed, step)
        down = self._plumb_line(np.array(accel, dtype=np.float64), np.radians(rate_deg)) / GRAVITY
        magnetic = mag is not None and self._config.use_magnetometer
        if magnetic:
            field = (np.array(mag, dtype=np.float64) - self._magnetic_offset) * 1e6
            self._ahrs.update(mean_rate * _FLIP, down * _FLIP, field * _FLIP)
        else:
            self._ahrs.update_no_magnetometer(mean_rate * _FLIP, down * _FLIP)
        return Attitude(self._quaternion(), self._status(magnetic))

    def _step(self, time: float) -> float | None:
        """Time since the last sample [s]; None, and a restart, when there was none recently."""
        last, self._time = self._time, time
        if last is None or not 0.0 < time - last <= self.LONGEST_STEP_S:
            if last is not None:
                self._ahrs.restart()
            return None
        return time - last

    def _unbiased(self, time: float, rate_deg: np.ndarray, at_rest: bool) -> np.ndarray:
        """Rates less the bias [deg/s]. The first standstill sets the bias to its mean; later ones trim it slowly."""
        if not at_rest:
            self._standing.clear()
            return rate_deg - np.asarray(self._bias.get_offset(), dtype=np.float64)
        unbiased = np.asarray(self._bias.update(rate_deg), dtype=np.float64)
        if self._bias_known:
            return unbiased
        if np.any(np.abs(unbiased) > self._config.standstill_dps):
            self._standing.clear()
        self._standing.append((time, rate_deg))
        if time - self._standing[0][0] >= self._config.standstill_s:
            mean = np.mean([rate for _, rate in self._standing], axis=0)
            self._bias.set_offset(mean)
            self._bias_known = True
            self._standing.clear()
            return rate_deg - mean
        return unbiased

    def _at_rest(self, airspeed: float | None) -> bool:
        """Whether the aircraft may stand still; a trimmed flight is as quiet to the gyro as the ground is."""
        return airspeed is None or airspeed < self.SLOWEST_FLIGHT

    def _follow_airspeed(self, airspeed: float | None, step: float | None) -> None:
        """Smooth the airspeed (first order) and find its rate of change."""
        smooth = self._airspeed
        if airspeed is None or step is None or smooth is None:
            self._airspeed, self._speeding_up = airspeed, 0.0
            return
        share = step / (self.AIRSPEED_SMOOTHING_S + step)
        self._airspeed = smooth + share * (airspeed - smooth)
        self._speeding_up = (self._airspeed - smooth) / step

    def _plumb_line(self, accel: np.ndarray, rate: np.ndarray) -> np.ndarray:
        """Specific force less the path's acceleration, dV/dt + omega x V with V along body x [m/s2]."""
        speed = self._airspeed
        if speed is None or not self._config.airspeed_correction:
            return accel
        return accel - np.array((self._speeding_up, speed * rate[2], -speed * rate[1]))

    def _quaternion(self) -> tuple[float, float, float, float]:
        w, x, left, up = (float(v) for v in self._ahrs.get_quaternion())
        y, z = -left, -up
        c, s = self._declination  # turn about the vertical, from magnetic to true north
        q = (c * w - s * z, c * x - s * y, c * y + s * x, c * z + s * w)
        return q if q[0] >= 0 else (-q[0], -q[1], -q[2], -q[3])

    def _status(self, magnetic: bool) -> AttitudeStatus:
        flags, inside = self._ahrs.get_flags(), self._ahrs.get_internal_states()
        status = AttitudeStatus(0)
        if flags.startup:
            status |= AttitudeStatus.INITIALISING
        if flags.overrange_recovery:
            status |= AttitudeStatus.RATE_RECOVERY
        if inside.accelerometer_ignored:
            status |= AttitudeStatus.ACCELERATION_REJECTED
        if magnetic:
            status |= AttitudeStatus.MAGNETOMETER_USED
            if inside.magnetometer_ignored:
                status |= AttitudeStatus.MAGNETIC_REJECTED
        return status
