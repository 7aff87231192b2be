"""MCAP files and ROS 2 bags of other programs (rosbag2 as MCAP and SQLite): the messages, decoded by the schemas they carry.

Formats: MCAP specification (mcap.dev), message encodings `cdr` with `ros2msg` schemas, `protobuf` and `json`;
rosbag2_storage_sqlite3 (tables topics, messages, and since Iron message_definitions). Bags older than that carry no
definitions: those of the standard messages are in `ros_definitions`.
"""

import contextlib
import io
import json
import sqlite3
import struct
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import IO, Any

from daq.contract.recordings.expand import Bad, expand_within
from groundstation.importers.errors import ImportDataError
from groundstation.importers.formats.bag_series import Topic, numbers_of

SQLITE = b"SQLite format 3\0"
OURS = "sideslip"  # profile of the recordings and flights that this program writes
MCAP_MAGIC = b"\x89MCAP0\r\n"
HEADER_OPCODE, HEADER_AT = 1, 17  # the header record, and where its profile begins
HEAD_BYTES = 4096  # read to find the profile
LARGEST_RECORD = 64 << 20
"""Bytes of one record of an MCAP file, and of a chunk unpacked: a chunk of a bag has a few megabytes."""
LONGEST_MESSAGE = 1 << 20
"""Bytes of a message that is decoded: pictures and clouds of points are longer, and hold no series."""
LONGEST_DEFINITION = 1 << 16  # bytes of the definition of a message, with those it uses: px4_msgs' longest has 10 kB
_DAMAGE = (ValueError, LookupError, TypeError, AttributeError, OverflowError, EOFError, MemoryError, struct.error)
Decode = Callable[[bytes], Any]


class UnknownSchemaError(Exception):
    """Messages of a kind that nothing here decodes."""


@dataclass
class Bag:
    """topics: by name; unread: topic -> why its messages cannot be read; damaged: messages that could not be decoded; notes."""

    topics: dict[str, Topic] = field(default_factory=dict)
    unread: dict[str, str] = field(default_factory=dict)
    damaged: int = 0
    notes: list[str] = field(default_factory=list)

    def decoder(self, topic: str, what: str, make: Callable[[], Decode]) -> Decode | None:
        """What reads the messages of a topic; None where its schema or definition (`what`) cannot be read; `unread` says why."""
        try:
            return make()
        except ModuleNotFoundError:
            self.unread[topic] = "a package is missing: pip install 'sideslip[ground]'"
        except UnknownSchemaError as error:
            self.unread[topic] = str(error)
        except Exception as error:  # noqa: BLE001 - a schema may be anything
            self.unread[topic] = f"its {what} cannot be read ({type(error).__name__})"
        return None

    def add_message(self, name: str, kind: str, time_ns: int, data: bytes, decode: Decode) -> None:
        """Decode and keep a message."""
        if len(data) > LONGEST_MESSAGE:
            self.unread[name] = f"messages of {len(data)} bytes; at most {LONGEST_MESSAGE} are read"
            return
        try:
            row = numbers_of(decode(data))
        except Exception as error:  # noqa: BLE001 - protobuf and struct raise classes of their own for damaged bytes
            self.damaged += 1
            if not isinstance(error, _DAMAGE):
                self.unread.setdefault(name, type(error).__name__)
            return
        self.topics.setdefault(name, Topic(name, kind)).add_message(time_ns * 1e-9, row)


def read_bag(path: Path) -> Bag:
    """Every message of a bag that can be decoded. Raises ImportDataError where the file is none, or nothing in it can be read."""
    with path.open("rb") as file:
        head = file.read(len(SQLITE))
    bag = _sqlite(path) if head == SQLITE else _mcap(path)
    if not bag.topics:
        reasons = "; ".join(f"{t}: {w}" for t, w in list(bag.unread.items())[:4]) or "it holds no messages"
        raise ImportDataError(f"{path}: no message of this bag can be read: {reasons}")
    if bag.damaged:
        bag.notes.append(f"{bag.damaged} messages of the bag are damaged and left out")
    if bag.unread:
        unread = ", ".join(f"{t} ({w})" for t, w in list(bag.unread.items())[:12])
        bag.notes.append(f"topics that cannot be read: {unread}")
    return bag


def is_bag(path: Path) -> bool:
    """Whether a file is an MCAP file or a ROS 2 bag that this program has not written."""
    if not path.is_file():
        return False
    with path.open("rb") as file:
        if file.read(len(SQLITE)) == SQLITE:
            return True
    profile = mcap_profile(path) if path.suffix.lower() == ".mcap" else None
    return profile is not None and profile != OURS


def mcap_profile(path: Path) -> str | None:
    """The profile that the header of an MCAP file names; None where it has no header. Reads its first bytes only."""
    try:
        with path.open("rb") as file:
            head = file.read(HEAD_BYTES)
    except OSError:
        return None
    if not head.startswith(MCAP_MAGIC) or len(head) < HEADER_AT + 4 or head[len(MCAP_MAGIC)] != HEADER_OPCODE:
        return None
    size = int.from_bytes(head[HEADER_AT : HEADER_AT + 4], "little")
    profile = head[HEADER_AT + 4 : HEADER_AT + 4 + size]
    return profile.decode("utf-8", "replace") if len(profile) == size else None


# ------------------------------------------------------------------------------------------------------------------- MCAP


