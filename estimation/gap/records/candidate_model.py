"""The base model with nuisance parameters that every fit estimates and with every candidate effect dormant.

The nuisance parameters, each with a prior as wide as its usual size, so that none is mistaken for an effect:

- instrument biases, about as large as the noise of the channel;
- the time at which a surface really moves between two samples: a tenth of the sample interval for all surfaces together, which
  one clock samples, and a few hundredths for one surface beside the others;
- errors of an attitude filter: a time (a tenth of the interval), and the rounding of rolling edges by straight lines between
  samples (at most h^2/12 times the angular acceleration);
- errors of a filter's plumb line, which takes the side acceleration of a changing sideslip for gravity: an error in bank
  proportional to sideslip (V/(g T) of it with the filter's memory T; a few hundredths where the filter corrects that with
  airspeed or GPS velocity);
- the level of a signal reconstructed from the motion, on every flight, within the uncertainty that the reconstruction states;
- times in a simulation of fixed steps: one that integrates rates with the moments of the last step, and attitudes with the rates
  of the last, has gyros half a step early and moments a step late (JSBSim by default: 2.5 and 5 ms at 200 Hz);
- the time of an attitude with its own times in the log: a tenth of its own interval.

One compiled right-hand side serves the whole workflow: all terms and lines that need no state are written into the equations
once, their parameters held at the value without effect. Awakening a form frees its parameters and attaches its transforms and
delays. Forms with states, and forms that clash with a dormant one, are added when awakened.
"""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType

import numpy as np

from daq.utilities.constants import GRAVITY
from estimation.gap.criteria import Criteria
from estimation.gap.effects.base import Effect, Form
from estimation.gap.records.channels import uncertainty
from estimation.models.base import InputTransform, Model, Parameter, ParameterRole, Signal
from groundstation.flight import Flight

TIMING = "timing_"  # prefix of a delay
TOGETHER = TIMING + "controls"  # of all controls
GYROS, MOMENTS = TIMING + "gyros", TIMING + "moments"
LEVEL = "level_"  # prefix of the level of a reconstructed input
STATIC_MOMENTS = {"Cl": "beta", "Cn": "beta", "Cm": "alpha"}  # coefficient -> angle of its static derivative
RATE_OF = {"phi": "p", "theta": "q", "psi": "r"}  # attitude -> the rate a filter integrates to it
DISTURBANCE = "disturbance_{}"
RARE = 0.9  # samples: the unknown time of a command recorded at longer intervals matters


def with_nuisance(
    model: Model,
    noise: Mapping[str, float],
    sample_interval: float,
    criteria: Criteria,
    filtered: Collection[str] = (),
    stamped: Mapping[str, float] = MappingProxyType({}),
) -> Model:
    """`model` with the nuisance parameters and their priors.

    noise: output -> standard deviation of its noise. filtered: outputs that are attitudes of a filter. stamped: attitude among
    the outputs -> interval [s] of its own times in the log.
    """
    biased = [n for n in model.output_names if noise.get(n, 0.0) > 0 and f"bias_{n}" not in model.parameter_names]
    extended = model.with_biases(*biased).with_prior(**{f"bias_{n}": (0.0, noise[n]) for n in biased})
    extended = _with_role(extended, [f"bias_{n}" for n in biased], ParameterRole.NUISANCE)
    extended = _with_step_times(_with_control_times(extended, sample_interval, criteria), sample_interval, criteria)
    for attitude, interval in stamped.items():
        width = criteria.timing_share * max(sample_interval, interval)
        extended = _with_output_error(extended, attitude, f"{TIMING}{attitude}", f"{attitude}_dot", "s", width)
    for attitude in filtered:
        extended = _with_filter_errors(extended, attitude, sample_interval, criteria)
    beliefs = {
        p.name: (p.reference, criteria.certain * p.reference_std)
        for p in extended.parameters
        if p.reference is not None and p.reference_std and p.prior_mean is None
    }
    return extended.with_prior(**beliefs)  # type: ignore[arg-type]


def _with_role(model: Model, names: Collection[str], role: ParameterRole) -> Model:
    """`model` with another role of some parameters."""
    return replace(model, parameters=tuple(replace(p, role=role) if p.name in names else p for p in model.parameters))


