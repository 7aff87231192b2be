"""Simulations of the user: a model file, whose text is evaluated and never executed, or a Python function.

The function is `base(V, alpha, beta, p, q, r, surfaces, thrust, rho) -> (CX, CY, CZ, Cl, Cm, Cn)`: V m/s, angles rad, rates
rad/s, thrust N, rho kg/m3, surfaces a mapping with delta_e, delta_a, delta_r [rad]; body axes, moments about the centre of
gravity. It may take arrays (N,) and return six arrays, or take numbers and return six numbers: it is tried with arrays and,
where that fails, called state by state. None stands for a coefficient that it does not have. A parameter alpha_dot receives the
rate of alpha [rad/s]. The module may define AIRCRAFT: an `estimation.aircraft.Aircraft`, or the path of an aircraft file."""

import inspect
import math
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from estimation.aircraft import Aircraft, load_aircraft
from estimation.models.base import Model
from estimation.models.expressions import evaluate, names_in
from estimation.models.load import read_model
from estimation.models.numeric import FUNCTIONS
from estimation.own_code import MISTAKES, import_named, mistake_text
from estimation.simulation.oracle import ALPHA_RATE, COEFFICIENTS, SURFACES, Array, Simulation, SimulationError, States


@dataclass(frozen=True)
class TextOracle:
    """The coefficients of a model file; see `estimation.simulation.oracle.Oracle`."""

    model: Model

    def coefficients(self, states: States) -> Array:
        symbols = self._symbols(states)
        result = np.full((len(states), len(COEFFICIENTS)), np.nan)
        for i, name in enumerate(COEFFICIENTS):
            if name in self.model.definitions:
                result[:, i] = self._value(name, symbols, name)
        return result

    def line(self, name: str, states: States) -> Array:
        """(N,) value of any line of the model. Raises SimulationError where it depends on more than `states` and constants."""
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
            for symbol in sorted(names_in(text)):
                self._value(symbol, symbols, wanted)
            symbols[name] = evaluate(text, symbols, FUNCTIONS)
        return symbols[name]


def text_simulation(spec: str) -> Simulation:
    """A model file as a simulation. Raises ModelError for no such file, SimulationError for a model without coefficients."""
    model = read_model(Path(spec))
    if not set(COEFFICIENTS) & set(model.definitions):
        raise SimulationError(
            f"{spec}: has none of the lines {', '.join(COEFFICIENTS)}; it cannot serve as a simulation"
        )
    body_values = {n: float(model.constants.get(n, math.nan)) for n in ("m", "S", "b", "c", "Ixx", "Iyy", "Izz", "Ixz")}
    aircraft = Aircraft(
        model.name, span=body_values["b"], area=body_values["S"], chord=body_values["c"], mass=body_values["m"],
        Ixx=body_values["Ixx"], Iyy=body_values["Iyy"], Izz=body_values["Izz"], Ixz=body_values["Ixz"], title=model.title,
    )  # fmt: skip
    stated_aircraft = None if all(math.isnan(v) for v in body_values.values()) else aircraft
    return Simulation(spec, model.name, TextOracle(model), stated_aircraft)


EXAMPLE = "module:function, like my_aircraft:base"
SAME = 1e-9  # relative difference allowed between the coefficients of a state alone and among many


@dataclass(frozen=True)
class FunctionOracle:
    """The coefficients of a Python function; see `estimation.simulation.oracle.Oracle`. spec: its name in messages; takes_rate:
    whether it has a parameter alpha_dot."""

    spec: str
    function: Callable[..., Any]
    takes_rate: bool = False

    def coefficients(self, states: States) -> Array:
        first = self._single(states.part(slice(0, 1)))
        if len(states) == 1:
            return first
        try:
            together = self._columns(self._call(states, arrays=True), len(states))
        except MISTAKES:
            together = None  # it takes numbers only
        if together is not None and np.allclose(together[:1], first, rtol=SAME, atol=SAME, equal_nan=True):
            return together
        return np.concatenate([self._single(states.part(slice(i, i + 1))) for i in range(len(states))])

    def _single(self, state: States) -> Array:
        """(1, 6) coefficients of one state, passed as numbers; SimulationError names a mistake in the function."""
        try:
            return self._columns(self._call(state, arrays=False), 1)
        except MISTAKES as error:
            raise SimulationError(f"simulation {self.spec}: {mistake_text(error)}") from error

    def _call(self, states: States, arrays: bool) -> Any:
        values = {n: v if arrays else float(v[0]) for n, v in {**states.values, "rho": states.rho}.items()}
        motion = [values[n] for n in ("V", "alpha", "beta", "p", "q", "r")]
        rate = states.alpha_dot if arrays else float(states.alpha_dot[0])
        rate_argument = {ALPHA_RATE: rate} if self.takes_rate else {}
        return self.function(
            *motion, {n: values[n] for n in SURFACES}, values["thrust"], values["rho"], **rate_argument
        )

    def _columns(self, answer: Any, count: int) -> Array:
        """(count, 6) coefficients from what the function returned. Raises ValueError where these are no coefficients."""
        if not hasattr(answer, "__len__") or len(answer) != len(COEFFICIENTS):
            raise ValueError(f"gives {type(answer).__name__}, not the six coefficients {' '.join(COEFFICIENTS)}")
        result = np.empty((count, len(COEFFICIENTS)))
        for i, value in enumerate(answer):
            column = np.full(count, np.nan) if value is None else np.asarray(value, float)
            if column.shape not in ((), (count,)):
                raise ValueError(f"gives {COEFFICIENTS[i]} of shape {column.shape} for {count} states")
            if value is not None and not np.isfinite(column).all():
                raise ValueError(f"gives a {COEFFICIENTS[i]} that is not a finite number")
            result[:, i] = column
        return result


def function_simulation(spec: str) -> Simulation:
    """The simulation `module:function`. Raises SimulationError."""
    function = import_named(spec, f"simulation {spec!r}", EXAMPLE, SimulationError)
    if not callable(function):
        raise SimulationError(f"simulation {spec!r}: that is {type(function).__name__}, not a function")
    module = sys.modules[spec.partition(":")[0]]
    stated_aircraft = getattr(module, "AIRCRAFT", None)
    if isinstance(stated_aircraft, str | Path):
        aircraft_path = Path(module.__file__ or "").parent / stated_aircraft
        stated_aircraft = load_aircraft(aircraft_path if aircraft_path.is_file() else str(stated_aircraft))
    if stated_aircraft is not None and not isinstance(stated_aircraft, Aircraft):
        raise SimulationError(
            f"simulation {spec!r}: AIRCRAFT is {type(stated_aircraft).__name__}; make it an Aircraft or the path of its file"
        )
    return Simulation(
        spec, spec.rpartition(":")[2], FunctionOracle(spec, function, _takes_rate(function)), stated_aircraft
    )


def _takes_rate(function: Callable[..., Any]) -> bool:
    try:
        return ALPHA_RATE in inspect.signature(function).parameters
    except (TypeError, ValueError):  # a compiled function has no signature
        return False
