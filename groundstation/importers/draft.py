"""`import LOG --draft-map`: a proposed mapping, each line with its evidence, and UNKNOWN where the log does not show it."""

import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from daq.contract.channels import COLUMN_BY_NAME
from daq.utilities.errors import UserError
from daq.utilities.input_files import parse_toml, read_bytes
from daq.utilities.plain_words import one_line
from groundstation.importers.columns import chosen_source, flight_kind
from groundstation.importers.draft_names import (
    ANGLES,
    UnitGuess,
    candidate_columns,
    rate_that_turns,
    running_column,
    time_column,
    time_unit,
    unit_in_name,
    unit_of,
)
from groundstation.importers.draft_surfaces import drafted_servos, surface_lines
from groundstation.importers.endings import TABLES
from groundstation.importers.errors import ImportDataError
from groundstation.importers.formats.table_time import stamps_of
from groundstation.importers.functions import OUTPUT
from groundstation.importers.mapping import EXAMPLE, ColumnSource, FileFormat, Map, Time
from groundstation.importers.run import check_log, import_data, read_logs
from groundstation.importers.series import Array, Log, native_rate
from groundstation.importers.units import UNITS, is_unit_of

if TYPE_CHECKING:
    from groundstation.importers.formats.tables import ImportedTable

HEADER_BYTES = 65_536  # from the beginning of a file, within which its header line lies
SURFACES = ("delta_e", "delta_a", "delta_r")
MOST_UNMAPPED = 40  # columns in no flight column that are listed one by one
_NO_NAMES: Mapping[str, str] = {}


def draft_map(paths: Sequence[Path]) -> str:
    """The text of a mapping file for a log. Raises ImportDataError where it cannot be read."""
    if not paths:
        raise ImportDataError("no file to draft a mapping for")
    path = paths[0]
    check_log(path)
    table = _first_table(path) if path.suffix.lower() in TABLES else None
    lines = _log_draft(path) if table is None else _table_draft(path, table)
    text = "\n".join([*lines, ""])
    return text + "\n".join(_trial_import(path, text)) + "\n"


def _head(path: Path) -> list[str]:
    """The first lines of a draft."""
    return [
        f"# Drafted for {one_line(path.name)}. Read each line: UNKNOWN is not in the log, and a person must write it down.",
        "format = 1",
        f'title = "{EXAMPLE}drafted from a log: write down what is UNKNOWN, then take this line out"',
    ]


def _log_draft(path: Path) -> list[str]:
    """Lines for a log whose messages a built-in mapping knows."""
    log, mapping = read_logs(path)[0]
    gyros = {n: chosen_source(log, mapping.columns.get(n, ())) for n in ("p", "q", "r")}
    lines, shares = drafted_servos(log, {n: s.parts[0].column for n, s in gyros.items() if s is not None})
    missing = [s for s in SURFACES if s not in shares and s not in mapping.columns]
    by_name = _lines_by_names(log, mapping)
    missing = [s for s in missing if not any(line.startswith(f"{s} = ") for line in by_name)]
    mapped = _mapped_lines(log, mapping)
    return [*_head(path), *lines, "", "[columns]", *surface_lines(shares, missing), *mapped, *by_name]


def _mapped_lines(log: Log, mapping: Map) -> Iterator[str]:
    """A line for each flight column of the built-in mapping, with the range of its values."""
    for name, sources in mapping.columns.items():
        source = chosen_source(log, sources)
        if source is None:
            yield f"# {name}: not in the log ({sources[0].formula})"
            continue
        series = [log.series[t.column] for t in source.parts]
        x = series[0].values[np.isfinite(series[0].values)]
        values = f"{np.min(x):.4g} to {np.max(x):.4g}, median {np.median(x):.4g}" if x.size else "no values"
        rate = min(native_rate(s) for s in series)
        kind = flight_kind(log, source)
        yield f"{name} = {_inline_table(source)}      # {kind}; {source.parts[0].column} {values}; {rate:.3g} Hz"


