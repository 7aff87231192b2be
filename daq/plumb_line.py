"""Which way is down in a moving aircraft: the accelerometer without the acceleration of the path it flies.

An accelerometer shows gravity and acceleration together. Two ways to tell them apart, the first whenever a GPS receiver
gives velocities, the second without one:

`GroundVelocity`: specific force, turned to north-east-down by the attitude held so far and freed of gravity, is integrated
to a velocity; a GPS velocity says how wrong that is, and a wrong velocity is a wrong vertical. Sideslip, gusts, turns and
launches leave no trace, and neither vanes nor airspeed enter: the attitude stays independent of the instruments that a
flight is meant to check. The receiver's latency does no harm: a fix is compared with the velocity of its own time.
`AirPath`: rates times airspeed and the airspeed's own change; sideslip velocity is neglected, which a rudder doublet
answers with a degree or two of bank.

Observer: R. Mahony, T. Hamel, J.-M. Pflimlin, "Nonlinear complementary filters on the special orthogonal group", IEEE
Trans. Automatic Control 53 (2008) 1203; with velocity aiding: M.-D. Hua, "Attitude estimation for accelerated vehicles
using GPS/INS measurements", Control Engineering Practice 18 (2010) 723, of which this is the linear cascade.
"""

from bisect import bisect_left
from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

GRAVITY = 9.80665

Array = NDArray[np.float64]
_DOWN = np.array((0.0, 0.0, GRAVITY))


@dataclass(frozen=True, slots=True)
class VelocityFix:
    """Velocity over ground (north, east, down) [m/s] at a time [s] on the clock of the samples."""

    time: float
    velocity: tuple[float, float, float]


class GroundVelocity:
    """Velocity over ground by inertial integration, held by GPS; see the module.

    Call `hear` and `plumb_line` before the attitude is advanced to a sample, and `advance` after.
    """

    LONGEST_S = 1.0  # without a fix for longer, the integrated velocity is worth nothing
    HISTORY_S = 1.0  # how late a fix may come

    def __init__(self) -> None:
        self._history: deque[tuple[float, Array]] = deque()  # velocity of the antenna
        self._velocity = np.zeros(3)
        self._acceleration: Array | None = None
        self._error = np.zeros(3)
        self._fix_time: float | None = None
        self._waiting: VelocityFix | None = None

    def restart(self) -> None:
        """Forget everything."""
        self._history.clear()
        self._velocity = np.zeros(3)
        self._acceleration, self._fix_time, self._waiting = None, None, None
        self._error = np.zeros(3)

    def hear(self, fix: VelocityFix | None) -> None:
        """Take in a fix that has come since the last call, as soon as the integration has reached its time; after a pause
        the integration begins anew at it."""
        for known in (self._waiting, fix):
            if known is None:
                continue
            self._waiting = known
            if self._history and known.time <= self._history[-1][0]:
                self._waiting = None
                self._compare(known)

    def _compare(self, fix: VelocityFix) -> None:
        lost = not self.known(fix.time)
        self._fix_time = fix.time
        error = np.array(fix.velocity) - self._at(fix.time)
        if lost:
            self._velocity = self._velocity + error
            self._history = deque((t, v + error) for t, v in self._history)
        self._error = np.zeros(3) if lost else error

    def known(self, time: float) -> bool:
        """Whether there was a fix lately."""
        return self._fix_time is not None and time - self._fix_time <= self.LONGEST_S

    def plumb_line(self, axes: Array, gain: float) -> Array:
        """Specific force of the aircraft as if it stood still (3,), body axes [m/s2].

        axes: (3, 3) turns body vectors to north-east-down by the attitude held so far. gain: weight of the velocity
        error [1/s].
        """
        return np.asarray(-axes.T @ (_DOWN + gain * self._error))

    def _at(self, time: float) -> Array:
        """The integrated velocity (3,) at an earlier time, by straight lines."""
        times = [t for t, _ in self._history]
        k = min(max(bisect_left(times, time), 1), len(times) - 1)
        if k < 1:
            return self._history[0][1]
        (t0, v0), (t1, v1) = self._history[k - 1], self._history[k]
        share = min(max((time - t0) / (t1 - t0), 0.0), 1.0)
        return np.asarray(v0 + share * (v1 - v0))

    def advance(self, time: float, step: float, axes: Array, accel: Array, gain: float, antenna: Array) -> None:
        """Integrate to `time` over `step` [s] with the specific force (3,) of this sample and the attitude it led to.

        antenna: (3,) velocity of the receiver's antenna about the IMU, north-east-down [m/s].
        """
        acceleration = axes @ accel + _DOWN
        if self._acceleration is not None:
            change = 0.5 * (self._acceleration + acceleration) + gain * self._error
            self._velocity = self._velocity + step * change
        self._acceleration = acceleration
        self._history.append((time, self._velocity + antenna))
        while self._history[-1][0] - self._history[0][0] > self.HISTORY_S:
            self._history.popleft()


class AirPath:
    """Acceleration along the path through the air, dV/dt + omega x V with V along body x."""

    SMOOTHING_S = 0.4

    def __init__(self) -> None:
        self._airspeed: float | None = None
        self._speeding_up = 0.0  # [m/s2]

    def follow(self, airspeed: float | None, step: float | None) -> None:
        """Smooth the airspeed [m/s] (first order) and find its rate of change."""
        smooth = self._airspeed
        if airspeed is None or step is None or smooth is None:
            self._airspeed, self._speeding_up = airspeed, 0.0
            return
        share = step / (self.SMOOTHING_S + step)
        self._airspeed = smooth + share * (airspeed - smooth)
        self._speeding_up = (self._airspeed - smooth) / step

    def plumb_line(self, accel: Array, rate: Array) -> Array:
        """Specific force less the path's acceleration (3,) [m/s2]; rate [rad/s]."""
        speed = self._airspeed
        if speed is None:
            return accel
        return accel - np.array((self._speeding_up, speed * rate[2], -speed * rate[1]))
