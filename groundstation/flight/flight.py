"""The calibrated flight: named columns over time, in SI and radians, with segments and provenance.

This is the hand-over between the ground station and the estimation package. A flight is read from MCAP (as written by
`sideslip calibrate`, `import` and `ground`), CSV or Parquet; columns and signs are those of `daq.contract.channels`.
NaN means "not measured". Time is checked on reading: unsorted rows are sorted, repeated instants dropped, and
gaps split the flight into segments, each of it said in `notes`.
"""

import csv
import hashlib
import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from daq.contract.channels import COLUMN_BY_NAME
from daq.contract.input_files import check_file
from daq.contract.plain_words import listed, one_line, plain_name
from daq.contract.recordings.claims import json_object, mapping
from groundstation.flight.credible_columns import credible_values, field_names, plain_names
from groundstation.flight.csv_columns import read_csv
from groundstation.flight.errors import FlightError, MissingColumnError
from groundstation.flight.notes import Note, NoteKind, as_note, from_meta, once, to_meta, unknown_columns
from groundstation.flight.parquet_columns import read_parquet
from groundstation.flight.utc import offset_in, stamps

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

Array = NDArray[np.float64]

GAP_FACTOR = 4.5
"""A step in time longer than this many median sample intervals is a gap: never integrated across."""

LATEST = 9e9
"""Latest time [s] of a sample, either way: what 64 bits of nanoseconds hold, 285 years."""

FLIGHT_TOPIC = "/flight"
FLIGHT_SCHEMA = "sideslip.FlightSample"
METADATA_NAME = "sideslip.flight"


AIRCRAFT_FILE = "aircraft_file"
"""Key of a provenance's detail under which the text of the aircraft's file travels with the flight."""
RECONSTRUCTED = "reconstructed"
"""Key of a provenance's detail: which columns were not measured but found from the others, from what, how sure."""


FOREIGN = "if another program wrote the file, convert it with 'sideslip import'"


@dataclass(frozen=True, slots=True)
class Provenance:
    """Where a flight's numbers come from, so that every result can be traced."""

    source: str = "imported"  # real | simulated | replayed | imported
    path: str = ""
    sha256: str = ""
    aircraft: str = ""
    software: str = ""
    calibration: Mapping[str, str] = field(default_factory=dict)  # calibration file -> sha256
    detail: Mapping[str, Any] = field(default_factory=dict)  # JSON-able extras (alignment, delays, noise, ...)


