"""Hidden effects of airframe, engine and air that have a state or a memory, or take hold in more than one place.

Sizes are engineering estimates for this aircraft at 17 m/s.
"""

import math
from typing import TYPE_CHECKING

from firmware_sim.physics.effects.base import HiddenEffect
from firmware_sim.physics.effects.table import alpha_rate
from firmware_sim.physics.maths import State, Value

if TYPE_CHECKING:
    from firmware_sim.physics.motion import Motion


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
        losses = []
        for i in (0, 1):
            attached = xp.clip(x[self.at + i], 0.0, 1.0)
            factor = 0.5 * (1.0 + xp.sqrt(attached))
            losses.append(self.size * 0.5 * lift * (1.0 - factor * factor))
        left_loss, right_loss = losses
        m.CL = m.CL - left_loss - right_loss
        m.CD = m.CD + 0.5 * (left_loss + right_loss)
        m.Cl = m.Cl + self.ARM * (right_loss - left_loss)

    def derivatives(self, m: "Motion", x: State, dx: State) -> None:
        for i, side in ((0, -1.0), (1, 1.0)):
            dx[self.at + i] = (self._half(m, side) - x[self.at + i]) / self.LAG


class IndicialLag(HiddenEffect):
    """Leading-edge vortices take time to move: the dihedral effect answers a lagged sideslip; `size` is the lag in s.

    Two to five chords of travel are 0.07 to 0.18 s at 17 m/s.
    """

    name, title, group, unit, typical = "indicial_lag", "rolling moment lags behind sideslip", "unsteady", "s", 0.10
    states = 1

    def start(self, m: "Motion", x: State) -> None:
        x[self.at] = m.beta

    def coefficients(self, m: "Motion", x: State) -> None:
        lag_angle = x[self.at] - m.beta
        m.Cl = m.Cl + self.plant.derivatives["Cl_beta"] * lag_angle

    def derivatives(self, m: "Motion", x: State, dx: State) -> None:
        dx[self.at] = (m.beta - x[self.at]) / self.xp.maximum(self.size, 1e-3)


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
        lift = per_rate * rate
        drag = self.plant.derivatives["CD_k"] * lift * (2.0 * m.CL + lift)
        ca, sa = xp.cos(m.alpha), xp.sin(m.alpha)
        m.CL, m.CD = m.CL + lift, m.CD + drag
        m.X = m.X + force * (lift * sa - drag * ca)
        m.Z = m.Z - force * (lift * ca + drag * sa)


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


class RoughAir(HiddenEffect):
    """Lateral and vertical turbulence beyond the scenario's gusts: `size` rad of sideslip (1 sigma) at 17 m/s.

    A sum of incommensurate waves frozen in the air mass, with random phases per flight; amplitudes follow the -5/3 law
    between wavelengths of 8 and 120 m. Another generator than the scenario's gusts on purpose.
    """

    name, title, group, unit, typical = "gust", "rough air", "environment", "rad", math.radians(0.8)
    WAVES = 14

    def start(self, m: "Motion", x: State) -> None:
        numbers = [2.0 * math.pi / (8.0 * 15.0 ** (k / (self.WAVES - 1))) for k in range(self.WAVES)]
        powers = [n ** (-5.0 / 3.0) * n for n in numbers]
        total = sum(powers)
        self._waves = [
            (
                n,
                math.sqrt(2.0 * w / total),
                self.draw(lambda g: g.uniform(0.0, 2.0 * math.pi)),
                self.draw(lambda g: g.uniform(0.0, 2.0 * math.pi)),
            )
            for n, w in zip(numbers, powers, strict=True)
        ]

    def wind(self, m: "Motion", x: State) -> None:
        sin = self.xp.sin
        distance = 17.0 * m.t
        lateral: Value = 0.0
        vertical: Value = 0.0
        for number, amplitude, phase_v, phase_w in getattr(self, "_waves", ()):
            lateral = lateral + amplitude * sin(number * distance + phase_v)
            vertical = vertical + amplitude * sin(number * distance + phase_w)
        m.gust_v = m.gust_v + 17.0 * self.size * lateral
        m.gust_w = m.gust_w + 0.5 * 17.0 * self.size * vertical


class WindShear(HiddenEffect):
    """Wind from the north that grows with height: `size` 1/s about the starting height."""

    name, title, group, unit, typical = "wind_shear", "wind changes with height", "environment", "1/s", 0.15

    def start(self, m: "Motion", x: State) -> None:
        self._down = m.down

    def wind(self, m: "Motion", x: State) -> None:
        m.wind_north = m.wind_north - self.size * (getattr(self, "_down", m.down) - m.down)
