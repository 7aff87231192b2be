"""What a model may lack, derived from its own equations: linear terms, first nonlinear terms, lags, scales.

A force line is an equation in which estimated derivatives multiply motion or controls. Its candidates are the regressors of all
force lines with which it shares a regressor, and first nonlinear terms of its own regressors. Further candidates: a control acts
later than recorded, a vane or an attitude lags, a channel has a wrong scale, an accelerometer is off the CG, a damper moves a
surface unrecorded, the product of inertia is wrong.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from enum import Enum

from estimation.models.base import InputTransform, Model, Parameter, ParameterRole, Signal
from estimation.models.expressions import names_in, products_in

LATE_OUTPUTS = ("alpha", "beta", "phi", "theta", "ax", "ay", "az")
"""Columns of instruments that may lag: vanes swing, attitudes and accelerations are filtered."""
SMALL_FLOW = ("alpha", "beta")
GRAVITY_OFF = {"ax": 0.005, "ay": 0.005, "az": 0.005}
"""Share by which gravity in flight may differ from the models' standard value: 0.3 % between pole and equator, 0.3 % at 10 km,
0.3 % at 200 m/s along the equator. An accelerometer's scale this close to one is gravity, not the instrument."""
DAMPED = {"delta_r": "r", "delta_e": "q"}
"""Control -> rate that a damper may feed back to it without a trace in its record."""
WASHOUT, WASHOUT_SPREAD, WASHOUT_BOUNDS = 3.0, 2.0, (0.3, 20.0)
"""Time constant [s] of such a damper's washout: prior mean, prior standard deviation, limits. Yaw dampers have 1 to 6 s (J.
Roskam, Airplane Flight Dynamics II, 8.2.3), and a score computed with 3 s finds these too. Without a washout no record can
distinguish a damper from the aeroplane's own damping."""


class CandidateKind(Enum):
    """Kinds of what a model may lack."""

    LINEAR = "derivative"
    NONLINEAR = "nonlinear term"
    LATE_CONTROL = "lag of a control"
    LATE_SENSOR = "lag of a sensor"
    SCALE = "scale of a channel"
    PLACE = "place of the accelerometer"
    DAMPER = "damper behind the record"
    INERTIA = "product of inertia"


UNITS = {
    CandidateKind.LATE_CONTROL: "s",
    CandidateKind.LATE_SENSOR: "s",
    CandidateKind.SCALE: "1",
    CandidateKind.PLACE: "m",
    CandidateKind.DAMPER: "s",
    CandidateKind.INERTIA: "kg m2",
}


@dataclass(frozen=True)
class Candidate:
    """One thing that a model may lack. name: of its parameter; null: value of the parameter that leaves the model unchanged;
    line, term: the term `name*term` is added to this line; channel: the input or output concerned; phrase: its name in
    sentences; least: distance from the null below which it is not significant."""

    name: str
    kind: CandidateKind
    null: float = 0.0
    line: str = ""
    term: str = ""
    channel: str = ""
    phrase: str = ""
    least: float = 0.0

    @property
    def parameter(self) -> Parameter:
        """The unknown parameter, which starts at its null value."""
        role = (
            ParameterRole.DERIVATIVE
            if self.kind in (CandidateKind.LINEAR, CandidateKind.NONLINEAR, CandidateKind.INERTIA)
            else ParameterRole.INSTRUMENT
        )
        return Parameter(self.name, UNITS.get(self.kind, f"1/rad{self.power or ''}"), start=self.null, role=role)

    @property
    def power(self) -> int:
        """Power of the angles in a nonlinear term; 0 for other kinds."""
        return (3 if self.term.endswith("^3") else 2) if self.kind is CandidateKind.NONLINEAR else 0


def structure_candidates(model: Model) -> tuple[Candidate, ...]:
    """Everything that is tested beside a model."""
    every_candidate = (*_terms(model), *_late_controls(model), *_sensors(model), *_inertia(model), *_dampers(model))
    return tuple(c for c in every_candidate if c.name not in model.parameter_names)