@dataclass(frozen=True, repr=False)
class Flight:
    """Calibrated columns of one flight over common time.

    time: (N,) seconds, strictly increasing. columns: name -> (N,) float64. segment: (N,) int, 0 upward in order of
    time; motion may be integrated within a segment, never from one to the next.
    """

    name: str
    time: Array
    columns: Mapping[str, Array]
    segment: NDArray[np.int64]
    provenance: Provenance = Provenance()
    notes: tuple[Note, ...] = ()

    @classmethod
    def build(
        cls,
        name: str,
        time: Array,
        columns: Mapping[str, Array],
        *,
        segment: NDArray[Any] | None = None,
        provenance: Provenance | None = None,
        notes: Iterable[Note | str] = (),
        gap_factor: float = GAP_FACTOR,
    ) -> "Flight":
        """A flight from raw arrays: sorts time, drops repeats, splits at gaps, and notes what it did.

        Raises FlightError when the arrays differ in length, fewer than two samples remain or time is not finite.
        """
        time = np.asarray(time, float)
        arrays = {k: np.asarray(v, float) for k, v in columns.items()}
        for key, values in arrays.items():
            if values.shape != time.shape:
                raise FlightError(f"{name}: column {key} has {values.size} samples, time has {time.size}")
        name = plain_name(name)
        labels = np.zeros(time.size, np.int64) if segment is None else np.asarray(segment).astype(np.int64)
        keep, order = _order(name, time)
        time, labels = time[keep], labels[keep]
        arrays = {k: v[keep] for k, v in arrays.items()}
        segments, gaps = _split(time, labels, gap_factor)
        # a flight read again finds the gaps it was written with
        said = (*notes, *(Note(NoteKind.TIME_ORDER, w) for w in order), *(Note(NoteKind.GAP, w) for w in gaps))
        return cls(name, time, MappingProxyType(arrays), segments, provenance or Provenance(), once(said))

    def __repr__(self) -> str:
        about = self.provenance
        known = f"{about.aircraft or 'unnamed aircraft'}, {about.source}"
        return (
            f"<Flight {self.name!r:.80}: {len(self)} samples, {self.time[-1] - self.time[0]:.2f} s at "
            f"{1.0 / self.sample_interval:.1f} Hz, {len(self.segments)} segment{'s' * (len(self.segments) > 1)}, "
            f"{sum(map(self.measured, self.columns))} columns measured, {known:.80}>"
        )

    def _repr_html_(self) -> str:
        from groundstation.flight.show import flight_html

        return flight_html(self)

    def __getstate__(self) -> dict[str, Any]:
        """Plain dictionaries in place of read-only views, which cannot be sent to another process."""
        return {**self.__dict__, "columns": dict(self.columns), "provenance": _plain(self.provenance)}

    def __arrow_c_stream__(self, requested_schema: object | None = None) -> object:
        """The Arrow stream protocol: polars, DuckDB, pandas and pyarrow take a flight as a table."""
        from groundstation.flight.tables import arrow_table, flight_table

        return arrow_table(flight_table(self)).__arrow_c_stream__(requested_schema)

    def to_pandas(self) -> "pd.DataFrame":
        """A frame indexed by time [s], with `segment`; units in `attrs["units"]`."""
        from groundstation.flight.tables import pandas_frame

        return pandas_frame(self)

    def to_xarray(self) -> "xr.Dataset":
        """A data set over time [s] with units and meaning as attributes."""
        from groundstation.flight.tables import xarray_dataset

        return xarray_dataset(self)

    def plot(self, *columns: str, ax: Any = None) -> Any:
        """Histories of columns (the motion and controls that were measured, where none is named); gives the axes.

        ax: one matplotlib axes, or as many as there are columns. Angles are drawn in degrees.
        """
        from groundstation.flight.show import plot_flight

        return plot_flight(self, columns, ax)

    def save(self, path: str | Path) -> Path:
        """Write .mcap, .csv or .parquet; `read_flight` gives the same arrays."""
        write_flight(self, path)
        return Path(path)

    def __getitem__(self, column: str) -> Array:
        try:
            return self.columns[column]
        except KeyError:
            raise MissingColumnError(self.name, [column], "this step") from None

    def __contains__(self, column: object) -> bool:
        return column in self.columns

    def __len__(self) -> int:
        return int(self.time.size)

    @property
    def sample_interval(self) -> float:
        """Median time between samples [s]."""
        return float(np.median(np.diff(self.time)))

    @property
    def segments(self) -> tuple[slice, ...]:
        """Index range of each segment, in order."""
        edges = np.flatnonzero(np.diff(self.segment)) + 1
        bounds = [0, *edges.tolist(), self.time.size]
        return tuple(slice(a, b) for a, b in zip(bounds, bounds[1:], strict=False))

    def measured(self, column: str) -> bool:
        """Whether the column exists and has at least one finite value."""
        return column in self.columns and bool(np.isfinite(self.columns[column]).any())

    def require(self, columns: Iterable[str], purpose: str) -> None:
        """Raise MissingColumnError naming every one of `columns` that is absent or entirely NaN."""
        missing = [c for c in columns if not self.measured(c)]
        if missing:
            raise MissingColumnError(self.name, missing, purpose, unknown=self.unknown_columns)

    @property
    def unknown_columns(self) -> tuple[str, ...]:
        """Columns that go by no name of `daq.contract.channels`."""
        return tuple(c for c in self.columns if c not in COLUMN_BY_NAME)

    def with_columns(self, **columns: Array) -> "Flight":
        """A copy with columns added or replaced."""
        return replace(self, columns=MappingProxyType({**self.columns, **columns}))

    def with_notes(self, *notes: Note | str) -> "Flight":
        """A copy with notes added."""
        return replace(self, notes=(*self.notes, *map(as_note, notes)))

    def part(self, keep: slice | NDArray[np.bool_], name: str | None = None) -> "Flight":
        """A copy of a range of samples; segments are renumbered from 0."""
        segment = self.segment[keep]
        _, renumbered = np.unique(segment, return_inverse=True)
        columns = MappingProxyType({k: v[keep] for k, v in self.columns.items()})
        return replace(
            self, name=name or self.name, time=self.time[keep], columns=columns, segment=renumbered.astype(np.int64)
        )


def _plain(provenance: Provenance) -> Provenance:
    return replace(provenance, calibration=dict(provenance.calibration), detail=dict(provenance.detail))


