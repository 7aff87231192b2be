"""What every fit of the workflow carries along because no flight is free of it, and what it must not be named for.

Instrument biases of each flight (about as large as the noise of the channel), the time at which a surface really moves
between two samples (a tenth of the sample interval), what an attitude filter makes of sampled rates (again a tenth of
the interval, and the rounding of rolling edges by straight lines between samples, at most h^2/12 times the angular
acceleration), and what its plumb line makes of slipping: it takes the side acceleration of a changing sideslip for
gravity, an error in bank that follows sideslip (V/(g T) of it where nothing is done against that, T the filter's memory;
a few hundredths with airspeed or GPS velocity). All estimated with priors of that width, so that none is mistaken for an
effect.
"""

from collections.abc import Collection, Mapping

from estimation.gap.whitening import RATE_OF
from estimation.models.base import InputTransform, Model, Parameter

BIAS_SHARE = 1.0  # of the noise of the channel
TIMING_SHARE = 0.1  # of the sample interval
PLUMB_SHARE = 0.02  # of sideslip, seen as bank by an attitude filter
PRIOR_SHARE = 3.0  # of the standard deviation the aircraft file states, as a weak regularisation


def with_nuisance(
    model: Model, noise: Mapping[str, float], sample_interval: float, filtered: Collection[str] = ()
) -> Model:
    """`model` with local biases on its outputs and small timing offsets on its controls, all with priors.

    noise: output -> standard deviation of its noise. filtered: attitudes among the outputs that are a filter's, which
    get a small timing offset and the rounding of sampled rates.
    """
    biased = [n for n in model.output_names if noise.get(n, 0.0) > 0 and f"bias_{n}" not in model.parameter_names]
    made = model.with_biases(*biased)
    made = made.with_prior(**{f"bias_{n}": (0.0, BIAS_SHARE * noise[n]) for n in biased})
    for signal in model.inputs:
        name = f"timing_{signal.name}"
        if signal.control and name not in made.parameter_names:
            made = made.plus(
                parameters=[Parameter(name, "s", prior_mean=0.0, prior_std=TIMING_SHARE * sample_interval)],
                transforms=[InputTransform("delay", signal.name, (name,))],
            )
    for attitude in filtered:
        made = _sampled(made, attitude, sample_interval)
    beliefs = {
        p.name: (p.reference, PRIOR_SHARE * p.reference_std)
        for p in made.parameters
        if p.reference is not None and p.reference_std and p.prior_mean is None
    }
    return made.with_prior(**beliefs)  # type: ignore[arg-type]


def _sampled(model: Model, attitude: str, sample_interval: float) -> Model:
    """`model` with an attitude as a filter that integrates sampled rates and has a plumb line shows it."""
    known = {*model.definitions, *model.state_names}
    widths = {
        f"timing_{attitude}": (f"{attitude}_dot", "s", TIMING_SHARE * sample_interval),
        f"rounding_{attitude}": (f"{RATE_OF[attitude]}_dot", "s2", sample_interval**2 / 12.0),
    }
    if attitude == "phi":
        widths["plumb_phi"] = ("beta", "1", PLUMB_SHARE)
    for name, (follows, unit, width) in widths.items():
        if follows in known and name not in model.parameter_names:
            model = model.plus(
                outputs={attitude: f"{attitude} + {name}*{follows}"},
                parameters=[Parameter(name, unit, prior_mean=0.0, prior_std=width)],
            )
    return model


def is_nuisance(name: str) -> bool:
    """Whether a parameter is one of those added here."""
    return name.startswith(("bias_", "timing_", "rounding_", "plumb_", "edge_"))
