"""MCAP records as bytes: their layout, and the checks that prove a record to be what was written.

Layout: MCAP specification, https://mcap.dev/spec. Every function here raises `Bad` for bytes that fail a check.
"""

import zlib
from collections.abc import Mapping
from dataclasses import dataclass

import zstandard

from daq.contract.recordings.recording import DETAIL_NAME, INFO_NAME, metadata_digest

MAGIC = b"\x89MCAP0\r\n"
HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX, CHUNK_INDEX = range(1, 9)
ATTACHMENT, ATTACHMENT_INDEX, STATISTICS, METADATA, METADATA_INDEX, SUMMARY_OFFSET, DATA_END = range(9, 16)

MAX_CHUNK = 1 << 28  # uncompressed; larger is taken for damage


@dataclass(frozen=True, slots=True)
class Attachment:
    """A file inside the recording, its checksum proven."""

    name: str
    data: bytes


@dataclass(frozen=True, slots=True)
class Metadata:
    """A metadata record; ours have proven digests."""

    name: str
    fields: Mapping[str, str]


class Bad(Exception):
    """The record at hand is not what was written."""


@dataclass(slots=True)
class Record:
    at: int
    opcode: int
    body: memoryview

    @property
    def end(self) -> int:
        return self.at + 9 + len(self.body)


class Cursor:
    """Reads the fields of a record body; `Bad` when the body is too short for them."""

    def __init__(self, body: memoryview) -> None:
        self.body = body
        self.at = 0

    def number(self, size: int) -> int:
        return int.from_bytes(self.take(size), "little")

    def take(self, size: int) -> memoryview:
        if self.at + size > len(self.body):
            raise Bad("its inner lengths do not fit")
        self.at += size
        return self.body[self.at - size : self.at]

    def text(self) -> str:
        try:
            return str(self.take(self.number(4)), "utf-8")
        except UnicodeDecodeError:
            raise Bad("a name in it is not text") from None

    def texts(self) -> dict[str, str]:
        part = Cursor(self.take(self.number(4)))
        out: dict[str, str] = {}
        while part.at < len(part.body):
            key = part.text()
            out[key] = part.text()
        return out

    def finish(self) -> None:
        if self.at != len(self.body):
            raise Bad("its length does not fit its content")


def chunk_content(body: memoryview) -> bytes | memoryview:
    cursor = Cursor(body)
    cursor.take(16)
    size, stated = cursor.number(8), cursor.number(4)
    compression = cursor.text()
    stored = cursor.take(cursor.number(8))
    cursor.finish()
    if size > MAX_CHUNK:
        raise Bad("its size was altered")
    content = _decompress(compression, stored, size)
    if len(content) != size:
        raise Bad("its size does not match")
    if stated and zlib.crc32(content) != stated:
        raise Bad("checksum does not match")
    return content


def _decompress(compression: str, stored: memoryview, size: int) -> bytes | memoryview:
    if compression == "":
        return stored
    if compression == "zstd":
        try:
            return zstandard.ZstdDecompressor().decompress(bytes(stored), max_output_size=size)
        except zstandard.ZstdError as error:
            raise Bad(f"cannot be decompressed ({error})") from error
    if compression == "lz4":
        return _decompress_lz4(bytes(stored))
    raise Bad(f"unknown compression {compression!r}")


def _decompress_lz4(stored: bytes) -> bytes:
    import lz4.frame

    try:
        return bytes(lz4.frame.decompress(stored))
    except RuntimeError as error:
        raise Bad(f"cannot be decompressed ({error})") from error


def read_attachment(body: memoryview) -> Attachment:
    cursor = Cursor(body)
    cursor.take(16)
    name = cursor.text()
    cursor.text()
    data = bytes(cursor.take(cursor.number(8)))
    covered = body[: cursor.at]
    stated = cursor.number(4)
    cursor.finish()
    if stated and stated != zlib.crc32(covered):
        raise Bad("checksum does not match")
    return Attachment(name, data)


def read_metadata(body: memoryview) -> Metadata:
    cursor = Cursor(body)
    name = cursor.text()
    fields = cursor.texts()
    cursor.finish()
    if name in (INFO_NAME, DETAIL_NAME) and fields.get("sha256") != metadata_digest(fields):
        raise Bad("digest does not match")
    return Metadata(name, fields)


def check_structure(record: Record) -> None:
    """Records that only index others: their content is not used, their shape must fit."""
    cursor = Cursor(record.body)
    if record.opcode == MESSAGE_INDEX:
        cursor.take(2)
        cursor.take(cursor.number(4))
    elif record.opcode == CHUNK_INDEX:
        cursor.take(32)
        cursor.take(cursor.number(4))
        cursor.take(8)
        cursor.text()
        cursor.take(16)
    elif record.opcode == HEADER:
        cursor.text()
        cursor.text()
    else:
        return
    cursor.finish()
