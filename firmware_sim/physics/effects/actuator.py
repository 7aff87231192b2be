"""Hidden linkages: between the servo arm, where the potentiometer sits, and the surface that the air feels.

Elevator is both elevons together, aileron half their difference; a linkage of one leaves the other where it was.
"""

from collections import deque
from collections.abc import Callable
from operator import attrgetter
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np

from firmware_sim.physics.effects.base import HiddenEffect, Host
from firmware_sim.physics.maths import Maths, State, Value

if TYPE_CHECKING:
    from firmware_sim.physics.motion import Motion


class DelayedHistory:
    """Values on the time grid, looked up in the past with linear interpolation; one value or one per flight."""

    def __init__(self, longest: float, step: float, first: Value, xp: Maths) -> None:
        self.step, self._xp = step, xp
        depth = int(np.ceil(longest / step)) + 3
        self._values: deque[Any] = deque([first] * depth, maxlen=depth)  # newest last
        self._newest = 0.0

    def push(self, time: float, value: Value) -> None:
        """Keep the value of a new grid point."""
        self._values.append(value)
        self._newest = time

    def at(self, time: Value) -> Value:
        """Value at a past time; times after the newest grid point give the newest value."""
        steps = (self._newest - time) / self.step
        if self._xp.flights is None:
            steps = min(max(steps, 0.0), len(self._values) - 2)
            index = int(steps)
            part = steps - index
            return (1.0 - part) * self._values[-1 - index] + part * self._values[-2 - index]
        steps = np.clip(np.broadcast_to(steps, (self._xp.flights,)), 0.0, len(self._values) - 2)
        index = steps.astype(int)
        part = steps - index
        values = np.empty(self._xp.flights)
        for k in np.unique(index):
            mask = index == k
            newer, older = self._values[-1 - int(k)], self._values[-2 - int(k)]
            values[mask] = ((1.0 - part) * newer + part * older)[mask]
        return values


class Joint(NamedTuple):
    """Where a linkage can give: the arm that its potentiometer shows, and what puts the surface somewhere."""

    arm: Callable[["Motion"], Value]
    stand: Callable[["Motion", Value], None]


def _elevator(m: "Motion") -> Value:
    return 0.5 * (m.arm_left + m.arm_right)


def _stand_elevator(m: "Motion", elevator: Value) -> None:
    """Let the elevator stand there, the aileron where it was."""
    shift = elevator - 0.5 * (m.surface_left + m.surface_right)
    m.surface_left, m.surface_right = m.surface_left + shift, m.surface_right + shift


def _aileron(m: "Motion") -> Value:
    return 0.5 * (m.arm_right - m.arm_left)


def _stand_aileron(m: "Motion", aileron: Value) -> None:
    """Let the aileron stand there, the elevator where it was."""
    elevator = 0.5 * (m.surface_left + m.surface_right)
    m.surface_left, m.surface_right = elevator - aileron, elevator + aileron


LEFT = Joint(attrgetter("arm_left"), lambda m, angle: setattr(m, "surface_left", angle))
RIGHT = Joint(attrgetter("arm_right"), lambda m, angle: setattr(m, "surface_right", angle))
RUDDER = Joint(attrgetter("arm_r"), lambda m, angle: setattr(m, "surface_r", angle))
ELEVATOR, AILERON = Joint(_elevator, _stand_elevator), Joint(_aileron, _stand_aileron)


class _Delay(HiddenEffect):
    """Dead time of `size` s between arms and surfaces."""

    group, unit, typical = "actuator", "s", 0.06
    joints: ClassVar[tuple[Joint, ...]]

    def bind(self, plant: Host) -> None:
        super().bind(plant)
        self._past: list[DelayedHistory] = []

    def start(self, m: "Motion", x: State) -> None:
        longest = float(np.max(self.size)) + 0.02
        self._past = [DelayedHistory(longest, self.plant.step_size, joint.arm(m), self.xp) for joint in self.joints]

    def linkage(self, m: "Motion", x: State) -> None:
        for history, joint in zip(self._past, self.joints, strict=False):  # none before the start
            joint.stand(m, history.at(m.t - self.size))

    def commit(self, m: "Motion", x: State) -> None:
        for history, joint in zip(self._past, self.joints, strict=False):
            history.push(m.t, joint.arm(m))


class AileronDelay(_Delay):
    """Elevons move a dead time after their potentiometers."""

    name, title, joints = "aileron_delay", "dead time of the elevons", (LEFT, RIGHT)


class RudderDelay(_Delay):
    """The fin moves a dead time after its potentiometer."""

    name, title, joints = "rudder_delay", "dead time of the rudder", (RUDDER,)


class ServoDelay(_Delay):
    """All surfaces move a dead time after what is recorded of them."""

    name, title, joints = "servo_delay", "dead time of all surfaces", (LEFT, RIGHT, RUDDER)


class ElevatorDelay(_Delay):
    """The elevator moves a dead time of `size` s after its potentiometers."""

    name, title, group, typical, joints = "elevator_delay", "dead time of the elevator", "elevator", 0.025, (ELEVATOR,)


class _Lag(HiddenEffect):
    """Elastic linkages: surfaces follow their arms with a first-order lag of `size` s, a state each."""

    group, unit, typical = "actuator", "s", 0.06
    joints: ClassVar[tuple[Joint, ...]]

    def start(self, m: "Motion", x: State) -> None:
        for k, joint in enumerate(self.joints):
            x[self.at + k] = joint.arm(m)

    def linkage(self, m: "Motion", x: State) -> None:
        for k, joint in enumerate(self.joints):
            joint.stand(m, x[self.at + k])

    def derivatives(self, m: "Motion", x: State, dx: State) -> None:
        tau = self.xp.maximum(self.size, 1e-3)
        for k, joint in enumerate(self.joints):
            dx[self.at + k] = (joint.arm(m) - x[self.at + k]) / tau


