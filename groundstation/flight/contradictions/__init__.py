"""Quantities of a flight that say the same twice, and by how much they contradict each other: for import, check, preflight,
recipe and estimate alike."""

import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager

import numpy as np

from groundstation.flight.contradictions import air, motion, zeros
from groundstation.flight.contradictions.contradiction import Contradiction, contradiction_from_json
from groundstation.flight.contradictions.failing import PITOT, failing_sensors
from groundstation.flight.contradictions.fits import FEWEST_BLOCKS, Array, Columns
from groundstation.flight.flight import Flight
from groundstation.flight.stretches import airborne

__all__ = ["CONTRADICTIONS", "Contradiction", "contradictions", "contradictions_of", "no_airspeed"]

CONTRADICTIONS = "contradictions"
"""Key of a provenance's detail: those that an import saw in the log itself, which the columns of the flight no longer show."""

COMPARISONS: tuple[Callable[[Array, Columns], Iterator[Contradiction]], ...] = (
    air.pitot_against_ground,
    air.speed_and_pressure,
    air.scale_against_ground,
    air.density_twice,
    air.pressure_and_height,
    motion.gyros_and_attitude,
    zeros.gyros_beside_attitude,
    motion.acceleration_and_velocity,
    motion.heading_and_course,
    motion.command_and_surface,
    motion.magnetic_field,
)
"""Each compares two ways to one quantity; all see the same measured columns."""


def contradictions_of(time: Array, columns: Mapping[str, Array]) -> tuple[Contradiction, ...]:
    """What arrays contradict of each other. time: (N,) [s]; columns: name -> (N,), SI, named as in `daq.contract.channels`;
    NaN and columns without a value count as not measured."""
    time = np.asarray(time, float)
    with _absurd_values():
        failures, sound = failing_sensors(time, _measured(columns))
        measured = _measured(sound)
        return (*failures, *(c for compare in COMPARISONS for c in compare(time, measured)))


@contextmanager
def _absurd_values() -> Iterator[None]:
    """Without warnings of absurd values, which are contradictions themselves or named elsewhere, and of stretches without any."""
    with np.errstate(all="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        yield


def _measured(columns: Mapping[str, Array]) -> dict[str, Array]:
    return {n: np.asarray(v, float) for n, v in columns.items() if np.isfinite(v).sum() >= FEWEST_BLOCKS}


def contradictions(flight: Flight) -> tuple[Contradiction, ...]:
    """Those of a flight: what its import saw in the log, and what its columns show.

    An airspeed that was reconstructed is not held against what it was made from: the measured one is. At rest before and after a
    flight a pitot reads its noise and the wind on the ground, so that is left out.
    """
    phase = airborne(flight)
    rows = phase.flying if phase.stood else np.ones(len(flight), bool)
    columns = {name: values[rows] for name, values in flight.columns.items()}
    airspeed = columns.pop("V_measured", None)
    if airspeed is not None and "V" in flight.reconstructed:
        columns["V"] = airspeed
    for name in flight.reconstructed:
        if name != "V":
            columns.pop(name, None)
    entries = flight.provenance.detail.get(CONTRADICTIONS)
    imported = map(contradiction_from_json, entries if isinstance(entries, list | tuple) else ())
    candidates = (*filter(None, imported), *contradictions_of(flight.time[rows], columns))
    return tuple({(c.between, c.text): c for c in candidates}.values())


def no_airspeed(flight: Flight) -> str:
    """Why a flight's V is none, for the end of a sentence; empty where the rest of the flight does not tell."""
    columns = _measured(flight.columns)
    with _absurd_values():
        lost = [c for c in failing_sensors(flight.time, columns)[0] if c.between[0] in PITOT]
        contradiction = next(iter([*lost, *air.pitot_against_ground(flight.time, columns)]), None)
    return "" if contradiction is None else f"; {contradiction.text}"