def _order(name: str, time: Array) -> tuple[NDArray[np.int64], list[str]]:
    """Indices that make time strictly increasing, and what had to be done for it."""
    notes: list[str] = []
    with np.errstate(invalid="ignore"):
        finite = np.flatnonzero(np.abs(time) < LATEST)
    endless = int(np.sum(np.abs(time[np.isfinite(time)]) >= LATEST))
    if endless:
        notes.append(f"{endless} rows with a time beyond 285 years dropped; is time in seconds?")
    if finite.size + endless < time.size:
        notes.append(f"{time.size - finite.size - endless} rows without a time dropped")
    steps = np.diff(time[finite])
    order = finite
    if np.any(steps < 0):
        order = finite[np.argsort(time[finite], kind="stable")]
        at = time[finite][1:][steps < 0][0]
        notes.append(f"time runs backwards {int(np.sum(steps < 0))} times (first at t = {at:g} s): rows sorted by time")
    repeated = np.concatenate([[False], np.diff(time[order]) == 0]) if order.size else np.zeros(0, bool)
    if repeated.any():
        at = time[order][repeated][0]
        notes.append(f"{int(repeated.sum())} repeated instants (first at t = {at:g} s): the first row of each kept")
    order = order[~repeated]
    if order.size < 2:
        hint = " in seconds (there are times beyond 285 years)" if endless else ""
        raise FlightError(
            f"{name}: only {order.size} usable samples; a flight needs at least two rows with a time{hint}"
        )
    return order, notes


def _split(time: Array, labels: NDArray[np.int64], gap_factor: float) -> tuple[NDArray[np.int64], list[str]]:
    """Segment number of each sample from the given labels and the gaps in time."""
    steps = np.diff(time)
    gap = steps > gap_factor * np.median(steps)
    notes = [
        f"gap of {steps[i]:.3g} s at t = {time[i]:g} s: split there, never integrated across"
        for i in np.flatnonzero(gap)
    ]
    if len(notes) > 5:
        notes = [*notes[:5], f"{len(notes) - 5} more gaps"]
    edge = gap | (np.diff(labels) != 0)
    return np.concatenate([[0], np.cumsum(edge)]).astype(np.int64), notes


# ------------------------------------------------------------------------------------------------ reading and writing


def read_flight(path: str | Path, *, gap_factor: float = GAP_FACTOR) -> Flight:
    """Read a flight from .mcap, .csv or .parquet.

    Unknown columns are kept and named in a note. Raises FlightError with one sentence for anything unusable.
    """
    path = Path(path)
    readers = {".mcap": _read_mcap, ".csv": _read_csv, ".parquet": _read_parquet}
    if path.suffix.lower() not in readers:
        raise FlightError(
            f"{path}: not a flight file; give .mcap, .csv or .parquet, or convert it with 'sideslip import'"
        )
    check_file(path, error=FlightError)
    columns, provenance, notes = readers[path.suffix.lower()](path)
    if "time" not in columns:
        raise FlightError(f"{path}: no column 'time' [s]; found {listed(columns) or 'nothing'}; {FOREIGN}")
    time = columns.pop("time")
    segment = columns.pop("segment", None)
    if segment is not None and not (np.all(np.isfinite(segment)) and np.all(segment == np.round(segment))):
        raise FlightError(
            f"{path}: column segment has empty cells or fractions; give an integer in each row or leave the column out"
        )
    if segment is not None and np.any(np.abs(segment) > 2**31):
        raise FlightError(f"{path}: column segment holds {np.max(np.abs(segment)):g}; number segments from 0")
    columns = plain_names(columns)
    columns, beyond = credible_values(columns)
    notes += beyond
    unknown = [c for c in columns if c not in COLUMN_BY_NAME]
    if unknown:
        notes.append(unknown_columns({c: c for c in unknown}))
    provenance = replace(provenance, path=str(path), sha256=hashlib.sha256(path.read_bytes()).hexdigest())
    return Flight.build(
        path.stem, time, columns, segment=segment, provenance=provenance, notes=notes, gap_factor=gap_factor
    )


def write_flight(flight: Flight, path: str | Path) -> None:
    """Write a flight as .mcap, .csv or .parquet, by suffix; reading it back gives the same arrays."""
    path = Path(path)
    writers = {".mcap": _write_mcap, ".csv": _write_csv, ".parquet": _write_parquet}
    if path.suffix.lower() not in writers:
        raise FlightError(f"{path}: cannot write this kind of file; name it .mcap, .csv or .parquet")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        writers[path.suffix.lower()](flight, path)
    except OSError as error:
        raise FlightError(f"{path}: cannot be written ({error.strerror or error}); choose another place") from error


