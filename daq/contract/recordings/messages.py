"""What a recording holds besides scans: events, log lines, accounting and timing, sensor health.

Each kind is a frozen dataclass with its own sealed protobuf form, so that any MCAP reader shows it. Log lines have
the fields of the well-known schema `foxglove.Log` and appear as text in common viewers.
Times are those of the scan: monotonic and UTC nanoseconds, UTC 0 while unknown.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from functools import cache
from typing import Any

from google.protobuf import descriptor_pb2, timestamp_pb2
from google.protobuf.message import DecodeError

from daq.contract.seal import SEAL_FIELD, SEAL_NUMBER, has_seal, message_class, seal, seal_holds
from daq.utilities.errors import UserError

EVENT_TOPIC, LOG_TOPIC, STATISTICS_TOPIC = "/event", "/log", "/statistics"
HEALTH_TOPIC, SEQUENCER_TOPIC = "/health", "/sequencer"

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


def _rows(first: int, kind: Any, names: str, repeated: bool = False) -> tuple[_Row, ...]:
    """Fields of one type with numbers from `first` on."""
    return tuple((name, first + i, kind, repeated) for i, name in enumerate(names.split()))


_TIMES = _rows(1, _F.TYPE_UINT64, "time_monotonic_ns time_utc_ns")
_NUMBER = _rows(3, _F.TYPE_UINT32, "number")
_ROWS: Mapping[str, tuple[_Row, ...]] = {
    "sideslip.Event": (*_TIMES, *_NUMBER, *_rows(4, _F.TYPE_STRING, "origin text")),
    "sideslip.Statistics": (
        *_TIMES,
        *_rows(3, _F.TYPE_STRING, "session"),
        *_rows(4, _F.TYPE_UINT32, "segment"),
        *_rows(5, _F.TYPE_BOOL, "final"),
        *_rows(6, _F.TYPE_UINT32, "queue_high_water late_scans"),
        *_rows(16, _F.TYPE_UINT32, "first_number next_number written dropped lost missed pending write_errors"),
        *_rows(32, _F.TYPE_UINT32, "absent_first absent_last", True),
        *_rows(40, _F.TYPE_UINT32, "edges_us lateness interval_error scan_duration write_latency sync_latency", True),
        *_rows(60, _F.TYPE_STRING, "extra_name", True),
        *_rows(61, _F.TYPE_UINT64, "extra_value", True),
    ),
    "sideslip.Health": (
        *_TIMES,
        *_NUMBER,
        *_rows(4, _F.TYPE_STRING, "group", True),
        *_rows(5, _F.TYPE_UINT32, "state", True),
        *_rows(6, _F.TYPE_STRING, "text", True),
        *_rows(7, _F.TYPE_UINT64, "since_monotonic_ns", True),
        *_rows(8, _F.TYPE_UINT32, "failures", True),
    ),
    "sideslip.Sequencer": (
        *_TIMES,
        *_NUMBER,
        *_rows(4, _F.TYPE_UINT32, "state reason switch elapsed_us"),
        *_rows(8, _F.TYPE_BOOL, "beating limited"),
        *_rows(10, _F.TYPE_FLOAT, "increments pilot_us output_us", True),
    ),
}
_LOG_SCHEMA = "foxglove.Log"
_KINDS: Mapping[type, tuple[str, str]] = {
    EventMessage: (EVENT_TOPIC, "sideslip.Event"),
    LogLine: (LOG_TOPIC, _LOG_SCHEMA),
    Statistics: (STATISTICS_TOPIC, "sideslip.Statistics"),
    Health: (HEALTH_TOPIC, "sideslip.Health"),
    SequencerFrame: (SEQUENCER_TOPIC, "sideslip.Sequencer"),
}
SCHEMA_OF_MESSAGES: Mapping[str, str] = dict(_KINDS.values())
"""Schema by topic."""


@cache
def schema_files(schema: str) -> descriptor_pb2.FileDescriptorSet:
    """The protobuf descriptor set of one of the message schemas."""
    if schema == _LOG_SCHEMA:
        return descriptor_pb2.FileDescriptorSet(file=_log_files())
    package, name = schema.split(".")
    file = descriptor_pb2.FileDescriptorProto(name=f"{package}/{name.lower()}.proto", package=package, syntax="proto3")
    message = file.message_type.add(name=name)
    for field_name, number, kind, repeated in (*_ROWS[schema], (SEAL_FIELD, SEAL_NUMBER, _F.TYPE_FIXED32, False)):
        label = _F.LABEL_REPEATED if repeated else _F.LABEL_OPTIONAL
        message.field.add(name=field_name, number=number, type=kind, label=label)
    return descriptor_pb2.FileDescriptorSet(file=[file])


def _log_files() -> list[descriptor_pb2.FileDescriptorProto]:
    """foxglove.Log, which refers to other types, with the aircraft's clock and the seal added."""
    stamp = descriptor_pb2.FileDescriptorProto()
    timestamp_pb2.DESCRIPTOR.CopyToProto(stamp)
    file = descriptor_pb2.FileDescriptorProto(name="foxglove/Log.proto", package="foxglove", syntax="proto3")
    file.dependency.append(stamp.name)
    message = file.message_type.add(name="Log")
    level = message.enum_type.add(name="Level")
    for member in LogLevel:
        level.value.add(name=member.name, number=member.value)
    optional = _F.LABEL_OPTIONAL
    for number, name, kind, type_name in (
        (1, "timestamp", _F.TYPE_MESSAGE, ".google.protobuf.Timestamp"),
        (2, "level", _F.TYPE_ENUM, ".foxglove.Log.Level"),
    ):
        message.field.add(name=name, number=number, type=kind, type_name=type_name, label=optional)
    for name, number, kind, _ in (
        *_rows(3, _F.TYPE_STRING, "message name file"),
        *_rows(6, _F.TYPE_FIXED32, "line"),
        *_rows(7, _F.TYPE_UINT64, "time_monotonic_ns"),
        (SEAL_FIELD, SEAL_NUMBER, _F.TYPE_FIXED32, False),
    ):
        message.field.add(name=name, number=number, type=kind, label=optional)
    return [stamp, file]


