"""A flight as the engine needs it: inputs without noise, measured outputs, initial states, cut at every gap.

Integration never crosses a gap in time, a segment border or a stretch in which a needed input was not measured. NaN in
a measured output is simply not counted.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from daq.contract.channels import COLUMN_BY_NAME
from estimation.engine.kernel import Array
from estimation.engine.plausible import refuse_impossible, stuck
from estimation.errors import DataError
from estimation.models.base import Model, Signal
from estimation.preprocess import denoise, denoise_many, noise_level
from groundstation.flight import Flight

SHORTEST_SEGMENT = 8  # samples
LONGEST_BRIDGE = 3  # missing input samples that a straight line may bridge
FLAT = 1e-12
DRAWS = 24  # of what may still be wrong with the inputs
DRAWN = 200_000  # samples times draws: long flights need fewer, for they average over time
FEWEST_DRAWS = 12
FLYING = 5.0  # m/s; slower than this a pitot tube says nothing of density
SLOW = 10.0  # s over which density hardly changes
SEED = 20  # of the draws: the same flight gives the same bound


@dataclass(frozen=True)
class Segment:
    """A stretch of samples that one integration covers.

    first: index of its first sample in the flight. time: (N,) s. u: (N, nu) inputs. z: (N, ny) outputs, NaN where not
    measured. x0: (nx,) guess of the initial state.
    """

    first: int
    time: Array
    u: Array
    z: Array
    x0: Array

    def __len__(self) -> int:
        return int(self.time.size)

    def part(self, start: int, stop: int, x0: Array) -> "Segment":
        """Samples start..stop-1 as a segment of their own."""
        s = slice(start, stop)
        return Segment(self.first + start, self.time[s], self.u[s], self.z[s], x0)


@dataclass(frozen=True)
class FlightData:
    """A flight prepared for one model. samples: of the flight; states: (samples, nx) smoothed measured states, NaN columns
    where a state is not measured; noise: column -> (estimated noise, rms removed) of the de-noised inputs; errors:
    (samples, nu, draws) what may still be wrong with the inputs (draws from the posterior of the de-noising, zero outside the
    segments), or None where nothing is known of it."""

    name: str
    samples: int
    segments: tuple[Segment, ...]
    states: Array
    noise: Mapping[str, tuple[float, float]]
    notes: tuple[str, ...]
    absent_outputs: tuple[str, ...]
    errors: NDArray[np.float32] | None = None

    @property
    def used(self) -> int:
        """Samples that lie in a segment."""
        return sum(len(s) for s in self.segments)


@dataclass(frozen=True, slots=True)
class Preparation:
    """How measured signals are prepared. denoise: take noise off the measured inputs (edge-preserving). draws: of what is
    left of it, for the corrected bound (0: inputs are taken for truth there too)."""

    denoise: bool = True
    draws: int = DRAWS


AS_USUAL = Preparation()


def draws_for(samples: int) -> int:
    """How many draws describe the errors of a flight well enough."""
    return min(DRAWS, max(FEWEST_DRAWS, DRAWN // samples))


def prepare(model: Model, flight: Flight, preparation: Preparation = AS_USUAL) -> FlightData:
    """Columns of `flight` as inputs, outputs and starting states of `model`.

    Raises MissingColumnError naming the columns that the model needs and the flight lacks, DataError when no stretch
    long enough is left.
    """
    notes = [_less_used(n, model) for n in flight.notes]
    required = [s.source for s in (*model.inputs, *model.outputs) if not s.optional and s.source not in DERIVED]
    flight.require(dict.fromkeys(required), f"model {model.name}")
    refuse_impossible(flight, (*model.inputs, *model.states), model.outputs, notes)
    pieces = _pieces(flight, [s for s in model.inputs if not _missing_optional(flight, s)], notes)
    noise: dict[str, tuple[float, float]] = {}
    u, errors = _inputs(model, flight, pieces, preparation, noise, notes)
    z, absent = _outputs(model, flight, pieces, notes)
    states = _states(model, flight, pieces)
    segments = tuple(
        Segment(a, flight.time[a:b], np.ascontiguousarray(u[a:b]), np.ascontiguousarray(z[a:b]), x0)
        for a, b in pieces
        for x0 in (_initial(model, flight, states, a),)
    )
    if not segments:
        raise DataError(_nothing_left(model, flight))
    return FlightData(
        flight.name, len(flight), segments, states, noise, tuple(n for n in dict.fromkeys(notes) if n), absent, errors
    )


UNKNOWN = "columns not known to Sideslip, kept as they are: "


def _less_used(note: str, model: Model) -> str:
    """The note on unknown columns without those that the model knows; empty where none is left."""
    if not note.startswith(UNKNOWN):
        return note
    used = {s.source for s in (*model.states, *model.inputs, *model.outputs)}
    left = [c for c in note.removeprefix(UNKNOWN).split(", ") if c.rpartition(" as ")[2] not in used]
    return UNKNOWN + ", ".join(left) if left else ""


def _nothing_left(model: Model, flight: Flight) -> str:
    longest = max(part.stop - part.start for part in flight.segments)
    if longest < SHORTEST_SEGMENT:
        return (
            f"{flight.name}: the longest stretch has {longest} samples; at least {SHORTEST_SEGMENT} in a row are needed"
        )
    return f"{flight.name}: no stretch of {SHORTEST_SEGMENT} samples in a row with every input of model {model.name} measured"


def _missing_optional(flight: Flight, signal: Signal) -> bool:
    return signal.optional and not flight.measured(signal.source)


def _pieces(flight: Flight, inputs: Sequence[Signal], notes: list[str]) -> list[tuple[int, int]]:
    """Index ranges without a gap, a segment border or a long hole in an input."""
    usable = np.ones(len(flight), bool)
    for signal in inputs:
        way = None if signal.source in flight.columns else _way(flight, signal.source)
        for source in way.needs if way else (signal.source,):
            if source not in flight.columns:
                continue
            holes = _long_holes(~np.isfinite(flight[source]), flight.segment)
            if holes.any():
                notes.append(f"{source} not measured at {int(holes.sum())} samples: those left out")
            usable &= ~holes
    ranges = []
    for part in flight.segments:
        edges = np.flatnonzero(np.diff(np.concatenate([[False], usable[part], [False]]).astype(int)))
        ranges += [(part.start + int(a), part.start + int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]
    short = [(a, b) for a, b in ranges if b - a < SHORTEST_SEGMENT]
    if short:
        lost = sum(b - a for a, b in short)
        notes.append(f"{len(short)} stretches shorter than {SHORTEST_SEGMENT} samples left out ({lost} samples)")
    return [r for r in ranges if r not in short]


def _long_holes(missing: np.ndarray, segment: np.ndarray) -> np.ndarray:  # type: ignore[type-arg]
    """Missing samples that may not be bridged: runs longer than LONGEST_BRIDGE, or at the end of a segment."""
    if not missing.any():
        return missing
    result = np.zeros_like(missing)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], missing, [False]]).astype(int)))
    for a, b in zip(edges[::2], edges[1::2], strict=True):
        at_border = a == 0 or b == missing.size or segment[a - 1] != segment[b]
        if b - a > LONGEST_BRIDGE or at_border:
            result[a:b] = True
    return result


def _inputs(
    model: Model,
    flight: Flight,
    pieces: list[tuple[int, int]],
    preparation: Preparation,
    noise: dict[str, tuple[float, float]],
    notes: list[str],
) -> tuple[Array, NDArray[np.float32] | None]:
    """(samples, nu) inputs, de-noised piece by piece, NaN outside the pieces; and `FlightData.errors`."""
    u = np.full((len(flight), len(model.inputs)), np.nan)
    for i, signal in enumerate(model.inputs):
        if _missing_optional(flight, signal):
            notes.append(f"{signal.source} not measured: taken as zero")
            u[:, i] = 0.0
        elif flight.measured(signal.source):
            for a, b in pieces:
                u[a:b, i] = _bridged(flight[signal.source][a:b])
            _say_stuck(flight, signal.source, stuck(flight.time, flight[signal.source]), notes, "is its sensor stuck?")
        else:
            u[:, i] = _derived(flight, signal.source, pieces, notes)
    if not preparation.denoise:
        notes.append("measured inputs taken with their noise")
        for i, signal in enumerate(model.inputs):
            if flight.measured(signal.source):
                noise[signal.name] = (max((noise_level(u[a:b, i]) for a, b in pieces), default=0.0), 0.0)
        return u, None
    draws = min(preparation.draws, draws_for(len(flight)))
    errors = np.zeros((*u.shape, draws), np.float32)
    rng = np.random.default_rng(SEED)
    for order in (1, 2):
        columns = [i for i, s in enumerate(model.inputs) if s.control == (order == 1) and flight.measured(s.source)]
        _denoise_columns(u, errors, columns, pieces, order, [s.name for s in model.inputs], noise, rng)
    _derive_errors(model, flight, pieces, errors)
    return u, errors


def _derive_errors(model: Model, flight: Flight, pieces: list[tuple[int, int]], errors: NDArray[np.float32]) -> None:
    """Errors of inputs that are slopes of other inputs: slopes of their errors."""
    sources = [s.source for s in model.inputs]
    for i, source in enumerate(sources):
        origin = source.removesuffix("_dot")
        if source in DERIVED and not flight.measured(source) and origin != source and origin in sources:
            for a, b in pieces:
                errors[a:b, i] = np.gradient(errors[a:b, sources.index(origin)], flight.time[a:b], axis=0)


def _denoise_columns(
    u: Array,
    errors: NDArray[np.float32],
    columns: list[int],
    pieces: list[tuple[int, int]],
    order: int,
    names: list[str],
    noise: dict[str, tuple[float, float]],
    rng: np.random.Generator,
) -> None:
    heard: dict[int, list[tuple[float, float]]] = {i: [] for i in columns}
    places = [(a, b, i) for a, b in pieces for i in columns]
    noisy = [u[a:b, i] for a, b, i in places]
    smooth = denoise_many(noisy, order=order, draws=errors.shape[2], rng=rng)
    for (a, b, i), done in zip(places, smooth, strict=True):
        u[a:b, i] = done.values
        errors[a:b, i] = done.errors.T
        heard[i].append((done.noise, done.removed))
    for i in columns:
        if heard[i]:
            noise[names[i]] = (float(np.median([n for n, _ in heard[i]])), float(np.median([r for _, r in heard[i]])))


def _bridged(values: Array) -> Array:
    missing = ~np.isfinite(values)
    if missing.any():
        index = np.arange(values.size)
        values = values.copy()
        values[missing] = np.interp(index[missing], index[~missing], values[~missing])
    return values


def _outputs(
    model: Model, flight: Flight, pieces: list[tuple[int, int]], notes: list[str]
) -> tuple[Array, tuple[str, ...]]:
    z = np.full((len(flight), len(model.outputs)), np.nan)
    absent = []
    for i, signal in enumerate(model.outputs):
        if flight.measured(signal.source):
            z[:, i] = flight[signal.source]
            _leave_out_stuck(flight, signal.source, z[:, i], notes)
        elif signal.source in DERIVED and not _missing_optional(flight, signal):
            z[:, i] = _derived(flight, signal.source, pieces, notes)
        else:
            notes.append(f"{signal.source} not measured: not compared")
            absent.append(signal.name)
            continue
        finite = z[np.isfinite(z[:, i]), i]
        if finite.size > SHORTEST_SEGMENT and np.ptp(finite) <= FLAT:
            notes.append(f"{signal.source} stands still at {finite[0]:g}: a dead channel, not compared")
            absent.append(signal.name)
            z[:, i] = np.nan
    if len(absent) == len(model.outputs):
        raise DataError(
            f"{flight.name}: none of the outputs of model {model.name} moves; nothing can be estimated from it"
        )
    return z, tuple(absent)


def _leave_out_stuck(flight: Flight, source: str, values: Array, notes: list[str]) -> None:
    """Samples of a stuck sensor become NaN in `values`; those and the missing ones are said."""
    missing = int((~np.isfinite(values)).sum())
    if missing:
        notes.append(f"{source} not measured at {missing} samples: not compared there")
    still = stuck(flight.time, values)
    _say_stuck(flight, source, still, notes, "not compared there")
    values[still] = np.nan


def _say_stuck(flight: Flight, source: str, still: NDArray[np.bool_], notes: list[str], what: str) -> None:
    if still.any():
        at = flight.time[still]
        notes.append(f"{source} repeats one value for {int(still.sum())} samples from t = {at[0]:g} s on: {what}")


def _states(model: Model, flight: Flight, pieces: list[tuple[int, int]]) -> Array:
    """(samples, nx) measured states without their noise, NaN where a state is not measured."""
    states = np.full((len(flight), len(model.states)), np.nan)
    sources = [s.source if flight.measured(s.source) else s.start for s in model.states]
    places = [
        (a, b, i, source)
        for a, b in pieces
        for i, source in enumerate(sources)
        if isinstance(source, str)
        and flight.measured(source)
        and np.isfinite(flight[source][a:b]).sum() >= SHORTEST_SEGMENT // 2
    ]
    parts = [_bridged(flight[source][a:b]) for a, b, _, source in places]
    for (a, b, i, _), done in zip(places, denoise_many(parts, order=2), strict=True):
        states[a:b, i] = done.values
    return states


def _initial(model: Model, flight: Flight, states: Array, at: int) -> Array:
    x0 = np.zeros(len(model.states))
    for i, signal in enumerate(model.states):
        if np.isfinite(states[at, i]):
            x0[i] = states[at, i]
        elif isinstance(signal.start, int | float):
            x0[i] = float(signal.start)
    return x0


# ------------------------------------------------------------------------------------------------- derived columns


def slope(time: Array, values: Array) -> Array:
    """Derivative of a signal from its de-noised curve, by central differences. time, values: (N,)."""
    return np.gradient(denoise(_bridged(values), order=2).values, time)


@dataclass(frozen=True)
class Way:
    """How a column is made where the flight lacks it. build: function of time (N,) and of each needed column (N,)."""

    needs: tuple[str, ...]
    build: Callable[..., Array]


def _way(flight: Flight, name: str) -> Way | None:
    """The first way to make a column of which the flight has all that it needs."""
    return next((w for w in DERIVED.get(name, ()) if all(flight.measured(n) for n in w.needs)), None)


def with_derived(flight: Flight, names: Sequence[str]) -> Flight:
    """The flight with those of the named columns added that it lacks and that can be made from others of its columns."""
    segments = [(s.start, s.stop) for s in flight.segments]
    lacking = [n for n in names if not flight.measured(n) and _way(flight, n) is not None]
    return flight.with_columns(**{n: _derived(flight, n, segments, []) for n in lacking}) if lacking else flight


def _derived(flight: Flight, name: str, pieces: list[tuple[int, int]], notes: list[str]) -> Array:
    way = _way(flight, name)
    if way is None:
        ways = " or ".join(" and ".join(w.needs) for w in DERIVED[name])
        flight.require([name], f"this model (or {ways} to derive it from)")
        raise DataError(f"{flight.name}: {name} is not measured")
    result = np.full(len(flight), np.nan)
    for a, b in pieces:
        result[a:b] = way.build(flight.time[a:b], *(flight[n][a:b] for n in way.needs))
    origin = " and ".join(way.needs)
    _refuse_impossible_result(flight, name, origin, result)
    notes.append(f"{name} derived from {origin}")
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
    return 1.225 * (1.0 - 2.25577e-5 * _bridged(altitude)) ** 4.25588


def _density_of_air_data(time: Array, p_dynamic: Array, V: Array) -> Array:
    """Density [kg/m3] from dynamic pressure [Pa] and true airspeed [m/s], rho = 2 p_dynamic / V^2, both averaged over `SLOW` s:
    density changes slowly, and what noise is left would act like noise of the airspeed. Below `FLYING` the median of the rest."""
    width = min(max(1, round(SLOW / float(np.median(np.diff(time))))), time.size)
    columns = (_bridged(p_dynamic), _bridged(V**2), np.ones(time.size))
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
