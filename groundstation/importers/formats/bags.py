"""MCAP files and ROS 2 bags of other programs (rosbag2 as MCAP and SQLite): the messages, decoded by the schemas they carry.

Formats: MCAP specification (mcap.dev), message encodings as in `bag_decoders`; rosbag2_storage_sqlite3 (tables topics, messages,
and since Iron message_definitions). Bags older than that carry no definitions: those of the standard messages are in
`ros_definitions`.
"""

import re
import sqlite3
import struct
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import IO, Any

from daq.contract.recordings.expand import Bad, expand_within
from daq.contract.recordings.profile import OURS, mcap_profile
from daq.utilities.input_files import read_text
from daq.utilities.plain_words import listed
from groundstation.importers.endings import BAGS, SQLITE_MAGIC
from groundstation.importers.errors import ImportDataError
from groundstation.importers.formats.bag_decoders import (
    Decode,
    UnknownSchemaError,
    mcap_decoder,
    sqlite_decoder,
    unpacked,
)
from groundstation.importers.formats.bag_series import Topic, numbers_of

LARGEST_RECORD = 64 << 20
"""Bytes of one record of an MCAP file, and of a decompressed chunk: a chunk of a bag has a few megabytes."""
LONGEST_MESSAGE = 1 << 20
"""Bytes of a message that is decoded: images and point clouds are longer, and hold no series."""
_DAMAGE = (ValueError, LookupError, TypeError, AttributeError, OverflowError, EOFError, MemoryError, struct.error)
METADATA = "metadata.yaml"  # of a bag's folder: lists its files in their order
_LISTED = re.compile(r"^\s*relative_file_paths:\s*\n((?:\s*- .*\n?)+)", re.MULTILINE)
PACKED = (".zstd", ".zst")  # endings of files that rosbag2 has compressed
_NUMBERED = re.compile(r"(.+)_(\d+)")
WORDS: Mapping[str, str] = {"mavros_msgs/State": "mode", "mavros_msgs/StatusText": "text"}
"""Kind of a message -> its field of text that is kept."""


@dataclass
class Bag:
    """topics: by name; unread: topic -> why its messages cannot be read; damaged: messages that could not be decoded; notes."""

    topics: dict[str, Topic] = field(default_factory=dict)
    unread: dict[str, str] = field(default_factory=dict)
    damaged: int = 0
    notes: list[str] = field(default_factory=list)

    def decoder(self, topic: str, description: str, make: Callable[[], Decode]) -> Decode | None:
        """The decoder of a topic's messages; None, with the reason in `unread`, where its `description` (schema, definition)
        cannot be read."""
        try:
            return make()
        except ModuleNotFoundError:
            self.unread[topic] = "a package is missing: pip install 'sideslip[ground]'"
        except UnknownSchemaError as error:
            self.unread[topic] = str(error)
        except Exception as error:  # noqa: BLE001 - a schema may be anything
            self.unread[topic] = f"its {description} cannot be read ({type(error).__name__})"
        return None

    def add_message(self, name: str, kind: str, time_ns: int, data: bytes, decode: Decode) -> None:
        """Decode a message and add it to its topic; count it where it is damaged."""
        if len(data) > LONGEST_MESSAGE:
            self.unread[name] = f"messages of {len(data)} bytes; at most {LONGEST_MESSAGE} are read"
            return
        try:
            message = decode(unpacked(data, LONGEST_MESSAGE))
            row = numbers_of(message)
        except Exception as error:  # noqa: BLE001 - protobuf and struct raise classes of their own for damaged bytes
            self.damaged += 1
            if not isinstance(error, _DAMAGE):
                self.unread.setdefault(name, type(error).__name__)
            return
        kind = kind.replace("/msg/", "/")
        field_of_words = WORDS.get(kind)
        words = str(_field(message, field_of_words)) if field_of_words else ""
        self.topics.setdefault(name, Topic(name, kind)).add_message(time_ns * 1e-9, row, words)


def _field(message: Any, name: str) -> object:
    """A field of a decoded message; empty text where the message lacks it."""
    return message.get(name, "") if isinstance(message, Mapping) else getattr(message, name, "")


def read_bag(paths: Sequence[Path]) -> Bag:
    """Every message of a bag that can be decoded. paths: its files in their order.

    Raises ImportDataError where a file is no bag, or nothing in the bag can be read.
    """
    bag = Bag()
    for path in paths:
        with path.open("rb") as file:
            head = file.read(len(SQLITE_MAGIC))
        (_read_sqlite if head == SQLITE_MAGIC else _read_mcap)(path, bag)
    if not bag.topics:
        raise ImportDataError(f"{paths[0]}: no message of this bag can be read: {_why_unread(bag)}")
    if bag.damaged:
        bag.notes.append(f"{bag.damaged} messages of the bag are damaged and left out")
    if bag.unread:
        unread = ", ".join(f"{t} ({w})" for t, w in list(bag.unread.items())[:12])
        bag.notes.append(f"topics that cannot be read: {unread}")
    return bag


