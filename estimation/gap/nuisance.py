"""What every fit of the workflow carries along because no flight is free of it, and what it must not be named for.

Instrument biases of each flight (about as large as the noise of the channel) and the time at which a surface really
moves between two samples (a tenth of the sample interval): estimated with priors of that width, so that neither is
mistaken for an effect.
"""

from collections.abc import Mapping

from estimation.models.base import InputTransform, Model, Parameter

BIAS_SHARE = 1.0  # of the noise of the channel
TIMING_SHARE = 0.1  # of the sample interval
PRIOR_SHARE = 3.0  # of the standard deviation the aircraft file states, as a weak regularisation


def with_nuisance(model: Model, noise: Mapping[str, float], sample_interval: float) -> Model:
    """`model` with local biases on its outputs and small timing offsets on its controls, all with priors.

    noise: output -> standard deviation of its noise.
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
    beliefs = {
        p.name: (p.reference, PRIOR_SHARE * p.reference_std)
        for p in made.parameters
        if p.reference is not None and p.reference_std and p.prior_mean is None
    }
    return made.with_prior(**beliefs)  # type: ignore[arg-type]


def is_nuisance(name: str) -> bool:
    """Whether a parameter is one of those added here."""
    return name.startswith(("bias_", "timing_", "edge_"))
