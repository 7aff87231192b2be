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
    "estimation.aircraft": ("Aircraft", "load_aircraft"),
    "estimation.prepare.flight_data": ("Preparation",),
    "estimation.engine.simulate": ("simulate", "simulate_with_sensitivities"),
    "estimation.estimators.gauss_newton": ("LoopOptions",),
    "estimation.estimators.output_error": ("OutputErrorOptions", "output_error"),
    "estimation.estimators.estimator": ("Estimator", "Extra", "Look", "Task"),
    "estimation.estimators.result": ("Result",),
    "estimation.models": (
        "InputTransform", "Model", "Parameter", "ParameterRole", "Signal", "load_model", "read_model", "write_model",
    ),
}  # fmt: skip
__all__ = [
    "Aircraft", "Estimator", "Extra", "InputTransform", "Look", "LoopOptions", "Model", "OutputErrorOptions", "Parameter",
    "ParameterRole", "Preparation", "Result", "Signal", "Task", "load_aircraft", "load_model", "output_error", "read_model",
    "simulate", "simulate_with_sensitivities", "write_model",
]  # fmt: skip


def __getattr__(name: str) -> Any:
    for module, names in _HOMES.items():
        if name in names:
            import importlib

            return getattr(importlib.import_module(module), name)
    raise AttributeError(f"module 'estimation' has no attribute {name!r}")
