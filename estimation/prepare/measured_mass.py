"""Mass as a history: fuel that is burnt, where a flight has a column `mass` [kg].

Inertia and centre of gravity stay those of the aircraft file: nothing in a flight says how they went.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from estimation.aircraft import Aircraft
from estimation.errors import DataError
from estimation.models.base import Model, renamed
from estimation.models.expressions import names_in
from estimation.models.parts import Signal
from groundstation.flight import Flight

COLUMN = "mass"
SYMBOL = "m"  # of the mass in built-in models
FARTHEST = 2.0  # times the file's mass, or a part of it: further off a unit is wrong (pounds are 2.2)


def mass_history(flight: Flight, aircraft: Aircraft) -> NDArray[np.float64]:
    """(N,) [kg] of a flight, the file's where it has no such column; between fuel readings by lines.

    Raises DataError for a mass that is none, or more than twice or less than half of what the aircraft file states.
    """
    if not flight.measured(COLUMN):
        return np.full(len(flight), aircraft.mass)
    values = np.asarray(flight[COLUMN], float)
    known = np.isfinite(values)
    if not (values[known] > 0.0).all():
        raise DataError(
            f"{flight.name}: column mass has values that are not above zero; it is that of the whole aircraft [kg]"
        )
    for value in (values[known].min(), values[known].max()):
        if not 1.0 / FARTHEST < value / aircraft.mass < FARTHEST:
            raise DataError(
                f"{flight.name}: column mass has {value:.4g} kg, the aircraft file states {aircraft.mass:.4g} kg; is its unit"
                " right in the map, and is it the whole aircraft and not its fuel?"
            )
    return np.interp(flight.time, flight.time[known], values[known])


def with_mass_history(
    model: Model, flights: Sequence[Flight], aircraft: Aircraft
) -> tuple[Model, tuple[Flight, ...], tuple[str, ...]]:
    """The model with the flights' own mass in its equations, the flights with it in every sample, and a note that says so.

    All as they were where a flight has no such column, or no equation has the mass of the aircraft's file: what a model of
    one's own calls m may be anything. Raises as `mass_history`.
    """
    holds_mass = model.constants.get(SYMBOL) == aircraft.mass and any(
        SYMBOL in names_in(text) for text in model.definitions.values()
    )
    if not holds_mass or not flights or not all(f.measured(COLUMN) for f in flights):
        return model, tuple(flights), ()
    histories = [mass_history(f, aircraft) for f in flights]
    least, greatest = min(h.min() for h in histories), max(h.max() for h in histories)
    stated = model.constants[SYMBOL]
    replaced = {n: renamed(text, SYMBOL, COLUMN) for n, text in model.definitions.items() if SYMBOL in names_in(text)}
    signal = Signal(COLUMN, "kg", "mass as it was in flight", computed=True)
    changed = model.plus(replaced=replaced, inputs=[signal])
    # what takes one number for the whole flight takes its mean
    changed = replace(changed, constants={**model.constants, SYMBOL: float(np.mean(np.concatenate(histories)))})
    note = (
        f"mass as measured, {least:.5g} to {greatest:.5g} kg, in place of {stated:.5g} kg; inertia and centre of gravity are the"
        " aircraft file's"
    )
    with_mass = tuple(f.with_columns(mass=h) for f, h in zip(flights, histories, strict=True))
    return changed, with_mass, (note,)
