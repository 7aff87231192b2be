"""Preparation of a flight for one model in steps; each adds its notes.

Integration never crosses a gap in time, a segment border or a stretch in which a needed input was not measured. A NaN in a
measured output does not count.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from estimation.errors import DataError
from estimation.models.base import Model
from estimation.prepare.columns import DERIVED, bridge_gaps, derive_column, require_columns, way_to
from estimation.prepare.conditioned import ConditionedFlight, condition_columns
from estimation.prepare.flight_data import AS_USUAL, SHORTEST_SEGMENT, FlightData, Preparation, Segment
from estimation.prepare.inputs import (
    PreparationState,
    feedback_restored,
    inputs_at_samples,
    inputs_without_noise,
    rounding_errors_drawn,
)
from estimation.prepare.plausible import refuse_impossible
from estimation.signals.denoise import denoise_many
from groundstation.flight import Array, Flight
from groundstation.flight.arrays import Mask, true_runs
from groundstation.flight.findings import Finding, FindingKind, unknown_columns, without_repeats

LONGEST_BRIDGE = 3  # missing input samples that a straight line may bridge
FLAT = 1e-12  # range of an output that does not move

FlightsToFit = Flight | FlightData | Sequence[Flight | FlightData]
"""One flight or several, prepared or not."""


def prepare(model: Model, flight: Flight, preparation: Preparation = AS_USUAL) -> FlightData:
    """Columns of `flight` as inputs, outputs and initial states of `model`.

    Raises MissingColumnError naming the columns that the model needs and the flight lacks, DataError for implausible columns or
    where no stretch is long enough.
    """
    state = PreparationState(model, preparation, ConditionedFlight(flight, {}, ()))
    for step in STEPS:
        state = step(state)
    return _flight_data(state)


def prepare_all(model: Model, flights: FlightsToFit, preparation: Preparation = AS_USUAL) -> list[FlightData]:
    """Flights prepared for a model; prepared ones as they are. DataError where there is none."""
    listed = [flights] if isinstance(flights, Flight | FlightData) else list(flights)
    if not listed:
        raise DataError("no flight given: at least one is needed")
    return [f if isinstance(f, FlightData) else prepare(model, f, preparation) for f in listed]


def columns_required(state: PreparationState) -> PreparationState:
    """Refuse a flight that lacks columns of the model; remove the model's columns from the import's note on unknown columns."""
    model, notes = state.model, []
    model_columns = {s.source for s in (*model.states, *model.inputs, *model.outputs)}
    for note in state.flight.notes:
        if note.kind is not FindingKind.UNKNOWN_COLUMNS:
            notes.append(note)
            continue
        labels = zip(note.columns, note.labels or note.columns, strict=True)
        if unused := {column: label for column, label in labels if column not in model_columns}:
            notes.append(unknown_columns(unused))
    require_columns(model, state.flight)
    return replace(state, notes=tuple(notes))


def measurements_conditioned(state: PreparationState) -> PreparationState:
    """Wild values removed, repeats of slow and stuck sensors marked."""
    model = state.model
    starts = [s.start for s in model.states if isinstance(s.start, str)]
    columns = [*(s.source for s in (*model.inputs, *model.outputs, *model.states) if not s.computed), *starts]
    conditioned = condition_columns(state.flight, columns, keep_held=state.preparation.keep_held)
    return replace(state, conditioned=conditioned, notes=(*state.notes, *conditioned.notes))


def units_plausible(state: PreparationState) -> PreparationState:
    """Refuse columns with another unit or sign than the model's."""
    notes: list[Finding] = []
    refuse_impossible(state.flight, (*state.model.inputs, *state.model.states), state.model.outputs, notes)
    return replace(state, notes=(*state.notes, *notes))


def gaps_cut(state: PreparationState) -> PreparationState:
    """Pieces without a gap in time, a segment border or a long hole in an input."""
    flight, notes = state.flight, list[Finding]()
    usable = np.ones(len(flight), bool)
    for signal in (s for s in state.model.inputs if not state.missing_optional(s)):
        way = None if flight.measured(signal.source) else way_to(flight, signal.source)
        for source in (c for c in (way.needs if way else (signal.source,)) if c in flight.columns):
            holes = _long_holes(~np.isfinite(flight[source]), flight.segment)
            if holes.any():
                text = f"{source} not measured at {int(holes.sum())} samples: those left out"
                notes.append(Finding(FindingKind.LEFT_OUT, text))
            usable &= ~holes
    runs = true_runs(usable, flight.segments)
    short = [b - a for a, b in runs if b - a < SHORTEST_SEGMENT]
    if short:
        text = f"{len(short)} stretches shorter than {SHORTEST_SEGMENT} samples left out ({sum(short)} samples)"
        notes.append(Finding(FindingKind.LEFT_OUT, text))
    pieces = tuple((a, b) for a, b in runs if b - a >= SHORTEST_SEGMENT)
    return replace(state, pieces=pieces, notes=(*state.notes, *notes))


