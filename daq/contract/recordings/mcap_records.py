"""MCAP records as bytes: their layout, and the checks that prove a record to be what was written.

Layout: MCAP specification, https://mcap.dev/spec. What reads a record raises `Bad` for bytes that fail a check. Where in damaged
bytes one may begin is found in one pass of a regular expression, by what must stand in its head.
"""

import re
import struct
import zlib
from collections.abc import Mapping
from dataclasses import dataclass

from daq.contract.recordings.expand import MAX_CHUNK, Bad, Effort, expand
from daq.contract.recordings.recording import DETAIL_NAME, INFO_NAME, LOG_TIME_NAME, metadata_digest

MAGIC = b"\x89MCAP0\r\n"
HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX, CHUNK_INDEX = range(1, 9)
ATTACHMENT, ATTACHMENT_INDEX, STATISTICS, METADATA, METADATA_INDEX, SUMMARY_OFFSET, DATA_END = range(9, 16)

SUMMARY_ONLY = (CHUNK_INDEX, ATTACHMENT_INDEX, STATISTICS, METADATA_INDEX, SUMMARY_OFFSET)
"""Records that stand behind the end of the data; anywhere before, the code is not what was written."""

RECORD_HEAD = 9  # code and length
_CHUNK_FIXED = struct.Struct("<QQQII")  # first and last time, size, checksum, length of the compression's name
CHUNK_HEAD = _CHUNK_FIXED.size + 8
"""Fields of a chunk around its compression's name and stored bytes."""


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


@dataclass(slots=True)
class McapRecord:
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
        texts: dict[str, str] = {}
        while part.at < len(part.body):
            key = part.text()
            texts[key] = part.text()
        return texts

    def finish(self) -> None:
        if self.at != len(self.body):
            raise Bad("its length does not fit its content")


def chunk_plausible(body: memoryview) -> bool:
    """Whether the lengths within a chunk fit each other and its checksum is stated: cheap, before anything is computed."""
    if len(body) < CHUNK_HEAD:
        return False
    _, _, size, checksum, name = _CHUNK_FIXED.unpack_from(body)
    if not checksum or name not in (0, 3, 4) or len(body) < CHUNK_HEAD + name:
        return False
    stored = len(body) - CHUNK_HEAD - name
    if int.from_bytes(body[_CHUNK_FIXED.size + name : CHUNK_HEAD + name], "little") != stored:
        return False
    return size <= MAX_CHUNK if name else size == stored


def chunk_content(body: memoryview, effort: Effort) -> bytes | memoryview:
    """The records in a chunk, proven by its checksum (where the writer gave one)."""
    cursor = Cursor(body)
    cursor.take(16)
    size, checksum = cursor.number(8), cursor.number(4)
    compression = cursor.text()
    stored = cursor.take(cursor.number(8))
    cursor.finish()
    effort.check(len(stored))
    content = expand(compression, stored, size, effort) if compression else stored
    if len(content) != size:
        raise Bad("its size does not match")
    if checksum and zlib.crc32(content) != checksum:
        raise Bad("checksum does not match")
    return content


def read_attachment(body: memoryview, effort: Effort) -> Attachment:
    """A file, proven by its checksum (where the writer gave one)."""
    cursor = Cursor(body)
    cursor.take(16)
    name = cursor.text()
    cursor.text()
    data = cursor.take(cursor.number(8))
    checked_bytes = body[: cursor.at]
    checksum = cursor.number(4)
    cursor.finish()
    effort.check(len(checked_bytes))
    if checksum and checksum != zlib.crc32(checked_bytes):
        raise Bad("checksum does not match")
    return Attachment(name, bytes(data))


def read_metadata(body: memoryview, effort: Effort) -> Metadata:
    """Names and values, ours proven by their digest."""
    effort.check(len(body))
    cursor = Cursor(body)
    name = cursor.text()
    fields = cursor.texts()
    cursor.finish()
    if name in (INFO_NAME, DETAIL_NAME, LOG_TIME_NAME) and fields.get("sha256") != metadata_digest(fields):
        raise Bad("digest does not match")
    return Metadata(name, fields)


_STRUCTURES: Mapping[int, tuple[int | str, ...]] = {
    HEADER: ("text", "text"),
    MESSAGE_INDEX: (2, "rows of 16"),
    CHUNK_INDEX: (32, "rows of 10", 8, "text", 16),
    ATTACHMENT_INDEX: (40, "text", "text"),
    STATISTICS: (42, "rows of 10"),
    METADATA_INDEX: (16, "text"),
    SUMMARY_OFFSET: (17,),
}
"""Parts of records that only index others: bytes, a text, a list whose elements have so many bytes."""


def check_structure(record: McapRecord) -> None:
    """Records that only index others: their content is not used, every length in them must fit."""
    cursor = Cursor(record.body)
    for part in _STRUCTURES.get(record.opcode, ()):
        if isinstance(part, int):
            cursor.take(part)
        elif part == "text":
            cursor.text()
        else:
            size = cursor.number(4)
            if size % int(part.removeprefix("rows of ")):
                raise Bad("its inner lengths do not fit")
            cursor.take(size)
    cursor.finish()


_LENGTH = rb".{5}\x00{3}"  # below 2^40
_SHORT = rb".\x00{3}"  # length of a text below 256
_CANDIDATE = re.compile(
    rb"(?s:"
    rb"\x06" + _LENGTH + rb"(?=.{16}" + _LENGTH + rb".{4}(?:\x00{4}|\x04\x00{3}zstd|\x03\x00{3}lz4)" + _LENGTH + rb")"
    rb"|\x09" + _LENGTH + rb"(?=.{16}" + _SHORT + rb")"
    rb"|\x0c" + _LENGTH + rb"(?=" + _SHORT + rb"sideslip\.)"
    rb"|\x07" + _LENGTH + rb"(?=...\x00)"
    rb"|\x08" + _LENGTH + rb"(?=.{32}...\x00)"
    rb"|\x0f\x04\x00{7}"
    rb"|\x02\x14\x00{7}(?=.{20}" + re.escape(MAGIC) + rb")"
    rb"|" + re.escape(MAGIC) + rb"\x01)"
)
_HEADER = re.compile(re.escape(MAGIC) + rb"(?s:\x01" + _LENGTH + rb")")


def next_candidate(data: bytes, at: int, end: int | None = None) -> int:
    """The first byte from `at` on where a record may begin that is worth a check; the length of `data` if there is none.

    end: heads are looked for in the bytes before it only.
    """
    match = _CANDIDATE.search(data, at, len(data) if end is None else end)
    return match.start() if match else len(data)


def begins(data: bytes, at: int) -> bool:
    """Whether a file begins here: the mark, and a header whose lengths fit."""
    match = _HEADER.match(data, at)
    if match is None:
        return False
    body = match.end()
    end = body + int.from_bytes(data[at + 9 : at + 17], "little")
    for _ in range(2):  # profile and library
        if body + 4 > min(end, len(data)):
            return False
        body += 4 + int.from_bytes(data[body : body + 4], "little")
    return body == end <= len(data)
