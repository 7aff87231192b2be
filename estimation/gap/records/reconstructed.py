"""Flights without vanes: what was found from the motion is no measurement to compare with, and its level is not known.

A flow angle found from velocity, acceleration and attitude repeats what these say; held against a model it shows their errors as
something that is missing. The model is compared in what was measured, which is enough: side acceleration, rates and bank tell
nearly as much of lateral motion as they do with a vane. Airspeed, and angles that the equations are driven by, stay, each with a
level of its own for every flight, as uncertain as the reconstruction says.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from estimation.gap.records.broken import dead_everywhere
from estimation.gap.records.candidate_model import nuisance_parameter
from estimation.models.base import InputTransform, Model
from groundstation.flight import Flight

ANGLES = ("alpha", "beta")
LEVEL = "level_"  # of an input that was found from the motion


def compared(model: Model, flights: Sequence[Flight]) -> tuple[Model, list[str]]:
    """`model` compared only in flow angles that every flight measured, and in what moves on any; and a note for each flight that
    lacks an angle."""
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
    """How uncertain a column is that was found from the motion (1 sigma, median over the flight), where that says so."""
    std = f"{column}_std"
    wide = float(np.nanmedian(flight[std])) if flight.measured(std) else 0.0
    return wide if 0.0 < wide < np.inf else None


def levels(model: Model, flights: Iterable[Flight]) -> dict[str, float]:
    """Input or output of `model` that some flight found from the motion -> how uncertain its level is (1 sigma)."""
    wide: dict[str, list[float]] = {}
    for flight in flights:
        for signal in (*model.inputs, *model.outputs):
            std = uncertainty(flight, signal.source) if signal.source in flight.reconstructed else None
            if std is not None:
                wide.setdefault(signal.name, []).append(std)
    return {name: float(np.sqrt(np.mean(np.square(stds)))) for name, stds in wide.items()}


def not_compared(base: Model, model: Model) -> str:
    """What the answer says of outputs of `base` that `model` is not compared in."""
    excluded = [n for n in base.output_names if n not in model.output_names]
    return f"Not measured, and so not compared: {', '.join(excluded)}." if excluded else ""


def with_levels(model: Model, wide: Mapping[str, float]) -> Model:
    """`model` with a level of every input and a bias of every output in `wide`, one for each flight."""
    inputs = [s for s in model.inputs if s.name in wide]
    outputs = [s for s in model.outputs if s.name in wide]
    return model.plus(
        outputs={s.name: f"{s.name} + bias_{s.name}" for s in outputs},
        parameters=[
            *(replace(nuisance_parameter(f"{LEVEL}{s.name}", s.unit, wide[s.name]), local=True) for s in inputs),
            *(replace(nuisance_parameter(f"bias_{s.name}", s.unit, wide[s.name]), local=True) for s in outputs),
        ],
        transforms=[InputTransform("bias", s.name, (f"{LEVEL}{s.name}",)) for s in inputs],
    )


def as_measured(flight: Flight) -> Flight:
    """`flight` without what was found from the motion."""
    columns = {name: values for name, values in flight.columns.items() if name not in flight.reconstructed}
    return replace(flight, columns=columns) if len(columns) < len(flight.columns) else flight
