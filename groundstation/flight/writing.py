"""Flights into files: MCAP, CSV and Parquet. A file is replaced completely or not at all. Stamps in MCAP are UTC if known."""

import csv
import hashlib
import json
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from daq.utilities.durable import whole, write_bytes
from daq.utilities.packages import optional
from groundstation.flight.errors import FlightError
from groundstation.flight.findings import to_meta
from groundstation.flight.tables import FlightView

if TYPE_CHECKING:
    import rerun as rr

FLIGHT_TOPIC = "/flight"
FLIGHT_SCHEMA = "sideslip.FlightSample"
METADATA_NAME = "sideslip.flight"
UTC_KEY = "utc_offset_s"
"""Key of a provenance's detail: UTC [s since 1970] minus flight time [s]; missing where the aircraft never had UTC."""
_ROWS_AT_ONCE = 4096  # of a flight turned into messages: a few megabytes
LAST_UTC_S = 4.0e9  # in 2096: a later time is a receiver's error, and nanoseconds must fit into 64 bits


def write_flight(flight: FlightView, path: str | Path) -> None:
    """Write a flight as .mcap, .csv or .parquet, by suffix; reading it back gives the same arrays."""
    path = Path(path)
    writers = {".mcap": _write_mcap, ".csv": _write_csv, ".parquet": _write_parquet}
    if path.suffix.lower() not in writers:
        raise FlightError(f"{path}: cannot write this kind of file; name it .mcap, .csv or .parquet")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with whole(path) as new:
            writers[path.suffix.lower()](flight, new)
    except OSError as error:
        raise FlightError(f"{path}: cannot be written ({error.strerror or error}); choose another place") from error


def _write_csv(flight: FlightView, path: Path) -> None:
    names = ["time", *flight.columns, "segment"]
    table = [flight.time, *flight.columns.values(), flight.segment]
    with path.open("w", newline="", encoding="utf-8") as handle:
        writer = csv.writer(handle)
        writer.writerow(names)
        for row in zip(*(c.tolist() for c in table), strict=True):
            writer.writerow(["" if v != v else v for v in row])


def _write_parquet(flight: FlightView, path: Path) -> None:
    pa, pq = optional("pyarrow", "writing Parquet"), optional("pyarrow.parquet", "writing Parquet")
    table = pa.table({"time": flight.time, **dict(flight.columns), "segment": flight.segment})
    with path.open("wb") as file:
        pq.write_table(table.replace_schema_metadata({METADATA_NAME: json.dumps(_provenance_to(flight))}), file)


def _provenance_to(flight: FlightView) -> dict[str, Any]:
    p = flight.provenance
    return {
        "source": p.source,
        "aircraft": p.aircraft,
        "software": p.software,
        "calibration": dict(p.calibration),
        "detail": dict(p.detail),
        "derived_from": {"path": p.path, "sha256": p.sha256},
        "name": flight.name,
        **to_meta(flight.notes),
    }


def field_names(names: Iterable[str]) -> list[str]:
    """Unique names for fields of an MCAP flight: other characters than letters and digits become underscores."""
    unique: dict[str, None] = {}
    for name in names:
        first = label = (
            name if name.isascii() and name.isidentifier() else "_" + re.sub(r"\W+", "_", name, flags=re.ASCII)
        )
        while label in unique:
            label = f"{first}_{len(unique)}"
        unique[label] = None
    return list(unique)


def _schema(names: Sequence[str]) -> bytes:
    """Serialised descriptor set of a protobuf message with one optional double per column."""
    from google.protobuf import descriptor_pb2

    kind = descriptor_pb2.FieldDescriptorProto
    file = descriptor_pb2.FileDescriptorProto(name="sideslip/flight.proto", package="sideslip", syntax="proto3")
    message = file.message_type.add(name=FLIGHT_SCHEMA.split(".")[1])
    for i, name in enumerate(names):
        number = {"number": i + 1, "oneof_index": i, "proto3_optional": True}
        message.field.add(name=name, type=kind.TYPE_DOUBLE, label=kind.LABEL_OPTIONAL, **number)
        message.oneof_decl.add(name=f"_{name}")
    return descriptor_pb2.FileDescriptorSet(file=[file]).SerializeToString()


