"""A model in our own text as a simulation: its lines of the coefficients, evaluated at any state. Parsed, never executed."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from estimation.aircraft import Aircraft
from estimation.models.base import Model
from estimation.models.expressions import evaluate, names_in
from estimation.models.load import read_model
from estimation.models.numeric import FUNCTIONS
from estimation.simulation.oracle import ALPHA_RATE, COEFFICIENTS, Array, Simulation, SimulationError, States


@dataclass(frozen=True)
class TextOracle:
    """See `estimation.simulation.oracle.Oracle`."""

    model: Model

    def coefficients(self, states: States) -> Array:
        symbols = self._symbols(states)
        result = np.full((len(states), len(COEFFICIENTS)), np.nan)
        for i, name in enumerate(COEFFICIENTS):
            if name in self.model.definitions:
                result[:, i] = self._value(name, symbols, name)
        return result

    def line(self, name: str, states: States) -> Array:
        """(N,) value of any line of the model. Raises SimulationError where it depends on something else."""
        return np.broadcast_to(np.asarray(self._value(name, self._symbols(states), name), float), (len(states),))

    def _symbols(self, states: States) -> dict[str, Any]:
        return {**self.model.constants, **self.model.starts(), **states.values, "rho": states.rho,
                ALPHA_RATE: states.alpha_dot}  # fmt: skip

    def _value(self, name: str, symbols: dict[str, Any], wanted: str) -> Any:
        if name not in symbols:
            if name not in self.model.definitions:
                raise SimulationError(
                    f"model {self.model.name}: its {wanted} depends on {name}; coefficients of a simulation may depend on"
                    " airspeed, flow angles, body rates, surfaces, thrust and density"
                )
            text = self.model.definitions[name]
            for needed in sorted(names_in(text)):
                self._value(needed, symbols, wanted)
            symbols[name] = evaluate(text, symbols, FUNCTIONS)
        return symbols[name]


def text_simulation(spec: str) -> Simulation:
    """The simulation that a model file is. Raises ModelError for no such file, SimulationError where it has no coefficient."""
    model = read_model(Path(spec))
    if not set(COEFFICIENTS) & set(model.definitions):
        raise SimulationError(
            f"{spec}: has none of the lines {', '.join(COEFFICIENTS)}; it cannot serve as a simulation"
        )
    known = {n: float(model.constants.get(n, math.nan)) for n in ("m", "S", "b", "c", "Ixx", "Iyy", "Izz", "Ixz")}
    aircraft = Aircraft(
        model.name, span=known["b"], area=known["S"], chord=known["c"], mass=known["m"],
        Ixx=known["Ixx"], Iyy=known["Iyy"], Izz=known["Izz"], Ixz=known["Ixz"], title=model.title,
    )  # fmt: skip
    told = None if all(math.isnan(v) for v in known.values()) else aircraft
    return Simulation(spec, model.name, TextOracle(model), told)
