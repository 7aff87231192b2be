"""The raw recording: an MCAP file that opens in any MCAP reader and contains its own description.

A session is one or more segments, `<session>_000.mcap` and so on. Each segment begins with everything needed to
understand it alone: who recorded what with which software and configuration, the channel table, the calibration
files. Then come chunks of sealed protobuf messages on six topics. Chunks carry a CRC, each message a seal, attachments
a CRC, our metadata a digest, and the whole data section a CRC, so there is no byte whose alteration goes unnoticed.

Chunks are not compressed unless asked for: one bad bit then costs one scan instead of the second around it.
Message times in a file: log_time is the aircraft's monotonic clock plus one offset for the whole file (`LogTime`), which makes
it UTC; publish_time is UTC as well as the message itself knows it, and monotonic where it does not. In memory, in an
`Entry`, log_time is always the monotonic clock, which is what the messages carry.
"""

import hashlib
import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from typing import IO, NamedTuple

from mcap.writer import CompressionType, Writer

from daq.contract.channels import CHANNELS, COLUMNS, GROUPS
from daq.contract.recordings import messages as m
from daq.contract.recordings.profile import OURS
from daq.contract.scan import SCAN_TOPIC, SCHEMA_NAME, Scan, encode_scan, file_descriptor_set, scan_stamp
from daq.utilities.errors import UserError

INFO_NAME = "sideslip.recording"
"""Name of the metadata record, and stem of the attachment, with the recording's identity."""

INFO_ATTACHMENT = f"{INFO_NAME}.json"
CHANNELS_ATTACHMENT = "channels.json"
CONFIG_ATTACHMENT = "config.toml"
AIRCRAFT_ATTACHMENT = "aircraft.toml"
CALIBRATION_PREFIX = "calibration/"
MANOEUVRE_ATTACHMENT = "manoeuvre.toml"
DETAIL_NAME = "sideslip.detail"
"""Name of metadata records that add to the identity while recording (a sensor found late and its factory data)."""

_LONGEST_NAME = 256
"""Letters of a session's, aircraft's or program's name: file systems allow 255."""
_MOST_SEGMENTS = 2**32 - 1  # what the accounting can count
_LATEST_NS = 2**64 - 1  # what a message's times can hold

SCHEMA_OF_TOPIC: Mapping[str, str] = {SCAN_TOPIC: SCHEMA_NAME, **m.SCHEMA_OF_MESSAGES}


class RecordingError(UserError):
    """A recording that cannot be read or written."""


COMPUTER, GPS = "system clock", "GPS"
LOG_TIME_NAME = "sideslip.log_time"
"""Name of the metadata record that says what log times are."""
UTC_FROM_NS, UTC_TO_NS = 10**18, 4 * 10**18
"""A log time between these (September 2001 and 2096) is UTC: no monotonic clock runs for 31 years."""


@dataclass(frozen=True, slots=True)
class LogTime:
    """offset_ns: log time of a file minus the monotonic clock [ns]; source: COMPUTER or GPS, empty for an offset of 0."""

    offset_ns: int = 0
    source: str = ""


class RecordedMessage(NamedTuple):
    """One message. log_time_ns: on the aircraft's monotonic clock, whatever the file has."""

    topic: str
    log_time_ns: int
    publish_time_ns: int
    sequence: int
    data: bytes


@dataclass(frozen=True, slots=True)
class RecordingInfo:
    """Identity of a recording.

    source: real | simulated | replayed. role: onboard | received (by the ground station, gaps expected) | recovered.
    details: facts found at run time, such as a pressure sensor's factory coefficients. attachments: file name -> bytes;
    `config.toml`, `calibration/...` and, with a sequencer, `manoeuvre.toml` among them.
    """

    session: str
    source: str
    aircraft: str = ""
    role: str = "onboard"
    segment: int = 0
    scan_rate_hz: float = 20.0
    started_utc_ns: int = 0
    software: str = ""
    details: Mapping[str, str] = field(default_factory=dict)
    attachments: Mapping[str, bytes] = field(default_factory=dict)

    @property
    def calibration(self) -> dict[str, bytes]:
        start = len(CALIBRATION_PREFIX)
        return {k[start:]: v for k, v in self.attachments.items() if k.startswith(CALIBRATION_PREFIX)}

    @property
    def config_text(self) -> str:
        """The embedded configuration; empty when the recording has none."""
        return self.attachments.get(CONFIG_ATTACHMENT, b"").decode("utf-8")


