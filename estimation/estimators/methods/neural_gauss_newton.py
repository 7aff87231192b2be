"""`ngn` and `ngn-improved`: the two forms of Neural Gauss-Newton; the networks of several flights are trained side by side."""

from typing import TYPE_CHECKING, Any

from estimation.estimators.estimator import Estimator, Extra, Look, Task

if TYPE_CHECKING:
    from estimation.estimators.result import Result
    from estimation.models.base import Model


def _form(name: str, title: str, improved: bool, rank: int, look: Look) -> Estimator:
    """The estimator of one form of Neural Gauss-Newton."""

    def settings(task: Task) -> dict[str, Any]:
        extras = task.extras
        return {
            "model": task.model,
            "improved": improved,
            "device": task.device,
            "bootstraps": extras.bootstrap or None,
            "seed": extras.seed,
        }

    def fit(task: Task) -> "Result":
        from estimation.estimators.neural_gauss_newton import estimate_ngn

        return estimate_ngn(task.aircraft, task.repaired, **settings(task))

    def fit_each(task: Task) -> "list[Result]":
        from estimation.estimators.neural_gauss_newton import estimate_campaign

        return estimate_campaign(task.aircraft, task.repaired, **settings(task))

    return Estimator(
        name,
        title,
        fit,
        frozenset({Extra.BOOTSTRAP, Extra.SEED, Extra.KEEP_HELD}),
        fit_each,
        rank,
        look,
        needs_aircraft=True,
        refuses=_refuses,
    )


def _refuses(model: "Model") -> str:
    from estimation.estimators.neural_gauss_newton.axes import unsupported_model

    return unsupported_model(model.name, model.parameter_names)


ESTIMATORS = (
    _form("ngn", "neural Gauss-Newton, as published", False, 2, Look("#D55E00", "D")),
    _form("ngn-improved", "neural Gauss-Newton, interval means", True, 3, Look("#CC79A7", "^")),
)
