"""What a recording holds besides scans: events, log lines, accounting and timing, sensor health.

Each kind is a frozen dataclass with its own sealed protobuf form, so that any MCAP reader shows it. Log lines have
the fields of the well-known schema `foxglove.Log` and appear as text in common viewers.
Times are those of the scan: monotonic and UTC nanoseconds, UTC 0 while unknown.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from functools import cache
from typing import Any

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory, timestamp_pb2
from google.protobuf.message import DecodeError

from daq.contract.errors import UserError
from daq.contract.seal import SEAL_FIELD, SEAL_NUMBER, has_seal, seal, seal_holds

EVENT_TOPIC, EVENT_SCHEMA = "/event", "sideslip.Event"
LOG_TOPIC, LOG_SCHEMA = "/log", "foxglove.Log"
STATISTICS_TOPIC, STATISTICS_SCHEMA = "/statistics", "sideslip.Statistics"
HEALTH_TOPIC, HEALTH_SCHEMA = "/health", "sideslip.Health"
SEQUENCER_TOPIC, SEQUENCER_SCHEMA = "/sequencer", "sideslip.Sequencer"

_NS = 1_000_000_000


class MessageError(UserError):
    """Bytes that are not a message of the expected kind."""


class LogLevel(IntEnum):
    """Weight of a log line, numbered as in foxglove.Log."""

    UNKNOWN = 0
    DEBUG = 1
    INFO = 2
    WARNING = 3
    ERROR = 4
    FATAL = 5


@dataclass(frozen=True, slots=True)
class EventMessage:
    """A marker: the pilot's switch, the ground, or the logger itself (`origin`)."""

    time_monotonic_ns: int
    time_utc_ns: int
    number: int  # the scan at or before which it happened
    origin: str  # switch | ground | logger
    text: str


@dataclass(frozen=True, slots=True)
class LogLine:
    """One line of the logger's log."""

    time_monotonic_ns: int
    time_utc_ns: int
    level: LogLevel
    name: str  # which part speaks
    message: str


@dataclass(frozen=True, slots=True)
class HealthEntry:
    """One sensor group: its state, the sentence for it, since when, and how often it has failed."""

    group: str
    state: int  # SensorState
    text: str
    since_monotonic_ns: int
    failures: int = 0


@dataclass(frozen=True, slots=True)
class Health:
    """State of all sensor groups at one instant."""

    time_monotonic_ns: int
    time_utc_ns: int
    number: int
    entries: tuple[HealthEntry, ...] = ()


@dataclass(frozen=True, slots=True)
class Statistics:
    """Accounting and timing of a recording session up to this message.

    Every scan slot from `first_number` to `next_number` - 1 is in exactly one count:
    slots = written + dropped + lost + missed + pending.

    written: in a file, as far as this logger knows. dropped: refused because the queue was full. lost: taken but
    given up because no file could be written. missed: never scanned, the slot had passed. pending: in memory.
    absent: the (first, last) numbers of dropped, lost and missed slots, whole session. final: the session was closed.
    Histograms are counts over `edges_us`, bin i holding values from edge i-1 up to below edge i (the first: below
    edge 0, the last: from the last edge on). `late_scans` began later than a tenth of a period after their deadline.
    """

    time_monotonic_ns: int
    time_utc_ns: int
    session: str
    segment: int
    first_number: int = 0
    next_number: int = 0
    written: int = 0
    dropped: int = 0
    lost: int = 0
    missed: int = 0
    pending: int = 0
    absent: tuple[tuple[int, int], ...] = ()
    write_errors: int = 0
    queue_high_water: int = 0
    late_scans: int = 0
    edges_us: tuple[int, ...] = ()
    lateness: tuple[int, ...] = ()
    interval_error: tuple[int, ...] = ()
    scan_duration: tuple[int, ...] = ()
    write_latency: tuple[int, ...] = ()
    sync_latency: tuple[int, ...] = ()
    final: bool = False
    extra: Mapping[str, int] = field(default_factory=dict)

    @property
    def slots(self) -> int:
        """Scan numbers used so far."""
        return self.next_number - self.first_number

    @property
    def closes(self) -> bool:
        """Whether the sums close."""
        return self.slots == self.written + self.dropped + self.lost + self.missed + self.pending