@cache
def _class(schema: str) -> Any:
    return message_class(schema, schema_files(schema))


# ------------------------------------------------------------------------------------------------------ coding


def topic_of(message: Message) -> str:
    """The topic under which a message of its kind is recorded."""
    return _KINDS[type(message)][0]


def encode(message: Message) -> bytes:
    """A message as sealed protobuf bytes."""
    schema = _KINDS[type(message)][1]
    return seal(schema, _class(schema)(**_fields(message, schema)).SerializeToString(deterministic=True))


def _fields(message: Message, schema: str) -> dict[str, Any]:
    """Protobuf fields: those of the dataclass, but for what has another form there."""
    match message:
        case LogLine():  # its timestamp is UTC, or monotonic time while UTC is unknown
            stamp = message.time_utc_ns or message.time_monotonic_ns
            plain_fields = {name: getattr(message, name) for name in ("message", "name", "time_monotonic_ns")}
            return {
                "timestamp": {"seconds": stamp // _NS, "nanos": stamp % _NS},
                "level": int(message.level),
                **plain_fields,
            }
        case Health():
            special: dict[str, Any] = {
                name: [getattr(e, name) for e in message.entries] for name, _, _, repeated in _ROWS[schema] if repeated
            }
        case Statistics():
            special = {
                "absent_first": [first for first, _ in message.absent],
                "absent_last": [last for _, last in message.absent],
                "extra_name": list(message.extra),
                "extra_value": list(message.extra.values()),
            }
        case _:
            special = {}
    return special | {name: getattr(message, name) for name, *_ in _ROWS[schema] if name not in special}


def decode(topic: str, data: bytes) -> Any:
    """The message of a topic from its bytes; MessageError when they are damaged or something else."""
    schema = SCHEMA_OF_MESSAGES[topic]
    m = _parsed(schema, data)
    if topic == LOG_TOPIC:
        return _log_line(m)
    if topic == HEALTH_TOPIC:
        return _health(m)
    fields: dict[str, Any] = {
        n: tuple(getattr(m, n)) if repeated else getattr(m, n) for n, _, _, repeated in _ROWS[schema]
    }
    if topic == EVENT_TOPIC:
        return EventMessage(**fields)
    if topic == SEQUENCER_TOPIC:
        return SequencerFrame(**fields)
    absent = tuple(zip(fields.pop("absent_first"), fields.pop("absent_last"), strict=False))
    extra = dict(zip(fields.pop("extra_name"), fields.pop("extra_value"), strict=False))
    return Statistics(**fields, absent=absent, extra=extra)


def _parsed(schema: str, data: bytes) -> Any:
    if has_seal(data) and not seal_holds(schema, data):
        raise MessageError(f"{len(data)} bytes of a {schema} fail their checksum; the recording is damaged there")
    message = _class(schema)()
    try:
        message.ParseFromString(data)
    except DecodeError as error:
        raise MessageError(f"{len(data)} bytes are not a {schema} ({error})") from error
    return message


def _log_line(m: Any) -> LogLine:
    stamp = m.timestamp.seconds * _NS + m.timestamp.nanos
    utc = 0 if stamp == m.time_monotonic_ns else stamp
    level = LogLevel(m.level) if m.level in LogLevel._value2member_map_ else LogLevel.UNKNOWN
    return LogLine(m.time_monotonic_ns, utc, level, m.name, m.message)


def _health(m: Any) -> Health:
    rows = zip(m.group, m.state, m.text, m.since_monotonic_ns, m.failures, strict=True)
    try:
        entries = tuple(HealthEntry(*row) for row in rows)
    except ValueError as error:
        raise MessageError(f"health report of scan {m.number} has columns of different length") from error
    return Health(m.time_monotonic_ns, m.time_utc_ns, m.number, entries)