def _why_unread(bag: Bag) -> str:
    """The reason why a bag gave no messages."""
    if bag.unread:
        by_reason: dict[str, list[str]] = {}
        for topic, reason in bag.unread.items():
            by_reason.setdefault(reason, []).append(topic)
        return "; ".join(f"{listed(topics, 3)}: {reason}" for reason, topics in list(by_reason.items())[:4])
    return f"all {bag.damaged} are damaged" if bag.damaged else "it holds no messages"


def is_bag(path: Path) -> bool:
    """Whether a path is an MCAP file or a ROS 2 bag that Sideslip has not written, or a folder of such files."""
    if path.is_dir():
        try:
            return is_bag(bag_files(path)[0])
        except ImportDataError:
            return False
    if not path.is_file():
        return False
    with path.open("rb") as file:
        if file.read(len(SQLITE_MAGIC)) == SQLITE_MAGIC:
            return True
    profile = mcap_profile(path) if path.suffix.lower() == ".mcap" else None
    return profile is not None and profile != OURS


def bag_files(folder: Path) -> list[Path]:
    """The files of a bag's folder in the order of its metadata.yaml, else of their numbers.

    Raises ImportDataError for a folder without such files.
    """
    try:
        files = [p for p in folder.iterdir() if p.is_file()]
    except OSError as error:
        raise ImportDataError(f"{folder}: cannot be read ({error.strerror})") from error
    parts = sorted((p for p in files if p.suffix.lower() in BAGS), key=_name_and_number)
    if not parts:
        packed = [p.name for p in files if p.suffix.lower() in PACKED and Path(p.stem).suffix.lower() in BAGS]
        unpack = f"; its files are packed: 'zstd -d {folder / packed[0]}' unpacks one" if packed else ""
        raise ImportDataError(f"{folder}: a folder without the files of a bag (.mcap, .db3){unpack}")
    listing = folder / METADATA
    if not listing.is_file():
        return parts
    match = _LISTED.search(read_text(listing, "bag's metadata", ImportDataError))
    names = re.findall(r"- *['\"]?([^'\"\n]+?)['\"]? *$", match[1], re.MULTILINE) if match else []
    listed_files = [folder / Path(name).name for name in names]
    return listed_files if set(listed_files) == set(parts) else parts


def _name_and_number(path: Path) -> tuple[str, int]:
    """Name and number of a bag's file, which rosbag2 calls NAME_0, NAME_1, ..., NAME_10; number -1 without one."""
    match = _NUMBERED.fullmatch(path.stem)
    return (match[1], int(match[2])) if match else (path.stem, -1)


def parts_of_one_bag(first: Path, second: Path) -> bool:
    """Whether two files are consecutive parts of a bag that was split."""
    if first.suffix.lower() not in BAGS or first.parent != second.parent or first.suffix != second.suffix:
        return False
    (name, number), (second_name, second_number) = _name_and_number(first), _name_and_number(second)
    return name == second_name and 0 <= number == second_number - 1


# ------------------------------------------------------------------------------------------------------------------- MCAP


def _read_mcap(path: Path, bag: Bag) -> None:
    """Add the messages of an MCAP file to `bag`."""
    from mcap.exceptions import McapError

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
                            make = partial(mcap_decoder, channel, schema)
                            decoders[record.channel_id] = bag.decoder(channel.topic, "schema", make)
                        decode = decoders[record.channel_id]
                        if decode is not None:
                            kind = schema.name if schema else ""
                            bag.add_message(channel.topic, kind, record.log_time, record.data, decode)
    except (McapError, Bad, RuntimeError, *_DAMAGE) as error:
        if not bag.topics:
            raise ImportDataError(
                f"{path}: not an MCAP file, or its first chunk is cut off or damaged ({str(error) or type(error).__name__})"
            ) from error
        bag.notes.append(f"the file is cut off or damaged ({type(error).__name__}); the whole messages before are used")


def _mcap_records(file: IO[bytes]) -> Iterator[Any]:
    """The records of an MCAP file and of its chunks, each of at most LARGEST_RECORD bytes."""
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


# ----------------------------------------------------------------------------------------------------------------- SQLite


def _read_sqlite(path: Path, bag: Bag) -> None:
    """Add the messages of an SQLite file to `bag`."""
    try:
        with sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True) as file:
            # Views and virtual tables, which have no pages, are left out: a hostile file may compute their rows without end.
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
                number: bag.decoder(name, "definition", partial(sqlite_decoder, kind, definitions))
                for number, (name, kind) in topics.items()
            }
            query = "select topic_id, timestamp, data from messages order by timestamp"
            for number, stamp, data in file.execute(query):
                decode = decoders.get(number)
                if decode is not None and isinstance(data, bytes) and isinstance(stamp, int):
                    bag.add_message(*topics[number], stamp, data, decode)
    except (sqlite3.Error, UnicodeDecodeError) as error:  # the latter: where SQLite's message quotes bytes of the file
        if not bag.topics:
            raise ImportDataError(f"{path}: damaged SQLite bag ({error})") from error
        bag.notes.append(f"the bag is damaged ({error}); the whole messages before are used")