def _encoded_rows(table: NDArray[np.float64]) -> Iterator[bytes]:
    """Rows as protobuf messages of `_schema`, without NaN: for each field its tag, then eight bytes. An object per row would take
    ten times as long."""
    from google.protobuf.internal.encoder import TagBytes
    from google.protobuf.internal.wire_format import WIRETYPE_FIXED64

    tags = [np.frombuffer(TagBytes(i + 1, WIRETYPE_FIXED64), np.uint8) for i in range(table.shape[1])]
    sizes = np.array([tag.size + 8 for tag in tags])
    heads = np.concatenate([np.append(tag, np.zeros(8, np.uint8)) for tag in tags])
    value_bytes = np.concatenate([np.arange(at - 8, at) for at in np.cumsum(sizes)])
    for rows in np.array_split(table, -(-len(table) // _ROWS_AT_ONCE) or 1):
        encoded = np.tile(heads, (len(rows), 1))
        encoded[:, value_bytes] = (
            np.ascontiguousarray(rows, "<f8").view(np.uint8).reshape(len(rows), 8 * table.shape[1])
        )
        present = ~np.isnan(rows)
        data, ends = encoded[np.repeat(present, sizes, axis=1)].tobytes(), np.cumsum(present @ sizes).tolist()
        yield from (data[start:end] for start, end in pairwise([0, *ends]))


def _write_mcap(flight: FlightView, path: Path) -> None:
    with open_flight_writer(flight, path, utc_stamps(flight.time, provenance_utc_offset(flight.provenance.detail))):
        pass


@contextmanager
def open_flight_writer(
    flight: FlightView, path: Path, stamps: NDArray[np.int64]
) -> Iterator[Callable[[str, int, Any], None]]:
    """Write a flight's own messages, then give a function that adds (topic, stamp [ns], protobuf message) of other kinds.

    stamps: (N,) log times of the samples [ns]. Raises FlightError for a column name that cannot be a field.
    """
    from mcap.writer import CompressionType, Writer

    names = field_names(["time", *flight.columns, "segment"])
    schema = _schema(names)
    table = np.column_stack([flight.time, *flight.columns.values(), flight.segment])
    with path.open("wb") as handle:
        writer = Writer(handle, compression=CompressionType.ZSTD)
        writer.start(profile="sideslip", library=f"sideslip {flight.provenance.software}".strip())
        text = json.dumps(_provenance_to(flight))
        writer.add_metadata(METADATA_NAME, {"json": text, "sha256": value_digest(text, names, table)})
        schema_id = writer.register_schema(FLIGHT_SCHEMA, "protobuf", schema)
        channel = writer.register_channel(FLIGHT_TOPIC, "protobuf", schema_id)
        for i, (data, stamp) in enumerate(zip(_encoded_rows(table), np.maximum(stamps, 0).tolist(), strict=True)):
            writer.add_message(channel, stamp, data, stamp, i)
        yield _MessageAdder(writer)
        writer.finish()


@dataclass(frozen=True, slots=True)
class Encoded:
    """A message that is not protobuf: its bytes, and their description for an MCAP channel."""

    data: bytes
    schema: str
    schema_encoding: str
    definition: str
    encoding: str


class _MessageAdder:
    """Messages of other schemas beside a flight's own; schemas and channels are registered when first used."""

    def __init__(self, writer: Any) -> None:
        self._writer = writer
        self._channels: dict[str, int] = {}

    def __call__(self, topic: str, stamp: int, message: Any) -> None:
        encoded = isinstance(message, Encoded)
        if topic not in self._channels:
            kind, encoding, definition = self._schema(message)
            schema = self._writer.register_schema(kind, encoding, definition)
            channel_encoding = message.encoding if encoded else "protobuf"
            self._channels[topic] = self._writer.register_channel(topic, channel_encoding, schema)
        data = message.data if encoded else message.SerializeToString()
        self._writer.add_message(self._channels[topic], stamp, data, stamp)

    @staticmethod
    def _schema(message: Any) -> tuple[str, str, bytes]:
        if isinstance(message, Encoded):
            return message.schema, message.schema_encoding, message.definition.encode()
        from mcap_protobuf.schema import build_file_descriptor_set

        described = build_file_descriptor_set(type(message)).SerializeToString()
        return message.DESCRIPTOR.full_name, "protobuf", described


def value_digest(provenance: str, names: Sequence[str], table: NDArray[np.float64]) -> str:
    """SHA-256 over provenance, names and values: MCAP's checksums cover neither schemas nor metadata."""
    digest = hashlib.sha256(json.dumps([provenance, *names]).encode())
    for rows in np.array_split(table, max(1, table.size // 1_000_000)):  # no copy of the whole table
        digest.update(np.ascontiguousarray(np.where(np.isnan(rows), np.nan, rows), "<f8").tobytes())
    return digest.hexdigest()


def provenance_utc_offset(detail: Mapping[str, Any]) -> float | None:
    """UTC minus flight time [s] from the detail of a provenance; None without a possible one."""
    value = detail.get(UTC_KEY)
    return float(value) if isinstance(value, int | float) and 0 <= value < LAST_UTC_S else None


def utc_stamps(time: NDArray[np.float64], offset: float | None) -> NDArray[np.int64]:
    """(N,) nanoseconds: UTC since 1970 where the offset is known, else flight time; never negative, rising with the samples."""
    return np.maximum(np.round(time * 1e9).astype(np.int64) + round((offset or 0.0) * 1e9), 0)


@contextmanager
def rerun_file(stream: "rr.RecordingStream", path: Path, blueprint: Any) -> Iterator[None]:
    """Write everything logged to a rerun stream within the context to `path` at its end, completely or not at all.

    blueprint: the layout. Raises OSError that names the file. rerun's own file sink reports no full disk, and then waits for
    ever. The data stay in memory until the end, some 10 bytes a value: each read of rerun's stream would be a recording of its
    own.
    """
    encoded = stream.binary_stream()
    try:
        # make it active, or a viewer makes a layout by itself: the stream names its recording first
        stream.send_blueprint(blueprint)
        yield
        write_bytes(path, encoded.read() or b"")
    finally:
        stream.disconnect()
