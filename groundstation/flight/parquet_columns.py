"""The plain columns of a Parquet file, read one at a time and never beyond what its bytes can stand for.

A footer of a kilobyte can announce a thousand million rows, and a compressed page of a few hundred bytes become two
gigabytes: rows and the size that each page claims are looked at before Arrow reads it (parquet-format, "Data Pages" and
`PageHeader` of parquet.thrift).
"""

import io
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.contract.errors import UserError
from daq.contract.input_files import read_bytes

Array = NDArray[np.float64]

MOST_CELLS = 12_000_000
"""Of a table, or one a byte of the file where that is more: three hours at 50 Hz with twenty columns; 200 MB while it is read."""
MOST_ROWS = 4_000_000
"""Of a table, or one for four bytes of the file where that is more: eleven hours at 100 Hz."""
LARGEST_PAGE = 2**26
"""Bytes of a page when unpacked; writers make pages of 1 MB."""
MOST_COLUMNS = 4096
"""Of a table; a PX4 log with all its topics has some 3,000."""
_MOST_SCHEMA = 100_000  # elements of a list in the footer
_LONGEST_TEXT = 2**24  # bytes of a text in the footer


@dataclass
class ParquetColumns:
    """Columns of a Parquet file by name. numeric: (N,) with NaN where empty; dates: (N,) [s] after the first; words: cells of
    columns of text that were asked for, none of the others; footer: the application's own metadata."""

    numeric: dict[str, Array] = field(default_factory=dict)
    dates: dict[str, Array] = field(default_factory=dict)
    words: dict[str, list[str]] = field(default_factory=dict)
    footer: dict[bytes, bytes] = field(default_factory=dict)