def with_candidates(model: Model, wanted_candidates: Iterable[Candidate], *, fitting: bool = False) -> Model:
    """The model with candidates as estimated parameters that start at their null values. fitting: also estimate what has no
    effect at the null values (the washout of a damper)."""
    selected = tuple(wanted_candidates)
    terms: dict[str, str] = {}
    dampers = [c for c in selected if c.kind is CandidateKind.DAMPER]
    for c in (c for c in selected if c.line):
        terms[c.line] = f"{terms[c.line]} + {c.name}*{c.term}" if c.line in terms else f"{c.name}*{c.term}"
    for c in dampers:
        for line, effect in _effects_of(model, c.channel):
            term = f"{c.name}*{effect}*({c.term} - {c.term}_slow)"
            terms[line] = f"{terms[line]} + {term}" if line in terms else term
    output_expressions: dict[str, str] = {}
    for c in (
        c for c in selected if c.kind in (CandidateKind.SCALE, CandidateKind.PLACE) and c.channel in model.output_names
    ):
        expression = output_expressions.get(c.channel, c.channel)
        output_expressions[c.channel] = (
            f"{c.name}*({expression})" if c.kind is CandidateKind.SCALE else f"{expression} + {c.name}*{c.term}"
        )
    transforms = [
        InputTransform("scale" if c.kind is CandidateKind.SCALE else "delay", c.channel, (c.name,))
        for c in selected
        if c.kind in (CandidateKind.SCALE, CandidateKind.LATE_CONTROL) and c.channel not in model.output_names
    ]
    return model.plus(
        terms=terms,
        outputs=output_expressions,
        transforms=transforms,
        output_delays={c.channel: c.name for c in selected if c.kind is CandidateKind.LATE_SENSOR},
        states=[Signal(f"{c.term}_slow", "rad/s", start=c.term, held=True) for c in dampers],
        lines=[f"{c.term}_slow_dot = ({c.term} - {c.term}_slow)/washout_{c.channel}" for c in dampers],
        parameters=[*(c.parameter for c in selected), *(_washout(c, fitting) for c in dampers)],
    )


# ------------------------------------------------------------------------------------------------ forces and moments


def force_lines(model: Model) -> Mapping[str, tuple[str, ...]]:
    """Force lines -> their regressors: states, inputs, and lines that depend on these without parameters."""
    derivatives = {p.name for p in model.parameters if p.role is ParameterRole.DERIVATIVE}
    free_of_parameters = _free_of_parameters(model)
    lines: dict[str, tuple[str, ...]] = {}
    for symbol, text in model.definitions.items():
        pairs = [names for names in products_in(text) if names & derivatives and len(names) == 2]
        if not pairs:
            continue
        regressors = dict.fromkeys(n for names in pairs for n in sorted(names - derivatives) if n in free_of_parameters)
        nested = [n for names in pairs for n in names if n in lines]
        for line in nested:  # drag that depends on lift also has the regressors of lift
            regressors |= dict.fromkeys(lines[line])
        lines[symbol] = tuple(regressors)
    return {symbol: regressors for symbol, regressors in lines.items() if regressors}


def _free_of_parameters(model: Model) -> frozenset[str]:
    """Names of motion and controls, and of lines that depend on these and constants only."""
    motion = {*model.state_names, *model.input_names}
    parameters = set(model.parameter_names)
    memo: dict[str, bool] = {}

    def is_free(name: str) -> bool:
        if name in motion or name in model.constants:
            return True
        if name in parameters or name not in model.definitions:
            return False
        if name not in memo:
            memo[name] = False  # ends the recursion in a circle of lines
            memo[name] = all(is_free(n) for n in names_in(model.definitions[name]))
        return memo[name]

    return frozenset(motion | {symbol for symbol in model.definitions if is_free(symbol)})


def _terms(model: Model) -> Iterator[Candidate]:
    lines = force_lines(model)
    for line, own_regressors in lines.items():
        related = {
            r: None for regressors in lines.values() if set(regressors) & set(own_regressors) for r in regressors
        }
        direct = {n for names in products_in(model.definitions[line]) for n in names}
        for regressor in related:
            if regressor not in direct:
                name = f"{line}_{_suffix(regressor)}"
                yield Candidate(name, CandidateKind.LINEAR, line=line, term=regressor, phrase=name)
        yield from _nonlinear(model, line, [r for r in own_regressors if r in direct])


