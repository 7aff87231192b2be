"""A page for each flight: conditions, estimates beside the pooled values of its group, fits, and warnings."""

import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import quote

from markupsafe import Markup

from daq.utilities.constants import RADIAN
from daq.utilities.plain_words import file_name
from estimation.campaign.groups import label_in
from estimation.campaign.pages.points import method_stem
from estimation.campaign.tasks import Row
from estimation.report.page import Page, Section, box, breakable, bullets, free_table, paragraph
from estimation.report.tables import ReportTable, number, significant

if TYPE_CHECKING:
    import pyarrow as pa

FOLDER = "flights"
MOST_PAGES = 2000  # of 20 kB each: in a larger campaign only flights with a warning have a page
SHOWN: Mapping[str, tuple[str, float]] = {
    "duration": ("s", 1.0),
    "V": ("m/s", 1.0),
    "alpha": ("deg", RADIAN),
    "beta_max": ("deg", RADIAN),
    "delta_e": ("deg", RADIAN),
    "altitude": ("m", 1.0),
    "rho": ("kg/m3", 1.0),
    "mass": ("kg", 1.0),
}
"""Conditions on a flight's page: unit and factor to it."""


def write_flight_pages(results: "pa.Table", groups: Sequence[Row], keys: Sequence[str], folder: Path) -> Markup:
    """Write pages into folder/flights; returns the table of all flights with links to them, in order of date and name."""
    flights = _by_flight(results)
    sentences_by_flight = _sentences(groups)
    pooled = [r for r in groups if r["kind"] == "pooled"]
    pages = folder / FOLDER
    for old in pages.glob("*.html"):
        old.unlink()
    lines = []
    for rows in sorted(flights.values(), key=lambda rows: (rows[0]["date"] or "", rows[0]["flight"])):
        first = next((r for r in rows if r["kind"] == "run" and r["V"] is not None), rows[0])
        words = sentences_by_flight.get(first["flight"], [])
        troubled = bool(words) or any(r["kind"] == "run" and r["status"] != "ok" for r in rows)
        page = _page_name(first) if len(flights) <= MOST_PAGES or troubled else ""
        if page:
            _write(pages / page, rows, first, words, _pooled_beside(pooled, first["date"] or ""), keys)
        lines.append(_flight_line(first, rows, page, len(words), keys))
    heads = ("flight", "group", "date", "V [m/s]", "alpha [deg]", "status", "sentences")
    kinds = {"group": "text", "status": "word"}
    return free_table([(kinds.get(head, ""), head) for head in heads], lines, "short", "Every flight, with its page")


def _pooled_beside(pooled: Sequence[Row], date: str) -> dict[tuple[str, str, str], Row]:
    """Group, method, parameter -> pooled value for a flight of this date: that of its side of a step."""
    return {
        (r["group"], r["method"], r["parameter"]): r
        for r in pooled
        if not r.get("since") or r["since"] <= date <= r["until"]
    }


def _by_flight(results: "pa.Table") -> dict[str, list[Row]]:
    """Location and digest of a flight -> its rows."""
    import pyarrow as pa
    import pyarrow.compute as pc

    kinds = pa.array(["run", "estimate", "fit", "check", "match"])
    flight_rows = results.filter(pc.and_(pc.is_valid(results["source"]), pc.is_in(results["kind"], kinds)))
    flights: dict[str, list[Row]] = {}
    for row in flight_rows.drop_columns(["covariance"]).to_pylist():
        flights.setdefault(f"{row['source']} {row['sha256']}", []).append(row)
    return flights


def _sentences(groups: Sequence[Row]) -> dict[str, list[str]]:
    sentences_by_flight: dict[str, list[str]] = {}
    for r in groups:
        if r.get("flight"):
            sentences_by_flight.setdefault(r["flight"], []).append(r["text"])
    return sentences_by_flight


def _page_name(row: Row) -> str:
    """File name of a flight's page; the digest separates flights of the same name."""
    digest = hashlib.sha256(f"{row['source']} {row['sha256']}".encode()).hexdigest()[:8]
    return f"{file_name(row['flight'])[:60]}-{digest}.html"