def _long_holes(missing: Mask, segment: np.ndarray) -> Mask:  # type: ignore[type-arg]
    """(N,) missing samples that are not bridged: runs longer than LONGEST_BRIDGE, or at an end of a segment."""
    holes = np.zeros_like(missing)
    for a, b in true_runs(missing):
        at_border = a == 0 or b == missing.size or segment[a - 1] != segment[b]
        holes[a:b] = b - a > LONGEST_BRIDGE or at_border
    return holes


def outputs_compared(state: PreparationState) -> PreparationState:
    """Measured outputs (samples, ny), NaN where not compared; DataError where none of them moves."""
    model, flight, notes = state.model, state.flight, list[Finding]()
    z = np.full((len(flight), len(model.outputs)), np.nan)
    absent = []
    for i, signal in enumerate(model.outputs):
        if flight.measured(signal.source):
            z[:, i], left_out = state.conditioned.as_output(signal.source)
            notes += left_out
        elif signal.source in DERIVED and not state.missing_optional(signal):
            z[:, i] = derive_column(flight, signal.source, state.pieces, notes)
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
    return replace(state, z=z, absent=tuple(absent), notes=(*state.notes, *notes))


def states_smoothed(state: PreparationState) -> PreparationState:
    """Measured states (samples, nx), de-noised, NaN where a state is not measured."""
    flight, model = state.flight, state.model
    states = np.full((len(flight), len(model.states)), np.nan)
    sources = [s.source if flight.measured(s.source) else s.start for s in model.states]
    places = [
        (a, b, i, source, state.own_samples(source, a, b))
        for a, b in state.pieces
        for i, source in enumerate(sources)
        if isinstance(source, str)
        and flight.measured(source)
        and np.isfinite(flight[source][a:b]).sum() >= SHORTEST_SEGMENT // 2
    ]
    parts = [bridge_gaps(flight[source][a:b])[rows - a] for a, b, _, source, rows in places]
    for (a, b, i, _, rows), denoised in zip(places, denoise_many(parts, order=2), strict=True):
        states[a:b, i] = np.interp(np.arange(a, b), rows, denoised.values)
    return replace(state, states=states)


STEPS: tuple[Callable[[PreparationState], PreparationState], ...] = (
    columns_required,
    measurements_conditioned,
    units_plausible,
    gaps_cut,
    inputs_at_samples,
    inputs_without_noise,
    outputs_compared,
    states_smoothed,
    feedback_restored,
    rounding_errors_drawn,
)


def _flight_data(state: PreparationState) -> FlightData:
    """The prepared flight; DataError where it has no piece."""
    flight, u, z = state.flight, state.u, state.z
    segments = tuple(
        Segment(a, flight.time[a:b], np.ascontiguousarray(u[a:b]), np.ascontiguousarray(z[a:b]), _first_state(state, a))
        for a, b in state.pieces
    )
    if not segments:
        longest = max(part.stop - part.start for part in flight.segments)
        if longest < SHORTEST_SEGMENT:
            raise DataError(
                f"{flight.name}: the longest stretch has {longest} samples; at least {SHORTEST_SEGMENT} in a row are needed"
            )
        raise DataError(
            f"{flight.name}: no stretch of {SHORTEST_SEGMENT} samples in a row with every input of model {state.model.name}"
            " measured"
        )
    notes = without_repeats(state.notes)
    intervals = {s.name: flight.held(s.source) for s in state.model.inputs if s.control}
    commands = {n: interval for n, interval in intervals.items() if interval is not None}
    return FlightData(
        flight.name,
        len(flight),
        segments,
        state.states,
        state.noise,
        notes,
        state.absent,
        state.errors,
        state.follows,
        commands,
        state.restless,
        state.grids,
    )


def _first_state(state: PreparationState, row: int) -> Array:
    """(nx,) initial state at a sample: a number at which the model holds it, else as measured, else the model's start or zero."""
    x0 = np.zeros(len(state.model.states))
    for i, signal in enumerate(state.model.states):
        start = float(signal.start) if isinstance(signal.start, int | float) else 0.0
        held_at_number = signal.held and isinstance(signal.start, int | float)
        x0[i] = start if held_at_number or not np.isfinite(state.states[row, i]) else state.states[row, i]
    return x0
