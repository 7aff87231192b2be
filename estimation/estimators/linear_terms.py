"""The regressor of the recursive estimator that each parameter of a model multiplies, from the model's text."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from daq.identification.regression import LATERAL, LONGITUDINAL, Equation, PlaneRegression
from estimation.errors import EstimationError
from estimation.models.base import Model
from estimation.models.expressions import evaluate, names_in
from estimation.models.numeric import FUNCTIONS
from estimation.prepare.measured_cg import at_stated_cg

PLANES = (LATERAL, LONGITUDINAL)
OPTIONAL = (
    "beta",
    "p",
    "r",
    "phi",
    "ay",
)  # signals that are zero for the pitching plane alone where a flight lacks them
LINEAR = "beta, p_hat, r_hat, delta_a, delta_r in CY Cl Cn, alpha, q_hat, delta_e in CL CD Cm, CL^2 in CD"


@dataclass(frozen=True)
class LinearTerms:
    """A model's parameters in the recursive estimator. regressions: planes with the model's terms; names: parameter of the model
    -> its name there, coefficient and column (`Cl_p`)."""

    regressions: tuple[PlaneRegression, ...]
    names: Mapping[str, str]

    @property
    def signals(self) -> tuple[str, ...]:
        """Columns that a flight must have."""
        signals = dict.fromkeys(s for r in self.regressions for s in r.signals)
        lateral = any(r.name == "lateral" for r in self.regressions)
        return tuple(s for s in signals if s != "rho" and (lateral or s not in OPTIONAL))


def linear_terms(model: Model) -> LinearTerms:
    """A model's parameters by the column that each multiplies in a line CY, Cl, Cn, CL, CD or Cm.

    Found from the lines' values at random motions: the coefficient must change by parameter times column, whatever the other
    parameters are. Raises EstimationError for a parameter that is fixed, or for which there is no such column.
    """
    names: dict[str, str] = {}
    model = at_stated_cg(model)  # the regression itself takes account of a moved CG
    for p in model.parameters:
        term = _term_of(model, p.name)
        if term is None or term in names.values():
            raise EstimationError(
                f"method live knows derivatives by {LINEAR}; in model {model.name}, {p.name} is none of them: take method ml"
            )
        names[p.name] = term
    if fixed_names := [p.name for p in model.parameters if p.fixed]:
        raise EstimationError(f"method live holds no parameter ({', '.join(fixed_names)}): free it, or take method ml")
    planes = [_with_terms(plane, set(names.values())) for plane in PLANES]
    return LinearTerms(tuple(plane for plane in planes if plane is not None), names)


def _with_terms(plane: PlaneRegression, names: set[str]) -> PlaneRegression | None:
    """A plane with those terms that a model has; None where the model has none of them."""
    if not any(name.partition("_")[0] in {e.coefficient for e in plane.equations} for name in names):
        return None
    equations = tuple(
        replace(e, terms={n: c for n, c in _possible_terms(plane, e).items() if n in names}) for e in plane.equations
    )
    return plane if equations == plane.equations else replace(plane, equations=equations)


def _possible_terms(plane: PlaneRegression, equation: Equation) -> dict[str, str]:
    """Terms that an equation may have, its usual ones first: name -> column."""
    further_terms = {f"{equation.coefficient}_{c}": c for c in plane.columns if c not in ("0", "CL2")}
    return {**equation.terms, **further_terms}


MOTIONS = 3  # random ones at which a term is recognised: one could agree by chance


def _term_of(model: Model, name: str) -> str | None:
    """Coefficient and column (`Cl_p`) of a parameter; None where it multiplies no column, or several."""
    rng = np.random.default_rng(1)
    candidates: set[str] | None = None
    for _ in range(MOTIONS):
        symbols = {
            **{s: rng.uniform(0.02, 0.2) for s in (*model.state_names, *model.input_names, *model.parameter_names)},
            **model.constants,
            "V": rng.uniform(10.0, 20.0),
        }
        terms = _matching_terms(model, name, symbols)
        candidates = terms if candidates is None else candidates & terms
    return next(iter(candidates)) if candidates and len(candidates) == 1 else None


def _matching_terms(model: Model, name: str, symbols: Mapping[str, float]) -> set[str]:
    """Terms that a parameter may be at one motion: those whose coefficient changes by a column's value for each unit of it."""
    terms: set[str] = set()
    for plane in PLANES:
        for equation in plane.equations:
            if name not in _names_behind(model, equation.coefficient):
                continue
            at_one, at_two, at_three = (
                _line_value(model, equation.coefficient, {**symbols, name: value}) for value in (1.0, 2.0, 3.0)
            )
            slope = at_two - at_one
            if not math.isclose(at_three - at_two, slope, rel_tol=1e-6, abs_tol=1e-12):
                continue
            for term, column in {equation.constant: "0", **_possible_terms(plane, equation)}.items():
                if math.isclose(slope, _column_value(model, plane, column, symbols), rel_tol=1e-6):
                    terms.add(term)
    return terms


def _names_behind(model: Model, name: str) -> set[str]:
    """Symbols on which a definition depends, directly or through others."""
    if name not in model.definitions:
        return set()
    direct = names_in(model.definitions[name])
    return set(direct).union(*(_names_behind(model, n) for n in direct))


def _line_value(model: Model, name: str, symbols: Mapping[str, float]) -> float:
    """Value of a definition, with those that it depends on evaluated first."""
    if name in symbols:
        return symbols[name]
    text = model.definitions[name]
    symbol_values = {n: _line_value(model, n, symbols) for n in names_in(text)}
    return float(evaluate(text, symbol_values, FUNCTIONS))


def _column_value(model: Model, plane: PlaneRegression, column: str, symbols: Mapping[str, float]) -> float:
    """Value of a column without dynamic pressure; NaN where the model lacks its signal."""
    if column == "0":
        return 1.0
    if column == "CL2":
        return _line_value(model, "CL", symbols) ** 2 if "CL" in model.definitions else math.nan
    value = symbols.get(plane.controls.get(column, column), math.nan)
    length = {"span": "b", "chord": "c"}.get(plane.states.get(column, ""))
    return value * symbols.get(length, math.nan) / (2.0 * symbols["V"]) if length else value
