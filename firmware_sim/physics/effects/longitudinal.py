"""Hidden lift, drag, pitching moment and thrust: what bends, what comes late, what the propeller's stream does.

All lift pays for itself: what an effect adds to lift adds its induced drag. Angles of attack count from level flight at 17 m/s.
Sizes are engineering estimates for this aircraft.
"""

from typing import TYPE_CHECKING, ClassVar

from daq.contract.constants import GRAVITY
from firmware_sim.physics.effects.aerodynamic import REFERENCE_ALPHA
from firmware_sim.physics.effects.base import HiddenEffect
from firmware_sim.physics.effects.propulsion import DISC_AREA
from firmware_sim.physics.maths import State, Value

if TYPE_CHECKING:
    from firmware_sim.physics.motion import Motion

REFERENCE_PRESSURE = 200.0  # Pa, dynamic: at it a surface that gives way has its nominal effect


class _Pitching(HiddenEffect):
    """Adds to one coefficient in proportion to `amount`."""

    group = "longitudinal"
    target: ClassVar[str]

    def amount(self, m: "Motion") -> Value:
        raise NotImplementedError

    def coefficients(self, m: "Motion", x: State) -> None:
        more = self.size * self.amount(m)
        if self.target == "CL":
            m.CD = m.CD + self.plant.derivatives["CD_k"] * more * (2.0 * m.CL + more)
        setattr(m, self.target, getattr(m, self.target) + more)


class _PowerOfAlpha(_Pitching):
    power: ClassVar[int]

    def amount(self, m: "Motion") -> Value:
        return (m.alpha - REFERENCE_ALPHA) ** self.power


class LiftSquare(_PowerOfAlpha):
    """Lift bends away from its line: vortex lift or early separation."""

    name, title, unit, typical, target, power = "CL_alpha2", "lift bends with angle of attack", "1/rad2", -4.0, "CL", 2


class LiftCube(_PowerOfAlpha):
    """Lift slope grows or falls on both sides of trim."""

    name, title, unit, typical, target, power = "CL_alpha3", "lift cubic in angle of attack", "1/rad3", -15.0, "CL", 3


class PitchUp(_PowerOfAlpha):
    """Static stability changes with angle of attack."""

    name, title, unit, typical, target, power = "Cm_alpha2", "pitch-up", "1/rad2", -0.4, "Cm", 2


class PitchCube(_PowerOfAlpha):
    """Static stability changes on both sides of trim."""

    name, title, unit, typical = "Cm_alpha3", "pitching moment cubic in angle of attack", "1/rad3", 2.0
    target, power = "Cm", 3


class ElevatorSaturationLift(_Pitching):
    """Flow leaves the strongly deflected trailing edge: lift is lost."""

    name, title, unit, typical, target = "CL_de3", "elevator loses lift at large angles", "1/rad3", -3.0, "CL"

    def amount(self, m: "Motion") -> Value:
        return m.surface_e * m.surface_e * m.surface_e


class ElevatorSaturation(_Pitching):
    """Flow leaves the strongly deflected trailing edge: moment is lost."""

    name, title, unit, typical, target = "Cm_de3", "elevator loses effectiveness at large angles", "1/rad3", 1.0, "Cm"

    def amount(self, m: "Motion") -> Value:
        return m.surface_e * m.surface_e * m.surface_e


class ElevatorWithAlpha(_Pitching):
    """Thick flow over the trailing edge at high angle of attack takes effect from the elevator."""

    name, title, unit, typical = "Cm_alpha_de", "elevator effectiveness changes with angle of attack", "1/rad2", 0.8
    target = "Cm"

    def amount(self, m: "Motion") -> Value:
        return (m.alpha - REFERENCE_ALPHA) * m.surface_e


class ShiftedPolar(_Pitching):
    """A cambered wing has its least drag at some lift."""

    name, title, unit, typical, target = "CD_CL", "least drag away from zero lift", "1", -0.03, "CD"

    def amount(self, m: "Motion") -> Value:
        return m.CL


class DragRise(_Pitching):
    """Separation drags before lift breaks."""

    name, title, unit, typical, target = "CD_alpha4", "drag rises steeply near the stall", "1/rad4", 8.0, "CD"

    def amount(self, m: "Motion") -> Value:
        return m.alpha * m.alpha * m.alpha * m.alpha


class ElevatorDrag(_Pitching):
    """Deflected trailing edges drag."""

    name, title, unit, typical, target = "CD_de2", "drag of the elevator", "1/rad2", 0.5, "CD"

    def amount(self, m: "Motion") -> Value:
        return m.surface_e * m.surface_e


class PitchRateDrag(_Pitching):
    """Pitching turns lift backward."""

    name, title, unit, typical, target = "CD_q", "drag from pitch rate", "1/rad", 0.2, "CD"

    def amount(self, m: "Motion") -> Value:
        return m.q_hat


class GroundEffect(_Pitching):
    """The ground hinders the downwash: induced drag times s / (1 + s), s = (16 h / b)^2 (McCormick 1979)."""

    name, title, unit, typical, target = "ground_effect", "less induced drag near the ground", "1", 1.0, "CD"

    def amount(self, m: "Motion") -> Value:
        ratio = 16.0 * m.down / self.plant.aircraft.span
        return -self.plant.derivatives["CD_k"] * m.CL * m.CL / (1.0 + ratio * ratio)


