"""MCAP files and ROS 2 bags of other programs (rosbag2 as MCAP and SQLite): the messages, decoded by the schemas they carry.

Formats: MCAP specification (mcap.dev), message encodings `cdr` with `ros2msg` schemas, `protobuf` and `json`;
rosbag2_storage_sqlite3 (tables topics, messages, and since Iron message_definitions). Bags older than that carry no
definitions: those of the standard messages are in `ros_definitions`.
"""

import json
import sqlite3
import struct
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from groundstation.importers.errors import ImportDataError
from groundstation.importers.formats.bag_series import Topic, numbers_of

SQLITE = b"SQLite format 3\0"
OURS = "sideslip"  # profile of the recordings and flights that this program writes
MCAP_MAGIC = b"\x89MCAP0\r\n"
HEADER_OPCODE, HEADER_AT = 1, 17  # the header record, and where its profile begins
HEAD_BYTES = 4096  # read to find the profile
LARGEST_RECORD = 256 << 20  # bytes of one record of an MCAP file: a chunk of a bag has a few megabytes
_DAMAGE = (
    ValueError,
    KeyError,
    IndexError,
    TypeError,
    AttributeError,
    OverflowError,
    EOFError,
    MemoryError,
    struct.error,
)
_WITHOUT = "a package is missing: pip install 'sideslip[ground]'"

Decode = Callable[[bytes], Any]


@dataclass
class Bag:
    """topics: by name; unread: topic -> why its messages cannot be read; damaged: messages that could not be decoded; notes."""

    topics: dict[str, Topic] = field(default_factory=dict)
    unread: dict[str, str] = field(default_factory=dict)
    damaged: int = 0
    notes: list[str] = field(default_factory=list)

    def take(self, name: str, kind: str, time_ns: int, data: bytes, decode: Decode) -> None:
        """Decode and keep a message."""
        try:
            row = numbers_of(decode(data))
        except _DAMAGE:
            self.damaged += 1
            return
        except Exception as error:  # noqa: BLE001 - protobuf and struct raise classes of their own for damaged bytes
            self.damaged += 1
            self.unread.setdefault(name, type(error).__name__)
            return
        self.topics.setdefault(name, Topic(name, kind)).add(time_ns * 1e-9, row)


def read_bag(path: Path) -> Bag:
    """Every message of a bag that can be decoded. Raises ImportDataError where the file is none, or nothing in it can be read."""
    with path.open("rb") as file:
        head = file.read(len(SQLITE))
    bag = _sqlite(path) if head == SQLITE else _mcap(path)
    if not bag.topics:
        why = "; ".join(f"{t}: {w}" for t, w in list(bag.unread.items())[:4]) or "it holds no messages"
        raise ImportDataError(f"{path}: no message of this bag can be read: {why}")
    if bag.damaged:
        bag.notes.append(f"{bag.damaged} messages of the bag are damaged and left out")
    if bag.unread:
        bag.notes.append(
            "topics that cannot be read: " + ", ".join(f"{t} ({w})" for t, w in list(bag.unread.items())[:12])
        )
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
    from mcap.stream_reader import StreamReader

    bag = Bag()
    schemas: dict[int, Any] = {}
    channels: dict[int, Any] = {}
    decoders: dict[int, Decode | None] = {}
    try:
        with path.open("rb") as file:
            every: Iterator[Any] = StreamReader(file, record_size_limit=LARGEST_RECORD).records
            for record in every:
                match type(record).__name__:
                    case "Schema":
                        schemas[record.id] = record
                    case "Channel":
                        channels[record.id] = record
                    case "Message" if record.channel_id in channels:
                        channel = channels[record.channel_id]
                        schema = schemas.get(channel.schema_id)
                        if record.channel_id not in decoders:
                            decoders[record.channel_id] = _decoder(bag, channel, schema)
                        decode = decoders[record.channel_id]
                        if decode is not None:
                            bag.take(channel.topic, schema.name if schema else "", record.log_time, record.data, decode)
    except (McapError, *_DAMAGE) as error:
        if not bag.topics:
            raise ImportDataError(
                f"{path}: not an MCAP file, or its first chunk is cut off or damaged ({error})"
            ) from error
        bag.notes.append(f"the file is cut off or damaged ({type(error).__name__}); the whole messages before are used")
    return bag


