"""Contradictions of a flight: quantities that were measured in two ways, and do not agree. Used by import, check, preflight,
recipe and estimate."""

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
"""Key of a provenance's detail: contradictions that an import found in the log and that its columns no longer show."""

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
"""Each compares two measurements of one quantity, in the columns without the samples of failed sensors."""


def contradictions_of(time: Array, columns: Mapping[str, Array]) -> tuple[Contradiction, ...]:
    """The contradictions between columns, sensors that failed in flight first. time: (N,) [s]; columns: name -> (N,), SI, named
    as in `daq.contract.channels`; NaN is not measured."""
    time = np.asarray(time, float)
    with _numpy_warnings_off():
        failures, sound = failing_sensors(time, _measured(columns))
        measured = _measured(sound)
        return (*failures, *(c for compare in COMPARISONS for c in compare(time, measured)))


@contextmanager
def _numpy_warnings_off() -> Iterator[None]:
    """No warnings of numpy for implausible values, which are reported as such, and for stretches without values."""
    with np.errstate(all="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        yield


def _measured(columns: Mapping[str, Array]) -> dict[str, Array]:
    """The columns with enough finite values for a comparison."""
    return {n: np.asarray(v, float) for n, v in columns.items() if np.isfinite(v).sum() >= FEWEST_BLOCKS}


def contradictions(flight: Flight) -> tuple[Contradiction, ...]:
    """The contradictions of a flight: those that its import found in the log, then those of its columns.

    Reconstructed columns are not compared, in place of a reconstructed airspeed the measured one is. Times on the ground are left
    out, where a pitot reads its noise and the wind.
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
    """Why a flight's V is not its airspeed, as the end of a sentence, beginning with '; '; empty without evidence."""
    columns = _measured(flight.columns)
    with _numpy_warnings_off():
        lost = [c for c in failing_sensors(flight.time, columns)[0] if c.between[0] in PITOT]
        contradiction = next(iter([*lost, *air.pitot_against_ground(flight.time, columns)]), None)
    return "" if contradiction is None else f"; {contradiction.text}"
