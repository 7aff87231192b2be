"""`import LOG --draft-map`: a mapping proposed, each line with its evidence, and UNKNOWN where the log cannot tell."""

import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from daq.contract.channels import COLUMN_BY_NAME
from daq.contract.errors import UserError
from daq.contract.input_files import check_file, parse_toml, read_bytes
from daq.contract.plain_words import one_line
from groundstation.importers.columns import chosen_source, flight_kind
from groundstation.importers.draft_names import fits, meant, time_column, time_unit, unit_in_name, unit_of
from groundstation.importers.draft_surfaces import drafted_servos, surface_lines
from groundstation.importers.endings import TABLES
from groundstation.importers.errors import ImportDataError
from groundstation.importers.mapping import EXAMPLE, ColumnSource, FileFormat, Map, Time
from groundstation.importers.run import import_data, read_logs
from groundstation.importers.series import Log, native_rate

if TYPE_CHECKING:
    from groundstation.importers.formats.tables import ImportedTable

FIRST_BYTES = 65_536
"""Of a file, among which its header line is."""
SURFACES = ("delta_e", "delta_a", "delta_r")
MOST_LEFT = 40
"""Columns in no flight column that are listed."""


def draft_map(paths: Sequence[Path]) -> str:
    """The text of a mapping file for a log. Raises ImportDataError where it cannot be read."""
    if not paths:
        raise ImportDataError("no file to draft a mapping for")
    path = paths[0]
    check_file(path, error=ImportDataError)
    lines = _of_table(path) if path.suffix.lower() in TABLES and path.suffix.lower() != ".mat" else _of_log(path)
    text = "\n".join([*lines, ""])
    return text + "\n".join(_tried(path, text)) + "\n"


def _head(path: Path) -> list[str]:
    return [
        f"# Drafted for {one_line(path.name)}. Read each line: UNKNOWN is what the log cannot tell and a person must write down.",
        "format = 1",
        f'title = "{EXAMPLE}drafted from a log: write down what is UNKNOWN, then take this line out"',
    ]


def _of_log(path: Path) -> list[str]:
    """A log whose messages a built-in mapping knows."""
    log, chosen = read_logs(path)[0]
    rates = {
        n: s.parts[0].column
        for n in ("p", "q", "r")
        if (s := chosen_source(log, chosen.columns.get(n, ()))) is not None
    }
    servos = drafted_servos(log, rates)
    lines = [*_head(path), *servos.lines, "", "[columns]"]
    lines += surface_lines(servos.shares, [s for s in SURFACES if s not in servos.shares and s not in chosen.columns])
    return [*lines, *_columns(log, chosen)]


def _columns(log: Log, chosen: Map) -> Iterator[str]:
    """Each flight column as the built-in mapping makes it, with what its values are."""
    for name, sources in chosen.columns.items():
        source = chosen_source(log, sources)
        if source is None:
            yield f"# {name}: not in the log ({sources[0].formula})"
            continue
        series = [log.series[t.column] for t in source.parts]
        known = series[0].values[np.isfinite(series[0].values)]
        values = (
            f"{np.min(known):.4g} to {np.max(known):.4g}, median {np.median(known):.4g}" if known.size else "no values"
        )
        rate = min(native_rate(s) for s in series)
        yield f"{name} = {_toml(source)}      # {flight_kind(log, source)}; {source.parts[0].column} {values}; {rate:.3g} Hz"


def _toml(source: ColumnSource) -> str:
    given = source.model_dump(exclude_defaults=True, exclude={"terms"})
    cells = [f"{k} = {_value(v)}" for k, v in given.items()]
    if source.terms:
        terms = ", ".join(f'{{ column = "{t.column}", factor = {t.factor:g} }}' for t in source.terms)
        cells.insert(0, f"terms = [{terms}]")
    return f"{{ {', '.join(cells)} }}"


