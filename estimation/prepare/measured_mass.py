"""Mass as a history, as fuel burns, where a flight has a column `mass` [kg].

Every verb that compares a model with flights uses it. Inertia stays that of the aircraft file, because no flight records it.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from daq.identification.airframe import FARTHEST_MASS
from daq.identification.airframe import MASS as COLUMN
from estimation.aircraft import Aircraft
from estimation.errors import DataError
from estimation.models.base import Model, renamed
from estimation.models.expressions import names_in
from estimation.models.library import LATERAL_AERODYNAMICS, LONGITUDINAL_AERODYNAMICS
from estimation.models.parts import Signal
from groundstation.flight import Flight

SYMBOL = "m"  # of the mass in built-in models
_LINES = (line.partition(" = ") for line in (*LATERAL_AERODYNAMICS, *LONGITUDINAL_AERODYNAMICS))
OF_MASS = frozenset((name, text) for name, _, text in _LINES if SYMBOL in names_in(text))
"""Lines of built-in models, in which m is the aircraft's mass whatever its value."""


def mass_history(flight: Flight, stated: float) -> NDArray[np.float64]:
    """(N,) mass of a flight [kg], on straight lines between readings; the stated one where the flight has no such column.

    Raises DataError for a mass that is not above zero, or further than a factor FARTHEST_MASS from the stated one.
    """
    if not flight.measured(COLUMN):
        return np.full(len(flight), stated)
    values = np.asarray(flight[COLUMN], float)
    known = np.isfinite(values)
    if not (values[known] > 0.0).all():
        raise DataError(
            f"{flight.name}: column mass has values that are not above zero; it is that of the whole aircraft [kg]"
        )
    for value in (values[known].min(), values[known].max()):
        if not 1.0 / FARTHEST_MASS < value / stated < FARTHEST_MASS:
            raise DataError(
                f"{flight.name}: column mass has {value:.4g} kg, the aircraft file states {stated:.4g} kg; is its unit"
                " right in the map, and is it the whole aircraft and not its fuel?"
            )
    return np.interp(flight.time, flight.time[known], values[known])


def with_mass_history(
    model: Model, flights: Sequence[Flight], aircraft: Aircraft
) -> tuple[Model, tuple[Flight, ...], tuple[str, ...]]:
    """The model with the measured mass in its equations, the flights with it at every sample, and a note.

    A flight without such a column has the stated mass. All are unchanged where no flight has it, or where m may be something
    else, as it may be in a user's model. Raises as `mass_history`.
    """
    if not _has_mass(model, aircraft) or not any(f.measured(COLUMN) for f in flights):
        return model, tuple(flights), ()
    stated = model.constants[SYMBOL]
    histories = [mass_history(f, stated) for f in flights]
    least, greatest = min(h.min() for h in histories), max(h.max() for h in histories)
    replaced = {n: renamed(text, SYMBOL, COLUMN) for n, text in model.definitions.items() if SYMBOL in names_in(text)}
    signal = Signal(COLUMN, "kg", "mass as it was in flight", computed=True)
    changed = model.plus(replaced=replaced, inputs=[signal])
    # code that needs one number for the flight uses the mean
    changed = replace(changed, constants={**model.constants, SYMBOL: float(np.mean(np.concatenate(histories)))})
    note = f"mass as measured, {least:.5g} to {greatest:.5g} kg, in place of {stated:.5g} kg; inertia is the aircraft file's"
    with_mass = tuple(f.with_columns(mass=h) for f, h in zip(flights, histories, strict=True))
    return changed, with_mass, (note,)


def _has_mass(model: Model, aircraft: Aircraft) -> bool:
    """Whether m is the mass: that of the aircraft file, or one in a line of a built-in model."""
    lines = {(name, text) for name, text in model.definitions.items() if SYMBOL in names_in(text)}
    return SYMBOL in model.constants and bool(
        lines if model.constants[SYMBOL] == aircraft.mass else lines.intersection(OF_MASS)
    )


def at_mean_mass(model: Model) -> Model:
    """The model for other flights: its equations with one mass, the mean over the flights it was used on."""
    if COLUMN not in model.input_names or SYMBOL not in model.constants:
        return model
    inputs = tuple(s for s in model.inputs if s.name != COLUMN)
    lines = tuple(f"{name} = {renamed(text, COLUMN, SYMBOL)}" for name, text in model.definitions.items())
    return replace(model, inputs=inputs, equations=lines)
