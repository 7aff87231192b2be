"""The data set of a finished campaign: the rows of the present plan with its conditions, and the manifest."""

import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from daq.utilities.durable import make_directories, whole_file
from daq.utilities.outputs import write_json
from daq.utilities.plain_words import visible
from estimation.campaign.keys import key_of, versions
from estimation.campaign.plan import CampaignPlan
from estimation.campaign.schema import RESULTS, VERSION, table_of
from estimation.campaign.sources import CampaignFlight
from estimation.campaign.store import Store
from estimation.campaign.tasks import Row
from estimation.campaign.work_list import WorkList

if TYPE_CHECKING:
    import pyarrow as pa

ORDER = ("flight", "source", "group", "key", "manoeuvre", "kind", "place", "parameter")
CONDITIONS = ("flight", "source", "manoeuvre", "aircraft", "configuration", "date", "day", "mass", "cg", "group")
"""Columns that come from the present plan, which may have changed since the work."""
BY_WORKER = ("aircraft", "manoeuvre", "group")
"""Those of them in which a worker's value replaces the plan's."""


def planned_rows(table: "pa.Table", conditions_by_key: Mapping[str, Row]) -> "tuple[pa.Table, pa.Table]":
    """(rows of the present plan with its conditions, rows of other plans). conditions_by_key: key of work -> conditions."""
    import pyarrow as pa
    import pyarrow.compute as pc

    is_planned = pc.is_in(table["key"], value_set=pa.array(list(conditions_by_key), pa.string()))
    planned = _with_conditions(table.filter(is_planned), conditions_by_key)
    # rows with neither are of flights whose bytes could not be read
    has_content = pc.or_(pc.is_valid(table["sha256"]), pc.is_valid(table["group"]))
    return ordered(planned), table.filter(pc.and_(pc.invert(is_planned), has_content))


def ordered(table: "pa.Table") -> "pa.Table":
    """Rows in the order of the data set."""
    return table.sort_by([(name, "ascending") for name in ORDER])


def _with_conditions(table: "pa.Table", conditions_by_key: Mapping[str, Row]) -> "pa.Table":
    """The table with the names and conditions of the present plan."""
    import pyarrow as pa

    keys = table["key"].to_pylist()
    for name in CONDITIONS:
        pairs = list(zip([conditions_by_key[key].get(name) for key in keys], table[name].to_pylist(), strict=True))
        values = [
            (worker_value if worker_value is not None else planned_value) if name in BY_WORKER else planned_value
            for planned_value, worker_value in pairs
        ]
        field = table.schema.field(name)
        table = table.set_column(table.schema.get_field_index(name), field, pa.array(values, field.type))
    return table


def conditions_of(entry: CampaignFlight) -> Row:
    """The conditions that the plan states of a flight, as columns of the results."""
    c = entry.conditions
    return {
        "flight": entry.name,
        "source": visible(entry.location),
        "manoeuvre": c.manoeuvre or None,
        "aircraft": Path(c.aircraft).stem or None,
        "configuration": c.configuration or None,
        "date": c.date or None,
        "day": c.day or None,
        "mass": c.mass,
        "cg": c.cg,
    }


def unreadable_rows(entries: Sequence[CampaignFlight]) -> "pa.Table":
    """A row with the reason for each flight whose bytes cannot be read."""
    rows = [
        {**conditions_of(e), "kind": "run", "status": "failed", "why": e.why, "key": key_of("unreadable", e.location)}
        for e in entries
    ]
    return table_of(rows, RESULTS)


def write_table(rows: Sequence[Row], columns: dict[str, str], path: Path) -> None:
    """Write rows as a Parquet file of these columns."""
    import pyarrow.parquet as pq

    make_directories(path.parent)
    with whole_file(path) as new:
        pq.write_table(table_of(rows, columns), new, compression="zstd")


def write_texts(texts: Mapping[str, str], folder: Path, ending: str) -> None:
    """Write `folder`/<name><ending> for each text; delete all other files of that ending."""
    from daq.utilities.outputs import write_text

    for old in folder.glob(f"*{ending}"):
        if old.name.removesuffix(ending) not in texts:
            old.unlink()
    for name, text in texts.items():
        write_text(text, folder / f"{name}{ending}")


def manifest(plan: CampaignPlan, work: WorkList, store: Store, failures: Mapping[str, str]) -> dict[str, Any]:
    """Versions, plan, flights with their digests and keys, and files with their SHA-256."""
    flights = [
        {
            "flight": p.entry.name,
            "source": p.entry.location,
            "sha256": p.work.subjects[0].source.sha256,
            "keys": dict(p.work.pieces),
            **({"failed": failures[p.entry.location]} if p.entry.location in failures else {}),
        }
        for p in work.planned
    ]
    flights += [{"flight": e.name, "source": e.location, "failed": e.why} for e in work.unreadable]
    flights += [
        {"flight": e.name, "source": e.location, "same_as": same_flight.location} for e, same_flight in work.duplicates
    ]
    return {
        "version": 1,
        "schema": VERSION,
        "software": dict(versions()),
        "plan": plan.model_dump(mode="json"),
        "flights": flights,
        "files": {
            p.relative_to(store.folder).as_posix(): hashlib.sha256(p.read_bytes()).hexdigest()
            for p in sorted([*store.folder.glob("[drgs]*/*.parquet"), *store.folder.glob("database/*.[tx]*ml")])
        },
    }


def write_manifest(data: Mapping[str, Any], folder: Path) -> bool:
    """Write `folder`/manifest.json; returns whether it differs from the one before."""
    path = folder / "manifest.json"
    old_bytes = path.read_bytes() if path.is_file() else b""
    write_json(data, path)
    return path.read_bytes() != old_bytes
