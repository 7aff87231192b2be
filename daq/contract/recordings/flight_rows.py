"""The rows of a calibrated flight in MCAP as one table, whatever the file claims about itself.

Nothing in the file is executed or believed: the schema in it gives names and numbers of columns, and only those; the rows are
decoded by a message class made here from them.
"""

import json
from collections.abc import Mapping
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
    rows = segment.kept.get(FLIGHT_TOPIC, ())
    numbers = _columns(segment)
    if not table_fits(len(rows), len(numbers), segment.size):
        raise FlightRowsError(
            f"{segment.path}: claims {len(rows)} rows of {len(numbers)} columns, more than a file of its size can hold"
        )
    cls = _message_class(numbers)
    column = {number: i for i, number in enumerate(numbers.values())}
    values = np.full((len(rows), len(numbers)), np.nan)
    for i, data in enumerate(rows):
        try:
            row = cls.FromString(data)
        except DecodeError as error:
            raise FlightRowsError(f"{segment.path}: row {i} of the flight is none ({error})") from error
        for field, value in row.ListFields():
            values[i, column[field.number]] = value
    return FlightRows(tuple(numbers), values)


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
