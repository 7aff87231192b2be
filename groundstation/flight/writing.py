"""Flights into files: MCAP, CSV and Parquet; a file is replaced whole, or not at all."""

import csv
import hashlib
import json
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.contract.durable import whole
from groundstation.flight.credible_columns import field_names
from groundstation.flight.errors import FlightError
from groundstation.flight.findings import to_meta
from groundstation.flight.tables import FlightView
from groundstation.flight.utc import offset_in, stamps

FLIGHT_TOPIC = "/flight"
FLIGHT_SCHEMA = "sideslip.FlightSample"
METADATA_NAME = "sideslip.flight"


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
    import pyarrow as pa
    import pyarrow.parquet as pq

    table = pa.table({"time": flight.time, **dict(flight.columns), "segment": flight.segment})
    pq.write_table(table.replace_schema_metadata({METADATA_NAME: json.dumps(_provenance_to(flight))}), path)


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


def _message_class(names: Sequence[str]) -> tuple[Any, bytes]:
    """Protobuf class with one optional double per column, and its serialised descriptor set."""
    from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

    kind = descriptor_pb2.FieldDescriptorProto
    file = descriptor_pb2.FileDescriptorProto(name="sideslip/flight.proto", package="sideslip", syntax="proto3")
    message = file.message_type.add(name=FLIGHT_SCHEMA.split(".")[1])
    for i, name in enumerate(names):
        message.field.add(
            name=name,
            number=i + 1,
            type=kind.TYPE_DOUBLE,
            label=kind.LABEL_OPTIONAL,
            proto3_optional=True,
            oneof_index=i,
        )
        message.oneof_decl.add(name=f"_{name}")
    pool = descriptor_pool.DescriptorPool()
    pool.Add(file)  # type: ignore[no-untyped-call]
    cls = message_factory.GetMessageClass(pool.FindMessageTypeByName(FLIGHT_SCHEMA))
    return cls, descriptor_pb2.FileDescriptorSet(file=[file]).SerializeToString()


def _write_mcap(flight: FlightView, path: Path) -> None:
    with open_flight_writer(flight, path, stamps(flight.time, offset_in(flight.provenance.detail))):
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
    cls, schema = _message_class(names)
    table = np.column_stack([flight.time, *flight.columns.values(), flight.segment])
    with path.open("wb") as handle:
        writer = Writer(handle, compression=CompressionType.ZSTD)
        writer.start(profile="sideslip", library=f"sideslip {flight.provenance.software}".strip())
        text = json.dumps(_provenance_to(flight))
        writer.add_metadata(METADATA_NAME, {"json": text, "sha256": value_digest(text, names, table)})
        schema_id = writer.register_schema(FLIGHT_SCHEMA, "protobuf", schema)
        channel = writer.register_channel(FLIGHT_TOPIC, "protobuf", schema_id)
        for i, row in enumerate(table.tolist()):
            data = cls(**{n: v for n, v in zip(names, row, strict=True) if v == v}).SerializeToString()
            stamp = max(0, int(stamps[i]))
            writer.add_message(channel, stamp, data, stamp, i)
        yield _Adder(writer)
        writer.finish()


@dataclass(frozen=True, slots=True)
class Encoded:
    """A message that is no protobuf one: its bytes, and what an MCAP channel says of them."""

    data: bytes
    schema: str
    schema_encoding: str
    definition: str
    encoding: str


class _Adder:
    """Messages of other schemas beside a flight's own; schemas and channels are registered when first used."""

    def __init__(self, writer: Any) -> None:
        self._writer = writer
        self._channels: dict[str, int] = {}

    def __call__(self, topic: str, stamp: int, message: Any) -> None:
        if isinstance(message, Encoded):
            self._add_encoded(topic, stamp, message)
            return
        if topic not in self._channels:
            from mcap_protobuf.schema import build_file_descriptor_set

            described = build_file_descriptor_set(type(message)).SerializeToString()
            schema = self._writer.register_schema(message.DESCRIPTOR.full_name, "protobuf", described)
            self._channels[topic] = self._writer.register_channel(topic, "protobuf", schema)
        self._writer.add_message(self._channels[topic], stamp, message.SerializeToString(), stamp)

    def _add_encoded(self, topic: str, stamp: int, message: Encoded) -> None:
        if topic not in self._channels:
            found = (message.schema, message.schema_encoding, message.definition.encode())
            schema = self._writer.register_schema(*found)
            self._channels[topic] = self._writer.register_channel(topic, message.encoding, schema)
        self._writer.add_message(self._channels[topic], stamp, message.data, stamp)


def value_digest(provenance: str, names: Sequence[str], table: NDArray[np.float64]) -> str:
    """SHA-256 over provenance, names and values: MCAP's checksums cover neither schemas nor metadata."""
    digest = hashlib.sha256(json.dumps([provenance, *names]).encode())
    for rows in np.array_split(table, max(1, table.size // 1_000_000)):  # no copy of the whole table
        digest.update(np.ascontiguousarray(np.where(np.isnan(rows), np.nan, rows), "<f8").tobytes())
    return digest.hexdigest()
