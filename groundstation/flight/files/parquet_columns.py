"""The columns of a Parquet file without nested ones, read one at a time and within bounds.

A footer of a kilobyte can announce 10^9 rows, and a compressed page of a few hundred bytes can unpack to two gigabytes. So the
number of rows and the stated size of each page are checked before Arrow reads it (parquet-format, "Data Pages" and `PageHeader`
of parquet.thrift). Arrow's own accessors of the footer abort the process where a column's statistics are inconsistent, so footer
and page headers are read here, as structs of Thrift's compact protocol (thrift-compact-protocol.md).
"""

import io
import struct
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from daq.utilities.errors import UserError
from daq.utilities.input_files import read_bytes
from daq.utilities.packages import optional
from groundstation.flight.arrays import Array

MOST_CELLS = 12_000_000
"""Of a table, or one per byte of the file if that is more: three hours at 50 Hz with twenty columns; 200 MB while it is read."""
MOST_ROWS = 4_000_000  # of a table, or one per four bytes of the file if that is more: eleven hours at 100 Hz
LARGEST_PAGE = 2**26  # bytes of a page when unpacked; writers make pages of 1 MB
MOST_COLUMNS = 4096  # of a table; a PX4 log with all its topics has some 3,000
MOST_VALUES = 1_000_000
"""Of a footer, or one per 16 bytes of the file if that is more: ten row groups of 3,000 columns, read in a second or two."""
_SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
_DEEPEST = 12  # nested values; the deepest of parquet.thrift's own (statistics of a column of a row group) is 6
_MOST_SCHEMA = 100_000  # elements of a list in the footer
_LONGEST_TEXT = 2**24  # bytes of a text in the footer


@dataclass
class ParquetColumns:
    """Columns of a Parquet file by name. numeric: (N,), NaN where empty. dates: (N,) [s] after the first date, or durations and
    times of day [s]. firsts: the first date of each [s since 1970]. words: cells of the wanted columns of text, empty for other
    columns that are not numbers. footer: the application's metadata."""

    numeric: dict[str, Array] = field(default_factory=dict)
    dates: dict[str, Array] = field(default_factory=dict)
    firsts: dict[str, float] = field(default_factory=dict)
    words: dict[str, list[str]] = field(default_factory=dict)
    footer: dict[bytes, bytes] = field(default_factory=dict)


def read_parquet(
    path: Path, error: type[UserError], wanted: Callable[[str], bool] = lambda name: False
) -> ParquetColumns:
    """The columns of numbers, dates and text. wanted: name of a column of text -> whether its cells are read.

    Raises `error` for a file that is not Parquet, is damaged, or would not fit the memory.
    """
    pa, pq = optional("pyarrow", "reading Parquet"), optional("pyarrow.parquet", "reading Parquet")
    data = read_bytes(path, error=error)
    try:
        limits = {"thrift_string_size_limit": _LONGEST_TEXT, "thrift_container_size_limit": _MOST_SCHEMA}
        file = pq.ParquetFile(io.BytesIO(data), **limits)
        content = ParquetColumns(footer=dict(file.schema_arrow.metadata or {}))
        _check_size(path, file.metadata, len(file.schema_arrow), len(data), error)
        chunks_by_name: dict[str, list[_Chunk]] = {}
        for i, chunks in enumerate(_chunks(data, len(file.schema))):
            chunks_by_name.setdefault(file.schema.column(i).path, []).extend(chunks)
        for item in file.schema_arrow:
            if item.name not in chunks_by_name or pa.types.is_nested(item.type):
                content.words[item.name] = []
                continue
            _check_pages(path, data, item.name, chunks_by_name[item.name], error)
            text = pa.types.is_string(item.type) or pa.types.is_large_string(item.type)
            reader = pq.ParquetFile(io.BytesIO(data), read_dictionary=[item.name], **limits) if text else file
            _add_column(content, item.name, reader.read(columns=[item.name]).column(0), wanted(item.name))
    except (pa.ArrowException, OSError, ValueError, OverflowError, KeyError, IndexError, MemoryError) as reason:
        message = " ".join(str(reason).split())[:200]
        raise error(f"{path}: not a readable Parquet file ({message or type(reason).__name__})") from reason
    lengths = {len(v) for v in (*content.numeric.values(), *content.dates.values())}
    if len(lengths) > 1:
        raise error(f"{path}: damaged Parquet file: its columns have {min(lengths)} to {max(lengths)} rows")
    return content


