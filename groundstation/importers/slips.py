"""Single impossible values: a logger's error, an inverted bit."""

from collections.abc import Mapping

import numpy as np

from daq.contract.channels import COLUMN_BY_NAME
from groundstation.flight.arrays import Array, true_runs

BEYOND = 3.0  # times a column's plausible limit
LONGEST = 2  # consecutive samples, at most: a motion lasts longer
MOST_SLIPS, LARGEST_SHARE = 3, 0.002
"""Slips of a column, as a number or a share of its samples, at most: more show a wrong unit."""


def without_slips(time: Array, columns: Mapping[str, Array]) -> tuple[dict[str, Array], list[str]]:
    """The columns (N,) with NaN for single values far beyond the plausible, and a note on each changed column. time: (N,) [s]."""
    cleaned, notes = dict(columns), []
    for name, values in columns.items():
        if name not in COLUMN_BY_NAME:
            continue
        low, high = COLUMN_BY_NAME[name].plausible
        reach = BEYOND * max(abs(low), abs(high))
        with np.errstate(invalid="ignore"):
            slips = np.abs(values) > reach
        count = int(slips.sum())
        if not 0 < count <= max(MOST_SLIPS, LARGEST_SHARE * values.size):
            continue
        if any(b - a > LONGEST for a, b in true_runs(slips)):
            continue
        first = int(np.flatnonzero(slips)[0])
        cleaned[name] = np.where(slips, np.nan, values)
        example = f"the first {values[first]:.4g} {COLUMN_BY_NAME[name].unit} at t = {time[first]:.4g} s"
        notes.append(f"column {name}: {count} values beyond all that flies ({example}) taken as not measured")
    return cleaned, notes