@dataclass(frozen=True, slots=True)
class SequencerFrame:
    """What the sequencer did in one frame of its output; one for every frame in which it is not idle, and the next one.

    state, reason, switch: numbers of `daq.contract.sequencing`. beating: the heartbeat was kept up. limited: a pulse was held
    back by its limits. increments: delta_e, delta_a, delta_r [rad]. pilot_us: the pilot's signal for each output as it
    is now, empty while not seen. output_us: pulses given to the servo driver, empty where none were.
    """

    time_monotonic_ns: int
    time_utc_ns: int
    number: int
    state: int
    reason: int
    switch: int
    elapsed_us: int = 0
    beating: bool = False
    limited: bool = False
    increments: tuple[float, ...] = ()
    pilot_us: tuple[float, ...] = ()
    output_us: tuple[float, ...] = ()


Message = EventMessage | LogLine | Health | Statistics | SequencerFrame

# --------------------------------------------------------------------------------------------------- protobuf schemas

_F = descriptor_pb2.FieldDescriptorProto
_Row = tuple[str, int, Any, bool]  # name, field number, protobuf type, repeated

_TIMES: tuple[_Row, ...] = (
    ("time_monotonic_ns", 1, _F.TYPE_UINT64, False),
    ("time_utc_ns", 2, _F.TYPE_UINT64, False),
)
_EVENT: tuple[_Row, ...] = (
    *_TIMES,
    ("number", 3, _F.TYPE_UINT32, False),
    ("origin", 4, _F.TYPE_STRING, False),
    ("text", 5, _F.TYPE_STRING, False),
)
_HEALTH: tuple[_Row, ...] = (
    *_TIMES,
    ("number", 3, _F.TYPE_UINT32, False),
    ("group", 4, _F.TYPE_STRING, True),
    ("state", 5, _F.TYPE_UINT32, True),
    ("text", 6, _F.TYPE_STRING, True),
    ("since_monotonic_ns", 7, _F.TYPE_UINT64, True),
    ("failures", 8, _F.TYPE_UINT32, True),
)
_SEQUENCER: tuple[_Row, ...] = (
    *_TIMES,
    ("number", 3, _F.TYPE_UINT32, False),
    ("state", 4, _F.TYPE_UINT32, False),
    ("reason", 5, _F.TYPE_UINT32, False),
    ("switch", 6, _F.TYPE_UINT32, False),
    ("elapsed_us", 7, _F.TYPE_UINT32, False),
    ("beating", 8, _F.TYPE_BOOL, False),
    ("limited", 9, _F.TYPE_BOOL, False),
    ("increments", 10, _F.TYPE_FLOAT, True),
    ("pilot_us", 11, _F.TYPE_FLOAT, True),
    ("output_us", 12, _F.TYPE_FLOAT, True),
)
_COUNTS = ("first_number", "next_number", "written", "dropped", "lost", "missed", "pending", "write_errors")
_HISTOGRAMS = ("edges_us", "lateness", "interval_error", "scan_duration", "write_latency", "sync_latency")
_STATISTICS: tuple[_Row, ...] = (
    *_TIMES,
    ("session", 3, _F.TYPE_STRING, False),
    ("segment", 4, _F.TYPE_UINT32, False),
    ("final", 5, _F.TYPE_BOOL, False),
    ("queue_high_water", 6, _F.TYPE_UINT32, False),
    ("late_scans", 7, _F.TYPE_UINT32, False),
    *((name, 16 + i, _F.TYPE_UINT32, False) for i, name in enumerate(_COUNTS)),
    ("absent_first", 32, _F.TYPE_UINT32, True),
    ("absent_last", 33, _F.TYPE_UINT32, True),
    *((name, 40 + i, _F.TYPE_UINT32, True) for i, name in enumerate(_HISTOGRAMS)),
    ("extra_name", 60, _F.TYPE_STRING, True),
    ("extra_value", 61, _F.TYPE_UINT64, True),
)


