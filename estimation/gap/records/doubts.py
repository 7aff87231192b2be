"""Doubts about the flights themselves, in words: one record given twice, a column of another unit or sign, or not measured,
times that are not those of the samples, stale, clipped and missing samples."""

from collections.abc import Sequence

import numpy as np

from estimation.engine.kernel import Array
from estimation.errors import DataError
from estimation.gap.criteria import Criteria
from estimation.gap.records.reconstructed import uncertainty
from estimation.gap.records.sampling import clock_step
from estimation.models.base import Model
from groundstation.flight import Flight
from groundstation.flight.arrays import longest_run
from groundstation.flight.quality.plausibility import suspicions
from groundstation.flight.quality.repeats import one_record_twice

MISSING = 0.02  # of the samples: a channel that lacks more of them gets a note


def sample_notes(flights: Sequence[Flight], columns: Sequence[str], criteria: Criteria) -> list[str]:
    """One sentence for each channel of each flight that is stale, clipped or has holes."""
    notes = []
    for flight in flights:
        for name in columns:
            if not flight.measured(name):
                continue
            notes += [f"{flight.name}: {words}" for words in _channel(name, flight.columns[name], criteria)]
    return notes


def stale_channels(flights: Sequence[Flight], columns: Sequence[str], criteria: Criteria) -> tuple[str, ...]:
    """Channels that repeat their last value in many samples of some flight."""
    return tuple(
        n for n in columns if any(f.measured(n) and _repeats(f.columns[n]) > criteria.stale_share for f in flights)
    )


def _repeats(values: Array) -> float:
    """Share of the samples that repeat the one before, except at the ends of the range: a clipped channel rests there."""
    measured = values[np.isfinite(values)]
    if measured.size < 2:
        return 0.0
    return float(
        np.mean((np.diff(measured) == 0.0) & (measured[1:] < measured.max()) & (measured[1:] > measured.min()))
    )


def _channel(name: str, values: Array, criteria: Criteria) -> list[str]:
    """What a channel lacks, in words: missing, repeated or clipped samples."""
    measured = values[np.isfinite(values)]
    notes = []
    if measured.size < (1.0 - MISSING) * values.size:
        notes.append(f"{name} is missing in {1 - measured.size / values.size:.0%} of the samples")
    if not measured.size or float(np.ptp(measured)) == 0.0:
        return notes
    ends = (float(measured.max()), float(measured.min()))
    stuck = _repeats(measured)
    if stuck > criteria.stale_share:
        notes.append(f"{name} repeats its last value in {stuck:.0%} of the samples: stale or coarsely rounded")
        return notes
    for end, word in zip(ends, ("upper", "lower"), strict=True):
        run = longest_run(measured == end)
        if run >= criteria.clipped_run:
            notes.append(f"{name} stands at its {word} end {end:.4g} for {run} samples in a row: clipped")
    return notes


def refuse_twice(training: Sequence[Flight], holdout: Sequence[Flight]) -> None:
    """DataError where one record is given twice: in a joint fit it counts double, and held out it confirms nothing."""
    duplicates = one_record_twice([*training, *holdout])
    if duplicates is None:
        return
    first, second = ([*training, *holdout][k].name for k in duplicates)
    if duplicates[0] < len(training) <= duplicates[1]:
        raise DataError(f"{second}, held out, is of the same record as {first}: hold out a flight that is in no fit")
    raise DataError(f"{second} is of the same record as {first}: give every flight once")


def doubts_of(flights: Sequence[Flight], model: Model) -> list[str]:
    """Per flight, one sentence for each channel of the model that looks like another unit or sign or was reconstructed without an
    uncertainty, for uneven times, and for sensors that were not brought to one time."""
    compared = {s.source for s in (*model.inputs, *model.outputs)}
    columns = {"time", *compared, *(s.source for s in model.states)}
    doubts = [f"{f.name}: {s.text}" for f in flights for s in suspicions(f.time, f.columns) if columns & set(s.columns)]
    for flight in flights:
        if clock_step(flight) is None:
            steps = 1e3 * np.quantile(np.diff(flight.time), (0.05, 0.95))
            fact = f"its rows are {steps[0]:.0f} to {steps[1]:.0f} ms apart"
            doubts.append(
                f"{flight.name}: {fact}: if only their time stamps are uneven and not the sampling, give even times"
            )
        if flight.provenance.detail.get("aligned") is False:
            doubts.append(
                f"{flight.name}: its sensors were sampled some ms apart and not brought to one time: an effect of the time or "
                "place of an instrument may come from that; where scans are missing, give the recording on board"
            )
        if reconstructed := [c for c in flight.reconstructed if c in compared and uncertainty(flight, c) is None]:
            fact = f"{', '.join(reconstructed)} not measured but found from the motion, without an uncertainty"
            doubts.append(f"{flight.name}: {fact}: their errors look like effects")
    return doubts
