"""`fem`, `fem-noise`: maximum likelihood by filter error, for flights in rough air."""

from typing import TYPE_CHECKING

from estimation.estimators.estimator import Estimator, Extra, Look, Task

if TYPE_CHECKING:
    from estimation.estimators.result import Result


def _fit(task: Task) -> "Result":
    from estimation.estimators.filter_error import filter_error

    return filter_error(task.model, task.data)


def _fit_noise(task: Task) -> "Result":
    from estimation.estimators.filter_error import process_noise_error

    return process_noise_error(task.model, task.data)


ESTIMATORS = (
    Estimator(
        "fem",
        "maximum likelihood, filter error",
        _fit,
        frozenset({Extra.RAW_INPUTS, Extra.KEEP_HELD}),
        rank=1,
        look=Look("#009E73", "s"),
    ),
    Estimator(
        "fem-noise",
        "maximum likelihood, filter error by process noise",
        _fit_noise,
        frozenset({Extra.RAW_INPUTS, Extra.KEEP_HELD}),
        rank=1,
        look=Look("#117733", "D"),
    ),
)
