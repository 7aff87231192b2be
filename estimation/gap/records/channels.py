"""Which channels of the given flights are measurements to compare with, and doubts about the flights in words.

A dead or stuck sensor is no measurement. A fit silently ignores a dead output, and the answer reads as if all channels had been
compared. A dead input cannot be replaced: the fit uses it as recorded, so the person has to know.

A flow angle reconstructed from velocity, acceleration and attitude is none either: it repeats their information, and compared
with a model it shows their errors as a missing effect. Measured outputs are enough, since side acceleration, rates and bank show
the lateral motion nearly as well without a vane. Reconstructed airspeed and inputs stay (`candidate_model.with_levels`).
"""

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from estimation.errors import DataError
from estimation.gap.criteria import Criteria
from estimation.gap.records.sampling import clock_step
from estimation.models.base import Model
from groundstation.flight import Array, Flight
from groundstation.flight.arrays import longest_run, true_runs
from groundstation.flight.quality.plausibility import suspicions
from groundstation.flight.quality.repeats import one_record_twice, repeats

ANGLES = ("alpha", "beta")
FEWEST = 10  # values: fewer may be equal by chance
MISSING = 0.02  # of the samples: a channel that lacks more of them gets a note


# ------------------------------------------------------------------------------------------------ dead and stuck sensors


def without_stuck(flight: Flight, columns: Iterable[str]) -> Flight:
    """The flight with NaN in the named columns while their sensor is stuck: an output is not compared there, and the stretch of a
    stuck input is left out."""
    stuck = {c: repeats(flight, c).stuck for c in columns if flight.measured(c)}
    changed = {c: np.where(mask, np.nan, flight[c]) for c, mask in stuck.items() if mask.any()}
    return flight.with_columns(**changed) if changed else flight


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


# ------------------------------------------------------------------------------------------------ reconstructed columns


def compared(model: Model, flights: Sequence[Flight]) -> tuple[Model, list[str]]:
    """`model` without flow angles that some flight did not measure and without outputs that are dead on all; and a note for each
    flight that lacks an angle."""
    excluded, notes = set(dead_everywhere(model, flights)), []
    for flight in flights:
        reconstructed = [s.name for s in model.outputs if s.source in ANGLES and s.source in flight.reconstructed]
        absent = [s.name for s in model.outputs if s.source in ANGLES and not flight.measured(s.source)]
        excluded |= {*reconstructed, *absent}
        words = [f"{', '.join(reconstructed)} found from the motion"] if reconstructed else []
        words += [f"{', '.join(absent)} not measured"] if absent else []
        if words:
            notes.append(f"{flight.name}: {' and '.join(words)}: not compared")
    return model.without_outputs(*excluded) if excluded else model, notes


def not_compared(base: Model, model: Model) -> str:
    """A sentence on the outputs of `base` that `model` is not compared in."""
    excluded = [n for n in base.output_names if n not in model.output_names]
    return f"Not measured, and so not compared: {', '.join(excluded)}." if excluded else ""


def as_measured(flight: Flight) -> Flight:
    """`flight` without its reconstructed columns."""
    columns = {n: v for n, v in flight.columns.items() if n not in flight.reconstructed}
    return replace(flight, columns=columns) if len(columns) < len(flight.columns) else flight


def uncertainty(flight: Flight, column: str) -> float | None:
    """Standard deviation of a reconstructed column (median over the flight); None where the flight does not state it."""
    std = f"{column}_std"
    median = float(np.nanmedian(flight[std])) if flight.measured(std) else 0.0
    return median if 0.0 < median < np.inf else None


# ------------------------------------------------------------------------------------------------ stale, clipped, missing samples


def sample_notes(flights: Sequence[Flight], columns: Sequence[str], criteria: Criteria) -> list[str]:
    """One sentence for each channel of each flight that is stale, clipped or has holes."""
    measured = ((f, n) for f in flights for n in columns if f.measured(n))
    return [f"{f.name}: {words}" for f, n in measured for words in _samples_in_words(n, f[n], criteria)]


def stale_channels(flights: Sequence[Flight], columns: Sequence[str], criteria: Criteria) -> tuple[str, ...]:
    """Channels that repeat their last value in many samples of some flight."""
    return tuple(n for n in columns if any(f.measured(n) and _repeats(f[n]) > criteria.negligible for f in flights))


def _repeats(values: Array) -> float:
    """Share of the samples that repeat the one before, except at the ends of the range: a clipped channel rests there."""
    measured = values[np.isfinite(values)]
    if measured.size < 2:
        return 0.0
    inside = (measured[1:] < measured.max()) & (measured[1:] > measured.min())
    return float(np.mean((np.diff(measured) == 0.0) & inside))


def _samples_in_words(name: str, values: Array, criteria: Criteria) -> list[str]:
    """What a measured channel lacks: missing, repeated or clipped samples."""
    measured = values[np.isfinite(values)]
    notes = []
    if measured.size < (1.0 - MISSING) * values.size:
        notes.append(f"{name} is missing in {1 - measured.size / values.size:.0%} of the samples")
    repeated = _repeats(measured)
    if repeated > criteria.negligible:
        notes.append(f"{name} repeats its last value in {repeated:.0%} of the samples: stale or coarsely rounded")
    elif np.ptp(measured) > 0.0:
        for end, word in ((measured.max(), "upper"), (measured.min(), "lower")):
            run = longest_run(measured == end)
            if run >= criteria.clipped_run:
                notes.append(f"{name} stands at its {word} end {end:.4g} for {run} samples in a row: clipped")
    return notes


# ------------------------------------------------------------------------------------------------ doubts about whole flights


def refuse_twice(training: Sequence[Flight], holdout: Sequence[Flight]) -> None:
    """DataError where one record is given twice: in a joint fit it counts double, and held out it confirms nothing."""
    flights = [*training, *holdout]
    duplicates = one_record_twice(flights)
    if duplicates is None:
        return
    first, second = (flights[k].name for k in duplicates)
    if duplicates[0] < len(training) <= duplicates[1]:
        raise DataError(f"{second}, held out, is of the same record as {first}: hold out a flight that is in no fit")
    raise DataError(f"{second} is of the same record as {first}: give every flight once")


def doubts_of(flights: Sequence[Flight], model: Model) -> list[str]:
    """Per flight, one sentence for each channel of the model that looks like another unit or sign or was reconstructed without an
    uncertainty, for uneven times, and for sensors that were not brought to one time."""
    compared_columns = {s.source for s in (*model.inputs, *model.outputs)}
    columns = {"time", *compared_columns, *(s.source for s in model.states)}
    doubts = [f"{f.name}: {s.text}" for f in flights for s in suspicions(f.time, f.columns) if columns & set(s.columns)]
    for flight in flights:
        if clock_step(flight) is None:
            steps = 1e3 * np.quantile(np.diff(flight.time), (0.05, 0.95))
            doubts.append(
                f"{flight.name}: its rows are {steps[0]:.0f} to {steps[1]:.0f} ms apart: if only their time stamps are uneven "
                "and not the sampling, give even times"
            )
        if flight.provenance.detail.get("aligned") is False:
            doubts.append(
                f"{flight.name}: its sensors were sampled some ms apart and not brought to one time: an effect of the time or "
                "place of an instrument may come from that; where scans are missing, give the recording on board"
            )
        reconstructed = [c for c in flight.reconstructed if c in compared_columns and uncertainty(flight, c) is None]
        if reconstructed:
            doubts.append(
                f"{flight.name}: {', '.join(reconstructed)} not measured but found from the motion, without an uncertainty: "
                "their errors look like effects"
            )
    return doubts
