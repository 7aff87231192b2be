"""`ml`: maximum likelihood by output error, with profiles and a parametric bootstrap on demand."""

from dataclasses import replace
from typing import TYPE_CHECKING

from estimation.estimators.estimator import Estimator, Extra, Look, Task

if TYPE_CHECKING:
    from estimation.estimators.result import Result


def _fit(task: Task) -> "Result":
    """Output error, then the profiles and the bootstrap that were requested."""
    from estimation.estimators.output_error import output_error

    flights, extras = task.data, task.extras
    result = output_error(task.model, flights)
    if extras.profile:
        from estimation.estimators.refits import profile_likelihood

        task.tell(f"profiles of {', '.join(extras.profile)}")
        curves = {name: profile_likelihood(task.model, flights, name, result) for name in extras.profile}
        result = replace(result, profile=curves)
    if extras.bootstrap:
        import numpy as np

        from estimation.estimators.refits import parametric_bootstrap

        task.tell(f"{extras.bootstrap} bootstrap replicates")
        rng = np.random.default_rng([extras.seed, task.number])
        result = replace(result, bootstrap=parametric_bootstrap(task.model, flights, result, extras.bootstrap, rng))
    return result


ESTIMATORS = (
    Estimator(
        "ml",
        "maximum likelihood, output error",
        _fit,
        frozenset({Extra.PROFILE, Extra.BOOTSTRAP, Extra.SEED, Extra.RAW_INPUTS, Extra.KEEP_HELD}),
        rank=0,
        look=Look("#0072B2", "o"),
    ),
)
