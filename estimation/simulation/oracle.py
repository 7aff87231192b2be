"""The interface of a simulation: six aerodynamic coefficients at given states, controls and air. Nothing else is used.

Body axes x forward, y right, z down; SI and radians; surfaces with the signs of the flight columns (+delta_a rolls left,
+delta_e nose down, +delta_r nose left). Moments are about the centre of gravity.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from estimation.aircraft import Aircraft
from estimation.errors import EstimationError
from groundstation.flight import Array

COEFFICIENTS = ("CX", "CY", "CZ", "Cl", "Cm", "Cn")
SURFACES = ("delta_e", "delta_a", "delta_r")
VARIABLES = ("V", "alpha", "beta", "p", "q", "r", *SURFACES, "thrust")
"""The variables of the coefficients, by which they are differentiated."""
ALPHA_RATE = "alpha_dot"
"""Rate of alpha [rad/s], on which moments may depend: its name in states, models and functions, and as a column of a flight
without noise (the value that a simulator's aerodynamics use)."""


class SimulationError(EstimationError):
    """A simulation that cannot be found, or that cannot compute its coefficients."""


@dataclass(frozen=True)
class States:
    """N states in the air. values: each of VARIABLES -> (N,) [m/s, rad, rad/s, N]; rho: (N,) kg/m3; alpha_dot: (N,) rad/s."""

    values: Mapping[str, Array]
    rho: Array
    alpha_dot: Array

    def __len__(self) -> int:
        return int(self.rho.size)

    def moved(self, name: str, step: Array | float) -> "States":
        """The same states with one variable, or the rate of alpha, changed by `step`."""
        if name == ALPHA_RATE:
            return replace(self, alpha_dot=self.alpha_dot + step)
        return replace(self, values={**self.values, name: self.values[name] + step})

    def part(self, keep: "NDArray[np.bool_] | slice") -> "States":
        """Some of the states."""
        values = {n: v[keep] for n, v in self.values.items()}
        return States(values, self.rho[keep], self.alpha_dot[keep])

    @classmethod
    def joined(cls, several: "list[States]") -> "States":
        """Several sets of states as one, because one call of a simulation is faster than many."""
        values = {n: np.concatenate([s.values[n] for s in several]) for n in VARIABLES}
        return cls(values, np.concatenate([s.rho for s in several]), np.concatenate([s.alpha_dot for s in several]))


class Oracle(Protocol):
    """The coefficients of a simulation at any state."""

    def coefficients(self, states: States) -> Array:
        """(N, 6) coefficients in the order of COEFFICIENTS, referred to the simulation's own area, span and chord; a column of
        NaN where the simulation has no such coefficient. Raises SimulationError where it cannot compute them."""


@dataclass(frozen=True)
class PolarOfAlpha:
    """Induced drag CD_k (CL_0 + CL_alpha alpha)^2 of a simulation whose drag depends only on the lift by angle of attack."""

    CL_0: float
    CL_alpha: float
    CD_k: float


@dataclass(frozen=True)
class Simulation:
    """A simulation and its properties.

    spec: the text that names it. name: a short name for models and files. aircraft: its geometry, mass and inertia, NaN where
    not stated, or None without any. notes: which parts of it are not used or held constant. referred: for a simulation that is
    defined by accelerations rather than coefficients: aircraft -> the simulation referred to its mass, inertia and geometry.
    polar: only where its drag leaves out the lift of elevator and pitch rate.
    """

    spec: str
    name: str
    oracle: Oracle
    aircraft: Aircraft | None = None
    notes: tuple[str, ...] = field(default=())
    referred: "Callable[[Aircraft], Simulation] | None" = None
    polar: PolarOfAlpha | None = None
