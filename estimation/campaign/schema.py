"""The tables of a campaign. Columns are only ever added, and may be null: old files are read together with new ones.

Units: SI and radians; derivatives per radian. See docs/campaign.md for the meaning of each column.
"""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from daq.contract.plain_words import printed

if TYPE_CHECKING:
    import pyarrow as pa

VERSION = 1
VERSION_KEY = "sideslip.campaign.schema"

TEXT, NUMBER, WHOLE, TRUTH, NUMBERS = "string", "double", "int64", "bool", "list"

IDENTITY = {
    "kind": TEXT,
    "flight": TEXT,
    "manoeuvre": TEXT,
    "method": TEXT,
    "parameter": TEXT,
}
VALUES = {
    "estimate": NUMBER,
    "std": NUMBER,
    "std_coloured": NUMBER,
    "identifiable": TRUTH,
    "reference": NUMBER,
    "bootstrap_std": NUMBER,
    "bootstrap_low": NUMBER,
    "bootstrap_high": NUMBER,
    "r2": NUMBER,
    "theil": NUMBER,
    "rms": NUMBER,
    "whiteness": NUMBER,
    "status": TEXT,
    "why": TEXT,
}
MEASURED = {
    "samples": WHOLE,
    "duration": NUMBER,
    "V": NUMBER,
    "V_min": NUMBER,
    "V_max": NUMBER,
    "alpha": NUMBER,
    "alpha_min": NUMBER,
    "alpha_max": NUMBER,
    "beta": NUMBER,
    "beta_max": NUMBER,
    "delta_e": NUMBER,
    "altitude": NUMBER,
    "rho": NUMBER,
    "dynamic_pressure": NUMBER,
}
PLANNED = {"aircraft": TEXT, "configuration": TEXT, "date": TEXT, "day": TEXT, "mass": NUMBER, "cg": NUMBER}
PROVENANCE = {
    "model": TEXT,
    "source": TEXT,
    "sha256": TEXT,
    "key": TEXT,
    "group": TEXT,
    "place": WHOLE,
    "covariance": NUMBERS,
    "iterations": WHOLE,
    "cost": NUMBER,
    "attempts": WHOLE,
    "cpu": NUMBER,
    "software": TEXT,
    "code": TEXT,
    "model_text": TEXT,
    "flights": WHOLE,
    "delta_a_max": NUMBER,
    "delta_r_max": NUMBER,
}
RESULTS = {**IDENTITY, **VALUES, **MEASURED, **PLANNED, **PROVENANCE}

GROUPS = {
    "kind": TEXT,
    "group": TEXT,
    "other": TEXT,
    "method": TEXT,
    "parameter": TEXT,
    "aircraft": TEXT,
    "configuration": TEXT,
    "day": TEXT,
    "manoeuvre": TEXT,
    "flights": WHOLE,
    "estimate": NUMBER,
    "std": NUMBER,
    "low": NUMBER,
    "high": NUMBER,
    "between": NUMBER,
    "scatter": NUMBER,
    "bound": NUMBER,
    "ratio": NUMBER,
    "probability": NUMBER,
    "power": NUMBER,
    "detectable": NUMBER,
    "at": TEXT,
    "flight": TEXT,
    "text": TEXT,
    "since": TEXT,
    "until": TEXT,
}

DATABASE = {
    "group": TEXT,
    "method": TEXT,
    "parameter": TEXT,
    "aircraft": TEXT,
    "configuration": TEXT,
    "day": TEXT,
    "manoeuvre": TEXT,
    "flights": WHOLE,
    "alpha": NUMBER,
    "V": NUMBER,
    "flown": TRUTH,
    "estimate": NUMBER,
    "std": NUMBER,
    "low": NUMBER,
    "high": NUMBER,
    "between": NUMBER,
    "formula": TEXT,
    "kind": TEXT,
    "along": TEXT,
    "beta_max": NUMBER,
    "delta_e": NUMBER,
    "bootstrap_std": NUMBER,
    "form": TEXT,
    "since": TEXT,
    "until": TEXT,
}

UNREPEATABLE = ("attempts", "cpu")
"""Columns that tell of the run and not of the flight: all others are the same whatever the number of workers."""


def arrow_schema(columns: dict[str, str]) -> "pa.Schema":
    """The columns as Arrow types, with the schema's version."""
    import pyarrow as pa

    kinds = {
        TEXT: pa.string(),
        NUMBER: pa.float64(),
        WHOLE: pa.int64(),
        TRUTH: pa.bool_(),
        NUMBERS: pa.list_(pa.float64()),
    }
    return pa.schema([(name, kinds[kind]) for name, kind in columns.items()], {VERSION_KEY: str(VERSION)})


def table_of(rows: Sequence[Mapping[str, Any]], columns: dict[str, str]) -> "pa.Table":
    """Rows as a table; text that holds what is no text (names of files need not be) with that shown by its number."""
    import pyarrow as pa

    sound = [{name: printed(value) for name, value in row.items()} for row in rows]
    return pa.Table.from_pylist(sound, arrow_schema(columns))