def _mcap(path: Path) -> Bag:
    from mcap.exceptions import McapError

    bag = Bag()
    schemas: dict[int, Any] = {}
    channels: dict[int, Any] = {}
    decoders: dict[int, Decode | None] = {}
    try:
        with path.open("rb") as file:
            for record in _mcap_records(file):
                match type(record).__name__:
                    case "Schema":
                        schemas[record.id] = record
                    case "Channel":
                        channels[record.id] = record
                    case "Message" if record.channel_id in channels:
                        channel = channels[record.channel_id]
                        schema = schemas.get(channel.schema_id)
                        if record.channel_id not in decoders:
                            make = partial(_mcap_decoder, channel, schema)
                            decoders[record.channel_id] = bag.decoder(channel.topic, "schema", make)
                        decode = decoders[record.channel_id]
                        if decode is not None:
                            kind = schema.name if schema else ""
                            bag.add_message(channel.topic, kind, record.log_time, record.data, decode)
    except (McapError, Bad, RuntimeError, *_DAMAGE) as error:
        if not bag.topics:
            raise ImportDataError(
                f"{path}: not an MCAP file, or its first chunk is cut off or damaged ({error})"
            ) from error
        bag.notes.append(f"the file is cut off or damaged ({type(error).__name__}); the whole messages before are used")
    return bag


def _mcap_records(file: IO[bytes]) -> Iterator[Any]:
    """The records of an MCAP file, those in its chunks among them, each within LARGEST_RECORD whatever its head claims."""
    from mcap.records import Chunk
    from mcap.stream_reader import StreamReader, breakup_chunk

    for record in StreamReader(file, emit_chunks=True, record_size_limit=LARGEST_RECORD).records:
        if not isinstance(record, Chunk):
            yield record
            continue
        if record.compression:
            record.data = expand_within(record.compression, record.data, record.uncompressed_size, LARGEST_RECORD)
            record.compression = ""
        yield from breakup_chunk(record)


def _mcap_decoder(channel: Any, schema: Any) -> Decode:
    if channel.message_encoding == "json":
        return json.loads
    if channel.message_encoding == "cdr" and schema is not None and schema.encoding == "ros2msg":
        return _cdr(schema.name, schema.data.decode())
    if channel.message_encoding == "protobuf" and schema is not None:
        return _protobuf(schema)
    kind = f"{channel.message_encoding or 'no encoding'} with {schema.encoding if schema else 'no'} schema"
    raise UnknownSchemaError(f"{kind} is not known; cdr with ros2msg, protobuf and json are")


def _cdr(name: str, definition: str) -> Decode:
    from mcap_ros2.decoder import generate_dynamic

    if len(definition) > LONGEST_DEFINITION:
        raise UnknownSchemaError(f"a definition of {len(definition)} letters; at most {LONGEST_DEFINITION} are read")
    with contextlib.redirect_stderr(io.StringIO()):  # it says there what it raises
        decoders: Mapping[str, Decode] = generate_dynamic(name, definition)
    return decoders[name] if name in decoders else decoders[name.replace("/msg/", "/")]


def _protobuf(schema: Any) -> Decode:
    from mcap_protobuf.decoder import DecoderFactory

    decode: Decode | None = DecoderFactory().decoder_for("protobuf", schema)
    if decode is None:
        raise ValueError("no protobuf schema")
    return decode


# ----------------------------------------------------------------------------------------------------------------- SQLite


def _sqlite(path: Path) -> Bag:
    bag = Bag()
    try:
        with sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True) as file:
            # Neither views nor virtual tables, which have no pages: what they hold is computed.
            tables = {
                row[0] for row in file.execute("select name from sqlite_master where type = 'table' and rootpage")
            }
            if not {"topics", "messages"} <= tables:
                raise ImportDataError(f"{path}: an SQLite file, but no ROS 2 bag: it has no tables topics and messages")
            computed = "select count(*) from pragma_table_xinfo('messages') where hidden"
            if file.execute(computed).fetchone()[0]:
                raise ImportDataError(f"{path}: its messages are computed as they are read, which no ROS 2 bag does")
            query = "select topic_type, encoded_message_definition from message_definitions where encoding = 'ros2msg'"
            definitions: dict[str, str] = dict(file.execute(query)) if "message_definitions" in tables else {}
            topics = {number: (name, kind) for number, name, kind in file.execute("select id, name, type from topics")}
            decoders = {
                number: bag.decoder(name, "definition", partial(_sqlite_decoder, kind, definitions))
                for number, (name, kind) in topics.items()
            }
            query = "select topic_id, timestamp, data from messages order by timestamp"
            for number, stamp, data in file.execute(query):
                decode = decoders.get(number)
                if decode is not None and isinstance(data, bytes) and isinstance(stamp, int):
                    bag.add_message(*topics[number], stamp, data, decode)
    except (sqlite3.Error, UnicodeDecodeError) as error:  # the latter: where SQLite's own words quote bytes of the file
        if not bag.topics:
            raise ImportDataError(f"{path}: damaged SQLite bag ({error})") from error
        bag.notes.append(f"the bag is damaged ({error}); the whole messages before are used")
    return bag


def _sqlite_decoder(kind: str, definitions: Mapping[str, str]) -> Decode:
    from groundstation.importers.formats.ros_definitions import STANDARD

    text = definitions.get(kind) or STANDARD.get(kind)
    if text is None:
        raise UnknownSchemaError(
            f"{kind}: this bag carries no definitions; convert it with 'ros2 bag convert' to MCAP, which does"
        )
    return _cdr(kind, text)
