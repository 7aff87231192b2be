"""Columns that a model needs of a flight, and those derived from others where the flight lacks them: slopes, air density."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from daq.contract.channels import COLUMN_BY_NAME
from daq.utilities.constants import GRAVITY
from estimation.aircraft import unknown_aircraft
from estimation.errors import DataError
from estimation.models.base import Model
from estimation.models.library import BUILDERS
from estimation.signals.denoise import denoise
from groundstation.flight import Array, Flight, MissingColumnError
from groundstation.flight.atmosphere import DENSITY_WAYS
from groundstation.flight.findings import Finding, FindingKind


def bridge_gaps(values: Array) -> Array:
    """The signal (N,) with its missing samples on straight lines between their neighbours; unchanged where none is measured."""
    missing = ~np.isfinite(values)
    if missing.any() and not missing.all():
        index = np.arange(values.size)
        values = values.copy()
        values[missing] = np.interp(index[missing], index[~missing], values[~missing])
    return values


def denoised_slope(time: Array, values: Array) -> Array:
    """Derivative of a de-noised signal, by central differences. time, values: (N,)."""
    return np.gradient(denoise(bridge_gaps(values), order=2).values, time)


def alpha_rate(flight: Flight, s: slice, time: Array, x: Mapping[str, Array]) -> Array:
    """(n,) rate of alpha [rad/s] over the samples `s` of a flight. x: V, alpha, beta, p, q, r there, (n,) each.

    From accelerometers and attitude by the equation of motion where the flight has them, because the slope of a vane between
    samples misses steps of the elevator; else that slope.
    """
    columns = ("ax", "az", "theta")
    if not all(flight.measured(n) for n in columns):
        return np.gradient(x["alpha"], time)
    ax, az, theta = (bridge_gaps(flight[n][s]) for n in columns)
    phi = bridge_gaps(flight["phi"][s]) if flight.measured("phi") else np.zeros(time.size)
    gx, gz = ax - GRAVITY * np.sin(theta), az + GRAVITY * np.cos(theta) * np.cos(phi)
    cos, sin = np.cos(x["alpha"]), np.sin(x["alpha"])
    rate = x["q"] - np.tan(x["beta"]) * (x["p"] * cos + x["r"] * sin)
    rate = rate + (gz * cos - gx * sin) / (x["V"] * np.cos(x["beta"]))
    return denoise(rate, order=2).values


@dataclass(frozen=True)
class Way:
    """One way to derive a column. needs: columns; build: function of time (N,) and of each needed column (N,); credible: whether
    the needed columns can be what their names say."""

    needs: tuple[str, ...]
    build: Callable[..., Array]
    credible: Callable[..., bool] = lambda *columns: True


def way_to(flight: Flight, name: str) -> Way | None:
    """The best way to derive a column whose needed columns the flight has, or None."""
    possible = (w for w in DERIVED.get(name, ()) if all(flight.measured(n) for n in w.needs))
    return next((w for w in possible if w.credible(*(flight[n] for n in w.needs))), None)


def with_derived(flight: Flight, names: Sequence[str]) -> Flight:
    """The flight with those of the named columns added that it lacks and that can be derived from others."""
    segments = [(s.start, s.stop) for s in flight.segments]
    derivable = [n for n in names if not flight.measured(n) and way_to(flight, n) is not None]
    return (
        flight.with_columns(**{n: derive_column(flight, n, segments, []) for n in derivable}) if derivable else flight
    )


def derive_column(flight: Flight, name: str, pieces: Sequence[tuple[int, int]], notes: list[Finding]) -> Array:
    """(N,) the column derived piece by piece in the best way, NaN outside the pieces; `notes` gets a note on it.

    Raises MissingColumnError naming the ways where the flight lacks columns for all of them, DataError for an implausible result.
    """
    way = way_to(flight, name)
    if way is None:
        flight.require([name], f"this model (or {_ways_text(name)} to derive it from)")
        raise DataError(f"{flight.name}: {name} is not measured")
    result = np.full(len(flight), np.nan)
    for a, b in pieces:
        result[a:b] = way.build(flight.time[a:b], *(flight[n][a:b] for n in way.needs))
    origin = " and ".join(way.needs)
    _refuse_impossible_result(flight, name, origin, result)
    notes.append(Finding(FindingKind.DERIVED, f"{name} derived from {origin}"))
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


def _bridged(build: Callable[..., Array]) -> Callable[..., Array]:
    return lambda time, *columns: build(*map(bridge_gaps, columns))


DERIVED: Mapping[str, tuple[Way, ...]] = {
    **{f"{n}_dot": (Way((n,), denoised_slope),) for n in ("V", "alpha", "beta", "p", "q", "r", "phi", "theta", "psi")},
    "rho": tuple(Way(w.needs, _bridged(w.build), w.credible) for w in DENSITY_WAYS),
}
"""Column -> ways to derive it where the flight lacks it, the best first."""


EITHER, EITHER_IN = ("beta", "ay"), ("lateral", "lateral-simple")
"""Two columns of which a flight needs only one, because the other follows from the motion (`estimation.session.without_sensor`),
and the models for which that holds."""


def require_columns(model: Model, flight: Flight) -> None:
    """Raise a MissingColumnError naming all columns that the model needs and the flight neither has nor can derive, and the
    built-in models that do not need them."""
    missing_columns = unmet_columns(model, flight)
    if missing_columns:
        fit = () if flight_without_motion(missing_columns, model) else models_for(flight)
        both = model.name in EITHER_IN and set(EITHER) <= set(missing_columns)
        raise MissingColumnError(
            flight.name, missing_columns, f"model {model.name}", fit, flight.unknown_columns, EITHER if both else ()
        )


def flight_without_motion(missing: Iterable[str], model: Model) -> bool:
    """Whether a flight lacks all outputs that the model requires, so that no other model would help."""
    return {s.source for s in model.outputs if not s.optional} <= set(missing)


def unmet_columns(model: Model, flight: Flight) -> list[str]:
    """Columns that the model needs and the flight lacks; a derivable one is named with the ways to derive it."""
    required = dict.fromkeys(s.source for s in (*model.inputs, *model.outputs) if not s.optional)
    unmeasured = [c for c in required if c not in DERIVED and not flight.measured(c)]
    underivable = [c for c in required if c in DERIVED and not flight.measured(c) and way_to(flight, c) is None]
    return unmeasured + [_with_ways(c) for c in underivable if not _comes_with(c, flight, unmeasured)]


def _comes_with(column: str, flight: Flight, missing: list[str]) -> bool:
    """Whether a column can be derived once the other missing columns are there."""
    return any(all(n in missing or flight.measured(n) for n in way.needs) for way in DERIVED[column])


def _with_ways(column: str) -> str:
    return f"{column} (or {_ways_text(column)} to derive it from)"


def _ways_text(column: str) -> str:
    """The ways to derive a column, without those that only add columns to another way."""
    needs = [w.needs for w in DERIVED[column]]
    return " or ".join(" and ".join(n) for n in needs if not any(set(n) > set(other) for other in needs))


def models_for(flight: Flight) -> tuple[str, ...]:
    """Built-in models whose columns the flight has."""
    aircraft = unknown_aircraft("any")  # columns do not depend on the aircraft
    return tuple(name for name, build in BUILDERS.items() if not unmet_columns(build(aircraft), flight))
