"""A flight as the engine needs it: inputs without noise, measured outputs, initial states, cut at every gap.

Integration never crosses a gap in time, a segment border or a stretch in which a needed input was not measured. NaN in
a measured output is simply not counted.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimation.engine.conditioned import Conditioned, conditioned
from estimation.engine.derived import DERIVED, bridged, derived, way_to
from estimation.engine.followed import keep_what_follows
from estimation.engine.kernel import Array
from estimation.engine.needs import require_columns
from estimation.engine.plausible import refuse_impossible
from estimation.errors import DataError
from estimation.models.base import Model, Signal
from estimation.signals.preprocess import denoise_many, noise_level
from groundstation.flight import Flight
from groundstation.flight.arrays import true_runs
from groundstation.flight.findings import Finding, FindingKind, unknown_columns, without_repeats

SHORTEST_SEGMENT = 8  # samples
LONGEST_BRIDGE = 3  # missing input samples that a straight line may bridge
FLAT = 1e-12
DRAWS = 24  # of what may still be wrong with the inputs
DRAWN = 200_000  # samples times draws: long flights need fewer, for they average over time
FEWEST_DRAWS = 12
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
    (samples, nu, draws) what may still be wrong with the inputs (draws from the posterior of the de-noising, or of the noise
    that was left in; zero outside the segments), or None where nothing is known of it."""

    name: str
    samples: int
    segments: tuple[Segment, ...]
    states: Array
    noise: Mapping[str, tuple[float, float]]
    notes: tuple[Finding, ...]
    absent_outputs: tuple[str, ...]
    errors: NDArray[np.float32] | None = None

    @property
    def used(self) -> int:
        """Samples that lie in a segment."""
        return sum(len(s) for s in self.segments)


@dataclass(frozen=True, slots=True)
class Preparation:
    """How measured signals are prepared. denoise: take noise off the measured inputs (edge-preserving). draws: of what is
    left of it (all of it where none is taken off), for the corrected bound (0: inputs are taken for truth there too).
    keep_held: take the repeated values of slow and stuck sensors for measurements. feedback: controls of a model that
    pitches keep what follows the motion, and their measured values by steps."""

    denoise: bool = True
    draws: int = DRAWS
    keep_held: bool = False
    feedback: bool = True


AS_USUAL = Preparation()
FOR_REGRESSION = Preparation(feedback=False)  # noise in a regressor biases it, more than what is lost of the feedback


