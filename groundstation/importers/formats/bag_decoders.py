"""Decoders for the messages of a bag, by the schemas in it: ROS 2 (CDR), ROS 1, protobuf and JSON."""

import contextlib
import io
import json
from collections.abc import Callable, Mapping
from typing import Any

from daq.contract.recordings.expand import expand_within
from groundstation.importers.formats.ros1_messages import ros1_decoder
from groundstation.importers.formats.ros_definitions import STANDARD

LONGEST_DEFINITION = 1 << 16  # bytes of a message's definition with its parts: the longest of px4_msgs has 10 kB
ZSTD = b"\x28\xb5\x2f\xfd"
"""First bytes of a message that rosbag2 compressed (compression_mode: message); a CDR message begins with 0, 0 or 0, 1."""
DEFINITIONS = ("ros2msg", "ros1msg")
Decode = Callable[[bytes], Any]


class UnknownSchemaError(Exception):
    """Messages for which there is no decoder."""


def mcap_decoder(channel: Any, schema: Any) -> Decode:
    """The decoder for the messages of an MCAP channel. Raises UnknownSchemaError."""
    encoding, kind = channel.message_encoding, schema.encoding if schema else "no"
    if encoding == "json":
        return json.loads
    if schema is not None and kind in DEFINITIONS:
        _check_length(schema.data)
    if encoding == "cdr" and kind == "ros2msg":
        return _cdr(schema.name, schema.data.decode())
    if encoding == "cdr" and schema is not None and schema.name in STANDARD:  # whatever the language of its definition
        return _cdr(schema.name, STANDARD[schema.name])
    if encoding == "ros1" and kind == "ros1msg":
        return ros1_decoder(schema.name, schema.data.decode())
    if encoding == "protobuf" and schema is not None:
        return _protobuf(schema)
    raise UnknownSchemaError(
        f"{encoding or 'no encoding'} with {kind} schema is not read; cdr with ros2msg, ros1, protobuf and json are: "
        "'rosbags-convert --src BAG --dst NEW' (pip install rosbags) writes them so"
    )


def sqlite_decoder(kind: str, definitions: Mapping[str, str]) -> Decode:
    """The decoder for a kind of message in an SQLite bag, by the bag's definition or else the standard one. Raises
    UnknownSchemaError."""
    text = definitions.get(kind) or STANDARD.get(kind)
    if text is None:
        raise UnknownSchemaError(
            f"{kind}: this bag carries no definitions; convert it with 'ros2 bag convert' to MCAP, which does"
        )
    _check_length(text)
    return _cdr(kind, text)


def _check_length(definition: str | bytes) -> None:
    if len(definition) > LONGEST_DEFINITION:
        raise UnknownSchemaError(f"a definition of {len(definition)} letters; at most {LONGEST_DEFINITION} are read")


def unpacked(data: bytes, limit: int) -> bytes:
    """A message, decompressed where rosbag2 compressed it. Raises `Bad` beyond `limit` bytes."""
    if not data.startswith(ZSTD):
        return data
    from zstandard import get_frame_parameters

    size = get_frame_parameters(data).content_size
    return expand_within("zstd", data, size if 0 < size <= limit else limit, limit)


def _cdr(name: str, definition: str) -> Decode:
    from mcap_ros2.decoder import generate_dynamic

    with contextlib.redirect_stderr(io.StringIO()):  # it also prints the errors that it raises
        decoders: Mapping[str, Decode] = generate_dynamic(name, definition)
    return decoders[name] if name in decoders else decoders[name.replace("/msg/", "/")]


def _protobuf(schema: Any) -> Decode:
    from mcap_protobuf.decoder import DecoderFactory

    decode: Decode | None = DecoderFactory().decoder_for("protobuf", schema)
    if decode is None:
        raise ValueError("no protobuf schema")
    return decode