class AileronLag(_Lag):
    """Elevons follow their arms late."""

    name, title, states, joints = "aileron_lag", "lag of the elevons", 2, (LEFT, RIGHT)


class RudderLag(_Lag):
    """The fin follows its arm late."""

    name, title, states, joints = "rudder_lag", "lag of the rudder", 1, (RUDDER,)


class ServoLag(_Lag):
    """What is recorded is what the servos are told: all surfaces follow it late."""

    name, title, states, joints = "servo_lag", "lag of all surfaces", 3, (LEFT, RIGHT, RUDDER)


class ElevatorLag(_Lag):
    """The elevator follows its arms late."""

    name, title, group, typical, states, joints = (
        "elevator_lag",
        "lag of the elevator",
        "elevator",
        0.04,
        1,
        (ELEVATOR,),
    )


class AileronDeadZone(HiddenEffect):
    """The aileron mixing does nothing near neutral: within `size` rad of differential deflection the elevons rest."""

    name, title, group, unit, typical = "aileron_deadzone", "dead zone of the ailerons", "actuator", "rad", 0.014

    def linkage(self, m: "Motion", x: State) -> None:
        difference = 0.5 * (m.surface_right - m.surface_left)
        _stand_aileron(m, difference - self.xp.clip(difference, -self.size, self.size))


class ElevatorDeadZone(HiddenEffect):
    """Within `size` rad of neutral the elevator rests."""

    name, title, group, unit, typical = "elevator_deadzone", "dead zone of the elevator", "elevator", "rad", 0.0052

    def linkage(self, m: "Motion", x: State) -> None:
        arm = _elevator(m)
        _stand_elevator(m, arm - self.xp.clip(arm, -self.size, self.size))


class _Backlash(HiddenEffect):
    """Play: a change of direction moves nothing until a gap of 2 `size` rad is taken up."""

    group, unit, typical = "actuator", "rad", 0.012
    joint: ClassVar[Joint]

    def start(self, m: "Motion", x: State) -> None:
        self._position: Value = self.joint.arm(m)

    def position(self, m: "Motion") -> Value:
        """Where the arm has pushed the surface to."""
        arm = self.joint.arm(m)
        return self.xp.clip(getattr(self, "_position", arm), arm - self.size, arm + self.size)

    def linkage(self, m: "Motion", x: State) -> None:
        self.joint.stand(m, self.position(m))

    def commit(self, m: "Motion", x: State) -> None:
        self._position = self.position(m)


class AileronBacklash(_Backlash):
    """Play in the aileron linkage."""

    name, title, joint = "aileron_backlash", "play in the aileron linkage", AILERON


class RudderBacklash(_Backlash):
    """Play in the rudder linkage; the fin rests where it stands in the end, whatever else bends it."""

    name, title, joint = "rudder_backlash", "play in the rudder linkage", RUDDER

    def commit(self, m: "Motion", x: State) -> None:
        self._position = m.surface_r


class ElevatorBacklash(_Backlash):
    """Play in the elevator linkage."""

    name, title, group, typical = "elevator_backlash", "play in the elevator linkage", "elevator", 0.0052
    joint = ELEVATOR


class ElevatorRateLimit(HiddenEffect):
    """A loaded linkage needs `size` s for a radian at the least."""

    name, title, group, unit, typical = (
        "elevator_rate_limit",
        "elevator slower than its servo",
        "elevator",
        "s/rad",
        0.4,
    )

    def start(self, m: "Motion", x: State) -> None:
        self._position: Value = _elevator(m)
        self._time = m.t

    def position(self, m: "Motion") -> Value:
        """How far the elevator has come after its arms."""
        arm = _elevator(m)
        reach = (m.t - getattr(self, "_time", m.t)) / self.xp.maximum(self.size, 1e-6)
        start = getattr(self, "_position", arm)
        return self.xp.clip(arm, start - reach, start + reach)

    def linkage(self, m: "Motion", x: State) -> None:
        _stand_elevator(m, self.position(m))

    def commit(self, m: "Motion", x: State) -> None:
        self._position, self._time = self.position(m), m.t


class SurfaceCompliance(HiddenEffect):
    """Pushrods bend under hinge moment: all surfaces give way with dynamic pressure; `size` per Pa."""

    name, title, group, unit = "surface_compliance", "surfaces give way with dynamic pressure", "actuator", "1/Pa"
    typical = 7e-4

    def linkage(self, m: "Motion", x: State) -> None:
        share = 1.0 / (1.0 + self.size * m.qbar)
        m.surface_left, m.surface_right = m.surface_left * share, m.surface_right * share
        m.surface_r = m.surface_r * share


class ElevatorCompliance(HiddenEffect):
    """Linkage and surface bend: `size` of the deflection is lost from 200 to 400 Pa."""

    name, title, group, unit = "elevator_compliance", "elevator gives way with dynamic pressure", "elevator", "1"
    typical = 0.15

    def linkage(self, m: "Motion", x: State) -> None:
        elevator = 0.5 * (m.surface_left + m.surface_right)
        _stand_elevator(m, elevator * (1.0 - self.size * (m.qbar / 200.0 - 1.0)))