def software_version() -> str:
    """Version of the installed software, as recordings quote it."""
    try:
        return version("sideslip")
    except PackageNotFoundError:
        return "not installed"


@cache
def channel_table() -> bytes:
    """The channel table as JSON, so that a recording explains its channels for good."""
    rows = {
        "groups": [{"name": g.name, "title": g.title, "device": g.device} for g in GROUPS],
        "channels": [
            {k: getattr(c, k) for k in ("name", "group", "raw_type", "unit", "meaning", "scale", "offset")}
            | {"rate": c.rate.value, "columns": list(c.columns)}
            for c in CHANNELS
        ],
        "columns": [{"name": c.name, "unit": c.unit, "meaning": c.meaning} for c in COLUMNS],
    }
    return json.dumps(rows, indent=1, ensure_ascii=False).encode()


def info_to_metadata(info: RecordingInfo) -> dict[str, str]:
    """Identity as MCAP metadata, with a digest over all of it."""
    fields = {
        "session": info.session,
        "segment": str(info.segment),
        "source": info.source,
        "role": info.role,
        "aircraft": info.aircraft,
        "software": info.software,
        "scan_rate_hz": repr(info.scan_rate_hz),
        "started_utc_ns": str(info.started_utc_ns),
        "channel_table_sha256": hashlib.sha256(channel_table()).hexdigest(),
        **{f"sha256 {name}": hashlib.sha256(data).hexdigest() for name, data in sorted(info.attachments.items())},
        **{f"detail {name}": value for name, value in sorted(info.details.items())},
    }
    return with_digest(fields)


def info_from_metadata(fields: Mapping[str, str]) -> RecordingInfo:
    """Identity from metadata whose digest has been checked; attachments are added by the reader.

    Raises KeyError or ValueError for fields that are not those of a recording: anybody can make a digest.
    """
    if any(len(fields[k]) > _LONGEST_NAME for k in ("session", "source", "aircraft", "role", "software")):
        raise ValueError("a name in the identity is too long for a sentence")
    if not 0 <= int(fields["started_utc_ns"]) <= _LATEST_NS or not 0 <= int(fields["segment"]) <= _MOST_SEGMENTS:
        raise ValueError("the identity's segment or start time is out of range")
    return RecordingInfo(
        session=fields["session"],
        source=fields["source"],
        aircraft=fields["aircraft"],
        role=fields["role"],
        segment=int(fields["segment"]),
        scan_rate_hz=float(fields["scan_rate_hz"]),
        started_utc_ns=int(fields["started_utc_ns"]),
        software=fields["software"],
        details={k.removeprefix("detail "): v for k, v in fields.items() if k.startswith("detail ")},
    )


def with_digest(fields: Mapping[str, str]) -> dict[str, str]:
    """Metadata with a SHA-256 over its fields added, since MCAP metadata has no checksum."""
    return {**fields, "sha256": metadata_digest(fields)}


def metadata_digest(fields: Mapping[str, str]) -> str:
    """Digest of metadata fields, the digest itself left out."""
    content = {k: v for k, v in fields.items() if k != "sha256"}
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def scan_entry(scan: Scan, data: bytes | None = None) -> RecordedMessage:
    """A scan as a message; `data` when it has been encoded already."""
    encoded = encode_scan(scan) if data is None else data
    utc = scan.time_utc_ns or scan.time_monotonic_ns
    return RecordedMessage(SCAN_TOPIC, scan.time_monotonic_ns, utc, scan.number, encoded)


def message_entry(message: m.Message, sequence: int = 0) -> RecordedMessage:
    """An event, log line, health report, statistics or frame of the sequencer as a message."""
    utc = message.time_utc_ns or message.time_monotonic_ns
    return RecordedMessage(m.topic_of(message), message.time_monotonic_ns, utc, sequence, m.encode(message))


def entry_of(topic: str, data: bytes) -> RecordedMessage:
    """The message around sealed bytes of a known topic, its times and number taken from the content."""
    if topic == SCAN_TOPIC:
        number, monotonic, utc = scan_stamp(data)
        return RecordedMessage(topic, monotonic, utc or monotonic, number, data)
    content = m.decode(topic, data)
    utc = content.time_utc_ns or content.time_monotonic_ns
    if not 0 <= utc <= _LATEST_NS:  # a log line carries seconds of any sign and size
        utc = content.time_monotonic_ns
    return RecordedMessage(topic, content.time_monotonic_ns, utc, getattr(content, "number", 0), data)