def _decoder(bag: Bag, channel: Any, schema: Any) -> Decode | None:
    """What reads the messages of a channel; None, and why in the bag, where nothing does."""
    try:
        if channel.message_encoding == "json":
            return json.loads
        if channel.message_encoding == "cdr" and schema is not None and schema.encoding == "ros2msg":
            return _cdr(schema.name, schema.data.decode())
        if channel.message_encoding == "protobuf" and schema is not None:
            return _protobuf(schema)
    except ModuleNotFoundError:
        bag.unread[channel.topic] = _WITHOUT
        return None
    except Exception as error:  # noqa: BLE001 - a schema may be anything
        bag.unread[channel.topic] = f"its schema cannot be read ({type(error).__name__})"
        return None
    kind = f"{channel.message_encoding or 'no encoding'} with {schema.encoding if schema else 'no'} schema"
    bag.unread[channel.topic] = f"{kind} is not known; cdr with ros2msg, protobuf and json are"
    return None


def _cdr(name: str, definition: str) -> Decode:
    from mcap_ros2.decoder import generate_dynamic

    made: Mapping[str, Decode] = generate_dynamic(name, definition)
    return made[name] if name in made else made[name.replace("/msg/", "/")]


def _protobuf(schema: Any) -> Decode:
    from mcap_protobuf.decoder import DecoderFactory

    decode: Decode | None = DecoderFactory().decoder_for("protobuf", schema)
    if decode is None:
        raise ValueError("no protobuf schema")
    return decode


# ----------------------------------------------------------------------------------------------------------------- SQLite


def _sqlite(path: Path) -> Bag:
    from groundstation.importers.formats.ros_definitions import STANDARD

    bag = Bag()
    try:
        with sqlite3.connect(f"file:{path.resolve()}?mode=ro", uri=True) as file:
            names = {row[0] for row in file.execute("select name from sqlite_master where type = 'table'")}
            if not {"topics", "messages"} <= names:
                raise ImportDataError(f"{path}: an SQLite file, but no ROS 2 bag: it has no tables topics and messages")
            defined = dict(_definitions(file)) if "message_definitions" in names else {}
            topics = {number: (name, kind) for number, name, kind in file.execute("select id, name, type from topics")}
            decoders: dict[int, Decode | None] = {}
            for number, (name, kind) in topics.items():
                text = defined.get(kind) or STANDARD.get(kind)
                decoders[number] = _cdr_or_why(bag, name, kind, text)
            for number, stamp, data in file.execute(
                "select topic_id, timestamp, data from messages order by timestamp"
            ):
                decode = decoders.get(number)
                if decode is not None and isinstance(data, bytes) and isinstance(stamp, int):
                    bag.take(*topics[number], stamp, data, decode)
    except sqlite3.Error as error:
        if not bag.topics:
            raise ImportDataError(f"{path}: damaged SQLite bag ({error})") from error
        bag.notes.append(f"the bag is damaged ({error}); the whole messages before are used")
    return bag


def _definitions(file: sqlite3.Connection) -> Iterator[tuple[str, str]]:
    yield from file.execute(
        "select topic_type, encoded_message_definition from message_definitions where encoding = 'ros2msg'"
    )


def _cdr_or_why(bag: Bag, name: str, kind: str, text: str | None) -> Decode | None:
    if text is None:
        bag.unread[name] = (
            f"{kind}: this bag carries no definitions; convert it with 'ros2 bag convert' to MCAP, which does"
        )
        return None
    try:
        return _cdr(kind, text)
    except ModuleNotFoundError:
        bag.unread[name] = _WITHOUT
    except Exception as error:  # noqa: BLE001 - a definition may be anything
        bag.unread[name] = f"its definition cannot be read ({type(error).__name__})"
    return None