def _flight_line(
    first: Row, rows: Sequence[Row], page: str, sentences: int, keys: Sequence[str]
) -> list[tuple[str, str]]:
    """Cells of a flight, each with its class. page: its file, empty for none."""
    link = Markup('<a href="{}/{}">{}</a>').format(FOLDER, quote(page), first["flight"]) if page else first["flight"]
    alpha = None if first["alpha"] is None else RADIAN * first["alpha"]
    numbers = [("", number(first["V"], 1)), ("", number(alpha, 1))]
    status = ", ".join(sorted({r["status"] for r in rows if r["kind"] == "run"}))
    count = ("" if sentences else "none", str(sentences or ""))
    group = ("text", breakable(label_in(first, keys)))
    return [("", link), group, ("", (first["date"] or "")[:16]), *numbers, ("word", status), count]


def _write(
    path: Path,
    rows: Sequence[Row],
    first: Row,
    words: Sequence[str],
    pooled: Mapping[tuple[str, str, str], Row],
    keys: Sequence[str],
) -> None:
    group = label_in(first, keys)
    conditions = tuple(
        (name, number(factor * first[name], 3), unit)
        for name, (unit, factor) in SHOWN.items()
        if first[name] is not None
    )
    tables = [
        ReportTable(
            "conditions", "Conditions, means over the flight", ("condition", "value", "unit"), conditions, symbols=False
        )
    ]
    for method in sorted({r["method"] for r in rows if r["kind"] in ("estimate", "check")}):
        tables.append(_estimates(method, [r for r in rows if r["method"] == method], group, pooled))
    tables += [_fits(kind, rows) for kind in ("fit", "match") if any(r["kind"] == kind for r in rows)]
    runs = [r for r in rows if r["kind"] == "run"]
    sentences = list(dict.fromkeys([*words, *(r["why"] for r in runs if r["why"])]))
    unremarkable = all(r["status"] == "ok" for r in runs) and not words
    status = paragraph(", ".join(dict.fromkeys(f"{r['method']}: {r['status']}" for r in runs)))
    head = box(
        [status, *([bullets(breakable(text) for text in sentences)] if sentences else [])], warn=not unremarkable
    )
    digest = first["sha256"] or ""
    note = Markup(
        "Histories and residuals: <code>sideslip estimate {} --report DIR</code>."
        ' SHA-256 <code class="breaks">{}<wbr>{}</code>'
    ).format(breakable(first["source"]), digest[:32], digest[32:])
    Page(
        first["flight"],
        f"{group}; {first['date'] or 'no date'}; {first['source']}",
        [Section("", "", [head, *tables, paragraph(note, "note")])],
        back='<a href="../index.html">&larr; Campaign</a>',
    ).write(path)


def _estimates(method: str, rows: Sequence[Row], group: str, pooled: Mapping[tuple[str, str, str], Row]) -> ReportTable:
    """Estimates beside the pooled values of the group, with the distance in bounds."""
    cells = []
    for r in rows:
        if r["kind"] not in ("estimate", "check"):
            continue
        pooled_row = pooled.get((group, method, r["parameter"]), {})
        identifiable = r["identifiable"] and r["estimate"] is not None and r["std_coloured"]
        distance = (r["estimate"] - pooled_row["estimate"]) / r["std_coloured"] if identifiable and pooled_row else None
        cells.append(
            (
                r["parameter"],
                number(r["estimate"]),
                significant(r["std_coloured"], 2),
                number(pooled_row.get("estimate")),
                number(distance, 1),
                "" if identifiable else "cannot tell",
            )
        )
    head = ("parameter", "estimate", "corrected bound", "pooled", "bounds apart", "")
    return ReportTable(f"estimates_{method_stem(method)}", f"Estimates by {method}", head, tuple(cells))


def _fits(kind: str, rows: Sequence[Row]) -> ReportTable:
    cells = tuple(
        (r["parameter"], r["method"], number(r["r2"], 3), number(r["theil"], 3), significant(r["rms"]))
        for r in rows
        if r["kind"] == kind
    )
    title = "Fit of each channel" if kind == "fit" else "Predicted by the others of the group"
    return ReportTable(kind, title, ("channel", "method", "r²", "Theil", "rms [SI]"), cells, symbols=False)