def on_monotonic_clock(entry: RecordedMessage) -> RecordedMessage:
    """A message as it stands in a file, its log time put back on the aircraft's monotonic clock by its own content."""
    if entry.log_time_ns < UTC_FROM_NS:
        return entry
    if entry.topic == SCAN_TOPIC:
        return entry._replace(log_time_ns=scan_stamp(entry.data)[1])
    return entry._replace(log_time_ns=m.decode(entry.topic, entry.data).time_monotonic_ns)


def utc_of(entries: Iterable[RecordedMessage]) -> LogTime:
    """The offset to UTC of the first scan with a UTC time; an empty LogTime where no scan has one."""
    return next((log_time for log_time in map(utc_of_scan, entries) if log_time is not None), LogTime())


def utc_of_scan(entry: RecordedMessage) -> LogTime | None:
    """The offset to UTC of a scan; None for one without a possible UTC time, and for other messages."""
    if entry.topic != SCAN_TOPIC or not UTC_FROM_NS <= entry.publish_time_ns < UTC_TO_NS:
        return None
    return LogTime(entry.publish_time_ns - entry.log_time_ns, GPS)


class RecordingWriter:
    """Writes one segment to a binary stream; everything but messages is written at once, at the start.

    The stream needs write, tell and flush. Errors of the stream pass through; after one the segment must be abandoned, since
    the MCAP writer has discarded what it failed to write. log_time: offset of the messages' log times; may be set until the
    first message is written.
    """

    def __init__(
        self, stream: IO[bytes], info: RecordingInfo, *, compress: bool = False, log_time: LogTime = LogTime()
    ) -> None:
        self.log_time = log_time
        self._begun = False
        info = replace(info, software=info.software or software_version())
        kind = CompressionType.ZSTD if compress else CompressionType.NONE
        self._writer = Writer(stream, compression=kind, enable_crcs=True, enable_data_crcs=True)
        self._writer.start(profile=OURS, library=f"sideslip {info.software}")
        identity = info_to_metadata(info)
        self._writer.add_metadata(INFO_NAME, identity)
        self._attach(info.started_utc_ns, INFO_ATTACHMENT, json.dumps(identity, indent=1).encode())
        self._attach(info.started_utc_ns, CHANNELS_ATTACHMENT, channel_table())
        for name, data in info.attachments.items():
            self._attach(info.started_utc_ns, name, data)
        self._channels: dict[str, int] = {}
        for topic, schema in SCHEMA_OF_TOPIC.items():
            files = file_descriptor_set() if topic == SCAN_TOPIC else m.schema_files(schema)
            schema_id = self._writer.register_schema(schema, "protobuf", files.SerializeToString(deterministic=True))
            self._channels[topic] = self._writer.register_channel(topic, "protobuf", schema_id)

    def write(self, entry: RecordedMessage) -> None:
        """Add a message to the chunk in progress; before the first one, write the LOG_TIME_NAME record."""
        if not self._begun:
            self._begun = True
            if self.log_time.source:
                fields = {"utc_minus_monotonic_ns": str(self.log_time.offset_ns), "known_by": self.log_time.source}
                self._writer.add_metadata(LOG_TIME_NAME, with_digest(fields))
        log_time_ns = min(_LATEST_NS, max(0, entry.log_time_ns + self.log_time.offset_ns))
        channel = self._channels[entry.topic]
        self._writer.add_message(channel, log_time_ns, entry.data, entry.publish_time_ns, entry.sequence)

    def write_message(self, message: m.Message) -> None:
        """Add an event, log line, health report or statistics."""
        self.write(message_entry(message))

    def add_detail(self, details: Mapping[str, str]) -> None:
        self._writer.add_metadata(DETAIL_NAME, with_digest(dict(details)))

    def flush(self) -> None:
        """Close the chunk in progress and hand everything to the stream."""
        self._writer.flush()

    def finish(self) -> None:
        """Write the index and the end mark; the stream stays open."""
        self._writer.finish()

    def _attach(self, time_ns: int, name: str, data: bytes) -> None:
        media = {"json": "application/json", "toml": "application/toml"}.get(name.rsplit(".", 1)[-1], "text/plain")
        self._writer.add_attachment(time_ns, time_ns, name, media, data)
