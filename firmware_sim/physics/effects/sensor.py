"""Hidden instrument errors with dynamics: lags and delays of a reading.

They change `Sensed`, the readings of ideal instruments at the CG; the instruments then add noise, quantisation, declared bias and
scale.
"""

from typing import TYPE_CHECKING, ClassVar

import numpy as np

from firmware_sim.physics.effects.actuator import DelayedHistory
from firmware_sim.physics.effects.base import HiddenEffect, Sensed
from firmware_sim.physics.maths import State, Value

if TYPE_CHECKING:
    from firmware_sim.physics.motion import Motion


class SensorEffect(HiddenEffect):
    """A reading that differs from the motion."""

    group = "sensor"


class LaggedSensor(SensorEffect):
    """An instrument that follows the motion with a first-order lag of `size` s. channel: of `Sensed`."""

    states = 1
    channel: ClassVar[str]

    def truth(self, m: "Motion") -> Value:
        """The quantity without lag."""
        value: Value = getattr(m, self.channel)
        return value

    def start(self, m: "Motion", x: State) -> None:
        x[self.at] = self.truth(m)

    def derivatives(self, m: "Motion", x: State, dx: State) -> None:
        dx[self.at] = (self.truth(m) - x[self.at]) / self.xp.maximum(self.size, 1e-3)

    def sense(self, s: Sensed, m: "Motion", x: State) -> None:
        setattr(s, self.channel, getattr(s, self.channel) + (x[self.at] - self.truth(m)))


class VaneLag(LaggedSensor):
    """A heavy or damped vane: first-order lag of `size` s."""

    name, title, unit, typical = "beta_lag", "sideslip vane lags", "s", 0.08
    channel = "beta"


class AlphaLag(LaggedSensor):
    """A heavy or damped angle-of-attack vane: first-order lag of `size` s."""

    name, title, unit, typical = "alpha_lag", "angle-of-attack vane lags", "s", 0.035
    channel = "alpha"


class PitchLag(LaggedSensor):
    """The pitch attitude follows with a first-order lag of `size` s."""

    name, title, unit, typical = "theta_lag", "pitch attitude lags", "s", 0.04
    channel = "theta"

    def truth(self, m: "Motion") -> Value:
        return self.xp.asin(self.xp.clip(-m.c13, -1.0, 1.0))


class AttitudeLag(SensorEffect):
    """The attitude filter follows bank and pitch with a first-order lag of `size` s."""

    name, title, unit, typical = "attitude_lag", "attitude lags", "s", 0.10
    states = 2

    def start(self, m: "Motion", x: State) -> None:
        x[self.at], x[self.at + 1] = self._angles(m)

    def _angles(self, m: "Motion") -> tuple[object, object]:
        xp = self.xp
        return xp.atan2(m.c23, m.c33), xp.asin(xp.clip(-m.c13, -1.0, 1.0))

    def derivatives(self, m: "Motion", x: State, dx: State) -> None:
        tau = self.xp.maximum(self.size, 1e-3)
        for i, angle in enumerate(self._angles(m)):
            dx[self.at + i] = (angle - x[self.at + i]) / tau

    def sense(self, s: Sensed, m: "Motion", x: State) -> None:
        phi, theta = self._angles(m)
        s.phi = s.phi + (x[self.at] - phi)
        s.theta = s.theta + (x[self.at + 1] - theta)


class InertialUnitLate(SensorEffect):
    """Rates and accelerations are delayed by `size` s, as by a buffer before the time stamp."""

    name, title, unit, typical = "time_skew", "inertial channels late", "s", 0.07
    CHANNELS: ClassVar[tuple[str, ...]] = ("ax", "ay", "az", "p", "q", "r")

    def start(self, m: "Motion", x: State) -> None:
        longest = float(np.max(np.abs(self.size))) + 0.02
        step = self.plant.step_size
        self._past = {c: DelayedHistory(longest, step, getattr(m, c), self.xp) for c in self.CHANNELS}

    def commit(self, m: "Motion", x: State) -> None:
        for channel, history in self._past.items():
            history.push(m.t, getattr(m, channel))

    def sense(self, s: Sensed, m: "Motion", x: State) -> None:
        for channel, history in self._past.items():
            setattr(s, channel, getattr(s, channel) + history.at(m.t - self.size) - getattr(m, channel))
