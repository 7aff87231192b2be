"""MATLAB files as tables, one for each record.

A record is a set of vectors of one length: the variables of the workspace, a struct, each of several structs with the same
fields, or each element of an array or a cell of structs. Vectors of nested structs are called `air.alpha`, columns of a matrix
`data[0]`, elements of a list `signals[0].values`. A struct `units` among the vectors has their units.
"""

import io
import json
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from daq.utilities.input_files import read_bytes
from daq.utilities.plain_words import listed, plain_name
from groundstation.flight.arrays import Array
from groundstation.flight.files.parquet_columns import MOST_COLUMNS
from groundstation.importers.errors import ImportDataError
from groundstation.importers.formats.tables import ImportedTable
from groundstation.importers.mapping import FileFormat

_HDF5 = b"\x89HDF\r\n\x1a\n"  # at the beginning, or after MATLAB's own header of 512 bytes
_BYTE_ORDERS = (b"IM", b"MI")  # at byte 126 of a MATLAB 5 file
_DESCRIPTIONS = ("units", "meaning", "about")  # structs of texts that `sideslip export` writes beside the vectors
MOST_RECORDS = 1000  # of a file; each becomes a segment
FEWEST_ROWS = 2
LEAST_UNPACKED, MOST_TIMES_PACKED = 2**26, 16
"""Bytes to which a file may decompress: 64 MiB, or 16 times its length. Flight data compress to a half, constants to almost
nothing."""
LONGEST_READING = 60  # [s] for a file; 100 MB take some 2 s
_CHILD = Path(__file__).with_name("matlab_child.py")
_NO_PACKAGE = 3  # exit status of the child without h5py


def read_variables(path: Path) -> tuple[dict[str, Any], int]:
    """Variables by name: dictionaries (structs), lists (cells, arrays of structs), texts and arrays of numbers; and the number of
    parts left out.

    A child process with limited memory and time reads the file. Raises ImportDataError for a damaged file or one of another
    format.
    """
    data = read_bytes(path, error=ImportDataError)
    version = "7.3" if _HDF5 in (data[:8], data[512:520]) else "5"
    if version == "5" and data[126:128] not in _BYTE_ORDERS:
        raise ImportDataError(
            f"{path}: not a MATLAB 5 or 7.3 file; save it with -v7 or -v7.3 (older ones, of MATLAB 4, are not read)"
        )
    most_bytes = max(LEAST_UNPACKED, MOST_TIMES_PACKED * len(data))
    child = [sys.executable, "-I", str(_CHILD), str(path.absolute()), str(most_bytes)]
    try:
        process = subprocess.run(child, capture_output=True, timeout=LONGEST_READING, check=False)
    except subprocess.TimeoutExpired:
        raise ImportDataError(
            f"{path}: damaged MATLAB {version} file (no end after {LONGEST_READING} s); save it again"
        ) from None
    if process.returncode == _NO_PACKAGE:
        raise ImportDataError(
            f"{path}: reading MATLAB 7.3 files needs the package h5py; pip install 'sideslip[ground]'"
        )
    if process.returncode < 0 and version == "5":
        raise ImportDataError(f"{path}: damaged MATLAB 5 file, at which its reader crashes; save it again")
    if process.returncode:
        raise ImportDataError(
            f"{path}: damaged MATLAB {version} file, or larger than {most_bytes} bytes when unpacked; save it again with -v7"
        )
    with np.load(io.BytesIO(process.stdout), allow_pickle=False) as arrays:
        tree = json.loads(str(arrays["tree"]))
        return {n: _from_tree(v, arrays) for n, v in tree["variables"].items()}, int(tree["left_out"])


def _from_tree(node: Any, arrays: Any) -> Any:
    """The variable that the child describes by a node of its JSON. arrays: of the child's .npz, by name."""
    match node:
        case {"array": str(name)}:
            return arrays[name]
        case {"struct": dict(fields)}:
            return {n: _from_tree(v, arrays) for n, v in fields.items()}
        case {"list": list(items)}:
            return [_from_tree(v, arrays) for v in items]
        case {"text": str(text)}:
            return text
    return None


