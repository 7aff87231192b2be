"""`ml-frequency`: maximum likelihood by output error in the frequency domain."""

from typing import TYPE_CHECKING

from estimation.estimators.estimator import Estimator, Extra, Look, Task

if TYPE_CHECKING:
    from estimation.estimators.result import Result


def _fit(task: Task) -> "Result":
    from estimation.estimators.frequency_domain.estimate import frequency_output_error

    return frequency_output_error(task.model, task.data)


ESTIMATORS = (
    Estimator(
        "ml-frequency",
        "maximum likelihood, output error in the frequency domain",
        _fit,
        frozenset({Extra.RAW_INPUTS, Extra.KEEP_HELD}),
        rank=1,
        look=Look("#E69F00", "h"),
    ),
)
