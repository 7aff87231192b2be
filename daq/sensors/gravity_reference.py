"""The direction of gravity in a moving aircraft: the specific force without the acceleration of the flight path.

An accelerometer measures gravity and acceleration together. Two ways to separate them, the first whenever a GPS receiver
gives velocities, the second without one:

`GroundVelocity`: specific force is rotated to north-east-down by the present attitude, gravity is added, and the sum is
integrated to a velocity. Its difference from the GPS velocity corrects the vertical. Sideslip, gusts, turns and launches do
not disturb it, and neither vanes nor airspeed enter, so that the attitude is independent of the instruments that a flight
shall check. The receiver's latency does no harm: a fix is compared with the velocity of its own time.
`AirPath`: the acceleration is body rates times airspeed plus the rate of change of the airspeed. Sideslip velocity is
neglected; a rudder doublet then makes an error of a degree or two of bank.

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
    """Velocity over ground by inertial integration, corrected by GPS; see the module.

    Call `add_fix` and `static_force` before the attitude is advanced to a sample, and `advance` after.
    """

    LONGEST_S = 1.0  # without a fix for longer, the integrated velocity is useless
    HISTORY_S = 1.0  # how late a fix may come

    def __init__(self) -> None:
        self._history: deque[tuple[float, Vector]] = deque()  # velocity of the antenna
        self._velocity = ZERO
        self._acceleration: Vector | None = None
        self._error = ZERO
        self._fix_time: float | None = None
        self._pending: VelocityFix | None = None

    @property
    def fix_pending(self) -> bool:
        """Whether a fix lies after the time that the integration has reached."""
        return self._pending is not None

    def restart(self) -> None:
        """Back to the state without samples and fixes."""
        self._history.clear()
        self._velocity = self._error = ZERO
        self._acceleration, self._fix_time, self._pending = None, None, None

    def add_fix(self, fix: VelocityFix | None) -> None:
        """Use a new fix, or the pending one, as soon as the integration has reached its time; after a pause the integration
        restarts at it."""
        for velocity_fix in (self._pending, fix):
            if velocity_fix is None:
                continue
            self._pending = velocity_fix
            if self._history and velocity_fix.time <= self._history[-1][0]:
                self._pending = None
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
        """Whether the last fix is recent enough for the velocity to be known at `time` [s]."""
        return self._fix_time is not None and time - self._fix_time <= self.LONGEST_S

    def static_force(self, axes: Axes, gain: float) -> Vector:
        """Specific force of the aircraft if it stood still at the present attitude, body axes [m/s2], with the correction by GPS.

        axes: rotates body vectors to north-east-down by the present attitude. gain: weight of the velocity error [1/s].
        """
        x, y, z = turned_back(axes, plus(_DOWN, self._error, gain))
        return -x, -y, -z

    def _at(self, time: float) -> Vector:
        """The integrated velocity at an earlier time, by linear interpolation."""
        next_sample = self._history[-1]
        for earlier in reversed(self._history):
            if earlier[0] < time:
                break
            next_sample = earlier
        (t0, v0), (t1, v1) = earlier, next_sample
        if t0 == t1:  # before the history, or at its end
            return v1
        return plus(v0, plus(v1, v0, -1.0), (time - t0) / (t1 - t0))

    def advance(self, time: float, step: float, axes: Axes, accel: Vector, gain: float, antenna: Vector) -> None:
        """Integrate to `time` over `step` [s] with the specific force of this sample and the attitude after it.

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
        self._airspeed_rate = 0.0  # [m/s2]

    def update(self, airspeed: float | None, step: float | None) -> None:
        """Smooth the airspeed [m/s] (first order) and take its rate of change."""
        smooth = self._airspeed
        if airspeed is None or step is None or smooth is None:
            self._airspeed, self._airspeed_rate = airspeed, 0.0
            return
        share = step / (self.SMOOTHING_S + step)
        self._airspeed = smooth + share * (airspeed - smooth)
        self._airspeed_rate = (self._airspeed - smooth) / step

    def static_force(self, accel: Vector, rate: Vector) -> Vector:
        """Specific force less the path's acceleration [m/s2]; rate [rad/s]."""
        speed = self._airspeed
        if speed is None:
            return accel
        return plus(accel, (self._airspeed_rate, speed * rate[2], -speed * rate[1]), -1.0)
