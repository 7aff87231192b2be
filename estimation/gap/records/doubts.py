"""What of the flights themselves is to be doubted: one record given twice, a column of another unit or sign, or not measured,
times that are not those of the samples."""

from collections.abc import Sequence

import numpy as np

from estimation.errors import DataError
from estimation.gap.records.lost_rows import clock_step
from estimation.gap.records.reconstructed import uncertainty
from estimation.models.base import Model
from groundstation.flight import Flight
from groundstation.flight.quality.plausibility import suspicions
from groundstation.flight.quality.repeats import one_record_twice


def refuse_twice(training: Sequence[Flight], holdout: Sequence[Flight]) -> None:
    """DataError where one record is given twice: fitted jointly it counts double, and held out it proves nothing."""
    same = one_record_twice([*training, *holdout])
    if same is None:
        return
    first, second = ([*training, *holdout][k].name for k in same)
    if same[0] < len(training) <= same[1]:
        raise DataError(f"{second}, held out, is of the same record as {first}: hold out a flight that is in no fit")
    raise DataError(f"{second} is of the same record as {first}: give every flight once")


def doubts_of(flights: Sequence[Flight], model: Model) -> list[str]:
    """One sentence for every channel that the model needs and that looks like another unit or sign, or was found from the
    others without saying how well, for uneven times, and for sensors that were not brought to one time, of each flight."""
    driven = {s.source for s in (*model.inputs, *model.outputs)}
    used = {"time", *driven, *(s.source for s in model.states)}
    told = [f"{f.name}: {s.text}" for f in flights for s in suspicions(f.time, f.columns) if used & set(s.columns)]
    for flight in flights:
        if clock_step(flight) is None:
            steps = 1e3 * np.quantile(np.diff(flight.time), (0.05, 0.95))
            said = f"its rows come {steps[0]:.0f} to {steps[1]:.0f} ms after one another"
            told.append(
                f"{flight.name}: {said}: if that is the clock that stamped them and not the sampling, give even times"
            )
        if flight.provenance.detail.get("aligned") is False:
            said = "its sensors stand at their own instants, some ms apart"
            told.append(
                f"{flight.name}: {said}: a name for when or where an instrument measures may be that; where scans are missing, "
                "give the recording on board"
            )
        if made := [c for c in flight.reconstructed if c in driven and uncertainty(flight, c) is None]:
            said = f"{', '.join(made)} not measured but found from the motion, without saying how well: errors look like effects"
            told.append(f"{flight.name}: {said}")
    return told
