"""`ls`: equation error by least squares, with all terms or those that partial F ratios select."""

from typing import TYPE_CHECKING

from estimation.estimators.estimator import Estimator, Extra, Look, Task

if TYPE_CHECKING:
    from estimation.estimators.result import Result


def _fit(task: Task) -> "Result":
    from estimation.estimators.equation_error import equation_error
    from estimation.estimators.regression_error import with_regression_errors

    result = equation_error(task.model, task.smooth, stepwise=task.extras.stepwise)
    return with_regression_errors(result, task.smooth, stepwise=task.extras.stepwise)


ESTIMATORS = (
    Estimator(
        "ls",
        "equation error, least squares",
        _fit,
        frozenset({Extra.STEPWISE, Extra.RAW_INPUTS, Extra.KEEP_HELD}),
        rank=4,
        look=Look("#8c6d31", "v"),
    ),
)
