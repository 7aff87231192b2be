"""Terms that make a derivative vary over the envelope, written into the equations of a model.

`Cl_beta` is replaced by `Cl_beta_here = Cl_beta + Cl_beta_alpha*(alpha - alpha_ref) + ...` wherever it stands, so terms can be
added to any model of equations, built-in or not. Airspeed enters as V/V_ref - 1, angles in rad.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from estimation.models.base import Model, Parameter, ParameterRole, Signal
from estimation.models.expressions import products_in

HERE = "_here"
CENTRED = {"alpha": "rad", "V": "m/s", "delta_e": "rad"}
"""Variables that enter as differences from a reference, and their units. All others enter squared: the lateral derivatives of a
symmetric aircraft have no odd powers of sideslip."""
POWERS: Mapping[str, tuple[int, ...]] = {"alpha": (1, 2), "V": (1, 2), "delta_e": (1,), "beta": (2,)}
OWN_CONTROL = (2,)  # powers of the control that a derivative multiplies: effectiveness lost at large deflections


@dataclass(frozen=True)
class ConditionTerm:
    """A correction of a derivative in proportion to a power of a variable of the flight."""

    derivative: str
    variable: str
    power: int

    @property
    def name(self) -> str:
        """Name of its parameter: `Cl_beta_alpha`, `Cl_beta_alpha2`."""
        return f"{self.derivative}_{self.variable}{self.power if self.power > 1 else ''}"

    @property
    def first(self) -> bool:
        """Whether it is tried before the others: angle of attack, and squares of sideslip and of the derivative's control.

        In level flight airspeed and elevator follow the angle of attack; as they are measured better, they would take its place.
        """
        return self.power == (1 if self.variable == "alpha" else 2) and self.variable != "V"

    @property
    def text(self) -> str:
        """Its summand in the equation of the derivative."""
        return f"{self.name}*{_factor(self.variable)}" + (f"^{self.power}" if self.power > 1 else "")

    def value(self, point: Mapping[str, float], reference: Mapping[str, float]) -> float:
        """The factor of the parameter at values of the variables; zero for one not given, which is at its reference."""
        if self.variable not in point:
            return 0.0
        x = point[self.variable]
        if self.variable == "V":
            x = x / reference["V_ref"] - 1.0
        elif self.variable in CENTRED:
            x = x - reference[f"{self.variable}_ref"]
        return float(x**self.power)


def _factor(variable: str) -> str:
    if variable == "V":
        return "(V/V_ref - 1)"
    return f"({variable} - {variable}_ref)" if variable in CENTRED else variable


def derivatives_of(model: Model) -> tuple[str, ...]:
    """Parameters that terms are tried on: free derivatives that are the same in every flight."""
    return tuple(n for n in model.free_of(ParameterRole.DERIVATIVE) if not model.parameter(n).local)


def candidates(model: Model, columns: Sequence[str]) -> tuple[ConditionTerm, ...]:
    """All terms to try. columns: variables that the flights have beyond the model's signals."""
    signals = {*model.state_names, *model.input_names, *columns}
    controls = {s.name for s in model.inputs if s.control}
    names = derivatives_of(model)
    terms = [ConditionTerm(d, v, n) for v, powers in POWERS.items() if v in signals for n in powers for d in names]
    terms += [
        ConditionTerm(d, v, n) for d in names for v in sorted(_symbols_beside(model, d) & controls) for n in OWN_CONTROL
    ]
    existing_names = set(model.parameter_names) | set(model.constants)
    return tuple(dict.fromkeys(t for t in terms if t.name not in existing_names))


def _symbols_beside(model: Model, parameter: str) -> set[str]:
    """Symbols that stand in a product with the parameter."""
    factor_sets = (names for line in model.definitions.values() for names in products_in(line) if parameter in names)
    return set().union(*factor_sets)


def with_terms(model: Model, terms: Sequence[ConditionTerm], reference: Mapping[str, float]) -> Model:
    """The model with terms, whose parameters start at zero. reference: `alpha_ref` [rad], `V_ref` [m/s], `delta_e_ref` [rad]."""
    if not terms:
        return model
    by_derivative: dict[str, list[ConditionTerm]] = {}
    for term in terms:
        by_derivative.setdefault(term.derivative, []).append(term)
    definitions = dict(model.definitions)
    for name in by_derivative:
        pattern = re.compile(rf"\b{re.escape(name)}\b")
        definitions = {symbol: pattern.sub(name + HERE, text) for symbol, text in definitions.items()}
    lines = [
        f"{name}{HERE} = {' + '.join([name, *(t.text for t in derivative_terms)])}"
        for name, derivative_terms in by_derivative.items()
    ]
    used_variables = {t.variable for t in terms}
    signals = {*model.state_names, *model.input_names}
    condition_signals = tuple(
        Signal(v, CENTRED.get(v, "rad"), "condition of the flight") for v in sorted(used_variables - signals)
    )
    constants = {f"{v}_ref": reference[f"{v}_ref"] for v in CENTRED if v in used_variables}
    parameters = tuple(
        Parameter(t.name, _unit(model, t), description=f"{t.derivative} over {t.variable}") for t in terms
    )
    return replace(
        model,
        inputs=model.inputs + condition_signals,
        parameters=model.parameters + parameters,
        constants={**model.constants, **constants},
        equations=tuple(f"{symbol} = {text}" for symbol, text in definitions.items()) + tuple(lines),
    )


def _unit(model: Model, term: ConditionTerm) -> str:
    derivative_unit = model.parameter(term.derivative).unit
    if term.variable == "V":
        return derivative_unit
    power = {"1/rad": 1, "1": 0}.get(derivative_unit)
    return f"1/rad{power + term.power}" if power is not None else f"{derivative_unit}/rad{term.power}"


def terms_of(model: Model) -> tuple[ConditionTerm, ...]:
    """The terms in a model's equations, as written by `with_terms`."""
    names = set(model.parameter_names)
    variables = {*POWERS, *model.input_names}
    terms = []
    for name in model.parameter_names:
        if f"{name}{HERE}" in model.definitions:
            possible_terms = (ConditionTerm(name, v, n) for v in sorted(variables) for n in (1, 2))
            terms += [t for t in possible_terms if t.name in names]
    return tuple(terms)


def row_of(model: Model, derivative: str, names: Sequence[str], point: Mapping[str, float]) -> list[float]:
    """The factor of each parameter `names` in the derivative, at values of the variables."""
    term_by_name = {t.name: t for t in terms_of(model) if t.derivative == derivative}
    return [
        1.0 if n == derivative else term_by_name[n].value(point, model.constants) if n in term_by_name else 0.0
        for n in names
    ]
