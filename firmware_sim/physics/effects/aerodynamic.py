"""Hidden aerodynamics: cross derivatives a simple model leaves out, and forces that do not grow in proportion.

Angles in rad, rates non-dimensional. Sizes are engineering estimates for this aircraft at 17 m/s.
"""

from typing import TYPE_CHECKING, ClassVar

from firmware_sim.physics.effects.base import HiddenEffect
from firmware_sim.physics.maths import State

if TYPE_CHECKING:
    from firmware_sim.physics.motion import Motion

REFERENCE_ALPHA = 0.086  # rad, level flight at 17 m/s


class AdverseYaw(HiddenEffect):
    """The down-going elevon drags more: yaw towards the rising wing."""

    name, title, group, unit, typical = "Cn_da", "adverse yaw from aileron", "omitted derivatives", "1/rad", -0.010

    def coefficients(self, m: "Motion", x: State) -> None:
        m.Cn = m.Cn + self.size * m.surface_a


class SideForceFromAileron(HiddenEffect):
    """Elevon pressure acts on the fin: side force with aileron."""

    name, title, group, unit, typical = "CY_da", "side force from aileron", "omitted derivatives", "1/rad", 0.04

    def coefficients(self, m: "Motion", x: State) -> None:
        m.CY = m.CY + self.size * m.surface_a


class SideForceFromRates(HiddenEffect):
    """More side force from rolling and yawing than the aircraft's own derivatives: `size` in CY_r, minus half in CY_p."""

    name, title, group, unit, typical = (
        "CY_p_r",
        "side force from roll and yaw rate",
        "omitted derivatives",
        "1/rad",
        0.08,
    )

    def coefficients(self, m: "Motion", x: State) -> None:
        m.CY = m.CY + self.size * (m.r_hat - 0.5 * m.p_hat)


class DihedralWithAlpha(HiddenEffect):
    """Leading-edge sweep: rolling moment due to sideslip grows with angle of attack."""

    name, title, group, unit = (
        "Cl_alpha_beta",
        "dihedral effect changes with angle of attack",
        "omitted derivatives",
        "1/rad2",
    )
    typical = -0.75

    def coefficients(self, m: "Motion", x: State) -> None:
        m.Cl = m.Cl + self.size * (m.alpha - REFERENCE_ALPHA) * m.beta


class WeathercockWithAlpha(HiddenEffect):
    """The fin meets the wing's wake: directional stability changes with angle of attack."""

    name, title, group, unit = "Cn_alpha_beta", "directional stability changes with angle of attack", "omitted derivatives", "1/rad2"  # fmt: skip # noqa: E501
    typical = -0.15

    def coefficients(self, m: "Motion", x: State) -> None:
        m.Cn = m.Cn + self.size * (m.alpha - REFERENCE_ALPHA) * m.beta


class ElevonMixing(HiddenEffect):
    """Elevons already deflected for pitch have less left to give in roll: Cl_da changes with elevator."""

    name, title, group, unit, typical = "Cl_da_de", "aileron effectiveness changes with elevator", "omitted derivatives", "1/rad2", 0.30  # fmt: skip # noqa: E501

    def coefficients(self, m: "Motion", x: State) -> None:
        m.Cl = m.Cl + self.size * m.surface_a * m.surface_e


class _CubeOfSideslip(HiddenEffect):
    target: ClassVar[str]
    group, unit = "aerodynamic nonlinearity", "1/rad3"

    def coefficients(self, m: "Motion", x: State) -> None:
        setattr(m, self.target, getattr(m, self.target) + self.size * m.beta * m.beta * m.beta)


class RollCubic(_CubeOfSideslip):
    """Vortices over a cropped delta: rolling moment bends away from its line beyond some five degrees of sideslip."""

    name, title, typical, target = "Cl_beta3", "rolling moment cubic in sideslip", 0.5, "Cl"


class YawCubic(_CubeOfSideslip):
    """Directional stability changes with the amplitude of sideslip."""

    name, title, typical, target = "Cn_beta3", "yawing moment cubic in sideslip", 0.25, "Cn"