def draws_for(samples: int) -> int:
    """How many draws describe the errors of a flight well enough."""
    return min(DRAWS, max(FEWEST_DRAWS, DRAWN // samples))


def prepare(model: Model, flight: Flight, preparation: Preparation = AS_USUAL) -> FlightData:
    """Columns of `flight` as inputs, outputs and starting states of `model`.

    Raises MissingColumnError naming the columns that the model needs and the flight lacks, DataError when no stretch
    long enough is left.
    """
    notes = [n for said in flight.notes if (n := _less_used(said, model)) is not None]
    require_columns(model, flight)
    told = conditioned(flight, _looked_at(model), keep_held=preparation.keep_held)
    flight = told.flight
    notes += told.notes
    refuse_impossible(flight, (*model.inputs, *model.states), model.outputs, notes)
    pieces = _pieces(flight, [s for s in model.inputs if not _missing_optional(flight, s)], notes)
    noise: dict[str, tuple[float, float]] = {}
    u, errors = _inputs(model, told, pieces, preparation, noise, notes)
    z, absent = _outputs(model, told, pieces, notes)
    states = _states(model, told, pieces)
    if preparation.denoise and preparation.feedback and errors is not None:
        keep_what_follows(model, told, pieces, u, errors, states, noise)
    segments = tuple(
        Segment(a, flight.time[a:b], np.ascontiguousarray(u[a:b]), np.ascontiguousarray(z[a:b]), x0)
        for a, b in pieces
        for x0 in (_initial(model, flight, states, a),)
    )
    if not segments:
        raise DataError(_nothing_left(model, flight))
    return FlightData(flight.name, len(flight), segments, states, noise, without_repeats(notes), absent, errors)


def _looked_at(model: Model) -> list[str]:
    """Measured columns that a model reads."""
    starts = [s.start for s in model.states if isinstance(s.start, str)]
    return [*(s.source for s in (*model.inputs, *model.outputs, *model.states) if not s.computed), *starts]


def _less_used(note: Finding, model: Model) -> Finding | None:
    """The note on unknown columns without those that the model knows; None where none is left."""
    if note.kind is not FindingKind.UNKNOWN_COLUMNS:
        return note
    used = {s.source for s in (*model.states, *model.inputs, *model.outputs)}
    left = {
        column: label
        for column, label in zip(note.columns, note.labels or note.columns, strict=True)
        if column not in used
    }
    return unknown_columns(left) if left else None


def _nothing_left(model: Model, flight: Flight) -> str:
    longest = max(part.stop - part.start for part in flight.segments)
    if longest < SHORTEST_SEGMENT:
        return (
            f"{flight.name}: the longest stretch has {longest} samples; at least {SHORTEST_SEGMENT} in a row are needed"
        )
    return f"{flight.name}: no stretch of {SHORTEST_SEGMENT} samples in a row with every input of model {model.name} measured"


def _missing_optional(flight: Flight, signal: Signal) -> bool:
    return signal.optional and not flight.measured(signal.source)


def _pieces(flight: Flight, inputs: Sequence[Signal], notes: list[Finding]) -> list[tuple[int, int]]:
    """Index ranges without a gap, a segment border or a long hole in an input."""
    usable = np.ones(len(flight), bool)
    for signal in inputs:
        way = None if signal.source in flight.columns else way_to(flight, signal.source)
        for source in way.needs if way else (signal.source,):
            if source not in flight.columns:
                continue
            holes = _long_holes(~np.isfinite(flight[source]), flight.segment)
            if holes.any():
                notes.append(
                    Finding(
                        FindingKind.LEFT_OUT, f"{source} not measured at {int(holes.sum())} samples: those left out"
                    )
                )
            usable &= ~holes
    ranges = true_runs(usable, flight.segments)
    short = [(a, b) for a, b in ranges if b - a < SHORTEST_SEGMENT]
    if short:
        lost = sum(b - a for a, b in short)
        text = f"{len(short)} stretches shorter than {SHORTEST_SEGMENT} samples left out ({lost} samples)"
        notes.append(Finding(FindingKind.LEFT_OUT, text))
    return [r for r in ranges if r not in short]


def _long_holes(missing: np.ndarray, segment: np.ndarray) -> np.ndarray:  # type: ignore[type-arg]
    """Missing samples that may not be bridged: runs longer than LONGEST_BRIDGE, or at the end of a segment."""
    if not missing.any():
        return missing
    result = np.zeros_like(missing)
    for a, b in true_runs(missing):
        at_border = a == 0 or b == missing.size or segment[a - 1] != segment[b]
        if b - a > LONGEST_BRIDGE or at_border:
            result[a:b] = True
    return result


def _inputs(
    model: Model,
    told: Conditioned,
    pieces: list[tuple[int, int]],
    preparation: Preparation,
    noise: dict[str, tuple[float, float]],
    notes: list[Finding],
) -> tuple[Array, NDArray[np.float32] | None]:
    """(samples, nu) inputs, de-noised piece by piece, NaN outside the pieces; and `FlightData.errors`."""
    flight = told.flight
    u = np.full((len(flight), len(model.inputs)), np.nan)
    rows: dict[
        int, list[NDArray[np.int64]]
    ] = {}  # of each measured input: the samples of each piece that were measured
    for i, signal in enumerate(model.inputs):
        if _missing_optional(flight, signal):
            notes.append(Finding(FindingKind.NOT_MEASURED, f"{signal.source} not measured: taken as zero"))
            u[:, i] = 0.0
        elif flight.measured(signal.source):
            rows[i] = [_rows(told, signal.source, a, b) for a, b in pieces]
            for (a, b), at in zip(pieces, rows[i], strict=True):
                u[a:b, i] = np.interp(np.arange(a, b), at, bridged(flight[signal.source][a:b])[at - a])
            notes += told.of_slow(signal.source, "taken on straight lines between new values")
            notes += told.of_stuck(signal.source, "is its sensor stuck?")
        else:
            u[:, i] = derived(flight, signal.source, pieces, notes)
    notes += _bridges([(s.source, flight[s.source]) for i, s in enumerate(model.inputs) if i in rows], pieces)
    rows = {i: at for i, at in rows.items() if not _without_noise(flight, model.inputs[i])}
    names = [s.name for s in model.inputs]
    draws = min(preparation.draws, draws_for(len(flight)))
    errors = np.zeros((*u.shape, draws), np.float32)
    rng = np.random.default_rng(SEED)
    if not preparation.denoise:
        notes.append(Finding(FindingKind.OTHER, "measured inputs taken with their noise"))
        _draw_noise(u, errors, rows, pieces, names, noise, rng)
        return u, errors if draws else None
    for order in (1, 2):
        columns = {i: rows[i] for i in rows if model.inputs[i].control == (order == 1)}
        _denoise_columns(u, errors, columns, pieces, order, names, noise, rng)
    _derive_errors(model, flight, pieces, errors)
    return u, errors


def _without_noise(flight: Flight, signal: Signal) -> bool:
    """Whether an input has no noise of its own: computed of others, or a command that holds between its records."""
    return signal.computed or flight.held(signal.source) is not None


def _bridges(columns: Sequence[tuple[str, Array]], pieces: list[tuple[int, int]]) -> list[Finding]:
    """A note on the inputs that lack samples between others of a piece, those that lack as many together."""
    lacking: dict[int, list[str]] = {}
    for column, values in columns:
        lacking.setdefault(sum(int(np.isnan(values[a:b]).sum()) for a, b in pieces), []).append(column)
    lacking.pop(0, None)
    every = sum(b - a for a, b in pieces)
    return [
        Finding(
            FindingKind.NOT_MEASURED,
            f"{', '.join(names)} not measured at {absent} samples here and there ({100.0 * absent / every:.2g}%): "
            "taken on straight lines",
        )
        for absent, names in lacking.items()
    ]


def _rows(told: Conditioned, column: str, a: int, b: int) -> NDArray[np.int64]:
    """Samples a..b-1 of a column without the repeats of a slow sensor, and without those that an import drew between its own
    samples; all of them where too few would be left."""
    repeated = told.found[column].held[a:b] if column in told.found else np.zeros(b - a, bool)
    if column in told.between:
        repeated = repeated | told.between[column][a:b]
    kept = np.flatnonzero(~repeated) + a
    return kept if kept.size >= SHORTEST_SEGMENT else np.arange(a, b)


def _derive_errors(model: Model, flight: Flight, pieces: list[tuple[int, int]], errors: NDArray[np.float32]) -> None:
    """Errors of inputs that are slopes of other inputs: slopes of their errors."""
    sources = [s.source for s in model.inputs]
    for i, source in enumerate(sources):
        origin = source.removesuffix("_dot")
        if source in DERIVED and not flight.measured(source) and origin != source and origin in sources:
            for a, b in pieces:
                errors[a:b, i] = np.gradient(errors[a:b, sources.index(origin)], flight.time[a:b], axis=0)


def _draw_noise(
    u: Array,
    errors: NDArray[np.float32],
    columns: Mapping[int, Sequence[NDArray[np.int64]]],
    pieces: list[tuple[int, int]],
    names: list[str],
    noise: dict[str, tuple[float, float]],
    rng: np.random.Generator,
) -> None:
    """Errors of inputs that keep their noise: white, of the level that each shows, on straight lines between its rows."""
    for i, rows in columns.items():
        level = max((noise_level(u[at, i]) for at in rows), default=0.0)
        noise[names[i]] = (level, 0.0)
        for (a, b), at in zip(pieces, rows, strict=True):
            drawn = level * rng.standard_normal((errors.shape[2], at.size))
            for k, values in enumerate(drawn):
                errors[a:b, i, k] = np.interp(np.arange(a, b), at, values)


def _denoise_columns(
    u: Array,
    errors: NDArray[np.float32],
    columns: Mapping[int, Sequence[NDArray[np.int64]]],
    pieces: list[tuple[int, int]],
    order: int,
    names: list[str],
    noise: dict[str, tuple[float, float]],
    rng: np.random.Generator,
) -> None:
    """Columns of `u` made smooth in place. columns: input -> rows that were measured, piece by piece."""
    heard: dict[int, list[tuple[float, float]]] = {i: [] for i in columns}
    places = [(a, b, i, columns[i][k]) for k, (a, b) in enumerate(pieces) for i in columns]
    noisy = [u[at, i] for _, _, i, at in places]
    smooth = denoise_many(noisy, order=order, draws=errors.shape[2], rng=rng)
    for (a, b, i, at), done in zip(places, smooth, strict=True):
        every = np.arange(a, b)
        u[a:b, i] = done.values if at.size == b - a else np.interp(every, at, done.values)
        for k, error in enumerate(done.errors):
            errors[a:b, i, k] = error if at.size == b - a else np.interp(every, at, error)
        heard[i].append((done.noise, done.removed))
    for i in columns:
        if heard[i]:
            noise[names[i]] = (float(np.median([n for n, _ in heard[i]])), float(np.median([r for _, r in heard[i]])))


def _outputs(
    model: Model, told: Conditioned, pieces: list[tuple[int, int]], notes: list[Finding]
) -> tuple[Array, tuple[str, ...]]:
    flight = told.flight
    z = np.full((len(flight), len(model.outputs)), np.nan)
    absent = []
    for i, signal in enumerate(model.outputs):
        if flight.measured(signal.source):
            z[:, i], said = told.compared(signal.source)
            notes += said
        elif signal.source in DERIVED and not _missing_optional(flight, signal):
            z[:, i] = derived(flight, signal.source, pieces, notes)
        else:
            notes.append(Finding(FindingKind.NOT_MEASURED, f"{signal.source} not measured: not compared"))
            absent.append(signal.name)
            continue
        finite = z[np.isfinite(z[:, i]), i]
        if finite.size > SHORTEST_SEGMENT and np.ptp(finite) <= FLAT:
            text = f"{signal.source} stands still at {finite[0]:g}: a dead channel, not compared"
            notes.append(Finding(FindingKind.STUCK, text))
            absent.append(signal.name)
            z[:, i] = np.nan
    if len(absent) == len(model.outputs):
        raise DataError(
            f"{flight.name}: none of the outputs of model {model.name} moves; nothing can be estimated from it"
        )
    return z, tuple(absent)


def _states(model: Model, told: Conditioned, pieces: list[tuple[int, int]]) -> Array:
    """(samples, nx) measured states without their noise, NaN where a state is not measured."""
    flight = told.flight
    states = np.full((len(flight), len(model.states)), np.nan)
    sources = [s.source if flight.measured(s.source) else s.start for s in model.states]
    places = [
        (a, b, i, source, _rows(told, source, a, b))
        for a, b in pieces
        for i, source in enumerate(sources)
        if isinstance(source, str)
        and flight.measured(source)
        and np.isfinite(flight[source][a:b]).sum() >= SHORTEST_SEGMENT // 2
    ]
    parts = [bridged(flight[source][a:b])[at - a] for a, b, _, source, at in places]
    for (a, b, i, _, at), done in zip(places, denoise_many(parts, order=2), strict=True):
        states[a:b, i] = np.interp(np.arange(a, b), at, done.values)
    return states


def _initial(model: Model, flight: Flight, states: Array, at: int) -> Array:
    x0 = np.zeros(len(model.states))
    for i, signal in enumerate(model.states):
        if signal.held and isinstance(signal.start, int | float):
            x0[i] = float(signal.start)
        elif np.isfinite(states[at, i]):
            x0[i] = states[at, i]
        elif isinstance(signal.start, int | float):
            x0[i] = float(signal.start)
    return x0
