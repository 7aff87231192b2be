"""Hidden linkage of the elevator: both elevons together leave where their arms are; their difference, the aileron, is kept."""

from typing import TYPE_CHECKING

import numpy as np

from firmware_sim.physics.effects.actuator import DelayedHistory
from firmware_sim.physics.effects.base import HiddenEffect, Host
from firmware_sim.physics.maths import State, Value

if TYPE_CHECKING:
    from firmware_sim.physics.motion import Motion


def arm_of(m: "Motion") -> Value:
    """Elevator as the potentiometers show it."""
    return 0.5 * (m.arm_left + m.arm_right)


def stand(m: "Motion", elevator: Value) -> None:
    """Let the elevator stand there, the aileron where it was."""
    shift = elevator - 0.5 * (m.surface_left + m.surface_right)
    m.surface_left, m.surface_right = m.surface_left + shift, m.surface_right + shift


class _Linkage(HiddenEffect):
    group = "elevator"


class ElevatorDelay(_Linkage):
    """The elevator moves a dead time of `size` s after its potentiometers."""

    name, title, unit, typical = "elevator_delay", "dead time of the elevator", "s", 0.025

    def bind(self, plant: Host) -> None:
        super().bind(plant)
        self._past: DelayedHistory | None = None

    def start(self, m: "Motion", x: State) -> None:
        self._past = DelayedHistory(float(np.max(self.size)) + 0.02, self.plant.step_size, arm_of(m), self.xp)

    def linkage(self, m: "Motion", x: State) -> None:
        if self._past is not None:
            stand(m, self._past.at(m.t - self.size))

    def commit(self, m: "Motion", x: State) -> None:
        if self._past is not None:
            self._past.push(m.t, arm_of(m))


class ElevatorLag(_Linkage):
    """Elastic linkage: the elevator follows its arms with a first-order lag of `size` s."""

    name, title, unit, typical = "elevator_lag", "lag of the elevator", "s", 0.04
    states = 1

    def start(self, m: "Motion", x: State) -> None:
        x[self.at] = arm_of(m)

    def linkage(self, m: "Motion", x: State) -> None:
        stand(m, x[self.at])

    def derivatives(self, m: "Motion", x: State, dx: State) -> None:
        dx[self.at] = (arm_of(m) - x[self.at]) / self.xp.maximum(self.size, 1e-3)


class ElevatorDeadZone(_Linkage):
    """Within `size` rad of neutral the elevator rests."""

    name, title, unit, typical = "elevator_deadzone", "dead zone of the elevator", "rad", 0.0052

    def linkage(self, m: "Motion", x: State) -> None:
        arm = arm_of(m)
        stand(m, arm - self.xp.clip(arm, -self.size, self.size))


class ElevatorBacklash(_Linkage):
    """A change of direction moves nothing until a gap of 2 `size` rad is taken up."""

    name, title, unit, typical = "elevator_backlash", "play in the elevator linkage", "rad", 0.0052

    def start(self, m: "Motion", x: State) -> None:
        self._rests: Value = arm_of(m)

    def _taken(self, m: "Motion") -> Value:
        arm = arm_of(m)
        return self.xp.clip(getattr(self, "_rests", arm), arm - self.size, arm + self.size)

    def linkage(self, m: "Motion", x: State) -> None:
        stand(m, self._taken(m))

    def commit(self, m: "Motion", x: State) -> None:
        self._rests = self._taken(m)


class ElevatorRateLimit(_Linkage):
    """A loaded linkage needs `size` s for a radian at the least."""

    name, title, unit, typical = "elevator_rate_limit", "elevator slower than its servo", "s/rad", 0.4

    def start(self, m: "Motion", x: State) -> None:
        self._rests: Value = arm_of(m)
        self._when = m.t

    def _reached(self, m: "Motion") -> Value:
        arm = arm_of(m)
        reach = (m.t - getattr(self, "_when", m.t)) / self.xp.maximum(self.size, 1e-6)
        rests = getattr(self, "_rests", arm)
        return self.xp.clip(arm, rests - reach, rests + reach)

    def linkage(self, m: "Motion", x: State) -> None:
        stand(m, self._reached(m))

    def commit(self, m: "Motion", x: State) -> None:
        self._rests, self._when = self._reached(m), m.t


class ElevatorCompliance(_Linkage):
    """Linkage and surface bend: `size` of the deflection is lost from 200 to 400 Pa."""

    name, title, unit, typical = "elevator_compliance", "elevator gives way with dynamic pressure", "1", 0.15

    def linkage(self, m: "Motion", x: State) -> None:
        both = 0.5 * (m.surface_left + m.surface_right)
        stand(m, both * (1.0 - self.size * (m.qbar / 200.0 - 1.0)))