def nuisance_parameter(name: str, unit: str, width: float) -> Parameter:
    """An unknown that is no effect, with a prior of zero mean and standard deviation `width`."""
    return Parameter(name, unit, prior_mean=0.0, prior_std=width, role=ParameterRole.NUISANCE)


def stamped_attitudes(model: Model, flights: Iterable[Flight]) -> dict[str, float]:
    """Attitude among the outputs with its own times in the log -> longest interval [s] of these on any flight."""
    intervals: dict[str, float] = {}
    for flight in flights:
        for signal in model.outputs:
            rate = flight.native_rate(signal.source) if signal.name in RATE_OF else None
            if rate is not None:
                intervals[signal.name] = max(intervals.get(signal.name, 0.0), 1.0 / rate)
    return intervals


def rare_commands(model: Model, flights: Sequence[Flight]) -> dict[str, float]:
    """Controls recorded as commands, no more often than the motion -> longest interval [s] between commands, within which the
    beginning of a move is unknown."""
    step = max(f.sample_interval for f in flights)
    controls = [s for s in model.inputs if s.control and not s.computed]
    intervals = {s.name: max(f.held(s.source) or 0.0 for f in flights) for s in controls}
    return {n: i for n, i in intervals.items() if i > RARE * step}


def _with_control_times(model: Model, sample_interval: float, criteria: Criteria) -> Model:
    """`model` with controls that move a little before or after they were sampled: all together, and each by itself."""
    controls = [s.name for s in model.inputs if s.control and f"{TIMING}{s.name}" not in model.parameter_names]
    several = len(controls) > 1 and TOGETHER not in model.parameter_names
    shares = {TOGETHER: criteria.timing_share} if several else {}
    delays = [InputTransform("delay", n, (TOGETHER,)) for n in controls] if several else []
    for name in controls:
        shares[f"{TIMING}{name}"] = criteria.own_timing_share if several else criteria.timing_share
        delays.append(InputTransform("delay", name, (f"{TIMING}{name}",)))
    return model.plus(
        parameters=[nuisance_parameter(n, "s", share * sample_interval) for n, share in shares.items()],
        transforms=delays,
    )


def _with_step_times(model: Model, sample_interval: float, criteria: Criteria) -> Model:
    """`model` with the times of a simulation of fixed steps: gyros a little before or after the other channels, and moments
    by the flow angles of a moment ago."""
    rates = [n for n in RATE_OF.values() if n in model.output_names and f"{n}_dot" in model.definitions]
    late = {
        c: f"-{MOMENTS}*{c}_{angle}*{angle}_dot"
        for c, angle in STATIC_MOMENTS.items()
        if c in model.definitions and f"{angle}_dot" in model.definitions and f"{c}_{angle}" in model.parameter_names
    }
    width = criteria.timing_share * sample_interval
    if 0 < len(rates) < len(model.output_names) and GYROS not in model.parameter_names:
        model = model.plus(
            outputs={n: f"{n} + {GYROS}*{n}_dot" for n in rates}, parameters=[nuisance_parameter(GYROS, "s", width)]
        )
    if late and MOMENTS not in model.parameter_names:
        model = model.plus(terms=late, parameters=[nuisance_parameter(MOMENTS, "s", width)])
    return model


def timing_of(control: str, values: Mapping[str, float]) -> float:
    """Time [s] by which a fit moved a control."""
    return values.get(TOGETHER, 0.0) + values.get(f"{TIMING}{control}", 0.0)


def _with_filter_errors(model: Model, attitude: str, sample_interval: float, criteria: Criteria) -> Model:
    """`model` with the errors of a filter that integrates sampled rates and has a plumb line, which takes sideways acceleration
    for bank and acceleration along the path for pitch."""
    width = criteria.timing_share * sample_interval
    model = _with_output_error(model, attitude, f"{TIMING}{attitude}", f"{attitude}_dot", "s", width)
    rate, width = f"{RATE_OF[attitude]}_dot", sample_interval**2 / 12.0
    model = _with_output_error(model, attitude, f"rounding_{attitude}", rate, "s2", width)
    if attitude == "phi":
        model = _with_output_error(model, attitude, "plumb_phi", "beta", "1", criteria.plumb_share)
    if attitude == "theta":
        width = criteria.plumb_share / GRAVITY
        model = _with_output_error(model, attitude, "plumb_theta", "V_dot", "s2/m", width)
    return model


