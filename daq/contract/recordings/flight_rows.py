"""The rows of a calibrated flight in MCAP as one table, whatever the file claims about itself.

Nothing in the file is executed or believed: the schema in it gives names and numbers of columns, and only those; the rows are
decoded by a message class made here from them.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from google.protobuf import descriptor_pb2
from google.protobuf.message import DecodeError
from numpy.typing import NDArray

from daq.contract.recordings.segments import FLIGHT_METADATA, FLIGHT_TOPIC, RecordingWalk
from daq.contract.seal import message_class
from daq.utilities.errors import UserError

FLIGHT_SCHEMA = "sideslip.FlightSample"
MAX_COLUMNS = 4096
"""Columns of a flight. Ours has 52; a wide log of an autopilot some hundred."""
_CELLS = 12_000_000
_CELLS_PER_BYTE = 0.75
"""Cells a table may have: as many as any file (96 MB), more where the file is larger. A cell takes nine bytes in a row before
compression, more than one after it where values are measured; absent cells are nearly free, and so they are what is forged."""

_FIXED64 = 1
"""Wire type of a double in protobuf."""
_KEY_BITS = 21
"""Of the key of a column below MAX_COLUMNS, in groups of seven."""
_MOST_LAYOUTS = 16
"""Of rows of one length that are decoded in bulk; what is left is decoded row by row."""


class FlightRowsError(UserError):
    """Rows that are no flight."""


@dataclass(frozen=True)
class FlightRows:
    """values: (rows, columns), NaN where a row does not set a column. names: of the columns, `time` and `segment` among them."""

    names: tuple[str, ...]
    values: NDArray[np.float64]

    @cached_property
    def samples(self) -> dict[str, int]:
        """How many rows set each column."""
        return dict(zip(self.names, (~np.isnan(self.values)).sum(axis=0).tolist(), strict=True))

    @property
    def duration_s(self) -> float:
        """Time of the last row after the first [s]; 0 where there are none."""
        if "time" not in self.names or not len(self.values):
            return 0.0
        time = self.values[:, self.names.index("time")]
        span = float(time[-1] - time[0])
        return span if np.isfinite(span) else 0.0


def flight_rows(segment: RecordingWalk) -> FlightRows:
    """The flight in a file that has been walked through. Raises FlightRowsError when its schema or rows are none of a flight."""
    rows = segment.auxiliary.get(FLIGHT_TOPIC, ())
    numbers = _columns(segment)
    if not table_fits(len(rows), len(numbers), segment.size):
        raise FlightRowsError(
            f"{segment.path}: claims {len(rows)} rows of {len(numbers)} columns, more than a file of its size can hold"
        )
    cls = _message_class(numbers)
    column = {number: i for i, number in enumerate(numbers.values())}
    values = np.full((len(rows), len(numbers)), np.nan)
    for i in _rows_in_bulk(rows, column, values):
        try:
            row = cls.FromString(rows[i])
        except DecodeError as error:
            raise FlightRowsError(f"{segment.path}: row {i} of the flight is none ({error})") from error
        for field, value in row.ListFields():
            values[i, column[field.number]] = value
    return FlightRows(tuple(numbers), values)


def _rows_in_bulk(rows: Sequence[bytes], column: Mapping[int, int], values: NDArray[np.float64]) -> list[int]:
    """Fills in rows that set the same columns in the same order, many at once; those that are left, in rising order.

    A row of doubles alone is a key and eight bytes for each: rows as long as one of them, with its keys at the same places, are
    laid out as it is.
    """
    lengths = np.fromiter(map(len, rows), np.int64, len(rows))
    order = np.argsort(lengths, kind="stable")
    rest: list[int] = []
    for remaining in np.split(order, np.flatnonzero(np.diff(lengths[order])) + 1):
        length = int(lengths[remaining[0]]) if remaining.size else 0
        if not length:  # rows that set nothing
            continue
        for _ in range(_MOST_LAYOUTS):
            layout = _layout(rows[remaining[0]], column)
            if layout is None:
                break
            table = np.frombuffer(b"".join([rows[i] for i in remaining.tolist()]), np.uint8).reshape(-1, length)
            keys = np.ones(length, bool)
            for place, _ in layout:
                keys[place : place + 8] = False
            alike = np.all(table[:, keys] == table[0, keys], axis=1)
            for place, name in layout:
                values[remaining[alike], name] = np.ascontiguousarray(table[alike, place : place + 8]).view("<f8")[:, 0]
            remaining = remaining[~alike]
            if not remaining.size:
                break
        rest += remaining.tolist()
    return sorted(rest)


def _layout(row: bytes, column: Mapping[int, int]) -> list[tuple[int, int]] | None:
    """Place of each double of a row, and its column; None where the row is not laid out as we write it."""
    layout, place = [], 0
    while place < len(row):
        key, shift = 0, 0
        while place < len(row) and shift < _KEY_BITS:
            byte = row[place]
            key, shift, place = key | (byte & 0x7F) << shift, shift + 7, place + 1
            if byte < 0x80:
                break
        number = key >> 3
        if key & 7 != _FIXED64 or byte >= 0x80 or number not in column or place + 8 > len(row):
            return None
        layout.append((place, column[number]))
        place += 8
    return layout


def _columns(segment: RecordingWalk) -> dict[str, int]:
    """Field number of each column, from the schema in the file."""
    name, data = segment.schemas.get(FLIGHT_TOPIC, ("", b""))
    try:
        files = descriptor_pb2.FileDescriptorSet.FromString(data)
    except DecodeError as error:
        raise FlightRowsError(f"{segment.path}: the schema of the flight is none ({error})") from error
    package, _, kind = FLIGHT_SCHEMA.partition(".")
    messages = [m for f in files.file if f.package == package for m in f.message_type if m.name == kind]
    fields = messages[0].field if name == FLIGHT_SCHEMA and messages else []
    numbers = {f.name: f.number for f in fields}
    usable = all(
        f.type == f.TYPE_DOUBLE
        and f.label == f.LABEL_OPTIONAL
        and f.name.isidentifier()
        and 0 < f.number <= MAX_COLUMNS
        for f in fields
    )
    if not numbers or not usable or len(set(numbers.values())) != len(fields) or len(numbers) != len(fields):
        raise FlightRowsError(f"{segment.path}: the schema of the flight does not name up to {MAX_COLUMNS} columns")
    return numbers


def _message_class(numbers: Mapping[str, int]) -> Any:
    """Protobuf class with one optional double per column."""
    kind = descriptor_pb2.FieldDescriptorProto
    file = descriptor_pb2.FileDescriptorProto(name="rows.proto", package="sideslip", syntax="proto3")
    message = file.message_type.add(name="Row")
    for i, (name, number) in enumerate(numbers.items()):
        message.field.add(
            name=name,
            number=number,
            type=kind.TYPE_DOUBLE,
            label=kind.LABEL_OPTIONAL,
            proto3_optional=True,
            oneof_index=i,
        )
        message.oneof_decl.add(name=f"_{i}_")
    return message_class("sideslip.Row", descriptor_pb2.FileDescriptorSet(file=[file]))


def described(segment: RecordingWalk) -> tuple[dict[str, Any], str, str]:
    """What a flight says of itself: its provenance, the text of it, and the digest stated; empty where unusable."""
    fields = next((m.fields for m in segment.metadata if m.name == FLIGHT_METADATA), {})
    text = fields.get("json", "")
    return json_object(text), text, fields.get("sha256", "")


def table_fits(rows: int, columns: int, file_size: int) -> bool:
    """Whether a file of `file_size` bytes can hold such a table: compressed, a few bytes claim billions of cells."""
    return columns <= MAX_COLUMNS and rows * columns <= max(_CELLS, _CELLS_PER_BYTE * file_size)


def json_object(text: str | bytes) -> dict[str, Any]:
    """A JSON object; empty for any other text."""
    try:
        return as_mapping(json.loads(text))
    except (ValueError, RecursionError):
        return {}


def as_mapping(value: object) -> dict[str, Any]:
    """A value of somebody's JSON where an object belongs."""
    return {str(k): v for k, v in value.items()} if isinstance(value, dict) else {}


def as_texts(value: object) -> list[str]:
    """A value of somebody's JSON where a list of sentences belongs."""
    return [str(v) for v in value] if isinstance(value, list) else []
