"""Hidden propulsion: what the propeller does besides pulling."""

from typing import TYPE_CHECKING

from firmware_sim.physics.effects.base import HiddenEffect
from firmware_sim.physics.maths import State

if TYPE_CHECKING:
    from firmware_sim.physics.motion import Motion

DISC_AREA = 0.0507  # m2 of a 10 inch propeller


class MotorTorque(HiddenEffect):
    """The propeller's drag torque turns the aircraft the other way, in proportion to thrust; `size` in N m per N."""

    name, title, group, unit, typical = "motor_torque", "motor torque rolls the aircraft", "propulsion", "m", 0.03

    def moments(self, m: "Motion", x: State) -> None:
        m.L = m.L - self.size * m.thrust


class SlipstreamOnFin(HiddenEffect):
    """The fin stands in the slipstream: its effectiveness grows with thrust.

    Momentum theory: dynamic pressure in the slipstream is raised by T / A; `size` of it reaches the fin.
    """

    name, title, group, unit, typical = "slipstream_rudder", "slipstream over the fin", "propulsion", "1", 0.5

    def coefficients(self, m: "Motion", x: State) -> None:
        gain = self.size * m.thrust / (m.qbar * DISC_AREA) * m.surface_r
        d = self.plant.derivatives
        m.CY = m.CY + d["CY_dr"] * gain
        m.Cl = m.Cl + d["Cl_dr"] * gain
        m.Cn = m.Cn + d["Cn_dr"] * gain


class PFactor(HiddenEffect):
    """The down-going blade pulls harder at an angle of attack: thrust acts off the axis, `size` m per rad."""

    name, title, group, unit, typical = "p_factor", "thrust moves off its axis with angle of attack", "propulsion", "m/rad", 0.25  # fmt: skip # noqa: E501

    def moments(self, m: "Motion", x: State) -> None:
        m.N = m.N - self.size * m.thrust * m.alpha
        m.M = m.M - self.size * m.thrust * m.beta