def _file(schema: str, rows: Sequence[_Row]) -> descriptor_pb2.FileDescriptorProto:
    package, name = schema.split(".")
    file = descriptor_pb2.FileDescriptorProto(name=f"{package}/{name.lower()}.proto", package=package, syntax="proto3")
    message = file.message_type.add(name=name)
    for field_name, number, kind, repeated in (*rows, (SEAL_FIELD, SEAL_NUMBER, _F.TYPE_FIXED32, False)):
        label = _F.LABEL_REPEATED if repeated else _F.LABEL_OPTIONAL
        message.field.add(name=field_name, number=number, type=kind, label=label)
    return file


def _log_files() -> list[descriptor_pb2.FileDescriptorProto]:
    stamp = descriptor_pb2.FileDescriptorProto()
    timestamp_pb2.DESCRIPTOR.CopyToProto(stamp)
    file = descriptor_pb2.FileDescriptorProto(name="foxglove/Log.proto", package="foxglove", syntax="proto3")
    file.dependency.append(stamp.name)
    message = file.message_type.add(name="Log")
    level = message.enum_type.add(name="Level")
    for member in LogLevel:
        level.value.add(name=member.name, number=member.value)
    optional = _F.LABEL_OPTIONAL
    message.field.add(
        name="timestamp", number=1, type=_F.TYPE_MESSAGE, type_name=".google.protobuf.Timestamp", label=optional
    )
    message.field.add(name="level", number=2, type=_F.TYPE_ENUM, type_name=".foxglove.Log.Level", label=optional)
    for number, name in ((3, "message"), (4, "name"), (5, "file")):
        message.field.add(name=name, number=number, type=_F.TYPE_STRING, label=optional)
    message.field.add(name="line", number=6, type=_F.TYPE_FIXED32, label=optional)
    message.field.add(name="time_monotonic_ns", number=7, type=_F.TYPE_UINT64, label=optional)
    message.field.add(name=SEAL_FIELD, number=SEAL_NUMBER, type=_F.TYPE_FIXED32, label=optional)
    return [stamp, file]


@cache
def schema_files(schema: str) -> descriptor_pb2.FileDescriptorSet:
    """The protobuf descriptor set of one of the message schemas."""
    if schema == LOG_SCHEMA:
        return descriptor_pb2.FileDescriptorSet(file=_log_files())
    rows = {
        EVENT_SCHEMA: _EVENT,
        HEALTH_SCHEMA: _HEALTH,
        STATISTICS_SCHEMA: _STATISTICS,
        SEQUENCER_SCHEMA: _SEQUENCER,
    }[schema]
    return descriptor_pb2.FileDescriptorSet(file=[_file(schema, rows)])


@cache
def message_class(schema: str, files: bytes) -> Any:
    """The protobuf message class of a schema, from its serialised descriptor set."""
    pool = descriptor_pool.DescriptorPool()
    for file in descriptor_pb2.FileDescriptorSet.FromString(files).file:
        pool.Add(file)  # type: ignore[no-untyped-call]
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(schema))


@cache
def _class(schema: str) -> Any:
    return message_class(schema, schema_files(schema).SerializeToString())


# ------------------------------------------------------------------------------------------------------ coding


def _sealed(schema: str, fields: Mapping[str, Any]) -> bytes:
    return seal(schema, _class(schema)(**fields).SerializeToString(deterministic=True))


def _parsed(schema: str, data: bytes) -> Any:
    if has_seal(data) and not seal_holds(schema, data):
        raise MessageError(f"{len(data)} bytes of a {schema} fail their checksum; the recording is damaged there")
    message = _class(schema)()
    try:
        message.ParseFromString(data)
    except DecodeError as error:
        raise MessageError(f"{len(data)} bytes are not a {schema} ({error})") from error
    return message


def encode_event(event: EventMessage) -> bytes:
    """An event as sealed protobuf bytes."""
    return _sealed(EVENT_SCHEMA, {name: getattr(event, name) for name, *_ in _EVENT})


