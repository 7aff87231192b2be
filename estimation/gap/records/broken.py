"""Channels with a dead or stuck sensor, and single values with a spike: they are no measurement, and the answer says so.

A fit silently ignores a dead output, and the answer reads as if all channels had been compared. A dead input cannot be
replaced: the fit uses it as recorded, so the person has to know.

A spike of a few standard deviations hardly bends a fit, but two of them in a second have an energy that no simulated flight with
Gaussian noise has. Only the residuals of a fit show so small a spike.
"""

from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from estimation.gap.criteria import Criteria
from estimation.gap.records.sampling import smallest_step
from estimation.models.base import Model
from estimation.signals.controls import near_steps
from groundstation.flight import Array, Flight
from groundstation.flight.arrays import MAD_TO_SIGMA, true_runs
from groundstation.flight.quality.repeats import repeats

FEWEST = 10  # values: fewer may be equal by chance
BESIDE_PARABOLA = np.array([2.0, -3.0, -6.0, 14.0, -6.0, -3.0, 2.0]) / 14.0
"""Weights of a value less the least-squares parabola through the three samples on either side."""
BEFORE, BEHIND = 1, 3  # samples about a step of a control, where a residual may jump
BESIDE_SPIKE = 0.7  # a spike alone shows in its neighbours as 0.43 of it
SAID = 3  # times in a note

Index = NDArray[np.int64]
Spikes = Mapping[int, Mapping[str, Index]]
"""Index of a flight -> column -> samples with a spike."""


def without_stuck(flight: Flight, columns: Iterable[str]) -> Flight:
    """The flight with NaN in the named columns while their sensor is stuck: an output is not compared there, and the stretch of a
    stuck input is left out."""
    stuck = {c: repeats(flight, c).stuck for c in columns if flight.measured(c)}
    changed = {c: np.where(mask, np.nan, flight[c]) for c, mask in stuck.items() if mask.any()}
    return flight.with_columns(**changed) if changed else flight


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
    residual: Array, stepping: NDArray[np.bool_], left_open: Array, farthest: float, most: float
) -> NDArray[np.bool_]:
    """(N,) single samples of a residual (N,), NaN where not measured, that leave their neighbours by more than `farthest`
    standard deviations; none at all where more than the share `most` stand out, which is no accident.

    stepping: (N,) samples near a step of a control, which are judged by their own scatter where that is larger. left_open: (N,)
    standard deviation that unknown paths of surfaces leave in a residual beside its neighbours (`BESIDE_PARABOLA`): at the
    fastest moves of an aileron a roll rate is off by many times its noise, and right.
    """
    away, scatter = _away(residual)
    level = np.nan_to_num(np.abs(away))
    at_steps = level[stepping & np.isfinite(residual)]
    wider = max(1.0, MAD_TO_SIGMA * float(np.median(at_steps))) if at_steps.size >= FEWEST else 1.0
    usual = np.hypot(np.where(stepping, wider, 1.0), left_open / scatter)
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


def stands_still(flight: Flight, column: str) -> bool:
    """Whether a channel has one value from beginning to end."""
    if not flight.measured(column):
        return False
    values = flight[column][np.isfinite(flight[column])]
    return values.size >= FEWEST and float(np.ptp(values)) == 0.0


def dead_everywhere(model: Model, flights: Sequence[Flight]) -> list[str]:
    """Outputs of `model` that stand still on every flight; none where all outputs do, which the fit itself refuses."""
    still = [s.name for s in model.outputs if all(stands_still(f, s.source) for f in flights)]
    return still if len(still) < len(model.outputs) else []


def broken_in_words(flights: Sequence[Flight], model: Model) -> list[str]:
    """One sentence for each channel that the model needs and that is dead or stuck on some flights.

    An input that stands still on every flight may never have been moved: `unmoved_in_words` reports controls.
    """
    outputs = {s.source for s in model.outputs}
    inputs = {s.source for s in model.inputs if not s.computed} - outputs
    sentences = []
    for column in sorted(outputs | inputs):
        still = [f.name for f in flights if stands_still(f, column)]
        if still and column in outputs:
            where = "every flight" if len(still) == len(flights) else " and ".join(still)
            sentences.append(f"{column} stands still on {where}: a dead channel, not compared there")
        elif still and len(still) < len(flights):
            sentences.append(
                f"{column} stands still on {' and '.join(still)} and moves elsewhere: is its sensor dead there?"
            )
        if stuck := [words for f in flights if (words := _stuck_in_words(f, column))]:
            what = "not compared there" if column in outputs else "those times are left out"
            sentences.append(f"{column} is stuck {' and '.join(stuck)}: {what}")
    return sentences


def _stuck_in_words(flight: Flight, column: str) -> str:
    """When a channel is stuck on a flight; empty where it is not."""
    runs = true_runs(repeats(flight, column).stuck) if flight.measured(column) else []
    if not runs:
        return ""
    first, last = flight.time[runs[0][0]], flight.time[runs[-1][1] - 1]
    times = f", {len(runs)} times" if len(runs) > 1 else f" at {flight[column][runs[0][0]]:.3g}"
    return f"on {flight.name} (between {first:.1f} and {last:.1f} s{times})"


def unmoved_in_words(flights: Sequence[Flight], model: Model) -> str:
    """A sentence on controls that stand still on every flight; empty where none does."""
    controls = [s.source for s in model.inputs if s.control and not s.computed]
    still = [c for c in controls if all(stands_still(f, c) for f in flights)]
    if not still:
        return ""
    return (
        f"{' and '.join(still)} never moved: nothing is known of its effect; if the surface did move, its channel is dead, and "
        "that is the missing effect."
    )