def read_parquet(
    path: Path, error: type[UserError], wanted: Callable[[str], bool] = lambda name: False
) -> ParquetColumns:
    """The columns of numbers, dates and text. wanted: whether the cells of a column of text are.

    Raises `error` for a file that is none, is damaged, or would not fit the memory.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    data = read_bytes(path, error=error)
    try:
        limits = {"thrift_string_size_limit": _LONGEST_TEXT, "thrift_container_size_limit": _MOST_SCHEMA}
        file = pq.ParquetFile(io.BytesIO(data), **limits)
        out = ParquetColumns(footer=dict(file.schema_arrow.metadata or {}))
        _check_size(path, file.metadata, len(file.schema_arrow), len(data), error)
        plain = {file.schema.column(i).path: i for i in range(len(file.schema))}
        for item in file.schema_arrow:
            if item.name not in plain or pa.types.is_nested(item.type):
                out.words[item.name] = []
                continue
            _check_pages(path, data, file.metadata, plain[item.name], error)
            text = pa.types.is_string(item.type) or pa.types.is_large_string(item.type)
            reader = pq.ParquetFile(io.BytesIO(data), read_dictionary=[item.name], **limits) if text else file
            _keep(out, item.name, reader.read(columns=[item.name]).column(0), wanted(item.name))
    except (pa.ArrowException, OSError, ValueError, OverflowError, KeyError, IndexError, MemoryError) as reason:
        said = " ".join(str(reason).split())[:200]
        raise error(f"{path}: not a readable Parquet file ({said or type(reason).__name__})") from reason
    lengths = {len(v) for v in (*out.numeric.values(), *out.dates.values())}
    if len(lengths) > 1:
        raise error(f"{path}: damaged Parquet file: its columns have {min(lengths)} to {max(lengths)} rows")
    return out


def _check_size(path: Path, metadata: Any, columns: int, size: int, error: type[UserError]) -> None:
    most, most_rows = max(MOST_CELLS, size), max(MOST_ROWS, size // 4)
    if columns > MOST_COLUMNS:
        raise error(f"{path}: {columns} columns; at most {MOST_COLUMNS} are read")
    if metadata.num_rows * columns > most or metadata.num_rows > most_rows:
        raise error(
            f"{path}: {metadata.num_rows} rows of {columns} columns; at most {most_rows} rows and {most} cells are read; "
            "write it in parts, or with fewer columns"
        )


def _keep(out: ParquetColumns, name: str, column: Any, wanted: bool) -> None:
    import pyarrow as pa
    import pyarrow.compute as pc

    if pa.types.is_timestamp(column.type):
        stamps = column.cast(pa.int64())
        first = pc.min(stamps).as_py() or 0
        scale = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}[column.type.unit]
        out.dates[name] = _floats(pc.subtract(stamps, first)) * scale
        return
    if pa.types.is_dictionary(column.type):
        column = column.unify_dictionaries()
        dictionary = column.chunk(0).dictionary if column.num_chunks else pa.array([], pa.string())
        try:
            values = np.append(_floats(dictionary), np.nan)
            indices = [
                chunk.indices.fill_null(len(dictionary)).to_numpy(zero_copy_only=False) for chunk in column.chunks
            ]
            out.numeric[name] = values[np.concatenate(indices).astype(np.int64)] if indices else np.zeros(0)
        except pa.ArrowException:
            out.words[name] = _cells(dictionary.to_pylist(), column) if wanted else []
        return
    try:
        out.numeric[name] = _floats(column)
    except pa.ArrowException:
        out.words[name] = []


def _floats(column: Any) -> Array:
    import pyarrow as pa

    with np.errstate(over="ignore"):
        values = np.array(column.cast(pa.float64(), safe=False).to_numpy(zero_copy_only=False), float)
    return values


def _cells(words: list[str], column: Any) -> list[str]:
    shown = [*words, ""]
    return [shown[len(words) if i is None else i] for chunk in column.chunks for i in chunk.indices.to_pylist()]


def _check_pages(path: Path, data: bytes, metadata: Any, column: int, error: type[UserError]) -> None:
    """Raise `error` when a page of a column would unpack to more than LARGEST_PAGE."""
    for group in range(metadata.num_row_groups):
        chunk = metadata.row_group(group).column(column)
        starts = [o for o in (chunk.dictionary_page_offset, chunk.data_page_offset) if o]
        at = min(starts, default=0)
        end = min(at + chunk.total_compressed_size, len(data))
        while 0 < at < end:
            header = _PageHeader(data, at)
            if not 0 <= header.unpacked <= LARGEST_PAGE or header.packed < 0:
                raise error(
                    f"{path}: column {chunk.path_in_schema}: a page of {header.unpacked} bytes unpacked; at most {LARGEST_PAGE} "
                    "are read"
                )
            at = header.end + header.packed


class _PageHeader:
    """Sizes in the header of a page, Thrift compact protocol. Raises ValueError where there is none."""

    def __init__(self, data: bytes, at: int) -> None:
        self._data = data
        self.end = at
        self.unpacked = self.packed = -1
        for number, kind in self._fields():
            if number == 2 and kind == 5:
                self.unpacked = self._signed()
            elif number == 3 and kind == 5:
                self.packed = self._signed()
            else:
                self._skip(kind, 8)

    def _fields(self) -> Iterator[tuple[int, int]]:
        """Number and type of each field of a struct; the reader takes its value."""
        number = 0
        while (head := self._byte()) != 0:
            number = number + (head >> 4) if head >> 4 else self._signed()
            yield number, head & 15

    def _byte(self) -> int:
        if self.end >= len(self._data):
            raise ValueError("a page header runs out of the file")
        self.end += 1
        return self._data[self.end - 1]

    def _varint(self) -> int:
        value = 0
        for shift in range(0, 70, 7):
            byte = self._byte()
            value |= (byte & 127) << shift
            if byte < 128:
                return value
        raise ValueError("a page header holds a number without end")

    def _signed(self) -> int:
        value = self._varint()
        return value >> 1 ^ -(value & 1)

    def _skip(self, kind: int, depth: int) -> None:
        """Pass over a value: 1, 2 booleans, 3 byte, 4 to 6 integers, 7 double, 8 binary, 9, 10 lists, 12 struct."""
        if kind == 3:
            self._byte()
        elif kind in (4, 5, 6):
            self._varint()
        elif kind == 7:
            self.end += 8
        elif kind == 8:
            length = self._varint()
            self.end += length
        elif kind in (9, 10) and depth:
            head = self._byte()
            for _ in range(head >> 4 if head >> 4 < 15 else self._varint()):
                self._skip(head & 15, depth - 1)
                if head & 15 in (1, 2):
                    self._byte()
        elif kind == 12 and depth:
            for _, inner in self._fields():
                self._skip(inner, depth - 1)
        elif kind not in (1, 2):
            raise ValueError("a page header that is none")
