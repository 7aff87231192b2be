"""Single values that nothing flown can show: slips of a logger, a bit that turned over."""

from collections.abc import Mapping

import numpy as np

from daq.contract.channels import COLUMN_BY_NAME
from groundstation.flight.arrays import Array, true_runs

BEYOND = 3.0  # times what is plausible
LONGEST = 2  # samples in a row: motion lasts longer
FEW, SHARE = 3, 0.002
"""Of the samples of a column, at most: where there are more, it is its unit that is wrong."""


def without_slips(time: Array, columns: Mapping[str, Array]) -> tuple[dict[str, Array], list[str]]:
    """The columns (N,) with NaN for single values far beyond what is plausible, and a note on each."""
    sound, notes = dict(columns), []
    for name, values in columns.items():
        if name not in COLUMN_BY_NAME:
            continue
        low, high = COLUMN_BY_NAME[name].plausible
        reach = BEYOND * max(abs(low), abs(high))
        with np.errstate(invalid="ignore"):
            far = np.abs(values) > reach
        count = int(far.sum())
        if not 0 < count <= max(FEW, SHARE * values.size) or any(b - a > LONGEST for a, b in true_runs(far)):
            continue
        first = int(np.flatnonzero(far)[0])
        sound[name] = np.where(far, np.nan, values)
        shown = f"the first {values[first]:.4g} {COLUMN_BY_NAME[name].unit} at t = {time[first]:.4g} s"
        notes.append(f"column {name}: {count} values beyond all that flies ({shown}) taken as not measured")
    return sound, notes
