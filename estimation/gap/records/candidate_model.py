"""The base model with what every fit carries along and with every candidate effect dormant.

No flight is free of instrument biases (about as large as the noise of the channel), of the time at which a surface really moves
between two samples (a tenth of the sample interval, for all surfaces together; they are sampled by one clock, and one of them
differs from the others by a few hundredths), of what an attitude filter makes of sampled rates (again a tenth of the interval,
and the rounding of rolling edges by straight lines between samples, at most h^2/12 times the angular acceleration), and of what
its plumb line makes of slipping: it takes the side acceleration of a changing sideslip for gravity, an error in bank that follows
sideslip (V/(g T) of it where nothing is done against that, T the memory; a few hundredths with airspeed or GPS velocity).
A simulation of fixed steps is not free of their length: one that steps rates by the moments of the last step, and attitudes by
the rates of the last, has gyros half a step early and moments a step late (JSBSim as it is set: 2.5 and 5 ms at 200 Hz).
An attitude that a log has with times of its own is a tenth of its own interval off, be it a filter's or not. All are estimated
with priors of that width, so that none is mistaken for an effect.

One compiled right-hand side serves the whole workflow: all terms and lines that need no state of their own are written into the
equations once, their parameters held at the value without effect. Awakening a form frees its parameters (and attaches its
transforms and delays); forms with states, and forms that clash with one already dormant, are added when awakened.
"""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType

from daq.utilities.constants import GRAVITY
from estimation.gap.criteria import Criteria
from estimation.gap.effects.base import Effect, Form
from estimation.models.base import InputTransform, Model, Parameter, ParameterRole, Signal
from groundstation.flight import Flight

TIMING = "timing_"  # of what moves late
TOGETHER = TIMING + "controls"  # all of them
GYROS, MOMENTS = TIMING + "gyros", TIMING + "moments"
STATIC_MOMENTS = {"Cl": "beta", "Cn": "beta", "Cm": "alpha"}  # coefficient -> the angle by which it holds the aircraft
RATE_OF = {"phi": "p", "theta": "q", "psi": "r"}  # attitude -> the rate a filter integrates to it
DISTURBANCE = "disturbance_{}"
RARE = 0.9  # of a sample: a command recorded more rarely than that is late by a time to tell


def with_nuisance(
    model: Model,
    noise: Mapping[str, float],
    sample_interval: float,
    criteria: Criteria,
    filtered: Collection[str] = (),
    stamped: Mapping[str, float] = MappingProxyType({}),
) -> Model:
    """`model` with local biases on its outputs and small timing offsets on its controls, all with priors.

    noise: output -> standard deviation of its noise. filtered: attitudes among the outputs that are a filter's, which
    get a small timing offset and the rounding of sampled rates. stamped: attitude among the outputs -> interval [s] of its own
    times in a log.
    """
    biased = [n for n in model.output_names if noise.get(n, 0.0) > 0 and f"bias_{n}" not in model.parameter_names]
    bias_names = {f"bias_{n}" for n in biased}
    extended = model.with_biases(*biased)
    extended = extended.with_prior(**{f"bias_{n}": (0.0, noise[n]) for n in biased})
    extended = _stepped(_timed(extended, sample_interval, criteria), sample_interval, criteria)
    for attitude, interval in stamped.items():
        width = criteria.timing_share * max(sample_interval, interval)
        extended = _shown(extended, attitude, {f"{TIMING}{attitude}": (f"{attitude}_dot", "s", width)})
    for attitude in filtered:
        extended = _shown(extended, attitude, _of_a_filter(attitude, sample_interval, criteria))
    marked = tuple(replace(p, role=ParameterRole.NUISANCE) if p.name in bias_names else p for p in extended.parameters)
    extended = replace(extended, parameters=marked)
    beliefs = {
        p.name: (p.reference, criteria.prior_share * p.reference_std)
        for p in extended.parameters
        if p.reference is not None and p.reference_std and p.prior_mean is None
    }
    return extended.with_prior(**beliefs)  # type: ignore[arg-type]


def stamped_attitudes(model: Model, flights: Iterable[Flight]) -> dict[str, float]:
    """Attitude among the outputs -> the longest interval [s] at which the log of a flight has it with times of its own."""
    intervals: dict[str, float] = {}
    for flight in flights:
        for signal in model.outputs:
            rate = flight.native_rate(signal.source) if signal.name in RATE_OF else None
            if rate is not None:
                intervals[signal.name] = max(intervals.get(signal.name, 0.0), 1.0 / rate)
    return intervals


def rare_commands(model: Model, flights: Sequence[Flight]) -> dict[str, float]:
    """Controls that flights have as commands, no oftener than the motion -> the longest interval [s] between these, within
    which it is not known when each move began."""
    step = max(f.sample_interval for f in flights)
    controls = [s for s in model.inputs if s.control and not s.computed]
    intervals = {s.name: max(f.held(s.source) or 0.0 for f in flights) for s in controls}
    return {n: i for n, i in intervals.items() if i > RARE * step}


