"""The tables of a campaign. Columns are only ever added, and may be null: old files are read together with new ones.

Units: SI and radians; derivatives per radian. See docs/campaign.md for the meaning of each column.
"""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from daq.utilities.plain_words import printed

if TYPE_CHECKING:
    import pyarrow as pa

VERSION = 1
VERSION_KEY = "sideslip.campaign.schema"


def _columns(text: str) -> dict[str, str]:
    """Column -> kind, from lines `kind: name name ...` in the order of the columns."""
    lines = (line.partition(":") for line in text.strip().splitlines())
    return {name: kind.strip() for kind, _, names in lines for name in names.split()}


RESULTS = _columns("""
    string: kind flight manoeuvre method parameter
    double: estimate std std_coloured
    bool: identifiable
    double: reference bootstrap_std bootstrap_low bootstrap_high r2 theil rms whiteness
    string: status why
    int64: samples
    double: duration V V_min V_max alpha alpha_min alpha_max beta beta_max delta_e altitude rho dynamic_pressure
    string: aircraft configuration date day
    double: mass cg
    string: model source sha256 key group
    int64: place
    list: covariance
    int64: iterations
    double: cost
    int64: attempts
    double: cpu
    string: software code model_text
    int64: flights
    double: delta_a_max delta_r_max
""")
GROUPS = _columns("""
    string: kind group other method parameter aircraft configuration day manoeuvre
    int64: flights
    double: estimate std low high between scatter bound ratio probability power detectable
    string: at flight text since until
""")
DATABASE = _columns("""
    string: group method parameter aircraft configuration day manoeuvre
    int64: flights
    double: alpha V
    bool: flown
    double: estimate std low high between
    string: formula kind along
    double: beta_max delta_e bootstrap_std
    string: form since until
""")

UNREPEATABLE = ("attempts", "cpu")
"""Columns that describe the run, not the flight: all others are the same whatever the number of workers."""


def arrow_schema(columns: dict[str, str]) -> "pa.Schema":
    """The columns as Arrow types, with the schema's version."""
    import pyarrow as pa

    fields = [(name, pa.list_(pa.float64()) if kind == "list" else kind) for name, kind in columns.items()]
    return pa.schema(fields, {VERSION_KEY: str(VERSION)})


def table_of(rows: Sequence[Mapping[str, Any]], columns: dict[str, str]) -> "pa.Table":
    """Rows as a table, their texts made printable: names of files may hold any bytes."""
    import pyarrow as pa

    printable_rows = [{name: printed(value) for name, value in row.items()} for row in rows]
    return pa.Table.from_pylist(printable_rows, arrow_schema(columns))


def usable_estimates(results: "pa.Table", kinds: Sequence[str], columns: Sequence[str]) -> list[dict[str, Any]]:
    """Rows of identifiable estimates with a bound, from runs of status ok. kinds: of rows; columns: further ones to read."""
    import pyarrow as pa
    import pyarrow.compute as pc

    is_sound = pc.and_(pc.is_in(results["kind"], pa.array(kinds, pa.string())), pc.equal(results["status"], "ok"))
    names = dict.fromkeys(("flight", "method", "parameter", "date", "key", "estimate", "std_coloured", *columns))
    rows = results.filter(pc.and_(is_sound, results["identifiable"])).select(list(names)).to_pylist()
    return [row for row in rows if row["estimate"] is not None and row["std_coloured"]]