class SideForceCubic(_CubeOfSideslip):
    """Cross-flow drag of body and fin."""

    name, title, typical, target = "CY_beta3", "side force cubic in sideslip", -1.5, "CY"


class AileronSaturation(HiddenEffect):
    """Flow separates from the hinge: effectiveness lost in proportion to deflection squared; 18 % at 15 degrees."""

    name, title, group, unit, typical = "Cl_da3", "aileron loses effectiveness at large angles", "aerodynamic nonlinearity", "1/rad2", 2.6  # fmt: skip # noqa: E501

    def coefficients(self, m: "Motion", x: State) -> None:
        d = m.surface_a
        m.Cl = m.Cl - self.plant.derivatives["Cl_da"] * self.size * d * d * d


class FinStallYaw(HiddenEffect):
    """The all-moving fin nears its stall: yawing moment lost with the cube of its local angle; 20 % at 12 degrees."""

    name, title, group, unit, typical = "Cn_dr3", "fin stalls: yawing moment cubic in rudder", "aerodynamic nonlinearity", "1/rad2", 4.5  # fmt: skip # noqa: E501

    def coefficients(self, m: "Motion", x: State) -> None:
        d = m.surface_r
        m.Cn = m.Cn - self.plant.derivatives["Cn_dr"] * self.size * d * d * d


class RollDampingNonlinear(HiddenEffect):
    """Tips approach stall in fast rolls: damping that grows with rate; 10 % at p b / 2V = 0.07."""

    name, title, group, unit, typical = "Cl_p_abs_p", "roll damping grows with roll rate", "aerodynamic nonlinearity", "1", 1.43  # fmt: skip # noqa: E501

    def coefficients(self, m: "Motion", x: State) -> None:
        xp = self.xp
        m.Cl = m.Cl + self.plant.derivatives["Cl_p"] * self.size * m.p_hat * xp.sign(m.p_hat) * m.p_hat


class StallSeparation(HiddenEffect):
    """Trailing-edge separation of each wing half with a lag (Kirchhoff; Goman and Khrabrov, J. Aircraft 31 (1994) 1109).

    Each half sees its own angle of attack (roll rate and sideslip raise one and lower the other); attached fraction X
    follows 0.5 (1 - tanh a1 (alpha - tau2 alpha_dot - alpha*)) with lag; lift scales with ((1 + sqrt X) / 2)^2. Lost
    lift on one side rolls the aircraft.
    """

    name, title, group, unit = "stall_separation", "flow separation with lag at high angle of attack", "aerodynamic nonlinearity", "1"  # fmt: skip # noqa: E501
    typical = 1.0
    states = 2
    STALL_ALPHA, SHARPNESS, LAG, ARM = 0.16, 22.0, 0.15, 0.24

    def _half(self, m: "Motion", side: float) -> object:
        """Static attached fraction of the right (+1) or left (-1) half."""
        local = m.alpha + side * (m.p_hat * 0.5 - 0.15 * m.beta)
        return 0.5 * (1.0 - self.xp.tanh(self.SHARPNESS * (local - self.STALL_ALPHA)))

    def start(self, m: "Motion", x: State) -> None:
        x[self.at], x[self.at + 1] = self._half(m, -1.0), self._half(m, 1.0)

    def coefficients(self, m: "Motion", x: State) -> None:
        xp = self.xp
        lift = self.plant.derivatives["CL_alpha"] * m.alpha
        lost = []
        for i in (0, 1):
            attached = xp.clip(x[self.at + i], 0.0, 1.0)
            factor = 0.5 * (1.0 + xp.sqrt(attached))
            lost.append(self.size * 0.5 * lift * (1.0 - factor * factor))
        left, right = lost
        m.CL = m.CL - left - right
        m.CD = m.CD + 0.5 * (left + right)
        m.Cl = m.Cl + self.ARM * (right - left)

    def derivatives(self, m: "Motion", x: State, dx: State) -> None:
        for i, side in ((0, -1.0), (1, 1.0)):
            dx[self.at + i] = (self._half(m, side) - x[self.at + i]) / self.LAG