def _check_size(path: Path, metadata: Any, columns: int, size: int, error: type[UserError]) -> None:
    most_cells, most_rows = max(MOST_CELLS, size), max(MOST_ROWS, size // 4)
    if columns > MOST_COLUMNS:
        raise error(f"{path}: {columns} columns; at most {MOST_COLUMNS} are read")
    if metadata.num_rows * columns > most_cells or metadata.num_rows > most_rows:
        raise error(
            f"{path}: {metadata.num_rows} rows of {columns} columns; at most {most_rows} rows and {most_cells} cells are read; "
            "write it in parts, or with fewer columns"
        )


def _add_column(content: ParquetColumns, name: str, column: Any, wanted: bool) -> None:
    """Add an Arrow column to `content`, by its type. wanted: whether the cells of a text are read."""
    import pyarrow as pa
    import pyarrow.compute as pc

    if pa.types.is_timestamp(column.type):
        stamps = column.cast(pa.int64())
        first = pc.min(stamps).as_py() or 0
        scale = _SECONDS[column.type.unit]
        content.dates[name], content.firsts[name] = _floats(pc.subtract(stamps, first)) * scale, first * scale
        return
    if pa.types.is_duration(column.type) or pa.types.is_time(column.type):
        integers = (
            column.cast(pa.int32()).cast(pa.int64()) if pa.types.is_time32(column.type) else column.cast(pa.int64())
        )
        content.dates[name] = _floats(integers) * _SECONDS[column.type.unit]
        return
    if pa.types.is_dictionary(column.type):
        column = column.unify_dictionaries()
        dictionary = column.chunk(0).dictionary if column.num_chunks else pa.array([], pa.string())
        try:
            values = np.append(_floats(dictionary), np.nan)
            indices = [
                chunk.indices.fill_null(len(dictionary)).to_numpy(zero_copy_only=False) for chunk in column.chunks
            ]
            content.numeric[name] = values[np.concatenate(indices).astype(np.int64)] if indices else np.zeros(0)
        except pa.ArrowException:
            content.words[name] = _cells(dictionary.to_pylist(), column) if wanted else []
        return
    try:
        content.numeric[name] = _floats(column)
    except pa.ArrowException:
        content.words[name] = []


def _floats(column: Any) -> Array:
    """(N,) an Arrow column as numbers, NaN where empty. Raises ArrowException where it holds none."""
    import pyarrow as pa

    with np.errstate(over="ignore"):
        return np.array(column.cast(pa.float64(), safe=False).to_numpy(zero_copy_only=False), float)


def _cells(words: list[str], column: Any) -> list[str]:
    """The cells of a column of text, empty ones as "". words: its dictionary."""
    labels = [*words, ""]
    return [labels[len(words) if i is None else i] for chunk in column.chunks for i in chunk.indices.to_pylist()]


_Chunk = tuple[int, int]
"""First byte of the pages of a column in a row group, and the byte behind them, by the footer."""


def _chunks(data: bytes, columns: int) -> list[list[_Chunk]]:
    """For each of `columns` columns its chunks in all row groups, in the order of the schema, by which Arrow reads, and not by
    the names that the row groups repeat (parquet.thrift, `FileMetaData`, `RowGroup`, `ColumnChunk`, `ColumnMetaData`).

    Raises ValueError for an invalid footer.
    """
    position = len(data) - 8 - int.from_bytes(data[-8:-4], "little")
    footer = ThriftReader(data, position, max(MOST_VALUES, len(data) // 16)).struct()
    groups = [[_chunk(column, len(data)) for column in _structs(group.get(1))] for group in _structs(footer.get(4))]
    if any(len(group) != columns for group in groups):
        raise ValueError("a row group has not one chunk for each column")
    return [[group[i] for group in groups] for i in range(columns)]


def _chunk(column: dict[int, Any], size: int) -> _Chunk:
    meta = column.get(3)
    if not isinstance(meta, dict):
        raise ValueError("a column without a description")
    first, dictionary, packed = meta.get(9), meta.get(11, 0), meta.get(7)
    if not isinstance(first, int) or not isinstance(dictionary, int) or not isinstance(packed, int):
        raise ValueError("a column without a place in the file")
    if 0 < dictionary < first:
        first = dictionary
    if not 0 < first <= size or packed < 0:
        raise ValueError(f"a column at byte {first} of {size}")
    return first, min(first + packed, size)


def _structs(value: Any) -> list[dict[int, Any]]:
    if not isinstance(value, list) or not all(isinstance(v, dict) for v in value):
        raise ValueError("a footer that is none")
    return value


def _check_pages(path: Path, data: bytes, name: str, chunks: list[_Chunk], error: type[UserError]) -> None:
    """Raise `error` when a page of a column would unpack to more than LARGEST_PAGE."""
    for position, end in chunks:
        while position < end:
            reader = ThriftReader(data, position)
            header = reader.struct()
            unpacked, packed = header.get(2), header.get(3)
            if not isinstance(unpacked, int) or not isinstance(packed, int):
                raise ValueError(f"column {name}: a page without a size")
            if not 0 <= unpacked <= LARGEST_PAGE or packed < 0:
                raise error(
                    f"{path}: column {name}: a page of {unpacked} bytes unpacked; at most {LARGEST_PAGE} are read"
                )
            position = reader.end + packed


class ThriftReader:
    """Reads values of Thrift's compact protocol in sequence. end: position of the next value. most: values that are read, with
    those within lists and structs.

    Raises ValueError, and nothing else, for bytes that are not valid or hold more values.
    """

    def __init__(self, data: bytes, at: int = 0, most: int = 1000) -> None:
        self._data = data
        self._left = most
        self.end = at

    def struct(self, depth: int = _DEEPEST) -> dict[int, Any]:
        """Number of each field -> its value, the last one of a repeated number."""
        fields: dict[int, Any] = {}
        number = 0
        while (head := self._byte()) != 0:
            number = number + (head >> 4) if head >> 4 else self._signed()
            fields[number] = self._value(head & 15, depth) if head & 15 not in (1, 2) else self._counted(head & 15 == 1)
        return fields

    def _value(self, kind: int, depth: int) -> Any:
        """A value of a type: 1, 2 booleans of a list, in a byte; 3 byte; 4 to 6 integers; 7 double; 8 bytes; 9, 10 lists; 12
        struct."""
        self._counted()
        if depth <= 0:
            raise ValueError("a header nested too deep")
        if kind in (1, 2, 3):
            return self._byte()
        if kind in (4, 5, 6):
            return self._signed()
        if kind == 7:
            return struct.unpack("<d", self._take(8))[0]
        if kind == 8:
            return self._take(self._varint())
        if kind in (9, 10):
            return self._list(depth)
        if kind == 12:
            return self.struct(depth - 1)
        raise ValueError("a header that is none")

    def _counted(self, value: bool = True) -> bool:
        """Count one value against the limit, and pass it on."""
        self._left -= 1
        if self._left < 0:
            raise ValueError("a header of too many values")
        return value

    def _list(self, depth: int) -> list[Any]:
        head = self._byte()
        length = head >> 4 if head >> 4 < 15 else self._varint()
        return [self._value(head & 15, depth - 1) for _ in range(length)]

    def _byte(self) -> int:
        return self._take(1)[0]

    def _take(self, length: int) -> bytes:
        if length > len(self._data) - self.end:
            raise ValueError("a header runs out of the file")
        self.end += length
        return self._data[self.end - length : self.end]

    def _varint(self) -> int:
        value = 0
        for shift in range(0, 70, 7):
            byte = self._byte()
            value |= (byte & 127) << shift
            if byte < 128:
                return value
        raise ValueError("a header holds a number without end")

    def _signed(self) -> int:
        value = self._varint()
        return value >> 1 ^ -(value & 1)
