"""Hidden unsteady aerodynamics: forces that remember how the flow came about."""

from typing import TYPE_CHECKING

from firmware_sim.physics.effects.base import HiddenEffect
from firmware_sim.physics.maths import State

if TYPE_CHECKING:
    from firmware_sim.physics.motion import Motion


class _SideslipRate(HiddenEffect):
    group, unit = "unsteady", "1/rad"

    def _moment(self, m: "Motion") -> object:
        """Moment [N m] of the coefficient times beta_dot b / 2V."""
        craft = self.plant.aircraft
        return m.qbar * craft.area * craft.span * self.size * m.beta_dot * (0.5 * craft.span / m.V)


class RollFromSideslipRate(_SideslipRate):
    """Lift of the two halves follows a change of sideslip late: rolling moment with beta_dot."""

    name, title, typical = "Cl_betadot", "rolling moment from rate of sideslip", 0.10

    def moments(self, m: "Motion", x: State) -> None:
        m.L = m.L + self._moment(m)


class YawFromSideslipRate(_SideslipRate):
    """Sidewash reaches the fin late: yawing moment with beta_dot."""

    name, title, typical = "Cn_betadot", "yawing moment from rate of sideslip", 0.03

    def moments(self, m: "Motion", x: State) -> None:
        m.N = m.N + self._moment(m)


class IndicialLag(HiddenEffect):
    """Leading-edge vortices take time to move: the dihedral effect answers a lagged sideslip; `size` is the lag in s.

    Two to five chords of travel are 0.07 to 0.18 s at 17 m/s.
    """

    name, title, group, unit, typical = "indicial_lag", "rolling moment lags behind sideslip", "unsteady", "s", 0.10
    states = 1

    def start(self, m: "Motion", x: State) -> None:
        x[self.at] = m.beta

    def coefficients(self, m: "Motion", x: State) -> None:
        behind = x[self.at] - m.beta
        m.Cl = m.Cl + self.plant.derivatives["Cl_beta"] * behind

    def derivatives(self, m: "Motion", x: State, dx: State) -> None:
        dx[self.at] = (m.beta - x[self.at]) / self.xp.maximum(self.size, 1e-3)
