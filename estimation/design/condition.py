"""Where a manoeuvre begins: straight, level, unaccelerated flight at one speed."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from daq.contract.constants import GRAVITY
from estimation.aircraft import Aircraft
from estimation.models.base import Model

USUAL_ALPHA = 0.08
"""Angle of attack [rad] where lift and pitching moment of the aircraft are not known: that of a small aircraft at cruise."""

TRIM_ROUNDS = 8
"""Of the fixed point of lift and thrust: thrust's share of lift is some hundredths, so each round gains two digits."""


@dataclass(frozen=True)
class Condition:
    """Values by name of states, inputs and outputs in trimmed flight; SI and radians. notes: what was assumed."""

    values: Mapping[str, float]
    notes: tuple[str, ...] = ()

    def of(self, name: str) -> float:
        """Trim value of a signal; 0 for what rests."""
        return self.values.get(name, 0.0)


def trimmed(model: Model, aircraft: Aircraft, speed: float, density: float) -> Condition:
    """Level flight: CL q S + T sin(alpha) = m g, Cm = 0 for alpha and delta_e (linear), T cos(alpha) = drag.

    speed: true airspeed [m/s]; density [kg/m3]; thrust acts along x.
    """
    values = {**{n: p.value for n, p in aircraft.derivatives.items()}, **model.starts()}
    base = {"V": speed, "rho": density, "g": GRAVITY}
    needed = ("CL_alpha", "Cm_alpha", "Cm_de")
    if any(values.get(n, 0.0) == 0.0 for n in needed):
        note = (
            f"lift and pitching moment are not known: alpha and theta are taken as {math.degrees(USUAL_ALPHA):.1f} deg"
        )
        return Condition({**base, "alpha": USUAL_ALPHA, "theta": USUAL_ALPHA}, (note,))
    pressure = 0.5 * density * speed**2 * aircraft.area
    matrix = [[values["CL_alpha"], values.get("CL_de", 0.0)], [values["Cm_alpha"], values["Cm_de"]]]
    alpha = elevator = thrust = 0.0
    for _ in range(TRIM_ROUNDS):
        lift = (aircraft.mass * GRAVITY - thrust * math.sin(alpha)) / pressure
        right = [lift - values.get("CL_0", 0.0), -values.get("Cm_0", 0.0)]
        alpha, elevator = np.linalg.solve(matrix, right).tolist()
        thrust = pressure * (values.get("CD_0", 0.0) + values.get("CD_k", 0.0) * lift**2) / math.cos(alpha)
    found = {"alpha": alpha, "theta": alpha, "delta_e": elevator, "thrust": thrust}
    shown = {"az": -GRAVITY * math.cos(alpha), "ax": GRAVITY * math.sin(alpha)}
    return Condition({**base, **found, **shown})