def _value(value: object) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return (
        f"{value:g}"
        if isinstance(value, int | float)
        else '"' + str(value).replace("\\", "\\\\").replace('"', '\\"') + '"'
    )


def _of_table(path: Path) -> list[str]:
    """A table, whose columns are told by their names and values."""
    from groundstation.importers.formats.tables import header_map

    table = _table(path)
    known, _ = header_map(table)
    names = list(table.numeric)
    lines = [*_head(path), "", "[time]"]
    column = (
        known.time.column
        if known.time is not None and known.time.column
        else time_column([*names, *table.words, *table.dates])
    )
    time = None
    if column is None:
        lines += [
            "rate_hz = 1      # UNKNOWN: no column looks like time; write the rate of the rows, or column = and unit ="
        ]
    elif column in table.numeric:
        unit, why = time_unit(table.numeric[column])
        lines += [f"column = {_value(column)}", f'unit = "{unit}"      # {why}']
        time = table.numeric[column] * {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}[unit]
    else:
        lines += [f"column = {_value(column)}", 'unit = "iso"      # dates, times of day or IRIG time']
    lines += ["", "[columns]"]
    found = meant([n for n in names if n != column])
    chosen = {c: n[0] for c, n in found.items()}
    for flight_column, name in chosen.items():
        stated = table.units.get(name)
        unit, why, sure = unit_of(flight_column, chosen, table.numeric, time)
        if flight_column in known.columns and known.columns[flight_column][0].unit:
            unit, why, sure = str(known.columns[flight_column][0].unit), f"by its header; {why}", True
        elif stated:
            unit, why, sure = stated, f"by the row of units; {why}", True
        elif (named := unit_in_name(name)) is not None and fits(named, flight_column):
            unit, why, sure = named, f"the unit stands in its name; {why}", True
        others = f"; also {', '.join(map(one_line, found[flight_column][1:]))}" if len(found[flight_column]) > 1 else ""
        doubt = "" if sure else "CHECK: "
        lines.append(
            f'{flight_column} = {{ column = {_value(name)}, unit = "{unit}" }}      # {doubt}by its name; {why}{others}'
        )
    left = [n for n in names if n not in chosen.values() and n != column]
    lines += [f"# {one_line(n)}: UNKNOWN, in no flight column of this draft" for n in left[:MOST_LEFT]]
    lines += [f"# {len(left) - MOST_LEFT} more columns are UNKNOWN"] if len(left) > MOST_LEFT else []
    missing = [c for c in ("ax", "p", "phi", "V", *SURFACES) if c not in chosen and c in COLUMN_BY_NAME]
    return [*lines, *(f"# {c} = UNKNOWN: no column looks like it" for c in missing)]


def _table(path: Path) -> "ImportedTable":
    """The table with the column that is its time, as numbers or as words; without one, its numbers alone."""
    from groundstation.importers.formats.tables import read_table

    try:
        return read_table(path, FileFormat(), None)
    except ImportDataError:
        bare = read_table(path, FileFormat(), Time(rate_hz=1.0))
    words = re.split(r"[,;\t\r\n]", read_bytes(path, error=ImportDataError)[:FIRST_BYTES].decode("utf-8", "replace"))
    column = time_column([w.strip(' "') for w in words])
    if column is None:
        return bare
    try:
        return read_table(path, FileFormat(), Time(column=column, unit="s" if column in bare.numeric else "iso"))
    except ImportDataError:
        return bare


def _tried(path: Path, text: str) -> Iterator[str]:
    """What an import with the draft finds, as comments."""
    yield "# An import with this draft says:"
    try:
        chosen = Map.model_validate(parse_toml(text, "draft", ImportDataError))
        flight = import_data(path, chosen, accept_implausible=True)
    except UserError as error:
        yield f"# {one_line(str(error))}"
        return
    from groundstation.flight.contradictions import contradictions

    yield from (f"# note: {one_line(n.text)}" for n in flight.notes)
    yield from (f"# contradiction: {one_line(c.text)}" for c in contradictions(flight))