def _timed(model: Model, sample_interval: float, criteria: Criteria) -> Model:
    """`model` with controls that move a little before or after they were sampled: all together, and each by itself."""
    controls = [s.name for s in model.inputs if s.control and f"{TIMING}{s.name}" not in model.parameter_names]
    several = len(controls) > 1 and TOGETHER not in model.parameter_names
    width = criteria.own_timing_share if several else criteria.timing_share
    if several:
        model = model.plus(
            parameters=[nuisance_parameter(TOGETHER, "s", criteria.timing_share * sample_interval)],
            transforms=[InputTransform("delay", name, (TOGETHER,)) for name in controls],
        )
    return model.plus(
        parameters=[nuisance_parameter(f"{TIMING}{name}", "s", width * sample_interval) for name in controls],
        transforms=[InputTransform("delay", name, (f"{TIMING}{name}",)) for name in controls],
    )


def _stepped(model: Model, sample_interval: float, criteria: Criteria) -> Model:
    """`model` with what simulations of fixed steps make of motion: gyros that show the turning of a moment before or after the
    other channels do, and moments that act on the incidence of a moment ago."""
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


def nuisance_parameter(name: str, unit: str, width: float) -> Parameter:
    """An unknown that no effect is named for, expected at nothing within `width`."""
    return Parameter(name, unit, prior_mean=0.0, prior_std=width, role=ParameterRole.NUISANCE)


def _of_a_filter(attitude: str, sample_interval: float, criteria: Criteria) -> dict[str, tuple[str, str, float]]:
    """What a filter that integrates sampled rates and has a plumb line makes of an attitude; see `_shown`."""
    widths = {
        f"{TIMING}{attitude}": (f"{attitude}_dot", "s", criteria.timing_share * sample_interval),
        f"rounding_{attitude}": (f"{RATE_OF[attitude]}_dot", "s2", sample_interval**2 / 12.0),
    }
    if attitude == "phi":
        widths["plumb_phi"] = ("beta", "1", criteria.plumb_share)
    if attitude == "theta":  # speeding up along the path is taken for gravity, as slipping is in bank
        widths["plumb_theta"] = ("V_dot", "s2/m", criteria.plumb_share / GRAVITY)
    return widths


def _shown(model: Model, attitude: str, widths: Mapping[str, tuple[str, str, float]]) -> Model:
    """`model` with an attitude that shows more than itself. widths: unknown -> signal that it follows, unit, width."""
    symbols = {*model.definitions, *model.state_names}
    for name, (follows, unit, width) in widths.items():
        if follows in symbols and name not in model.parameter_names:
            model = model.plus(
                outputs={attitude: f"{attitude} + {name}*{follows}"},
                parameters=[nuisance_parameter(name, unit, width)],
            )
    return model


def with_dormant(
    model: Model, effects: Sequence[Effect], available: frozenset[str], disturbed: Sequence[str] = ()
) -> Model:
    """`model` with every applicable form without states dormant.

    available: inputs all flights have. disturbed: states whose rates get an input `disturbance_<state>`, zero in every
    fit, through which simulated nulls are shaken.
    """
    extended = model.plus(
        inputs=[Signal(DISTURBANCE.format(s)) for s in disturbed],
        terms={f"{s}_dot": DISTURBANCE.format(s) for s in disturbed},
    )
    for effect in effects:
        # the richest form first: where forms share unknowns, its lines hold those of the others
        for form in sorted(effect.forms, key=lambda f: -len(f.parameters)):
            if form.states or form.lines or form.frees or not all(s.name in available for s in form.inputs):
                continue
            if form.obstacle(model) is None and form.obstacle(extended) is None:
                extended = _dormant(extended, form)
    return extended


def _dormant(model: Model, form: Form) -> Model:
    quiet = replace(form, transforms=(), output_delays={})
    extended = quiet.added_to(model, fixed=True)
    names = {p.name for p in form.parameters}
    marked = tuple(replace(p, role=ParameterRole.DORMANT) if p.name in names else p for p in extended.parameters)
    return replace(extended, parameters=marked)


def awakened(model: Model, form: Form, at: Mapping[str, float] | None = None) -> Model:
    """`model` with a form free to act, its parameters starting at `at` (by default without effect)."""
    dormant = {p.name: p for p in model.parameters if p.role is ParameterRole.DORMANT}
    if not all(p.name in dormant for p in form.parameters):
        return form.added_to(model, at)
    fresh: dict[str, Parameter] = {}
    for p in form.parameters:
        old = dormant[p.name]
        start = (at or {}).get(p.name, old.start)
        fresh[p.name] = replace(
            old,
            fixed=False,
            start=start,
            lower=min(old.lower, start),
            upper=max(old.upper, start),
            role=ParameterRole.DERIVATIVE,
        )
    return replace(
        model,
        parameters=tuple(fresh.get(p.name, p) for p in model.parameters),
        transforms=model.transforms + tuple(t for t in form.transforms if t.input in model.input_names),
        output_delays={**model.output_delays, **form.output_delays},
    )
