"""A checksum inside every recorded message, so that each one can be trusted alone.

A chunk checksum tells only that something in a second of data is wrong. With a checksum of its own, a scan that
survives in a torn or altered chunk is known to be right, and one that was altered is known to be wrong.
The seal is one protobuf field, number 15, type fixed32, named `crc`, always the last five bytes of the message:
CRC-32 over the name of the schema and all bytes before the seal. The name is part of it so that a message cannot pass
for one of another kind. Readers that do not know the seal see an ordinary field.
"""

import struct
import zlib
from functools import cache
from typing import Any

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

SEAL_FIELD = "crc"
SEAL_NUMBER = 15
SEAL_SIZE = 5
SEAL_TAG = bytes([SEAL_NUMBER << 3 | 5])
"""First byte of a seal."""


@cache
def seal_start(schema: str) -> int:
    """CRC-32 that the seal of a schema's messages starts from."""
    return zlib.crc32(schema.encode())


def seal(schema: str, data: bytes) -> bytes:
    """The message bytes with their seal appended."""
    return data + SEAL_TAG + struct.pack("<I", zlib.crc32(data, seal_start(schema)))


def has_seal(data: bytes | memoryview) -> bool:
    """Whether the bytes end like a sealed message."""
    return len(data) >= SEAL_SIZE and data[-SEAL_SIZE] == SEAL_TAG[0]


def seal_holds(schema: str, data: bytes | memoryview) -> bool:
    """Whether the bytes are sealed, as a message of `schema`, and unaltered."""
    if not has_seal(data):
        return False
    return zlib.crc32(data[:-SEAL_SIZE], seal_start(schema)) == int.from_bytes(data[-4:], "little")


def message_class(schema: str, files: descriptor_pb2.FileDescriptorSet) -> Any:
    """The protobuf class of a message by its descriptors, in a pool of its own."""
    pool = descriptor_pool.DescriptorPool()
    for file in files.file:
        pool.Add(file)  # type: ignore[no-untyped-call]
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(schema))
