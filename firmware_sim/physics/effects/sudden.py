"""Failures in the air: nothing is wrong until they begin, `BEGINS_S` after the flight does.

For monitors that watch while the aircraft flies. Sizes are engineering estimates, chosen to be plainly there.
"""

from typing import TYPE_CHECKING

from firmware_sim.physics.effects.base import HiddenEffect, Sensed
from firmware_sim.physics.maths import State, Value

if TYPE_CHECKING:
    from firmware_sim.physics.motion import Motion

BEGINS_S = 20.0
ICES_S = 5.0
"""Time in which ice has grown [s]."""


class _Sudden(HiddenEffect):
    group = "sudden"
    catalogued = False


class ElevonStuck(_Sudden):
    """The linkage of the right elevon jams, `size` of its travel lost: it stays where it stood, whatever its arm does."""

    name, title, unit, typical = "elevon_stuck", "the right elevon sticks", "1", 1.0

    def start(self, m: "Motion", x: State) -> None:
        self._stood: Value = m.arm_right

    def linkage(self, m: "Motion", x: State) -> None:
        if m.t >= BEGINS_S:
            m.surface_right = m.surface_right + self.size * (self._stood - m.surface_right)

    def commit(self, m: "Motion", x: State) -> None:
        if m.t < BEGINS_S:
            self._stood = m.arm_right


class VaneSlipped(_Sudden):
    """The sideslip vane slips on its shaft by `size` rad."""

    name, title, unit, typical = "vane_slipped", "the sideslip vane slips on its shaft", "rad", 0.03

    def sense(self, s: Sensed, m: "Motion", x: State) -> None:
        if m.t >= BEGINS_S:
            s.beta = s.beta + self.size


class Ice(_Sudden):
    """Ice grows over five seconds: controls and damping in roll lose the share `size`, drag grows by a tenth of it."""

    name, title, unit, typical = "ice", "ice on the wing", "1", 0.3

    def coefficients(self, m: "Motion", x: State) -> None:
        share = self.size * min(max((m.t - BEGINS_S) / ICES_S, 0.0), 1.0)
        d = self.plant.derivatives
        m.Cl = m.Cl - share * (d["Cl_da"] * m.surface_a + d["Cl_p"] * m.p_hat)
        m.CD = m.CD + 0.1 * share


class MassShift(_Sudden):
    """A battery slides to starboard: the CG lies `size` m to the right of where the forces are."""

    name, title, unit, typical = "mass_shift", "a mass shifts sideways", "m", 0.015

    def moments(self, m: "Motion", x: State) -> None:
        if m.t >= BEGINS_S:
            m.L = m.L - self.size * m.Z
            m.N = m.N + self.size * m.X


class RudderStuck(_Sudden):
    """The fin jams: it stays where it stood, whatever its arm does."""

    name, title, unit, typical = "rudder_stuck", "the fin sticks", "1", 1.0

    def start(self, m: "Motion", x: State) -> None:
        self._stood: Value = m.arm_r

    def linkage(self, m: "Motion", x: State) -> None:
        if m.t >= BEGINS_S:
            m.surface_r = m.surface_r + self.size * (self._stood - m.surface_r)

    def commit(self, m: "Motion", x: State) -> None:
        if m.t < BEGINS_S:
            self._stood = m.arm_r


class EngineOut(_Sudden):
    """The engine loses the share `size` of its thrust."""

    name, title, unit, typical = "engine_out", "the engine stops", "1", 1.0

    def linkage(self, m: "Motion", x: State) -> None:
        if m.t >= BEGINS_S:
            m.thrust = m.thrust * (1.0 - self.size)


class GyroJumped(_Sudden):
    """The yaw gyro jumps by `size` rad/s, as with a cracked package."""

    name, title, unit, typical = "gyro_jumped", "the yaw gyro jumps", "rad/s", 0.05

    def sense(self, s: Sensed, m: "Motion", x: State) -> None:
        if m.t >= BEGINS_S:
            s.r = s.r + self.size


class PitotBlocked(_Sudden):
    """The pitot tube closes: the airspeed that it shows falls by the share `size`."""

    name, title, unit, typical = "pitot_blocked", "the pitot tube closes", "1", 0.4

    def sense(self, s: Sensed, m: "Motion", x: State) -> None:
        if m.t >= BEGINS_S:
            s.V = s.V * (1.0 - self.size)