class WingCompliance(_Pitching):
    """The wing twists under load: `size` of its lift slope is lost from 200 to 400 Pa."""

    name, title, unit, typical, target = "wing_compliance", "wing gives way with dynamic pressure", "1", 0.15, "CL"

    def amount(self, m: "Motion") -> Value:
        return -(m.qbar / REFERENCE_PRESSURE - 1.0) * self.plant.derivatives["CL_alpha"] * m.alpha


class PropwashOnWing(_Pitching):
    """Part of the wing stands in the slipstream, whose dynamic pressure is raised by T / A: `size` of it counts."""

    name, title, unit, typical, target = "propwash_CL", "slipstream over the wing", "1", 0.1, "CL"

    def amount(self, m: "Motion") -> Value:
        return m.thrust / (m.qbar * DISC_AREA) * self.plant.derivatives["CL_alpha"] * m.alpha


class PropwashOnElevator(HiddenEffect):
    """The elevator stands in the slipstream: `size` of the rise of its dynamic pressure counts."""

    name, title, group, unit, typical = "propwash_elevator", "slipstream over the elevator", "longitudinal", "1", 0.3

    def coefficients(self, m: "Motion", x: State) -> None:
        d, gain = self.plant.derivatives, self.size * m.thrust / (m.qbar * DISC_AREA) * m.surface_e
        more = d["CL_de"] * gain
        m.CD = m.CD + d["CD_k"] * more * (2.0 * m.CL + more)
        m.CL = m.CL + more
        m.Cm = m.Cm + d["Cm_de"] * gain


def alpha_rate(m: "Motion", ax: Value, az: Value) -> Value:
    """Rate of angle of attack in still air for specific forces ax, az [m/s2]; a gust passing by is not counted."""
    ua_dot = ax + GRAVITY * m.c13 + m.r * m.va - m.q * m.wa
    wa_dot = az + GRAVITY * m.c33 + m.q * m.ua - m.p * m.va
    return (m.ua * wa_dot - m.wa * ua_dot) / (m.ua * m.ua + m.wa * m.wa)


class LiftFromAlphaRate(HiddenEffect):
    """The flow settles late: lift with the rate of angle of attack, which it changes itself.

    With F = k alpha_dot the lift and alpha_dot = alpha_dot0 - F / (m V) for flight in the plane of symmetry:
    alpha_dot = alpha_dot0 / (1 + k / (m V)).
    """

    name, title, group, unit, typical = "CL_alphadot", "lift from rate of angle of attack", "longitudinal", "1/rad", 1.5

    def forces(self, m: "Motion", x: State) -> None:
        xp, craft, mass = self.xp, self.plant.aircraft, self.plant.mass
        per_rate = self.size * 0.5 * craft.chord / m.V
        force = m.qbar * craft.area
        plane = xp.sqrt(m.ua * m.ua + m.wa * m.wa)
        rate = alpha_rate(m, m.X / mass, m.Z / mass) / (1.0 + force * per_rate / (mass * plane))
        more = per_rate * rate
        drag = self.plant.derivatives["CD_k"] * more * (2.0 * m.CL + more)
        ca, sa = xp.cos(m.alpha), xp.sin(m.alpha)
        m.CL, m.CD = m.CL + more, m.CD + drag
        m.X = m.X + force * (more * sa - drag * ca)
        m.Z = m.Z - force * (more * ca + drag * sa)


class MomentFromAlphaRate(HiddenEffect):
    """Downwash and vortices come late: pitching moment with the rate of angle of attack."""

    name, title, group, unit, typical = (
        "Cm_alphadot",
        "pitching moment from rate of angle of attack",
        "longitudinal",
        "1/rad",
        -0.4,
    )

    def moments(self, m: "Motion", x: State) -> None:
        craft = self.plant.aircraft
        m.M = m.M + m.qbar * craft.area * craft.chord * self.size * alpha_rate(m, m.ax, m.az) * 0.5 * craft.chord / m.V


class ThrustBelow(HiddenEffect):
    """The thrust line passes `size` m below the CG: thrust pitches the nose up."""

    name, title, group, unit, typical = "thrust_z", "thrust line below the CG", "longitudinal", "m", 0.02

    def moments(self, m: "Motion", x: State) -> None:
        m.M = m.M + self.size * m.thrust


class ThrustTilt(HiddenEffect):
    """The shaft points up by `size` rad through the CG."""

    name, title, group, unit, typical = "thrust_tilt", "thrust line tilted up", "longitudinal", "rad", 0.052

    def forces(self, m: "Motion", x: State) -> None:
        m.X = m.X + m.thrust * (self.xp.cos(self.size) - 1.0)
        m.Z = m.Z - m.thrust * self.xp.sin(self.size)


class ThrustScale(HiddenEffect):
    """The propeller pulls more by a fraction than its bench curve, which is recorded."""

    name, title, group, unit, typical = "thrust_scale", "thrust wrong by a factor", "longitudinal", "1", 0.08

    def forces(self, m: "Motion", x: State) -> None:
        m.X = m.X + self.size * m.thrust


class ThrustLag(HiddenEffect):
    """The air follows the recorded thrust with a first-order lag of `size` s."""

    name, title, group, unit, typical = "thrust_lag", "thrust later than recorded", "longitudinal", "s", 0.2
    states = 1

    def start(self, m: "Motion", x: State) -> None:
        x[self.at] = m.thrust

    def forces(self, m: "Motion", x: State) -> None:
        m.X = m.X + (x[self.at] - m.thrust)

    def derivatives(self, m: "Motion", x: State, dx: State) -> None:
        dx[self.at] = (m.thrust - x[self.at]) / self.xp.maximum(self.size, 1e-3)
