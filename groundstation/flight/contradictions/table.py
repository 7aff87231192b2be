"""The table of what nearly every flight says twice, and the contradictions in a flight."""

from collections.abc import Callable, Iterator, Mapping

import numpy as np

from groundstation.flight.contradictions.air import (
    density_twice,
    pressure_and_height,
    scale_against_ground,
    speed_and_pressure,
)
from groundstation.flight.contradictions.contradiction import Contradiction, from_json
from groundstation.flight.contradictions.fits import FEWEST_BLOCKS, Array, Columns
from groundstation.flight.contradictions.motion import (
    acceleration_and_velocity,
    command_and_surface,
    gyros_and_attitude,
    heading_and_course,
    magnetic_field,
)
from groundstation.flight.flight import Flight

CONTRADICTIONS = "contradictions"
"""Key of a provenance's detail: those that an import saw in the log itself, which the columns of the flight no longer show."""

Row = Callable[[Array, Columns], Iterator[Contradiction]]

ROWS: tuple[Row, ...] = (
    speed_and_pressure,
    scale_against_ground,
    density_twice,
    pressure_and_height,
    gyros_and_attitude,
    acceleration_and_velocity,
    heading_and_course,
    command_and_surface,
    magnetic_field,
)
"""Each row compares two ways to one quantity; all see the same measured columns."""


def contradictions_of(time: Array, columns: Mapping[str, Array]) -> tuple[Contradiction, ...]:
    """What arrays contradict of each other. time: (N,) [s]; columns: name -> (N,), SI, named as in `daq.contract.channels`;
    NaN and columns without a value count as not measured."""
    known = {n: np.asarray(v, float) for n, v in columns.items() if np.isfinite(v).sum() >= FEWEST_BLOCKS}
    with np.errstate(all="ignore"):  # absurd values, which are contradictions themselves or named elsewhere
        return tuple(found for row in ROWS for found in row(np.asarray(time, float), known))


def contradictions(flight: Flight) -> tuple[Contradiction, ...]:
    """Those of a flight: what its import saw in the log, and what its columns show.

    An airspeed that was reconstructed is not held against what it was made from: the measured one is.
    """
    columns = dict(flight.columns)
    measured = columns.pop("V_measured", None)
    if measured is not None and "V" in flight.reconstructed:
        columns["V"] = measured
    for name in flight.reconstructed:
        if name != "V":
            columns.pop(name, None)
    stated = flight.provenance.detail.get(CONTRADICTIONS)
    seen = [from_json(one) for one in stated] if isinstance(stated, list | tuple) else []
    found = {
        (c.between, c.text): c for c in (*(c for c in seen if c is not None), *contradictions_of(flight.time, columns))
    }
    return tuple(found.values())
