"""Steady wind and gusts.

Gusts follow Dryden spectra at low altitude (MIL-F-8785C form): first order along the path and for the roll gust, second
order across it. The level is given as the angle of the lateral gust at the trim speed, so the same number means the same
disturbance of sideslip at any speed. The shaping filters are driven by white noise that is constant over an integration step,
so that a flight does not depend on the times at which it is sampled.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from firmware_sim.physics.maths import Maths, State, Value

GUST_STATES = 6  # u; v and its inner state; w and its inner state; p
NOISE_CHANNELS = 4
LENGTH, VERTICAL_LENGTH = 50.0, 30.0  # m, scale lengths at some 60 m above ground
VERTICAL_SHARE = 0.7  # of vertical to lateral gusts near the ground


@dataclass(frozen=True, slots=True)
class Gusts:
    """Dryden gust model of one or many flights.

    sigma_lateral, sigma_vertical, sigma_along [m/s]; lengths [m]; speed [m/s] at which the field is crossed.
    """

    sigma_along: Value
    sigma_lateral: Value
    sigma_vertical: Value
    sigma_roll: Value
    speed: Value
    length: Value
    length_vertical: Value
    span: float

    def derivatives(self, x: State, at: int, noise: State, dx: State, xp: Maths) -> None:
        """Rates of the six filter states for unit white noise `noise` (variance 1 / step)."""
        tu = self.length / self.speed
        tw = self.length_vertical / self.speed
        tp = math.sqrt(self.length_vertical * self.span) / (2.6 * self.speed)
        dx[at] = (-x[at] + self.sigma_along * xp.sqrt(2.0 * tu) * noise[0]) / tu
        self._second_order(x, at + 1, self.sigma_lateral, tu, noise[1], dx, xp)
        self._second_order(x, at + 3, self.sigma_vertical, tw, noise[2], dx, xp)
        dx[at + 5] = (-x[at + 5] + self.sigma_roll * xp.sqrt(2.0 * tp) * noise[3]) / tp

    @staticmethod
    def _second_order(x: State, i: int, sigma: Value, tau: Value, noise: Value, dx: State, xp: Maths) -> None:
        """sigma sqrt(tau) (1 + sqrt(3) tau s) / (1 + tau s)^2: output x[i], inner first-order state x[i + 1].

        With y the inner state, tau y' = -y + g noise, the output is sqrt(3) y + z where tau z' = -z + (1 - sqrt(3)) y.
        """
        gain = sigma * xp.sqrt(tau)
        inner_dot = (-x[i + 1] + gain * noise) / tau
        dx[i + 1] = inner_dot
        # x[i] holds the output o = sqrt(3) y + z, so o' = sqrt(3) y' + (-(o - sqrt(3) y) + (1 - sqrt(3)) y) / tau.
        dx[i] = math.sqrt(3.0) * inner_dot + (x[i + 1] - x[i]) / tau


def gusts_for(level_rad: Value, speed: Value, span: float, xp: Maths) -> Gusts:
    """Gusts whose lateral component is `level_rad` of sideslip (1 sigma) at `speed`.

    The roll gust follows MIL-F-8785C, scaled to the span.
    """
    lateral = xp.full(level_rad * speed)
    vertical = VERTICAL_SHARE * lateral
    roll = 1.9 * vertical / math.sqrt(VERTICAL_LENGTH * span)
    return Gusts(lateral, lateral, vertical, roll, xp.full(speed), LENGTH, VERTICAL_LENGTH, span)


def stationary_start(gusts: Gusts, draws: NDArray[np.float64]) -> list[Value]:
    """Filter states drawn from the stationary distribution; draws (6,) or (6, flights) of standard normals.

    From the Lyapunov equation of the second-order form: inner state variance sigma^2 / 2, output variance sigma^2,
    covariance (1 + sqrt(3)) sigma^2 / 4.
    """

    def pair(sigma: Value, one: Value, two: Value) -> tuple[Value, Value]:
        inner = sigma * one / math.sqrt(2.0)
        slope = (1.0 + math.sqrt(3.0)) / 2.0
        rest = math.sqrt(1.0 - slope**2 / 2.0)
        return slope * inner + sigma * rest * two, inner

    v, v_inner = pair(gusts.sigma_lateral, draws[1], draws[2])
    w, w_inner = pair(gusts.sigma_vertical, draws[3], draws[4])
    return [gusts.sigma_along * draws[0], v, v_inner, w, w_inner, gusts.sigma_roll * draws[5]]
