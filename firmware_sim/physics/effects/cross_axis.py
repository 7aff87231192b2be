"""Hidden coupling of the planes: of sideslip and ailerons into lift, drag and pitching, of alpha into rolling and yawing."""

from typing import TYPE_CHECKING, ClassVar

from firmware_sim.physics.effects.aerodynamic import REFERENCE_ALPHA
from firmware_sim.physics.effects.base import HiddenEffect
from firmware_sim.physics.maths import State

if TYPE_CHECKING:
    from firmware_sim.physics.motion import Motion


class _Coupling(HiddenEffect):
    """Adds `size` times the product of some quantities of the motion to one coefficient."""

    group = "across axes"
    target: ClassVar[str]
    factors: ClassVar[tuple[str, str]]

    def coefficients(self, m: "Motion", x: State) -> None:
        one, two = (m.alpha - REFERENCE_ALPHA if f == "over" else getattr(m, f) for f in self.factors)
        more = self.size * one * two
        if self.target == "CL":
            m.CD = m.CD + self.plant.derivatives["CD_k"] * more * (2.0 * m.CL + more)
        setattr(m, self.target, getattr(m, self.target) + more)


class PitchFromSideslip(_Coupling):
    """Slipping either way pitches the nose."""

    name, title, unit, typical = "Cm_beta2", "pitching moment from sideslip", "1/rad2", 0.3
    target, factors = "Cm", ("beta", "beta")


class LiftFromSideslip(_Coupling):
    """Slipping either way costs lift."""

    name, title, unit, typical = "CL_beta2", "lift lost in sideslip", "1/rad2", -1.0
    target, factors = "CL", ("beta", "beta")


class DragFromSideslip(_Coupling):
    """Slipping either way drags."""

    name, title, unit, typical = "CD_beta2", "drag of sideslip", "1/rad2", 0.4
    target, factors = "CD", ("beta", "beta")


class LiftFromAileron(_Coupling):
    """One elevon up and one down do not cancel in lift."""

    name, title, unit, typical = "CL_da2", "lift from aileron", "1/rad2", 0.3
    target, factors = "CL", ("surface_a", "surface_a")


class DragFromAileron(_Coupling):
    """One elevon up and one down drag."""

    name, title, unit, typical = "CD_da2", "drag of the ailerons", "1/rad2", 0.3
    target, factors = "CD", ("surface_a", "surface_a")


class PitchFromAileron(_Coupling):
    """One elevon up and one down do not cancel in pitching moment."""

    name, title, unit, typical = "Cm_da2", "pitching moment from aileron", "1/rad2", 0.3
    target, factors = "Cm", ("surface_a", "surface_a")


class AileronWithAlpha(_Coupling):
    """Ailerons lose effect as the flow thickens."""

    name, title, unit, typical = "Cl_alpha_da", "aileron effectiveness with angle of attack", "1/rad2", 0.2
    target, factors = "Cl", ("over", "surface_a")


class AdverseYawWithAlpha(_Coupling):
    """Adverse yaw grows with lift."""

    name, title, unit, typical = "Cn_alpha_da", "adverse yaw with angle of attack", "1/rad2", 0.1
    target, factors = "Cn", ("over", "surface_a")


class RudderWithAlpha(_Coupling):
    """The rudder meets the wing's wake."""

    name, title, unit, typical = "Cn_alpha_dr", "rudder effectiveness with angle of attack", "1/rad2", 0.2
    target, factors = "Cn", ("over", "surface_r")


class RollDampingWithAlpha(_Coupling):
    """Roll damping follows the slope of lift."""

    name, title, unit, typical = "Cl_alpha_p", "roll damping with angle of attack", "1/rad2", 1.0
    target, factors = "Cl", ("over", "p_hat")


class YawFromRollWithAlpha(_Coupling):
    """Yaw from rolling goes with lift."""

    name, title, unit, typical = "Cn_alpha_p", "yaw from roll with angle of attack", "1/rad2", 0.3
    target, factors = "Cn", ("over", "p_hat")
