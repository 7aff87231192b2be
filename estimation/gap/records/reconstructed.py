"""Flights without vanes: a reconstructed flow angle is no measurement to compare with, and its level is uncertain.

A flow angle reconstructed from velocity, acceleration and attitude repeats their information; compared with a model it shows
their errors as a missing effect. So only measured outputs are compared, which is enough: side acceleration, rates and bank show
the lateral motion nearly as well without a vane. Airspeed, and angles that are inputs of the equations, stay, each with a level
of its own on every flight within the uncertainty that the reconstruction states.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from estimation.gap.records.broken import dead_everywhere
from estimation.gap.records.candidate_model import nuisance_parameter
from estimation.models.base import InputTransform, Model
from groundstation.flight import Flight

ANGLES = ("alpha", "beta")
LEVEL = "level_"  # of a reconstructed input


def compared(model: Model, flights: Sequence[Flight]) -> tuple[Model, list[str]]:
    """`model` without flow angles that some flight did not measure and without outputs that are dead on all; and a note for each
    flight that lacks an angle."""
    excluded, notes = set(dead_everywhere(model, flights)), []
    for flight in flights:
        reconstructed = [s.name for s in model.outputs if s.source in ANGLES and s.source in flight.reconstructed]
        absent = [s.name for s in model.outputs if s.source in ANGLES and not flight.measured(s.source)]
        excluded |= {*reconstructed, *absent}
        if reconstructed or absent:
            words = [f"{', '.join(reconstructed)} found from the motion"] if reconstructed else []
            words += [f"{', '.join(absent)} not measured"] if absent else []
            notes.append(f"{flight.name}: {' and '.join(words)}: not compared")
    return model.without_outputs(*excluded) if excluded else model, notes


def uncertainty(flight: Flight, column: str) -> float | None:
    """Standard deviation of a reconstructed column (median over the flight); None where the flight does not state it."""
    std = f"{column}_std"
    median = float(np.nanmedian(flight[std])) if flight.measured(std) else 0.0
    return median if 0.0 < median < np.inf else None


def levels(model: Model, flights: Iterable[Flight]) -> dict[str, float]:
    """Input or output of `model` that some flight has reconstructed -> standard deviation of its level."""
    deviations: dict[str, list[float]] = {}
    for flight in flights:
        for signal in (*model.inputs, *model.outputs):
            std = uncertainty(flight, signal.source) if signal.source in flight.reconstructed else None
            if std is not None:
                deviations.setdefault(signal.name, []).append(std)
    return {name: float(np.sqrt(np.mean(np.square(stds)))) for name, stds in deviations.items()}


def not_compared(base: Model, model: Model) -> str:
    """A sentence on the outputs of `base` that `model` is not compared in."""
    excluded = [n for n in base.output_names if n not in model.output_names]
    return f"Not measured, and so not compared: {', '.join(excluded)}." if excluded else ""


def with_levels(model: Model, deviations: Mapping[str, float]) -> Model:
    """`model` with a level of every input and a bias of every output in `deviations` (from `levels`), one for each flight."""
    inputs = [s for s in model.inputs if s.name in deviations]
    outputs = [s for s in model.outputs if s.name in deviations]
    unknowns = [(f"{LEVEL}{s.name}", s) for s in inputs] + [(f"bias_{s.name}", s) for s in outputs]
    return model.plus(
        outputs={s.name: f"{s.name} + bias_{s.name}" for s in outputs},
        parameters=[replace(nuisance_parameter(n, s.unit, deviations[s.name]), local=True) for n, s in unknowns],
        transforms=[InputTransform("bias", s.name, (f"{LEVEL}{s.name}",)) for s in inputs],
    )


def as_measured(flight: Flight) -> Flight:
    """`flight` without its reconstructed columns."""
    columns = {name: values for name, values in flight.columns.items() if name not in flight.reconstructed}
    return replace(flight, columns=columns) if len(columns) < len(flight.columns) else flight
