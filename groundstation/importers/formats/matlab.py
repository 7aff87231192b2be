"""MATLAB files as tables: one for each record in them.

A record is a struct of vectors of one length, wherever it stands: the variables of the workspace themselves, one struct,
several structs with the same fields, an array or a cell of structs. Vectors in structs within are called `air.alpha`,
columns of a matrix `data[0]`, members of a list `signals[0].values`. A struct `units` beside the vectors says their units.
"""

from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.contract.input_files import read_bytes
from daq.contract.plain_words import listed, plain_name
from groundstation.flight.files.parquet_columns import MOST_COLUMNS
from groundstation.importers.errors import ImportDataError
from groundstation.importers.formats.tables import ImportedTable
from groundstation.importers.mapping import FileFormat

Array = NDArray[np.float64]

_HDF5 = b"\x89HDF\r\n\x1a\n"
_ASIDE = ("units", "meaning", "about")
"""Structs beside the vectors that `sideslip export` writes."""
MOST_RECORDS = 1000
"""Of a file; each becomes a segment."""
_FEWEST_ROWS = 2


def read_matlab(path: Path, layout: FileFormat) -> list[ImportedTable]:
    """The records of a MATLAB file, in order. Raises ImportDataError for a file that cannot be read or holds none."""
    return tables_of(path, *read_variables(path), layout)


def read_variables(path: Path) -> tuple[dict[str, Any], int]:
    """The variables of a MATLAB file, and how many could not be read. Raises ImportDataError for a file that is none."""
    data = read_bytes(path, error=ImportDataError)
    if _HDF5 in (data[:8], data[512:520]):
        from groundstation.importers.formats.matlab_v73 import read_v73

        return read_v73(path)
    from groundstation.importers.formats.matlab_v5 import read_v5

    return read_v5(path, data)


def tables_of(path: Path, variables: Mapping[str, Any], left_out: int, layout: FileFormat) -> list[ImportedTable]:
    """The records among the variables of a MATLAB file. Raises ImportDataError where there is none."""
    notes = (f"{left_out} variables that only MATLAB can read, or damaged, left out",) if left_out else ()
    records = _records(_chosen(path, variables, layout.variable))[:MOST_RECORDS]
    tables = [table for table in (_table(record, notes) for record in records) if table.numeric]
    if not tables:
        found = listed(map(plain_name, variables), 12) or "nothing that can be read"
        raise ImportDataError(
            f"{path}: no vectors of numbers over time in it; found {found}; tables, timetables and objects are read by MATLAB "
            "only: save a struct of vectors, for example with table2struct(T, 'ToScalar', true)"
        )
    return tables


def _chosen(path: Path, variables: Mapping[str, Any], name: str | None) -> Any:
    if name is None:
        return variables
    if name not in variables:
        raise ImportDataError(
            f"{path}: no variable {name!r}; found {listed(map(plain_name, variables), 12)}; correct [file] variable"
        )
    return variables[name]


def _records(found: Any) -> list[Mapping[str, Any]]:
    """The structs that hold vectors over time."""
    if isinstance(found, list):
        return [r for item in found for r in _records(item)]
    if not isinstance(found, dict):
        return []
    if any(_is_vector(v) for n, v in found.items() if n not in _ASIDE):
        return [found]
    inside = {n: v for n, v in found.items() if n not in _ASIDE and isinstance(v, (dict, list))}
    several = [r for v in inside.values() for r in _records(v)]
    alike = len({frozenset(r) for r in several}) == 1
    # structs of different fields are parts of one record, not records
    return several if alike and several else [found]


def _is_vector(value: Any) -> bool:
    return isinstance(value, np.ndarray) and value.size >= _FEWEST_ROWS


def _table(record: Mapping[str, Any], notes: tuple[str, ...]) -> ImportedTable:
    leaves = {name: v for name, v in _leaves(record) if v.size >= _FEWEST_ROWS}
    rows = Counter(max(v.shape) for v in leaves.values())
    if not rows:
        return ImportedTable({}, {})
    length = rows.most_common(1)[0][0]
    numeric: dict[str, Array] = {}
    other = []
    for name, values in leaves.items():
        columns = _columns(name, values, length)
        if columns:
            numeric |= columns
        else:
            other.append(plain_name(name))
    numeric = dict(list(numeric.items())[:MOST_COLUMNS])
    units = {n: u for n, u in _texts(record.get("units", {})) if n in numeric}
    if other:
        notes = (*notes, f"arrays that are not of {length} samples, left out: {listed(other, 12)}")
    return ImportedTable(
        {n: np.where(np.isinf(v), np.nan, v) for n, v in numeric.items()}, {}, units=units, notes=notes
    )


def _leaves(node: Any, name: str = "") -> Iterator[tuple[str, Array]]:
    """Arrays of numbers with the way to them."""
    if isinstance(node, np.ndarray):
        yield name, node
    elif isinstance(node, dict):
        for key, value in node.items():
            if name or key not in _ASIDE:
                yield from _leaves(value, f"{name}.{key}" if name else key)
    elif isinstance(node, list):
        for i, value in enumerate(node):
            yield from _leaves(value, f"{name}[{i}]")


def _texts(node: Any, name: str = "") -> Iterator[tuple[str, str]]:
    if isinstance(node, str):
        yield name, node
    elif isinstance(node, dict):
        for key, value in node.items():
            yield from _texts(value, f"{name}.{key}" if name else key)


def _columns(name: str, values: Array, length: int) -> dict[str, Array]:
    """A vector, or the columns of a matrix of `length` rows; nothing for an array of another length."""
    if values.size == length:
        return {name: values.ravel()}
    flat = values.reshape(values.shape[0], -1, order="F")
    if flat.shape[0] != length and values.ndim == 2 and values.shape[1] == length:
        flat = values.T
    if flat.shape[0] != length or flat.shape[1] > MOST_COLUMNS:
        return {}
    return {f"{name}[{i}]": column for i, column in enumerate(flat.T)}