_Read = tuple[dict[str, Array], Provenance, list[Note | str]]


def _read_csv(path: Path) -> _Read:
    try:
        return read_csv(path, FlightError), Provenance(), []
    except FlightError as error:
        raise FlightError(f"{error}; {FOREIGN}") from error


def _write_csv(flight: Flight, path: Path) -> None:
    names = ["time", *flight.columns, "segment"]
    table = [flight.time, *flight.columns.values(), flight.segment]
    with path.open("w", newline="", encoding="utf-8") as handle:
        writer = csv.writer(handle)
        writer.writerow(names)
        for row in zip(*(c.tolist() for c in table), strict=True):
            writer.writerow(["" if v != v else v for v in row])


def _read_parquet(path: Path) -> _Read:
    found = read_parquet(path, FlightError)
    notes: list[Note | str] = [
        f"column {plain_name(name)} is not numeric: left out" for name in (*found.words, *found.dates)
    ]
    if len(notes) > 30:
        notes = [*notes[:30], f"{len(notes) - 30} more columns are not numeric: left out"]
    meta = found.footer.get(METADATA_NAME.encode())
    about = json_object(meta) if meta else {}
    if meta and not about:
        notes.append("what the file says of its origin cannot be read: taken as not known")
    return found.numeric, _provenance_from(about) if about else Provenance(), notes


def _write_parquet(flight: Flight, path: Path) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    table = pa.table({"time": flight.time, **dict(flight.columns), "segment": flight.segment})
    pq.write_table(table.replace_schema_metadata({METADATA_NAME: json.dumps(_provenance_to(flight))}), path)


def _provenance_to(flight: Flight) -> dict[str, Any]:
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


def _provenance_from(meta: Mapping[str, Any]) -> Provenance:
    return Provenance(
        source=one_line(str(meta.get("source", "imported")), 40),
        aircraft=plain_name(str(meta.get("aircraft", ""))),
        software=plain_name(str(meta.get("software", ""))),
        calibration={k: str(v) for k, v in mapping(meta.get("calibration")).items()},
        detail={**mapping(meta.get("detail")), "derived_from": mapping(meta.get("derived_from"))},
    )


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


def _write_mcap(flight: Flight, path: Path) -> None:
    with open_flight_writer(flight, path, stamps(flight.time, offset_in(flight.provenance.detail))):
        pass


@contextmanager
def open_flight_writer(
    flight: Flight, path: Path, stamps: NDArray[np.int64]
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
        writer.add_metadata(METADATA_NAME, {"json": text, "sha256": _digest(text, names, table)})
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


def _read_mcap(path: Path) -> _Read:
    from daq.contract.recordings.flight_rows import described, flight_rows
    from daq.contract.recordings.reading import read_parts
    from daq.contract.recordings.recording import RecordingError

    try:
        flights = read_parts(path)
    except RecordingError as error:
        raise FlightError(f"{error}; damaged, or no flight at all") from error
    flight = flights[0]
    if any(s.entries for s in flights) or (
        all(s.sound for s in flights) and not any(FLIGHT_TOPIC in s.kept for s in flights)
    ):
        raise FlightError(
            f"{path}: no calibrated flight in this file; a raw recording must pass 'sideslip calibrate' first"
        )
    for damage in (d for s in flights for d in s.damages):
        raise FlightError(
            f"{path}: damaged or not an MCAP file (byte {damage.at_byte}: {damage.what}); "
            "try 'sideslip recover' on the raw recording"
        )
    if len(flights) > 1:
        raise FlightError(f"{path}: {len(flights)} flights one behind the other in one file; calibrate each by itself")
    table = flight_rows(flight)
    meta, text, stated = described(flight)
    if stated != _digest(text, table.names, table.values):
        raise FlightError(
            f"{path}: damaged: the values are not those that were written; calibrate the raw recording again"
        )
    columns = {n: table.values[:, i] for i, n in enumerate(table.names)}
    return columns, _provenance_from(meta), [*from_meta(meta)]


def _digest(provenance: str, names: Sequence[str], table: Array) -> str:
    """SHA-256 over provenance, names and values: MCAP's checksums cover neither schemas nor metadata."""
    digest = hashlib.sha256(json.dumps([provenance, *names]).encode())
    for rows in np.array_split(table, max(1, table.size // 1_000_000)):  # no copy of the whole table
        digest.update(np.ascontiguousarray(np.where(np.isnan(rows), np.nan, rows), "<f8").tobytes())
    return digest.hexdigest()