def _nonlinear(model: Model, line: str, regressors: Iterable[str]) -> Iterator[Candidate]:
    """First nonlinear terms: cubes of flow angles and controls, alpha squared, and sideslip effects that change with alpha."""
    terms: list[tuple[str, str]] = []
    for r in regressors:
        control = any(s.name == r and s.control for s in model.inputs)
        if r in SMALL_FLOW or (control and r.startswith("delta_")):
            terms.append((f"{_suffix(r)}3", f"{r}^3"))
        if r == "beta" and "alpha" in (*model.state_names, *model.input_names):
            terms.append(("alpha_beta", "alpha*beta"))
        if r == "alpha":
            terms.append(("alpha2", "alpha^2"))
    for suffix, term in terms:
        name = f"{line}_{suffix}"
        yield Candidate(name, CandidateKind.NONLINEAR, line=line, term=term, phrase=name)


def _suffix(regressor: str) -> str:
    """Index of a derivative: `da` for delta_a, `p` for p_hat."""
    return regressor.replace("delta_", "d").removesuffix("_hat")


# ------------------------------------------------------------------------------------------------ instruments


def _late_controls(model: Model) -> Iterator[Candidate]:
    delayed = {t.input for t in model.transforms if t.kind in ("delay", "lag")}
    for s in model.inputs:
        if s.control and s.name not in delayed and s.name != "thrust":
            yield Candidate(
                f"delay_{s.name}",
                CandidateKind.LATE_CONTROL,
                channel=s.name,
                phrase=f"a lag between the recorded {s.name} and the motion",
            )


def _sensors(model: Model) -> Iterator[Candidate]:
    for s in model.outputs:
        if s.source in LATE_OUTPUTS and s.name not in model.output_delays:
            yield Candidate(
                f"delay_{s.name}", CandidateKind.LATE_SENSOR, channel=s.name, phrase=f"a lag of the {s.name} sensor"
            )
        yield Candidate(
            f"scale_{s.name}",
            CandidateKind.SCALE,
            null=1.0,
            channel=s.name,
            phrase=f"a wrong scale of {s.name}",
            least=GRAVITY_OFF.get(s.source, 0.0),
        )
    scaled = {t.input for t in model.transforms if t.kind == "scale"}
    for s in model.inputs:
        if s.source == "V" and s.name not in scaled:
            yield Candidate(
                f"scale_{s.name}", CandidateKind.SCALE, null=1.0, channel=s.name, phrase=f"a wrong scale of {s.name}"
            )
    yield from _places(model)


def _places(model: Model) -> Iterator[Candidate]:
    if "ay" not in model.output_names:
        return
    for axis, term in (("x", "r_dot"), ("z", "p_dot")):
        if term in model.definitions and f"{axis}_imu" not in model.parameter_names:
            yield Candidate(
                f"{axis}_imu",
                CandidateKind.PLACE,
                channel="ay",
                term=term,
                phrase=f"an accelerometer off the CG along {axis}",
            )


def _inertia(model: Model) -> Iterator[Candidate]:
    names = frozenset[str]().union(*(names_in(text) for text in model.definitions.values()))
    if "Ixz" in model.constants and "Ixz" in names:
        yield Candidate("Ixz", CandidateKind.INERTIA, null=model.constants["Ixz"], phrase="another Ixz")


def _dampers(model: Model) -> Iterator[Candidate]:
    for control, rate in DAMPED.items():
        if control in model.input_names and rate in model.state_names and any(_effects_of(model, control)):
            phrase = f"something that moves {control} with {rate} behind its record, such as a damper"
            yield Candidate(f"damper_{control}", CandidateKind.DAMPER, term=rate, channel=control, phrase=phrase)


def _effects_of(model: Model, control: str) -> Iterator[tuple[str, str]]:
    """(line, derivative) for each line in which a control acts."""
    derivatives = {p.name for p in model.parameters if p.role is ParameterRole.DERIVATIVE}
    for line, text in model.definitions.items():
        for names in products_in(text):
            if control in names and len(names) == 2 and (effect := names & derivatives):
                yield line, next(iter(effect))


def _washout(damper: Candidate, free: bool) -> Parameter:
    low, high = WASHOUT_BOUNDS
    return Parameter(
        f"washout_{damper.channel}", "s", start=WASHOUT, lower=low, upper=high, prior_mean=WASHOUT,
        prior_std=WASHOUT_SPREAD, fixed=not free, role=ParameterRole.NUISANCE,
    )  # fmt: skip
