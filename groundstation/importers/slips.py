"""Single impossible values: errors of a logger, an inverted bit."""

from collections.abc import Mapping

import numpy as np

from daq.contract.channels import COLUMN_BY_NAME
from groundstation.flight.arrays import Array, true_runs

BEYOND = 3.0  # times a column's plausible limit
LONGEST = 2  # consecutive samples, at most: motion lasts longer
MOST_SLIPS, LARGEST_SHARE = 3, 0.002
"""Number, or share of a column's samples, at most: more are a wrong unit."""


def without_slips(time: Array, columns: Mapping[str, Array]) -> tuple[dict[str, Array], list[str]]:
    """The columns (N,) with NaN for single values far beyond the plausible, and a sentence on each changed column. time: [s]."""
    sound, notes = dict(columns), []
    for name, values in columns.items():
        if name not in COLUMN_BY_NAME:
            continue
        low, high = COLUMN_BY_NAME[name].plausible
        reach = BEYOND * max(abs(low), abs(high))
        with np.errstate(invalid="ignore"):
            far = np.abs(values) > reach
        count = int(far.sum())
        if not 0 < count <= max(MOST_SLIPS, LARGEST_SHARE * values.size) or any(
            b - a > LONGEST for a, b in true_runs(far)
        ):
            continue
        first = int(np.flatnonzero(far)[0])
        sound[name] = np.where(far, np.nan, values)
        example = f"the first {values[first]:.4g} {COLUMN_BY_NAME[name].unit} at t = {time[first]:.4g} s"
        notes.append(f"column {name}: {count} values beyond all that flies ({example}) taken as not measured")
    return sound, notes
