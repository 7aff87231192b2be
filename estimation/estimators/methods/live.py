"""`live`: the recursive estimator of aircraft and ground station, over a recorded flight, with its history."""

from typing import TYPE_CHECKING

from estimation.estimators.estimator import Estimator, Look, Task

if TYPE_CHECKING:
    from estimation.estimators.result import Result
    from estimation.models.base import Model


def _fit(task: Task) -> "Result":
    from estimation.estimators.recursive import estimate_recursively

    return estimate_recursively(task.model, task.flights, task.aircraft)


def _refuses(model: "Model") -> str:
    from estimation.estimators.recursive import unsupported_by_live

    return unsupported_by_live(model)


ESTIMATORS = (
    Estimator(
        "live",
        "recursive regression with simulated instruments",
        _fit,
        rank=5,
        look=Look("#56B4E9", "P"),
        needs_aircraft=True,
        refuses=_refuses,
    ),
)
