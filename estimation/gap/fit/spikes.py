"""Single values with a spike: they are no measurement, are left out, and the answer says so.

A spike of a few standard deviations hardly bends a fit, but two of them in a second have an energy that no simulated flight with
Gaussian noise has. Only the residuals of a fit show so small a spike.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from estimation.gap.criteria import Criteria
from estimation.gap.fit.baseline import Baseline
from estimation.gap.fit.linear_motion import linear_motions
from estimation.gap.fit.noise import NoiseModel, channel_noise, filtered_attitudes
from estimation.gap.fit.problem import LikelihoodProblem, ModelFit
from estimation.gap.fit.surface_steps import find_surface_steps
from estimation.gap.records.sampling import smallest_step
from estimation.prepare.plausible import MOST_WILD
from estimation.signals.controls import near_steps
from groundstation.flight import Array, Flight
from groundstation.flight.arrays import MAD_TO_SIGMA

FEWEST = 10  # values, for their scatter
BESIDE_PARABOLA = np.array([2.0, -3.0, -6.0, 14.0, -6.0, -3.0, 2.0]) / 14.0
"""Weights of a value less the least-squares parabola through the three samples on either side."""
BEFORE, BEHIND = 1, 3  # samples about a step of a control, where a residual may jump
BESIDE_SPIKE = 0.7  # a spike alone shows in its neighbours as 0.43 of it
SAID = 3  # times in a note

Index = NDArray[np.int64]
Spikes = Mapping[int, Mapping[str, Index]]
"""Index of a flight -> column -> samples with a spike."""


def spikes_about(baseline: Baseline) -> Spikes:
    """Single values that a fit does not follow, on training and held-out flights. A filter's attitude has none: it is smoother
    than a model is right."""
    criteria, found = baseline.criteria, dict[int, dict[str, list[int]]]()
    values = sum(np.isfinite(r.z).sum() for r in baseline.prepared.records)
    farthest = -float(ndtri(0.5 * (1.0 - criteria.null_level) / values))  # of any of them, were they Gaussian noise
    fits = filter(None, ((baseline.problem, baseline.fit), baseline.held_out))
    records, outputs = baseline.problem.records, baseline.problem.model.output_names
    filtered = filtered_attitudes(records, outputs, channel_noise(records), criteria)
    for problem, model_fit in fits:
        controls = [i for i, s in enumerate(problem.model.inputs) if s.control]
        opened = left_open(problem, model_fit, baseline.noise)
        each = zip(problem.records, problem.coarse, model_fit.residuals, opened, strict=True)
        for record, segment, residual, paths in each:
            stepping = stepping_samples(segment.u[:, controls], criteria)
            columns = found.setdefault(record.flight, {})
            for signal, course, path in zip(problem.model.outputs, residual.T, paths.T, strict=True):
                at = segment.first + np.flatnonzero(spikes_in(course, stepping, path, farthest, MOST_WILD))
                if at.size and signal.name not in filtered:
                    columns.setdefault(signal.source, []).extend(at.tolist())
    return {flight: {c: np.array(at) for c, at in columns.items()} for flight, columns in found.items() if columns}


def left_open(problem: LikelihoodProblem, model_fit: ModelFit, noise: NoiseModel) -> list[Array]:
    """(N, ny) standard deviations that the unknown paths of surfaces leave in a residual beside its neighbours, for every
    record."""
    motions = zip(linear_motions(problem, model_fit.values), problem.coarse, problem.records, strict=True)
    steps = (find_surface_steps(problem.model, m, s, problem.criteria, r.restless) for m, s, r in motions)
    return [e.scatter(noise.freedom, BESIDE_PARABOLA) for e in steps]


def beside_neighbours(residual: Array) -> Array:
    """(N,) a residual (N,) less a parabola through the three samples on either side, in its robust scatter; NaN where not
    measured."""
    return _away(residual)[0]


def _away(residual: Array) -> tuple[Array, float]:
    """See `beside_neighbours`; and the robust scatter, infinite where it is not known."""
    rows = np.flatnonzero(np.isfinite(residual))
    result = np.full(residual.size, np.nan)
    if rows.size < FEWEST:
        return result, np.inf
    away = np.convolve(np.pad(residual[rows], 3, mode="reflect"), BESIDE_PARABOLA, "valid")
    scatter = MAD_TO_SIGMA * float(np.median(np.abs(away))) or np.inf
    result[rows] = away / scatter
    return result, scatter


def spikes_in(
    residual: Array, stepping: NDArray[np.bool_], open_paths: Array, farthest: float, most: float
) -> NDArray[np.bool_]:
    """(N,) single samples of a residual (N,), NaN where not measured, that leave their neighbours by more than `farthest`
    standard deviations; none at all where more than the share `most` stand out, which is no accident.

    stepping: (N,) samples near a step of a control, which are judged by their own scatter where that is larger. open_paths: (N,)
    of `left_open`: at the fastest moves of an aileron a roll rate is off by four times its noise, and right.
    """
    away, scatter = _away(residual)
    level = np.nan_to_num(np.abs(away))
    at_steps = level[stepping & np.isfinite(residual)]
    wider = max(1.0, MAD_TO_SIGMA * float(np.median(at_steps))) if at_steps.size >= FEWEST else 1.0
    usual = np.hypot(np.where(stepping, wider, 1.0), open_paths / scatter)
    neighbours = np.maximum(np.roll(level, 1), np.roll(level, -1))
    spikes = (level > usual * farthest) & (neighbours < BESIDE_SPIKE * level)
    return spikes if spikes.sum() <= max(2, most * np.isfinite(residual).sum()) else np.zeros_like(spikes)


def stepping_samples(controls: Array, criteria: Criteria) -> NDArray[np.bool_]:
    """(N,) samples near a step of any of the controls (N, controls)."""
    stepping = np.zeros(len(controls), bool)
    for u in controls.T:
        stepping |= near_steps(u, smallest_step(np.diff(u), criteria), 1.0, range(-BEFORE, BEHIND + 1))
    return stepping


def without_spikes(flight: Flight, spikes: Mapping[str, Index]) -> Flight:
    """The flight with NaN at the spikes of its columns."""
    columns = {c: flight[c].copy() for c in spikes}
    for column, at in spikes.items():
        columns[column][at] = np.nan
    return flight.with_columns(**columns)


def spikes_in_words(flights: Sequence[Flight], spikes: Spikes) -> list[str]:
    """A note on the spikes of every flight."""
    notes = []
    for index, columns in spikes.items():
        flight = flights[index]
        said = [f"{column} at {_times(flight.time[at])}" for column, at in columns.items()]
        notes.append(
            f"{flight.name}: single values far from their neighbours and from the model left out: {'; '.join(said)}"
        )
    return notes


def _times(times: Array) -> str:
    more = f" and {times.size - SAID} more" if times.size > SAID else ""
    return f"{', '.join(f'{t:.2f}' for t in times[:SAID])} s{more}"