def decode_event(data: bytes) -> EventMessage:
    """An event from its bytes; MessageError when they are damaged or something else."""
    message = _parsed(EVENT_SCHEMA, data)
    return EventMessage(**{name: getattr(message, name) for name, *_ in _EVENT})


def encode_log(line: LogLine) -> bytes:
    """A log line as sealed foxglove.Log bytes; its timestamp is UTC, or monotonic time while UTC is unknown."""
    stamp = line.time_utc_ns or line.time_monotonic_ns
    fields = {
        "timestamp": {"seconds": stamp // _NS, "nanos": stamp % _NS},
        "level": int(line.level),
        "message": line.message,
        "name": line.name,
        "time_monotonic_ns": line.time_monotonic_ns,
    }
    return _sealed(LOG_SCHEMA, fields)


def decode_log(data: bytes) -> LogLine:
    """A log line from its bytes; MessageError when they are damaged or something else."""
    m = _parsed(LOG_SCHEMA, data)
    stamp = m.timestamp.seconds * _NS + m.timestamp.nanos
    utc = 0 if stamp == m.time_monotonic_ns else stamp
    level = LogLevel(m.level) if m.level in LogLevel._value2member_map_ else LogLevel.UNKNOWN
    return LogLine(m.time_monotonic_ns, utc, level, m.name, m.message)


def encode_health(health: Health) -> bytes:
    """A health report as sealed protobuf bytes."""
    columns = {name: [getattr(e, name) for e in health.entries] for name, _, _, repeated in _HEALTH if repeated}
    header = {name: getattr(health, name) for name, _, _, repeated in _HEALTH if not repeated}
    return _sealed(HEALTH_SCHEMA, header | columns)


def decode_health(data: bytes) -> Health:
    """A health report from its bytes; MessageError when they are damaged or something else."""
    m = _parsed(HEALTH_SCHEMA, data)
    rows = zip(m.group, m.state, m.text, m.since_monotonic_ns, m.failures, strict=True)
    try:
        entries = tuple(HealthEntry(*row) for row in rows)
    except ValueError as error:
        raise MessageError(f"health report of scan {m.number} has columns of different length") from error
    return Health(m.time_monotonic_ns, m.time_utc_ns, m.number, entries)


_PLAIN = ("time_monotonic_ns", "time_utc_ns", "session", "segment", "final", "queue_high_water", "late_scans", *_COUNTS)


def encode_statistics(statistics: Statistics) -> bytes:
    """Statistics as sealed protobuf bytes."""
    fields: dict[str, Any] = {name: getattr(statistics, name) for name in (*_PLAIN, *_HISTOGRAMS)}
    fields["absent_first"] = [first for first, _ in statistics.absent]
    fields["absent_last"] = [last for _, last in statistics.absent]
    fields["extra_name"] = list(statistics.extra)
    fields["extra_value"] = list(statistics.extra.values())
    return _sealed(STATISTICS_SCHEMA, fields)


def decode_statistics(data: bytes) -> Statistics:
    """Statistics from their bytes; MessageError when they are damaged or something else."""
    m = _parsed(STATISTICS_SCHEMA, data)
    fields: dict[str, Any] = {name: getattr(m, name) for name in _PLAIN}
    fields |= {name: tuple(getattr(m, name)) for name in _HISTOGRAMS}
    absent = tuple(zip(m.absent_first, m.absent_last, strict=False))
    return Statistics(**fields, absent=absent, extra=dict(zip(m.extra_name, m.extra_value, strict=False)))


def encode_sequencer(frame: SequencerFrame) -> bytes:
    """A frame of the sequencer as sealed protobuf bytes."""
    return _sealed(SEQUENCER_SCHEMA, {name: getattr(frame, name) for name, *_ in _SEQUENCER})


def decode_sequencer(data: bytes) -> SequencerFrame:
    """A frame of the sequencer from its bytes; MessageError when they are damaged or something else."""
    m = _parsed(SEQUENCER_SCHEMA, data)
    fields: dict[str, Any] = {
        name: tuple(getattr(m, name)) if repeated else getattr(m, name) for name, _, _, repeated in _SEQUENCER
    }
    return SequencerFrame(**fields)
