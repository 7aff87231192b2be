"""Settings of the two forms of Neural Gauss-Newton."""

from dataclasses import dataclass, field

from estimation.estimators.neural_gauss_newton.training import TrainingOptions


@dataclass(frozen=True, slots=True)
class NgnOptions:
    """improved: the interval form with a linear path; instruments: normal equations with instruments.

    hidden: neurons; ensemble: networks of different seeds whose estimates are averaged; bootstraps: networks of the
    block bootstrap (0: no honest spread, the Cramer-Rao bound stands alone); device: cpu, cuda or auto, for training.
    """

    improved: bool = False
    instruments: bool = False
    hidden: int = 6
    training: TrainingOptions = field(default_factory=lambda: TrainingOptions(restarts=1))
    ensemble: int = 2
    bootstraps: int = 64
    bootstrap_iterations: int = 4
    seed: int = 0
    device: str = "cpu"


def default_options(improved: bool, axis: str = "lateral") -> NgnOptions:
    """What the study found best. The published form's networks differ more, so it takes more of them.

    Longitudinal: lift follows angle of attack so closely that instruments carry too little of what is left.
    """
    if improved and axis == "lateral":
        return NgnOptions(improved=True, instruments=True)
    steady = TrainingOptions(restarts=1, decay=1e-2)
    if improved:
        return NgnOptions(improved=True, hidden=4, training=steady)
    return NgnOptions(training=steady, ensemble=4)