def _inline_table(source: ColumnSource) -> str:
    """A source as an inline table of TOML."""
    fields = source.model_dump(exclude_defaults=True, exclude={"terms"})
    cells = [f"{k} = {_toml_value(v)}" for k, v in fields.items()]
    if source.terms:
        terms = ", ".join(f'{{ column = "{t.column}", factor = {t.factor:g} }}' for t in source.terms)
        cells.insert(0, f"terms = [{terms}]")
    return f"{{ {', '.join(cells)} }}"


def _toml_value(value: object) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, int | float):
        return f"{value:g}"
    return '"' + str(value).replace("\\", "\\\\").replace('"', '\\"') + '"'


def _recognised_lines(
    names: Sequence[str],
    values: Mapping[str, Array],
    time: Array | None,
    header_units: Mapping[str, str | None],
    row_units: Mapping[str, str],
    full_names: Mapping[str, str] = _NO_NAMES,
) -> tuple[list[str], dict[str, str]]:
    """Lines for all columns (N,), UNKNOWN where neither name nor values show what a column is; and flight column -> name.
    header_units: of flight columns, row_units: of names, as the file states them; full_names: in the file, of names that are
    only the ends of them."""

    def full(name: str) -> str:
        return full_names.get(name, name)

    candidates = candidate_columns(names)
    columns = {column: labels[0] for column, labels in candidates.items()}
    turn_evidence = {}
    for rate, angle in ANGLES.items():
        if len(candidates.get(rate, ())) > 1 and angle in columns:
            columns[rate], turn_evidence[rate] = rate_that_turns(candidates[rate], columns[angle], values, time)
    lines = []
    for column, name in columns.items():
        guess = unit_of(column, columns, values, time)
        header_unit = header_units.get(column)
        name_unit = unit_in_name(name)
        bare = name == column and guess.sure  # a flight column's bare name states no unit, but its values show it
        if header_unit and not bare:
            guess = UnitGuess(header_unit, f"by its header; {guess.why}", True)
        elif row_units.get(name):
            guess = UnitGuess(row_units[name], f"by the row of units; {guess.why}", True)
        elif name_unit is not None and is_unit_of(name_unit, COLUMN_BY_NAME[column].unit):
            guess = UnitGuess(name_unit, f"the unit stands in its name; {guess.why.partition('; UNKNOWN')[0]}", True)
        evidence = f"{'' if guess.sure else 'CHECK: '}by its name; {guess.why}"
        if len(candidates[column]) > 1:
            alternatives = [one_line(full(label)) for label in candidates[column] if label != name]
            reasons = (turn_evidence.get(column, ""), f"also {', '.join(alternatives)}")
            evidence += "".join(f"; {reason}" for reason in reasons if reason)
        lines.append(f'{column} = {{ column = {_toml_value(full(name))}, unit = "{guess.unit}" }}      # {evidence}')
    unmapped = [n for n in names if n not in columns.values()]
    lines += [f"# {one_line(full(n))}: UNKNOWN, in no flight column of this draft" for n in unmapped[:MOST_UNMAPPED]]
    if len(unmapped) > MOST_UNMAPPED:
        lines.append(f"# {len(unmapped) - MOST_UNMAPPED} more columns are UNKNOWN")
    return lines, columns


def _lines_by_names(log: Log, mapping: Map) -> list[str]:
    """Lines for the series of a bag whose kind of message is not known here: by their names, and by their values at the times
    of the fastest series that is recognised by its name."""
    mapped_topics = {name.partition(".")[0] for name in mapping.source_columns}
    topics = [n for n in log.series if n.startswith("/")]
    foreign = [n for n in topics if n.partition(".")[0] not in mapped_topics and not OUTPUT.fullmatch(n)]
    fields = Counter(n.partition(".")[2] for n in foreign)
    full_names = {n.partition(".")[2] if fields[n.partition(".")[2]] == 1 else n: n for n in foreign}
    candidates = [full_names[n] for labels in candidate_columns(list(full_names)).values() for n in labels]
    if not foreign:
        return []
    fastest = max((log.series[n] for n in candidates or foreign), key=native_rate)
    values = {n: np.interp(fastest.time, log.series[f].time, log.series[f].values) for n, f in full_names.items()}
    lines, _ = _recognised_lines(list(full_names), values, fastest.time, {}, {}, full_names)
    return [line for line in lines if line.partition(" ")[0] not in mapping.columns]


