"""Hidden linkages: between the servo arm, where the potentiometer sits, and the surface that the air feels."""

from collections import deque
from typing import TYPE_CHECKING, Any, ClassVar

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
            whole = int(steps)
            part = steps - whole
            return (1.0 - part) * self._values[-1 - whole] + part * self._values[-2 - whole]
        steps = np.clip(np.broadcast_to(steps, (self._xp.flights,)), 0.0, len(self._values) - 2)
        whole = steps.astype(int)
        part = steps - whole
        out = np.empty(self._xp.flights)
        for k in np.unique(whole):
            chosen = whole == k
            newer, older = self._values[-1 - int(k)], self._values[-2 - int(k)]
            out[chosen] = ((1.0 - part) * newer + part * older)[chosen]
        return out


class _Delay(HiddenEffect):
    """Dead time between arm and surface; `size` in s."""

    group, unit, typical = "actuator", "s", 0.06
    arms: ClassVar[tuple[tuple[str, str], ...]]

    def bind(self, plant: Host) -> None:
        super().bind(plant)
        self._past: list[DelayedHistory] = []

    def start(self, m: "Motion", x: State) -> None:
        longest = float(np.max(self.size)) + 0.02
        self._past = [DelayedHistory(longest, self.plant.step_size, getattr(m, arm), self.xp) for arm, _ in self.arms]

    def linkage(self, m: "Motion", x: State) -> None:
        for past, (_, surface) in zip(self._past, self.arms, strict=False):
            setattr(m, surface, past.at(m.t - self.size))

    def commit(self, m: "Motion", x: State) -> None:
        for past, (arm, _) in zip(self._past, self.arms, strict=True):
            past.push(m.t, getattr(m, arm))


class AileronDelay(_Delay):
    """Elevons move a dead time after their potentiometers."""

    name, title = "aileron_delay", "dead time of the elevons"
    arms = (("arm_left", "surface_left"), ("arm_right", "surface_right"))


class RudderDelay(_Delay):
    """The fin moves a dead time after its potentiometer."""

    name, title = "rudder_delay", "dead time of the rudder"
    arms = (("arm_r", "surface_r"),)


class AileronLag(HiddenEffect):
    """Elastic linkages: elevons follow their arms with a first-order lag of `size` s."""

    name, title, group, unit, typical = "aileron_lag", "lag of the elevons", "actuator", "s", 0.06
    states = 2

    def start(self, m: "Motion", x: State) -> None:
        x[self.at], x[self.at + 1] = m.arm_left, m.arm_right

    def linkage(self, m: "Motion", x: State) -> None:
        m.surface_left, m.surface_right = x[self.at], x[self.at + 1]

    def derivatives(self, m: "Motion", x: State, dx: State) -> None:
        tau = self.xp.maximum(self.size, 1e-3)
        dx[self.at] = (m.arm_left - x[self.at]) / tau
        dx[self.at + 1] = (m.arm_right - x[self.at + 1]) / tau


class RudderLag(HiddenEffect):
    """Elastic linkage: the fin follows its arm with a first-order lag of `size` s."""

    name, title, group, unit, typical = "rudder_lag", "lag of the rudder", "actuator", "s", 0.06
    states = 1

    def start(self, m: "Motion", x: State) -> None:
        x[self.at] = m.arm_r

    def linkage(self, m: "Motion", x: State) -> None:
        m.surface_r = x[self.at]

    def derivatives(self, m: "Motion", x: State, dx: State) -> None:
        dx[self.at] = (m.arm_r - x[self.at]) / self.xp.maximum(self.size, 1e-3)


class ServoDelay(_Delay):
    """All surfaces move a dead time after what is recorded of them."""

    name, title = "servo_delay", "dead time of all surfaces"
    arms = (("arm_left", "surface_left"), ("arm_right", "surface_right"), ("arm_r", "surface_r"))


