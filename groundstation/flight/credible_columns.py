"""Columns that come from outside: names that can be shown and written, and values that an instrument can have measured."""

import re
from collections.abc import Iterable, Mapping

import numpy as np
from numpy.typing import NDArray

from daq.contract.channels import COLUMN_BY_NAME
from daq.contract.plain_words import plain_name

Array = NDArray[np.float64]

LARGEST = 1e12
"""No quantity of a flight in SI units is as large; squares and sums of what is smaller stay far from the largest float."""


def field_names(names: Iterable[str]) -> list[str]:
    """Names that can be fields of an MCAP flight, each of its own: letters, digits and underscores for what is anything else."""
    out: dict[str, None] = {}
    for name in names:
        first = plain = (
            name if name.isascii() and name.isidentifier() else "_" + re.sub(r"\W+", "_", name, flags=re.ASCII)
        )
        while plain in out:
            plain = f"{first}_{len(out)}"
        out[plain] = None
    return list(out)


def credible_values(columns: Mapping[str, Array]) -> tuple[dict[str, Array], list[str]]:
    """The columns with NaN for what no instrument measures, and notes on it: infinities, and values beyond LARGEST."""
    out, notes = dict(columns), []
    for name, values in columns.items():
        for what, wrong in (
            ("infinite values", np.isinf(values)),
            (f"values beyond {LARGEST:g}", np.isfinite(values) & (np.abs(values) > LARGEST)),
        ):
            if wrong.any() and (name in COLUMN_BY_NAME or what.startswith("inf")):
                out[name] = np.where(wrong, np.nan, out[name])
                notes.append(f"column {name}: {int(wrong.sum())} {what} taken as not measured")
    return out, notes


def plain_names(columns: Mapping[str, Array]) -> dict[str, Array]:
    """The columns under names that can be shown anywhere, each of its own."""
    out: dict[str, Array] = {}
    for name, values in columns.items():
        shown = plain_name(name)
        while shown in out:
            shown = f"{shown[:100]}_{len(out)}"
        out[shown] = values
    return out
