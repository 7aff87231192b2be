"""What every fit of the workflow carries along because no flight is free of it, and what it must not be named for.

Instrument biases of each flight (about as large as the noise of the channel), the time at which a surface really moves
between two samples (a tenth of the sample interval, for all surfaces together; they are sampled by one clock, and one of
them differs from the others by a few hundredths), what an attitude filter makes of sampled rates (again a tenth of
the interval, and the rounding of rolling edges by straight lines between samples, at most h^2/12 times the angular
acceleration), and what its plumb line makes of slipping: it takes the side acceleration of a changing sideslip for
gravity, an error in bank that follows sideslip (V/(g T) of it where nothing is done against that, T the filter's memory;
a few hundredths with airspeed or GPS velocity). An attitude that a log has with times of its own is a tenth of its own
interval off, be it a filter's or not. All estimated with priors of that width, so that none is mistaken for an
effect.
"""

from collections.abc import Collection, Iterable, Mapping
from dataclasses import replace
from types import MappingProxyType

from daq.contract.constants import GRAVITY
from estimation.gap.criteria import Criteria
from estimation.models.base import InputTransform, Model, Parameter, ParameterRole
from groundstation.flight import Flight

TIMING = "timing_"  # of what moves late
TOGETHER = TIMING + "controls"  # all of them
RATE_OF = {"phi": "p", "theta": "q", "psi": "r"}  # attitude -> the rate a filter integrates to it


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
    own = {f"bias_{n}" for n in biased}
    made = model.with_biases(*biased)
    made = made.with_prior(**{f"bias_{n}": (0.0, criteria.bias_share * noise[n]) for n in biased})
    made = _timed(made, sample_interval, criteria)
    for attitude, interval in stamped.items():
        width = criteria.timing_share * max(sample_interval, interval)
        made = _shown(made, attitude, {f"{TIMING}{attitude}": (f"{attitude}_dot", "s", width)})
    for attitude in filtered:
        made = _shown(made, attitude, _of_a_filter(attitude, sample_interval, criteria))
    marked = tuple(replace(p, role=ParameterRole.NUISANCE) if p.name in own else p for p in made.parameters)
    made = replace(made, parameters=marked)
    beliefs = {
        p.name: (p.reference, criteria.prior_share * p.reference_std)
        for p in made.parameters
        if p.reference is not None and p.reference_std and p.prior_mean is None
    }
    return made.with_prior(**beliefs)  # type: ignore[arg-type]


def stamped_attitudes(model: Model, flights: Iterable[Flight]) -> dict[str, float]:
    """Attitude among the outputs -> the longest interval [s] at which the log of a flight has it with times of its own."""
    found: dict[str, float] = {}
    for flight in flights:
        for signal in model.outputs:
            rate = flight.native_rate(signal.source) if signal.name in RATE_OF else None
            if rate is not None:
                found[signal.name] = max(found.get(signal.name, 0.0), 1.0 / rate)
    return found


def _timed(model: Model, sample_interval: float, criteria: Criteria) -> Model:
    """`model` with controls that move a little before or after they were sampled: all together, and each by itself."""
    controls = [s.name for s in model.inputs if s.control and f"{TIMING}{s.name}" not in model.parameter_names]
    several = len(controls) > 1 and TOGETHER not in model.parameter_names
    own = criteria.own_timing_share if several else criteria.timing_share
    if several:
        model = model.plus(
            parameters=[carried(TOGETHER, "s", criteria.timing_share * sample_interval)],
            transforms=[InputTransform("delay", name, (TOGETHER,)) for name in controls],
        )
    return model.plus(
        parameters=[carried(f"{TIMING}{name}", "s", own * sample_interval) for name in controls],
        transforms=[InputTransform("delay", name, (f"{TIMING}{name}",)) for name in controls],
    )


def timing_of(control: str, values: Mapping[str, float]) -> float:
    """Time [s] by which a fit moved a control."""
    return values.get(TOGETHER, 0.0) + values.get(f"{TIMING}{control}", 0.0)


def carried(name: str, unit: str, width: float) -> Parameter:
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
    known = {*model.definitions, *model.state_names}
    for name, (follows, unit, width) in widths.items():
        if follows in known and name not in model.parameter_names:
            model = model.plus(
                outputs={attitude: f"{attitude} + {name}*{follows}"},
                parameters=[carried(name, unit, width)],
            )
    return model