def tables_of(path: Path, variables: Mapping[str, Any], excluded: int, layout: FileFormat) -> list[ImportedTable]:
    """The records among the variables of a MATLAB file, at most MOST_RECORDS. excluded: number of parts that were left out.
    Raises ImportDataError for a file without records."""
    notes = (f"{excluded} variables that only MATLAB can read, or damaged, left out",) if excluded else ()
    records = _records(_record_variable(path, variables, layout.variable))[:MOST_RECORDS]
    tables = [table for table in (_table(record, notes) for record in records) if table.numeric]
    if not tables:
        names = listed(map(plain_name, variables), 12) or "nothing that can be read"
        raise ImportDataError(
            f"{path}: no vectors of numbers over time in it; found {names}; tables, timetables and objects are read by MATLAB "
            "only: save a struct of vectors, for example with table2struct(T, 'ToScalar', true)"
        )
    return tables


def _record_variable(path: Path, variables: Mapping[str, Any], name: str | None) -> Any:
    """The variable that a mapping names; all variables where it names none."""
    if name is None:
        return variables
    if name not in variables:
        raise ImportDataError(
            f"{path}: no variable {name!r}; found {listed(map(plain_name, variables), 12)}; correct [file] variable"
        )
    return variables[name]


def _records(variable: Any) -> list[Mapping[str, Any]]:
    """The structs in a variable that hold vectors over time."""
    if isinstance(variable, list):
        return [r for item in variable for r in _records(item)]
    if not isinstance(variable, dict):
        return []
    if any(_is_vector(v) for n, v in variable.items() if n not in _DESCRIPTIONS):
        return [variable]
    containers = {n: v for n, v in variable.items() if n not in _DESCRIPTIONS and isinstance(v, (dict, list))}
    inner = [r for v in containers.values() for r in _records(v)]
    same_fields = len({frozenset(r) for r in inner}) == 1  # structs of different fields are parts of one record
    return inner if same_fields else [variable]


def _is_vector(value: Any) -> bool:
    """Whether a value is an array with the rows of a record."""
    return isinstance(value, np.ndarray) and value.size >= FEWEST_ROWS


def _table(record: Mapping[str, Any], notes: tuple[str, ...]) -> ImportedTable:
    """A record as a table of its most common length; arrays of another length are left out, with a note."""
    leaves = {name: v for name, v in _leaves(record) if v.size >= FEWEST_ROWS}
    rows = Counter(max(v.shape) for v in leaves.values())
    if not rows:
        return ImportedTable({}, {})
    length = rows.most_common(1)[0][0]
    numeric: dict[str, Array] = {}
    skipped = []
    for name, values in leaves.items():
        columns = _columns(name, values, length)
        if columns:
            numeric |= columns
        else:
            skipped.append(plain_name(name))
    numeric = dict(list(numeric.items())[:MOST_COLUMNS])
    units = {n: u for n, u in _texts(record.get("units", {})) if n in numeric}
    if skipped:
        notes = (*notes, f"arrays that are not of {length} samples, left out: {listed(skipped, 12)}")
    return ImportedTable(
        {n: np.where(np.isinf(v), np.nan, v) for n, v in numeric.items()}, {}, units=units, notes=notes
    )


def _leaves(node: Any, name: str = "") -> Iterator[tuple[str, Array]]:
    """Path and values of each array of numbers in a record."""
    if isinstance(node, np.ndarray):
        yield name, node
    elif isinstance(node, dict):
        for key, value in node.items():
            if name or key not in _DESCRIPTIONS:
                yield from _leaves(value, f"{name}.{key}" if name else key)
    elif isinstance(node, list):
        for i, value in enumerate(node):
            yield from _leaves(value, f"{name}[{i}]")


def _texts(node: Any, name: str = "") -> Iterator[tuple[str, str]]:
    """Path and content of each text."""
    if isinstance(node, str):
        yield name, node
    elif isinstance(node, dict):
        for key, value in node.items():
            yield from _texts(value, f"{name}.{key}" if name else key)


def _columns(name: str, values: Array, length: int) -> dict[str, Array]:
    """Name -> (length,) of a vector, or of each column of a matrix; empty for an array of another length."""
    if values.size == length:
        return {name: values.ravel()}
    flat = values.reshape(values.shape[0], -1, order="F")
    if flat.shape[0] != length and values.ndim == 2 and values.shape[1] == length:
        flat = values.T
    if flat.shape[0] != length or flat.shape[1] > MOST_COLUMNS:
        return {}
    return {f"{name}[{i}]": column for i, column in enumerate(flat.T)}
