"""Measured inputs of a model at every sample, de-noised, and draws of their remaining errors.

Controls of a model with pitch rate keep their part that follows the motion, and their measured values near steps: an elevator
acts on a light and little damped motion, so what de-noising removes besides noise would bias pitch damping and the derivatives
by the elevator far beyond their bounds (`estimation.signals.controls`). Lateral models need neither, but for very quiet gyros:
there the noise of measured values costs as much as the rounding of steps. A control that moves so much that de-noising takes
more signal than noise is filtered by Wiener's filter. One that a converter of few bits has rounded keeps its error while it stays
on a level.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from estimation.models.base import Model, Signal
from estimation.prepare.columns import DERIVED, bridge_gaps, derive_column
from estimation.prepare.conditioned import ConditionedFlight
from estimation.prepare.flight_data import FEWEST_DRAWS, SHORTEST_SEGMENT, Preparation, draws_for
from estimation.signals.controls import STEP, ControlStretch, feedback_gains, near_steps, step_reach, with_feedback
from estimation.signals.denoise import (
    QUIET,
    Denoised,
    denoise_many,
    finest_noise_level,
    moving_share,
    noise_level,
    wiener,
    worth_denoising,
)
from estimation.signals.rounding import Grid, draw_level_errors, grid_of, near_edges
from groundstation.flight import Array, Flight
from groundstation.flight.findings import Finding, FindingKind

SEED = 20  # of the draws: the same flight gives the same bound
FEEDBACK_SEED = 22
RESTLESS_SEED = 23
ROUNDING_SEED = 24
MOVING = 0.55
"""Of the samples of a control that never rests: multisines 1.0, random steps 0.65 to 0.8, doublets and multisteps 0.1 to 0.5. The
estimated risk alone is not enough: noise that was filtered or interpolated on the way is no longer white, and looks smaller."""
FEWEST = 100  # samples that give the noise of a restless control to a tenth
PITCH_RATE = "q"  # column

Index = NDArray[np.int64]


@dataclass(frozen=True)
class PreparationState:
    """A flight partly prepared for a model: argument and result of each step of the pipeline.

    pieces: [start, stop) of samples without a gap. rows: index of an input -> the measured samples of each piece. u, z, states:
    as in `FlightData` and its segments, over all samples, NaN outside the pieces; errors, follows, noise, restless, grids, absent
    as there.
    """

    model: Model
    preparation: Preparation
    conditioned: ConditionedFlight
    notes: tuple[Finding, ...] = ()
    pieces: tuple[tuple[int, int], ...] = ()
    rows: dict[int, list[Index]] = field(default_factory=dict)
    u: Array = field(default_factory=lambda: np.zeros((0, 0)))
    z: Array = field(default_factory=lambda: np.zeros((0, 0)))
    states: Array = field(default_factory=lambda: np.zeros((0, 0)))
    errors: NDArray[np.float32] | None = None
    follows: Array | None = None
    noise: dict[str, tuple[float, float]] = field(default_factory=dict)
    restless: frozenset[str] = frozenset()
    grids: dict[str, Grid] = field(default_factory=dict)
    absent: tuple[str, ...] = ()

    @property
    def flight(self) -> Flight:
        return self.conditioned.flight

    def missing_optional(self, signal: Signal) -> bool:
        """Whether the flight lacks a signal that the model can do without."""
        return signal.optional and not self.flight.measured(signal.source)

    def own_samples(self, column: str, start: int, stop: int) -> Index:
        """Samples start..stop-1 at which a column has a measurement of its own; all of them where those are too few."""
        rows = np.flatnonzero(~self.conditioned.copies(column)[start:stop]) + start
        return rows if rows.size >= SHORTEST_SEGMENT else np.arange(start, stop)


def inputs_at_samples(state: PreparationState) -> PreparationState:
    """Inputs at every sample of the pieces, with their noise: measured, derived, or zero for an optional one that is missing."""
    flight, inputs, notes = state.flight, state.model.inputs, list[Finding]()
    u = np.full((len(flight), len(inputs)), np.nan)
    rows: dict[int, list[Index]] = {}
    for i, signal in enumerate(inputs):
        if state.missing_optional(signal):
            notes.append(Finding(FindingKind.NOT_MEASURED, f"{signal.source} not measured: taken as zero"))
            u[:, i] = 0.0
        elif flight.measured(signal.source):
            rows[i] = [state.own_samples(signal.source, a, b) for a, b in state.pieces]
            for (a, b), measured_rows in zip(state.pieces, rows[i], strict=True):
                u[a:b, i] = np.interp(
                    np.arange(a, b), measured_rows, bridge_gaps(flight[signal.source][a:b])[measured_rows - a]
                )
            notes += state.conditioned.slow_notes(signal.source, "taken on straight lines between new values")
            notes += state.conditioned.stuck_notes(signal.source, "is its sensor stuck?")
        else:
            u[:, i] = derive_column(flight, signal.source, state.pieces, notes)
    notes += _bridge_notes([(inputs[i].source, flight[inputs[i].source]) for i in rows], state.pieces)
    return replace(state, u=u, rows=rows, notes=(*state.notes, *notes))


def _bridge_notes(columns: Sequence[tuple[str, Array]], pieces: Sequence[tuple[int, int]]) -> list[Finding]:
    """Notes on inputs with missing samples inside a piece; inputs with equally many share one."""
    by_count: dict[int, list[str]] = {}
    for column, values in columns:
        by_count.setdefault(sum(int(np.isnan(values[a:b]).sum()) for a, b in pieces), []).append(column)
    by_count.pop(0, None)
    total = sum(b - a for a, b in pieces)
    return [
        Finding(
            FindingKind.NOT_MEASURED,
            f"{', '.join(names)} not measured at {count} samples here and there ({100.0 * count / total:.2g}%): "
            "taken on straight lines",
        )
        for count, names in by_count.items()
    ]


def inputs_without_noise(state: PreparationState) -> PreparationState:
    """Inputs de-noised piece by piece, unless the preparation keeps noise, and draws of their remaining errors."""
    flight, inputs, preparation = state.flight, state.model.inputs, state.preparation
    # a computed input, or a command that holds between its records, has no measurement noise
    noisy = {i for i in state.rows if not inputs[i].computed and flight.held(inputs[i].source) is None}
    draws = min(preparation.draws, draws_for(len(flight)))
    errors = np.zeros((*state.u.shape, draws), np.float32)
    rng = np.random.default_rng(SEED)
    if not preparation.denoise:
        _draw_noise(state, noisy, errors, rng)
        note = Finding(FindingKind.OTHER, "measured inputs taken with their noise")
        return replace(state, errors=errors if draws else None, notes=(*state.notes, note))
    controls = [i for i in state.rows if i in noisy and inputs[i].control]
    motion = [i for i in state.rows if i in noisy and not inputs[i].control]
    restless = _denoise(state, controls, 1, errors, rng)
    _denoise(state, motion, 2, errors, rng)
    _derive_errors(state, errors)
    grids, notes = _coarse_grids(state, controls)
    restless_names = frozenset(inputs[i].name for i in restless)
    return replace(state, errors=errors, restless=restless_names, grids=grids, notes=(*state.notes, *notes))


def _draw_noise(
    state: PreparationState, noisy: set[int], errors: NDArray[np.float32], rng: np.random.Generator
) -> None:
    """Draw errors of inputs that keep their noise, in place: white, of the estimated level, on straight lines between measured
    samples."""
    for i in (i for i in state.rows if i in noisy):
        level = max((noise_level(state.u[rows, i]) for rows in state.rows[i]), default=0.0)
        state.noise[state.model.inputs[i].name] = (level, 0.0)
        for (a, b), rows in zip(state.pieces, state.rows[i], strict=True):
            noise = level * rng.standard_normal((errors.shape[2], rows.size))
            for k, values in enumerate(noise):
                errors[a:b, i, k] = np.interp(np.arange(a, b), rows, values)


def _denoise(
    state: PreparationState, inputs: Sequence[int], order: int, errors: NDArray[np.float32], rng: np.random.Generator
) -> list[int]:
    """De-noise columns of `u` and draw their errors, in place. order: of the polynomials. Returns the controls that never
    rest."""
    levels: dict[int, list[tuple[float, float]]] = {i: [] for i in inputs}
    places = [(a, b, i, state.rows[i][k]) for k, (a, b) in enumerate(state.pieces) for i in inputs]
    measured = [state.u[rows, i] for _, _, i, rows in places]
    draws = errors.shape[2]
    # whether a control never rests must not depend on how many draws are asked for
    smooth = denoise_many(measured, order=order, draws=max(draws, FEWEST_DRAWS) if order == 1 else draws, rng=rng)
    restless = _restless(state, places, measured, smooth)
    for (a, b, i, rows), values, denoised in zip(places, measured, smooth, strict=True):
        if i in restless:
            denoised = wiener(values, restless[i], draws, np.random.default_rng([RESTLESS_SEED, i]))
        complete, samples = rows.size == b - a, np.arange(a, b)
        state.u[a:b, i] = denoised.values if complete else np.interp(samples, rows, denoised.values)
        for k, error in enumerate(denoised.errors[:draws]):
            errors[a:b, i, k] = error if complete else np.interp(samples, rows, error)
        levels[i].append((denoised.noise, denoised.removed))
    for i in inputs:
        if levels[i]:
            noise, removed = (float(np.median(values)) for values in zip(*levels[i], strict=True))
            state.noise[state.model.inputs[i].name] = (noise, removed)
    return list(restless)


def _coarse_grids(state: PreparationState, controls: Sequence[int]) -> tuple[dict[str, Grid], list[Finding]]:
    """Control -> its levels, of those whose noise is mostly their rounding; with a note on each."""
    grids, notes = {}, list[Finding]()
    for i in controls:
        signal = state.model.inputs[i]
        grid = grid_of(state.flight[signal.source])
        if grid is not None and grid.is_coarse(state.noise[signal.name][0]):
            grids[signal.name] = grid
            in_degrees = signal.unit == "rad"
            step, unit = (np.degrees(grid.step), "deg") if in_degrees else (grid.step, signal.unit)
            text = f"{signal.source} is recorded in steps of {step:.2g} {unit}: between two it is not known"
            notes.append(Finding(FindingKind.OTHER, text, columns=(signal.source,)))
    return grids, notes


def _restless(
    state: PreparationState,
    places: Sequence[tuple[int, int, int, Index]],
    measured: Sequence[Array],
    smooth: Sequence[Denoised],
) -> dict[int, float]:
    """Control -> its noise, of those that would lose more signal than noise in most of their samples."""
    samples: dict[int, list[tuple[int, float, bool]]] = {}
    for (*_, i, _), values, denoised in zip(places, measured, smooth, strict=True):
        if state.model.inputs[i].control and values.size >= FEWEST:
            level = finest_noise_level(values)
            worth = worth_denoising(denoised, level) or moving_share(values, denoised.noise) < MOVING
            samples.setdefault(i, []).append((values.size, level, worth))
    lost = {i: sum(n if not worth else -n for n, _, worth in parts) for i, parts in samples.items()}
    return {i: float(np.median([level for _, level, _ in samples[i]])) for i, count in lost.items() if count > 0}


def _derive_errors(state: PreparationState, errors: NDArray[np.float32]) -> None:
    """Errors of inputs that are slopes of other inputs, in place: slopes of their errors."""
    sources = [s.source for s in state.model.inputs]
    for i, source in enumerate(sources):
        origin = source.removesuffix("_dot")
        if source in DERIVED and not state.flight.measured(source) and origin != source and origin in sources:
            for a, b in state.pieces:
                errors[a:b, i] = np.gradient(errors[a:b, sources.index(origin)], state.flight.time[a:b], axis=0)


# ------------------------------------------------------------------------------------------------ controls that follow the motion


def has_pitch_rate(model: Model) -> bool:
    """Whether pitch rate is a state of a model."""
    return any(s.source == PITCH_RATE for s in model.states)


def feedback_restored(state: PreparationState) -> PreparationState:
    """Controls with their part that follows the motion restored, and steps as measured, where the preparation says so.

    A piece in which a control was not measured at every sample stays unchanged.
    """
    applies = has_pitch_rate(state.model) or state.preparation.every_axis
    if not (state.preparation.denoise and state.preparation.feedback and applies):
        return state
    state = replace(state, follows=np.zeros_like(state.u))
    for i, signal in enumerate(state.model.inputs):
        level = state.noise.get(signal.name, (0.0, 0.0))[0]
        if not signal.control or signal.computed or not state.flight.measured(signal.source):
            continue
        if signal.name in state.restless:  # the filter took off no part that follows
            continue
        column = state.flight[signal.source]
        missing = ~np.isfinite(column) | state.conditioned.held(signal.source)
        pieces = [(a, b) for a, b in state.pieces if not missing[a:b].any() and level > QUIET * np.ptp(column[a:b])]
        if pieces:
            removed = _restore_feedback(state, i, column, pieces, level)
            state.noise[signal.name] = (level, float(np.sqrt(np.mean(removed**2))))
    return state


def _restore_feedback(
    state: PreparationState, i: int, column: Array, pieces: Sequence[tuple[int, int]], level: float
) -> Array:
    """Restore one control and draw its errors, in place; return measured less restored values over all pieces."""
    assert state.errors is not None
    assert state.follows is not None
    u, states, errors = state.u, state.states, state.errors
    smooth_states = [j for j in range(states.shape[1]) if all(np.isfinite(states[a:b, j]).all() for a, b in pieces)]
    parts = [
        ControlStretch(np.asarray(column[a:b], float), u[a:b, i].copy(), states[a:b][:, smooth_states])
        for a, b in pieces
    ]
    feedback = feedback_gains(parts, level) if smooth_states else None
    rng = np.random.default_rng([FEEDBACK_SEED, i])
    grid = state.grids.get(state.model.inputs[i].name)
    draws, reach = errors.shape[2], step_reach(state.flight.sample_interval)
    for (a, b), part in zip(pieces, parts, strict=True):
        if feedback is not None:
            u[a:b, i], error_draws = with_feedback(part, feedback, level, draws, rng)
            errors[a:b, i], state.follows[a:b, i] = error_draws.T, part.following(feedback)
        step_rows = np.flatnonzero(near_steps(part.smooth, level, STEP, reach))
        u[a + step_rows, i] = near_edges(part.values, grid, state.flight.sample_interval)[step_rows]
        errors[a + step_rows, i] = level * rng.standard_normal((step_rows.size, draws))
    return np.concatenate([part.values - u[a:b, i] for (a, b), part in zip(pieces, parts, strict=True)])


def rounding_errors_drawn(state: PreparationState) -> PreparationState:
    """Draws of the errors of coarsely rounded controls where they stay on one level."""
    for i, signal in enumerate(state.model.inputs):
        grid = state.grids.get(signal.name)
        if grid is not None and state.errors is not None:
            rng, column = np.random.default_rng([ROUNDING_SEED, i]), state.flight[signal.source]
            for a, b in state.pieces:
                draw_level_errors(state.errors[a:b, i], column[a:b], grid, rng)
    return state
