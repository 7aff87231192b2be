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

from collections import deque
from dataclasses import dataclass

from daq.sensors.vectors import ZERO, Axes, Vector, plus, turned, turned_back
from daq.utilities.constants import GRAVITY

_DOWN = (0.0, 0.0, GRAVITY)


@dataclass(frozen=True, slots=True)
class VelocityFix:
    """Velocity over ground (north, east, down) [m/s] at a time [s] on the clock of the samples."""

    time: float
    velocity: Vector


class GroundVelocity:
    """Velocity over ground by inertial integration, held by GPS; see the module.

    Call `hear` and `plumb_line` before the attitude is advanced to a sample, and `advance` after.
    """

    LONGEST_S = 1.0  # without a fix for longer, the integrated velocity is worth nothing
    HISTORY_S = 1.0  # how late a fix may come

    def __init__(self) -> None:
        self._history: deque[tuple[float, Vector]] = deque()  # velocity of the antenna
        self._velocity = ZERO
        self._acceleration: Vector | None = None
        self._error = ZERO
        self._fix_time: float | None = None
        self._waiting: VelocityFix | None = None

    @property
    def waits(self) -> bool:
        """Whether a fix has come whose time the integration has not reached."""
        return self._waiting is not None

    def restart(self) -> None:
        """Forget everything."""
        self._history.clear()
        self._velocity = self._error = ZERO
        self._acceleration, self._fix_time, self._waiting = None, None, None

    def hear(self, fix: VelocityFix | None) -> None:
        """Take in a fix that has come since the last call, as soon as the integration has reached its time; after a pause
        the integration begins anew at it."""
        for velocity_fix in (self._waiting, fix):
            if velocity_fix is None:
                continue
            self._waiting = velocity_fix
            if self._history and velocity_fix.time <= self._history[-1][0]:
                self._waiting = None
                self._compare(velocity_fix)

    def _compare(self, fix: VelocityFix) -> None:
        restart = not self.known(fix.time)
        self._fix_time = fix.time
        error = plus(fix.velocity, self._at(fix.time), -1.0)
        if restart:
            self._velocity = plus(self._velocity, error)
            self._history = deque((t, plus(v, error)) for t, v in self._history)
        self._error = ZERO if restart else error

    def known(self, time: float) -> bool:
        """Whether there was a fix lately."""
        return self._fix_time is not None and time - self._fix_time <= self.LONGEST_S

    def plumb_line(self, axes: Axes, gain: float) -> Vector:
        """Specific force of the aircraft as if it stood still, body axes [m/s2].

        axes: turns body vectors to north-east-down by the attitude held so far. gain: weight of the velocity error [1/s].
        """
        x, y, z = turned_back(axes, plus(_DOWN, self._error, gain))
        return -x, -y, -z

    def _at(self, time: float) -> Vector:
        """The integrated velocity at an earlier time, by straight lines."""
        next_sample = self._history[-1]
        for earlier in reversed(self._history):
            if earlier[0] < time:
                break
            next_sample = earlier
        (t0, v0), (t1, v1) = earlier, next_sample
        if t0 == t1:  # before all that is remembered, or at its end
            return v1
        return plus(v0, plus(v1, v0, -1.0), (time - t0) / (t1 - t0))

    def advance(self, time: float, step: float, axes: Axes, accel: Vector, gain: float, antenna: Vector) -> None:
        """Integrate to `time` over `step` [s] with the specific force of this sample and the attitude it led to.

        antenna: velocity of the receiver's antenna about the IMU, north-east-down [m/s].
        """
        acceleration = plus(turned(axes, accel), _DOWN)
        if self._acceleration is not None:
            mean = plus(self._acceleration, acceleration)
            self._velocity = plus(self._velocity, plus(mean, self._error, 2.0 * gain), 0.5 * step)
        self._acceleration = acceleration
        self._history.append((time, plus(self._velocity, antenna)))
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

    def plumb_line(self, accel: Vector, rate: Vector) -> Vector:
        """Specific force less the path's acceleration [m/s2]; rate [rad/s]."""
        speed = self._airspeed
        if speed is None:
            return accel
        return plus(accel, (self._speeding_up, speed * rate[2], -speed * rate[1]), -1.0)
