"""Hidden errors of the instruments that see pitching, airspeed and the forces in the plane of symmetry."""

from typing import TYPE_CHECKING

from firmware_sim.physics.effects.aerodynamic import REFERENCE_ALPHA
from firmware_sim.physics.effects.base import Sensed
from firmware_sim.physics.effects.sensor import LaggedSensor, SensorEffect
from firmware_sim.physics.maths import State, Value

if TYPE_CHECKING:
    from firmware_sim.physics.motion import Motion


class AlphaScale(SensorEffect):
    """Upwash turns the air before the vane meets it: angle of attack too large by a fraction."""

    name, title, unit, typical = "alpha_scale", "angle-of-attack vane scale", "1", 0.1

    def sense(self, s: Sensed, m: "Motion", x: State) -> None:
        s.alpha = s.alpha * (1.0 + self.size)


class AlphaBias(SensorEffect):
    """The angle-of-attack vane is turned on its mount."""

    name, title, unit, typical = "alpha_bias", "angle-of-attack vane bias", "rad", 0.0087

    def sense(self, s: Sensed, m: "Motion", x: State) -> None:
        s.alpha = s.alpha + self.size


class AlphaPosition(SensorEffect):
    """The angle-of-attack vane stands `size` m ahead of where it is believed to be: it sees the wind of pitching."""

    name, title, unit, typical = "alpha_position", "angle-of-attack vane ahead of its place", "m", 0.4

    def sense(self, s: Sensed, m: "Motion", x: State) -> None:
        s.alpha = s.alpha - self.size * m.q / m.V


class AlphaLag(LaggedSensor):
    """A heavy or damped angle-of-attack vane: first-order lag of `size` s."""

    name, title, unit, typical = "alpha_lag", "angle-of-attack vane lags", "s", 0.035
    channel = "alpha"


class SpeedScale(SensorEffect):
    """Airspeed too high by a fraction, in a model that flies it."""

    name, title, unit, typical = "V_scale", "airspeed scale", "1", 0.03

    def sense(self, s: Sensed, m: "Motion", x: State) -> None:
        s.V = s.V * (1.0 + self.size)


class SpeedWithAlpha(SensorEffect):
    """The static port's error grows with angle of attack."""

    name, title, unit, typical = "V_alpha", "airspeed error grows with angle of attack", "1/rad", 0.3

    def sense(self, s: Sensed, m: "Motion", x: State) -> None:
        s.V = s.V * (1.0 + self.size * (m.alpha - REFERENCE_ALPHA))


class AccelerometerAhead(SensorEffect):
    """The accelerometer sits `size` m ahead of the CG, uncorrected."""

    name, title, unit, typical = "imu_x", "accelerometer ahead of the CG", "m", 0.08

    def sense(self, s: Sensed, m: "Motion", x: State) -> None:
        s.ax = s.ax - (m.q * m.q + m.r * m.r) * self.size
        s.ay = s.ay + (m.r_dot + m.p * m.q) * self.size
        s.az = s.az + (m.r * m.p - m.q_dot) * self.size


class AccelerometerBelow(SensorEffect):
    """The accelerometer sits `size` m below the CG, uncorrected in the plane of symmetry."""

    name, title, unit, typical = "imu_z", "accelerometer below the CG", "m", 0.08

    def sense(self, s: Sensed, m: "Motion", x: State) -> None:
        s.ax = s.ax + (m.p * m.r + m.q_dot) * self.size
        s.az = s.az - (m.p * m.p + m.q * m.q) * self.size


class AccelerometerTilt(SensorEffect):
    """The accelerometer's board points up by `size` rad."""

    name, title, unit, typical = "imu_tilt", "accelerometer turned about the pitch axis", "rad", 0.0175

    def sense(self, s: Sensed, m: "Motion", x: State) -> None:
        c, n = self.xp.cos(self.size), self.xp.sin(self.size)
        s.ax, s.az = c * s.ax - n * s.az, c * s.az + n * s.ax


class PitchGyroScale(SensorEffect):
    """The pitch gyro reads too much by a fraction."""

    name, title, unit, typical = "q_scale", "pitch gyro scale", "1", 0.03

    def sense(self, s: Sensed, m: "Motion", x: State) -> None:
        s.q = s.q * (1.0 + self.size)


class PitchLag(LaggedSensor):
    """The pitch attitude follows with a first-order lag of `size` s."""

    name, title, unit, typical = "theta_lag", "pitch attitude lags", "s", 0.04
    channel = "theta"

    def truth(self, m: "Motion") -> Value:
        return self.xp.asin(self.xp.clip(-m.c13, -1.0, 1.0))
