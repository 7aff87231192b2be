"""Hidden mass properties: what the scales and the swing test got wrong, and what spins."""

from typing import TYPE_CHECKING

from firmware_sim.physics.effects.base import HiddenEffect, Host
from firmware_sim.physics.maths import State

if TYPE_CHECKING:
    from firmware_sim.physics.motion import Motion


class ProductOfInertia(HiddenEffect):
    """The product of inertia is larger than the aircraft file says."""

    name, title, group, unit, typical = "Ixz_error", "product of inertia wrong", "kinematic, inertial", "kg m2", 0.015

    def bind(self, plant: Host) -> None:
        super().bind(plant)
        plant.Ixz = plant.Ixz + self.size


class LateralCg(HiddenEffect):
    """The CG sits to the right of the plane of symmetry: lift then acts left of it and rolls the aircraft."""

    name, title, group, unit, typical = "lateral_cg", "CG off the plane of symmetry", "kinematic, inertial", "m", 0.008

    def moments(self, m: "Motion", x: State) -> None:
        # Force at y = -size from the CG: L = y Z, N = -y X.
        m.L = m.L - self.size * m.Z
        m.N = m.N + self.size * m.X


class PropellerGyroscope(HiddenEffect):
    """The spinning propeller turns a pitch into a yaw and a yaw into a pitch; `size` is its angular momentum at 5.5 N.

    Clockwise seen from behind: momentum along +x, growing with the square root of thrust.
    """

    name, title, group, unit, typical = "prop_gyroscopic", "gyroscopic moments of the propeller", "kinematic, inertial", "kg m2/s", 0.15  # fmt: skip # noqa: E501

    def moments(self, m: "Motion", x: State) -> None:
        xp = self.xp
        momentum = self.size * xp.sqrt(xp.maximum(m.thrust, 0.0) / 5.5)
        m.M = m.M - momentum * m.r
        m.N = m.N + momentum * m.q


class RollInertia(HiddenEffect):
    """Roll inertia larger than the file says, by a fraction: tied to every rolling derivative."""

    name, title, group, unit, typical = "Ixx_scale", "roll inertia wrong by a factor", "exactly absorbed", "1", 0.10

    def bind(self, plant: Host) -> None:
        super().bind(plant)
        plant.Ixx = plant.Ixx * (1.0 + self.size)


class MassScale(HiddenEffect):
    """Mass larger than the file says, by a fraction: tied to every force derivative."""

    name, title, group, unit, typical = "mass_scale", "mass wrong by a factor", "exactly absorbed", "1", 0.08

    def bind(self, plant: Host) -> None:
        super().bind(plant)
        plant.mass = plant.mass * (1.0 + self.size)
