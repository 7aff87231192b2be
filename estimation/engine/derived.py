"""Columns that are made from others where the flight lacks them: slopes of signals, density from air data."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from daq.contract.channels import COLUMN_BY_NAME
from estimation.engine.kernel import Array
from estimation.errors import DataError
from estimation.signals.preprocess import denoise
from groundstation.flight import Flight
from groundstation.flight.notes import Note, NoteKind

FLYING = 5.0  # m/s; slower than this a pitot tube says nothing of density
SLOW = 10.0  # s over which density hardly changes


def bridged(values: Array) -> Array:
    """The signal with samples that were not measured on straight lines between their neighbours. values: (N,)."""
    missing = ~np.isfinite(values)
    if missing.any():
        index = np.arange(values.size)
        values = values.copy()
        values[missing] = np.interp(index[missing], index[~missing], values[~missing])
    return values


def slope(time: Array, values: Array) -> Array:
    """Derivative of a signal from its de-noised curve, by central differences. time, values: (N,)."""
    return np.gradient(denoise(bridged(values), order=2).values, time)


@dataclass(frozen=True)
class Way:
    """How a column is made where the flight lacks it. build: function of time (N,) and of each needed column (N,)."""

    needs: tuple[str, ...]
    build: Callable[..., Array]


def way_to(flight: Flight, name: str) -> Way | None:
    """The first way to make a column of which the flight has all that it needs."""
    return next((w for w in DERIVED.get(name, ()) if all(flight.measured(n) for n in w.needs)), None)


def with_derived(flight: Flight, names: Sequence[str]) -> Flight:
    """The flight with those of the named columns added that it lacks and that can be made from others of its columns."""
    segments = [(s.start, s.stop) for s in flight.segments]
    lacking = [n for n in names if not flight.measured(n) and way_to(flight, n) is not None]
    return flight.with_columns(**{n: derived(flight, n, segments, []) for n in lacking}) if lacking else flight


def derived(flight: Flight, name: str, pieces: list[tuple[int, int]], notes: list[Note]) -> Array:
    """(N,) the column made piece by piece in the best way there is, NaN outside the pieces; said in `notes`.

    Raises MissingColumnError naming the ways where the flight has no columns for any, DataError where what comes out cannot be
    what its name says.
    """
    way = way_to(flight, name)
    if way is None:
        ways = " or ".join(" and ".join(w.needs) for w in DERIVED[name])
        flight.require([name], f"this model (or {ways} to derive it from)")
        raise DataError(f"{flight.name}: {name} is not measured")
    result = np.full(len(flight), np.nan)
    for a, b in pieces:
        result[a:b] = way.build(flight.time[a:b], *(flight[n][a:b] for n in way.needs))
    origin = " and ".join(way.needs)
    _refuse_impossible_result(flight, name, origin, result)
    notes.append(Note(NoteKind.DERIVED, f"{name} derived from {origin}"))
    return result


def _refuse_impossible_result(flight: Flight, name: str, origin: str, values: Array) -> None:
    if name not in COLUMN_BY_NAME or not np.isfinite(values).any():
        return
    low, high = COLUMN_BY_NAME[name].plausible
    middle = float(np.nanmedian(values))
    if not low <= middle <= high:
        raise DataError(
            f"{flight.name}: {name} derived from {origin} would be {middle:.3g} {COLUMN_BY_NAME[name].unit}, outside {low:g} to "
            f"{high:g}; check their units, or add the column {name}"
        )


def _standard_density(time: Array, altitude: Array) -> Array:
    """Density [kg/m3] of the standard atmosphere's troposphere at altitude [m] (ICAO Doc 7488)."""
    return 1.225 * (1.0 - 2.25577e-5 * bridged(altitude)) ** 4.25588


def _density_of_air_data(time: Array, p_dynamic: Array, V: Array) -> Array:
    """Density [kg/m3] from dynamic pressure [Pa] and true airspeed [m/s], rho = 2 p_dynamic / V^2, both averaged over `SLOW` s:
    density changes slowly, and what noise is left would act like noise of the airspeed. Below `FLYING` the median of the rest."""
    width = min(max(1, round(SLOW / float(np.median(np.diff(time))))), time.size)
    columns = (bridged(p_dynamic), bridged(V**2), np.ones(time.size))
    # with zeros beyond the ends, which cancel: the mean there is over what there is
    pressure, square, share = (np.convolve(c, np.full(width, 1.0 / width), "same") for c in columns)
    flying = square > FLYING**2 * share
    if not flying.any():
        return np.full(time.size, np.nan)
    density = 2.0 * pressure / np.maximum(square, FLYING**2 * share)
    return np.where(flying, density, np.median(density[flying]))


DERIVED: Mapping[str, tuple[Way, ...]] = {
    **{f"{n}_dot": (Way((n,), slope),) for n in ("V", "alpha", "beta", "p", "q", "r", "phi", "theta", "psi")},
    "rho": (Way(("p_dynamic", "V"), _density_of_air_data), Way(("altitude",), _standard_density)),
}
"""Columns that are made from others where the flight lacks them, the best way first."""
