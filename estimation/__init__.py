"""Aircraft identification: models, estimators, the gap workflow and their reports.

    from estimation import load_model, output_error
    result = output_error(load_model("lateral", "cdfp"), [read_flight("flight.csv")])

Names are imported on first use, so that the simulator can read an aircraft without a numerical library.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from estimation.aircraft import Aircraft, load_aircraft
    from estimation.engine.simulate import simulate, simulate_with_sensitivities
    from estimation.estimators.estimator import Estimator, Extra, Look, Task
    from estimation.estimators.gauss_newton import LoopOptions
    from estimation.estimators.output_error import OutputErrorOptions, output_error
    from estimation.estimators.result import Result
    from estimation.models import (
        InputTransform,
        Model,
        Parameter,
        ParameterRole,
        Signal,
        load_model,
        read_model,
        write_model,
    )
    from estimation.prepare.flight_data import Preparation

_HOMES = {
    "Aircraft": "estimation.aircraft",
    "load_aircraft": "estimation.aircraft",
    "Preparation": "estimation.prepare.flight_data",
    "simulate": "estimation.engine.simulate",
    "simulate_with_sensitivities": "estimation.engine.simulate",
    "LoopOptions": "estimation.estimators.gauss_newton",
    "OutputErrorOptions": "estimation.estimators.output_error",
    "output_error": "estimation.estimators.output_error",
    "Estimator": "estimation.estimators.estimator",
    "Extra": "estimation.estimators.estimator",
    "Look": "estimation.estimators.estimator",
    "Task": "estimation.estimators.estimator",
    "Result": "estimation.estimators.result",
    "InputTransform": "estimation.models",
    "Model": "estimation.models",
    "Parameter": "estimation.models",
    "ParameterRole": "estimation.models",
    "Signal": "estimation.models",
    "load_model": "estimation.models",
    "read_model": "estimation.models",
    "write_model": "estimation.models",
}
__all__ = [
    "Aircraft", "Estimator", "Extra", "InputTransform", "Look", "LoopOptions", "Model", "OutputErrorOptions", "Parameter",
    "ParameterRole", "Preparation", "Result", "Signal", "Task", "load_aircraft", "load_model", "output_error", "read_model",
    "simulate", "simulate_with_sensitivities", "write_model",
]  # fmt: skip


def __getattr__(name: str) -> Any:
    if name in _HOMES:
        import importlib

        return getattr(importlib.import_module(_HOMES[name]), name)
    raise AttributeError(f"module 'estimation' has no attribute {name!r}")