def _table_draft(path: Path, table: "ImportedTable") -> list[str]:
    """Lines for a table, whose columns are recognised by their names and values."""
    from groundstation.importers.formats.tables import header_map

    by_header, _ = header_map(table)
    header_time = by_header.time.column if by_header.time is not None else None
    by_name = header_time or time_column([*table.numeric, *table.words, *table.dates])
    time_name = by_name or running_column(table.numeric)
    time_lines, time = _time_lines(table, time_name)
    if by_name is None and time_name is not None:
        time_lines[0] += "      # CHECK: it rises from row to row in even steps, as time does"
    names = [n for n in table.numeric if n != time_name]
    header_units = {column: sources[0].unit for column, sources in by_header.columns.items()}
    lines, columns = _recognised_lines(names, table.numeric, time, header_units, table.units)
    missing = [c for c in ("ax", "p", "phi", "V", *SURFACES) if c not in columns and c in COLUMN_BY_NAME]
    lines += [f"# {c} = UNKNOWN: no column looks like it" for c in missing]
    return [*_head(path), "", "[time]", *time_lines, "", "[columns]", *lines]


def _time_lines(table: "ImportedTable", name: str | None) -> tuple[list[str], Array | None]:
    """The lines of the section [time], and time (N,) [s] where it can be read."""
    if name is None:
        hint = "UNKNOWN: no column looks like time; write the rate of the rows, or column = and unit ="
        return [f"rate_hz = 1      # {hint}"], None
    column = f"column = {_toml_value(name)}"
    if name not in table.numeric:
        line = 'unit = "iso"      # dates, times of day or IRIG time'
        return [column, line], _time_of_text(table, name)
    unit, evidence = time_unit(table.numeric[name])
    return [column, f'unit = "{unit}"      # {evidence}'], table.numeric[name] * UNITS[unit].scale


def _time_of_text(table: "ImportedTable", name: str) -> Array | None:
    """(N,) time [s] from a column of dates or times of day; None where it cannot be read."""
    try:
        return stamps_of(Path(name), table.numeric, table.words, table.dates, Time(column=name, unit="iso")).seconds
    except ImportDataError:
        return None


def _first_table(path: Path) -> "ImportedTable | None":
    """The table with its time column, as numbers or text; without one, the columns of numbers only. Of a MATLAB file the first
    record, None where it holds the topics of an autopilot's log."""
    from groundstation.importers.formats.tables import read_table

    if path.suffix.lower() == ".mat":
        from groundstation.importers.formats.matlab import read_variables, tables_of
        from groundstation.importers.formats.matlab_topics import topics_of

        variables, excluded = read_variables(path)
        return tables_of(path, variables, excluded, FileFormat())[0] if topics_of(variables) is None else None
    try:
        return read_table(path, FileFormat(), None)
    except ImportDataError:
        timeless = read_table(path, FileFormat(), Time(rate_hz=1.0))
    words = re.split(r"[,;\t\r\n]", read_bytes(path, error=ImportDataError)[:HEADER_BYTES].decode("utf-8", "replace"))
    column = time_column([w.strip(' "') for w in words])
    if column is None:
        return timeless
    try:
        return read_table(path, FileFormat(), Time(column=column, unit="s" if column in timeless.numeric else "iso"))
    except ImportDataError:
        return timeless


def _trial_import(path: Path, text: str) -> Iterator[str]:
    """Notes, contradictions or the error of an import with the draft, as comments."""
    yield "# An import with this draft says:"
    try:
        mapping = Map.model_validate(parse_toml(text, "draft", ImportDataError))
        flight = import_data(path, mapping, accept_implausible=True)
    except UserError as error:
        yield f"# {one_line(str(error))}"
        return
    from groundstation.flight.contradictions import contradictions

    yield from (f"# note: {one_line(n.text)}" for n in flight.notes)
    yield from (f"# contradiction: {one_line(c.text)}" for c in contradictions(flight))