def _with_output_error(model: Model, output: str, unknown: str, signal: str, unit: str, width: float) -> Model:
    """`model` with an unknown factor times a signal of the model as an error of an output; unchanged where the model lacks the
    signal or has the factor. unit, width: of the factor and its prior."""
    if unknown in model.parameter_names or signal not in {*model.definitions, *model.state_names}:
        return model
    return model.plus(
        outputs={output: f"{output} + {unknown}*{signal}"}, parameters=[nuisance_parameter(unknown, unit, width)]
    )


def levels(model: Model, flights: Iterable[Flight]) -> dict[str, float]:
    """Input or output of `model` that some flight has reconstructed -> standard deviation of its level."""
    deviations: dict[str, list[float]] = {}
    for flight in flights:
        for signal in (*model.inputs, *model.outputs):
            std = uncertainty(flight, signal.source) if signal.source in flight.reconstructed else None
            if std is not None:
                deviations.setdefault(signal.name, []).append(std)
    return {name: float(np.sqrt(np.mean(np.square(stds)))) for name, stds in deviations.items()}


def with_levels(model: Model, deviations: Mapping[str, float]) -> Model:
    """`model` with a level of every input and a bias of every output in `deviations` (from `levels`), one for each flight."""
    inputs = [s for s in model.inputs if s.name in deviations]
    outputs = [s for s in model.outputs if s.name in deviations]
    unknowns = [(f"{LEVEL}{s.name}", s) for s in inputs] + [(f"bias_{s.name}", s) for s in outputs]
    return model.plus(
        outputs={s.name: f"{s.name} + bias_{s.name}" for s in outputs},
        parameters=[replace(nuisance_parameter(n, s.unit, deviations[s.name]), local=True) for n, s in unknowns],
        transforms=[InputTransform("bias", s.name, (f"{LEVEL}{s.name}",)) for s in inputs],
    )


def with_dormant(
    model: Model, effects: Sequence[Effect], available: frozenset[str], disturbed: Sequence[str] = ()
) -> Model:
    """`model` with every applicable form without states dormant.

    available: inputs that all flights have. disturbed: states whose rates get an input `disturbance_<state>`: zero in every fit,
    gusts in simulated nulls.
    """
    extended = model.plus(
        inputs=[Signal(DISTURBANCE.format(s)) for s in disturbed],
        terms={f"{s}_dot": DISTURBANCE.format(s) for s in disturbed},
    )
    for effect in effects:
        # the form with most unknowns first: its lines hold those of forms that share unknowns with it
        for form in sorted(effect.forms, key=lambda f: -len(f.parameters)):
            if form.states or form.lines or form.frees or not all(s.name in available for s in form.inputs):
                continue
            if form.obstacle(model) is None and form.obstacle(extended) is None:
                extended = replace(form, transforms=(), output_delays={}).added_to(extended, fixed=True)
                extended = _with_role(extended, [p.name for p in form.parameters], ParameterRole.DORMANT)
    return extended


def awakened(model: Model, form: Form, at: Mapping[str, float] | None = None) -> Model:
    """`model` with the parameters of a form free, starting at `at` (by default without effect)."""
    dormant = {p.name: p for p in model.parameters if p.role is ParameterRole.DORMANT}
    if not all(p.name in dormant for p in form.parameters):
        return form.added_to(model, at)
    fresh: dict[str, Parameter] = {}
    for p in form.parameters:
        start = (at or {}).get(p.name, dormant[p.name].start)
        lower, upper = min(dormant[p.name].lower, start), max(dormant[p.name].upper, start)
        fresh[p.name] = replace(
            dormant[p.name], fixed=False, start=start, lower=lower, upper=upper, role=ParameterRole.DERIVATIVE
        )
    return replace(
        model,
        parameters=tuple(fresh.get(p.name, p) for p in model.parameters),
        transforms=model.transforms + tuple(t for t in form.transforms if t.input in model.input_names),
        output_delays={**model.output_delays, **form.output_delays},
    )