class ServoLag(HiddenEffect):
    """What is recorded is what the servos are told: all surfaces follow it with a first-order lag of `size` s."""

    name, title, group, unit, typical = "servo_lag", "lag of all surfaces", "actuator", "s", 0.06
    states = 3

    def start(self, m: "Motion", x: State) -> None:
        x[self.at], x[self.at + 1], x[self.at + 2] = m.arm_left, m.arm_right, m.arm_r

    def linkage(self, m: "Motion", x: State) -> None:
        m.surface_left, m.surface_right, m.surface_r = x[self.at], x[self.at + 1], x[self.at + 2]

    def derivatives(self, m: "Motion", x: State, dx: State) -> None:
        tau = self.xp.maximum(self.size, 1e-3)
        for k, arm in enumerate((m.arm_left, m.arm_right, m.arm_r)):
            dx[self.at + k] = (arm - x[self.at + k]) / tau


def _dead(value: Value, half_width: Value, xp: Maths) -> Value:
    """Nothing within the dead zone, the rest beyond it."""
    return value - xp.clip(value, -half_width, half_width)


class AileronDeadZone(HiddenEffect):
    """The aileron mixing does nothing near neutral: within `size` rad of differential deflection the elevons rest."""

    name, title, group, unit, typical = "aileron_deadzone", "dead zone of the ailerons", "actuator", "rad", 0.014

    def linkage(self, m: "Motion", x: State) -> None:
        both = 0.5 * (m.surface_left + m.surface_right)
        difference = _dead(0.5 * (m.surface_right - m.surface_left), self.size, self.xp)
        m.surface_left, m.surface_right = both - difference, both + difference


def _play(arm: Value, before: Value, half_gap: Value, xp: Maths) -> Value:
    """Surface position when the arm pushes it along after taking up the gap: the play operator."""
    return xp.clip(before, arm - half_gap, arm + half_gap)


class AileronBacklash(HiddenEffect):
    """Play in the aileron linkage: a change of direction moves nothing until a gap of 2 `size` rad is taken up."""

    name, title, group, unit, typical = "aileron_backlash", "play in the aileron linkage", "actuator", "rad", 0.012

    def start(self, m: "Motion", x: State) -> None:
        self._rests: Value = 0.5 * (m.arm_right - m.arm_left)

    def _difference(self, m: "Motion") -> Value:
        arm = 0.5 * (m.arm_right - m.arm_left)
        return _play(arm, getattr(self, "_rests", arm), self.size, self.xp)

    def linkage(self, m: "Motion", x: State) -> None:
        both, difference = 0.5 * (m.surface_left + m.surface_right), self._difference(m)
        m.surface_left, m.surface_right = both - difference, both + difference

    def commit(self, m: "Motion", x: State) -> None:
        self._rests = self._difference(m)


class RudderBacklash(HiddenEffect):
    """Play in the rudder linkage; gap of 2 `size` rad."""

    name, title, group, unit, typical = "rudder_backlash", "play in the rudder linkage", "actuator", "rad", 0.012

    def start(self, m: "Motion", x: State) -> None:
        self._rests: Value = m.arm_r

    def linkage(self, m: "Motion", x: State) -> None:
        m.surface_r = _play(m.arm_r, getattr(self, "_rests", m.arm_r), self.size, self.xp)

    def commit(self, m: "Motion", x: State) -> None:
        self._rests = m.surface_r


class SurfaceCompliance(HiddenEffect):
    """Pushrods bend under hinge moment: all surfaces give way with dynamic pressure; `size` per Pa."""

    name, title, group, unit, typical = "surface_compliance", "surfaces give way with dynamic pressure", "actuator", "1/Pa", 7e-4  # fmt: skip # noqa: E501

    def linkage(self, m: "Motion", x: State) -> None:
        kept = 1.0 / (1.0 + self.size * m.qbar)
        m.surface_left, m.surface_right = m.surface_left * kept, m.surface_right * kept
        m.surface_r = m.surface_r * kept
