"""Walk through the bytes of an MCAP file, sound or damaged, and give out everything that is surely right.

Stock readers stop at the first damage or pass altered values on. This walk trusts a record only when its own checksum
or structure proves it, names every damaged stretch, looks inside that stretch for messages whose seal holds, and goes
on at the next record that can be trusted. Record layout: MCAP specification, https://mcap.dev/spec.
"""

import re
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass

from daq.contract.recordings.fragment_scan import salvage_region
from daq.contract.recordings.mcap_records import (
    ATTACHMENT,
    CHANNEL,
    CHUNK,
    CHUNK_INDEX,
    DATA_END,
    FOOTER,
    HEADER,
    MAGIC,
    MESSAGE,
    MESSAGE_INDEX,
    METADATA,
    SCHEMA,
    Attachment,
    Bad,
    Cursor,
    Metadata,
    Record,
    check_structure,
    chunk_content,
    read_attachment,
    read_metadata,
)
from daq.contract.recordings.recording import DETAIL_NAME, INFO_NAME, SCHEMA_OF_TOPIC, Entry
from daq.contract.seal import seal_holds

_MAYBE_RECORD = re.compile(rb"[\x01-\x0f](?=.{5}\x00{3})", re.DOTALL)


@dataclass(frozen=True, slots=True)
class Damage:
    """A stretch of the file that is not what was written."""

    at_byte: int
    length: int
    what: str


@dataclass(frozen=True, slots=True)
class Closed:
    """The end mark of a file that was closed in order."""

    at_byte: int


Item = Entry | Attachment | Metadata | Damage | Closed


class Walk:
    """One pass over the bytes of a file: iterate it. Afterwards `schemas` and `channel_schema` hold what was declared."""

    def __init__(self, data: bytes) -> None:
        self._data = memoryview(data)
        self._raw = data
        self._topics: dict[int, str] = {}
        self._seen_damage = False
        self._ended = False
        self.schemas: dict[int, tuple[str, bytes]] = {}
        self.channel_schema: dict[str, int] = {}

    def __iter__(self) -> Iterator[Item]:
        at = 0
        if self._raw.startswith(MAGIC):
            at = len(MAGIC)
        else:
            yield self._damage(0, min(len(MAGIC), len(self._raw)), "the file does not begin like an MCAP file")
            at = self._next_trusted(0)
            yield from salvage_region(self._raw[:at])
        while at < len(self._raw):
            if self._ended:
                return
            try:
                record = self._record(at)
                items = list(self._items(record))
            except Bad as error:
                resume = self._resume(at)
                yield self._damage(at, resume - at, f"{self._name(at)}: {error}")
                yield from salvage_region(self._raw[at:resume])
                at = resume
                continue
            yield from items
            at = record.end
        if self._ended:
            return
        yield self._damage(at, 0, "the file ends without an end mark: it was cut off or never closed")

    # ------------------------------------------------------------------------------------------ records

    def _record(self, at: int) -> Record:
        if at + 9 > len(self._raw):
            raise Bad("cut off")
        opcode, length = struct.unpack_from("<BQ", self._raw, at)
        if not HEADER <= opcode <= DATA_END:
            raise Bad(f"no record has the code {opcode}")
        if at + 9 + length > len(self._raw):
            raise Bad("cut off, or its length altered")
        return Record(at, opcode, self._data[at + 9 : at + 9 + length])

    def _items(self, record: Record) -> Iterator[Item]:
        if record.opcode == CHUNK:
            yield from self._chunk(record)
        elif record.opcode == MESSAGE:
            yield self._message(record.body)
        elif record.opcode in (SCHEMA, CHANNEL):
            self._declare(record)
        elif record.opcode == ATTACHMENT:
            yield read_attachment(record.body)
        elif record.opcode == METADATA:
            yield read_metadata(record.body)
        elif record.opcode == DATA_END:
            yield from self._data_end(record)
        elif record.opcode == FOOTER:
            yield from self._footer(record)
        else:
            check_structure(record)

    def _chunk(self, record: Record) -> Iterator[Entry]:
        content = memoryview(chunk_content(record.body))
        at = 0
        while at < len(content):
            if at + 9 > len(content):
                raise Bad("its content breaks off")
            opcode, length = struct.unpack_from("<BQ", content, at)
            if at + 9 + length > len(content):
                raise Bad("its content breaks off")
            inner = Record(at, opcode, content[at + 9 : at + 9 + length])
            if opcode == MESSAGE:
                yield self._message(inner.body)
            elif opcode in (SCHEMA, CHANNEL):
                self._declare(inner)
            at = inner.end

    def _message(self, body: memoryview) -> Entry:
        if len(body) < 22:
            raise Bad("shorter than a message can be")
        channel, sequence, log_time, publish_time = struct.unpack_from("<HIQQ", body)
        data = bytes(body[22:])
        topic = self._topics.get(channel)
        if topic is None or topic in SCHEMA_OF_TOPIC:
            sealed_as = [t for t in ([topic] if topic else SCHEMA_OF_TOPIC) if seal_holds(SCHEMA_OF_TOPIC[t], data)]
            if not sealed_as:
                raise Bad("a message in it fails its checksum or belongs to a channel that was not declared")
            topic = sealed_as[0]
        return Entry(topic, log_time, publish_time, sequence, data)

    def _declare(self, record: Record) -> None:
        cursor = Cursor(record.body)
        number = cursor.number(2)
        if record.opcode == SCHEMA:
            name = cursor.text()
            cursor.text()
            self.schemas.setdefault(number, (name, bytes(cursor.take(cursor.number(4)))))
            cursor.finish()
            return
        schema_id = cursor.number(2)
        topic = cursor.text()
        cursor.text()
        cursor.texts()
        cursor.finish()
        self._topics.setdefault(number, topic)
        self.channel_schema.setdefault(topic, schema_id)

    def _data_end(self, record: Record) -> Iterator[Damage]:
        cursor = Cursor(record.body)
        stated = cursor.number(4)
        cursor.finish()
        if stated and not self._seen_damage and stated != zlib.crc32(self._data[: record.at]):
            yield self._damage(0, 0, "a byte outside the chunks was altered (checksum of the data section)")

    def _footer(self, record: Record) -> Iterator[Item]:
        cursor = Cursor(record.body)
        start, _, stated = cursor.number(8), cursor.number(8), cursor.number(4)
        cursor.finish()
        if start and not len(MAGIC) <= start <= record.at:
            raise Bad("it points outside the file")
        covered = self._data[start or record.at : record.end - 4]
        if stated and stated != zlib.crc32(covered):
            yield self._damage(start, record.at - start, "index at the end: checksum does not match")
        if not self._at_end_mark(record.end):
            yield self._damage(record.end, len(self._raw) - record.end, "the end mark is damaged or followed by more")
        self._ended = True
        yield Closed(record.at)

    def _at_end_mark(self, at: int) -> bool:
        return len(self._raw) - at == len(MAGIC) and self._raw.endswith(MAGIC)

    # ------------------------------------------------------------------------------------------ damaged stretches

    def _damage(self, at: int, length: int, what: str) -> Damage:
        self._seen_damage = True
        return Damage(at, length, what)

    def _name(self, at: int) -> str:
        names = {CHUNK: "chunk", METADATA: "metadata", ATTACHMENT: "attachment", DATA_END: "end of data"}
        return names.get(self._raw[at], "record")

    def _resume(self, at: int) -> int:
        """Start of the next record to be trusted after a bad one."""
        if at + 9 <= len(self._raw):
            stated = at + 9 + int.from_bytes(self._raw[at + 1 : at + 9], "little")
            if stated < len(self._raw) and self._trusted(stated):
                return stated
        return self._next_trusted(at + 1)

    def _next_trusted(self, at: int) -> int:
        for match in _MAYBE_RECORD.finditer(self._raw, at):
            if self._trusted(match.start()):
                return match.start()
        return len(self._raw)

    def _trusted(self, at: int) -> bool:
        """Whether checks prove that a record begins here; kinds too short to prove anything are not trusted."""
        try:
            record = self._record(at)
            if record.opcode == CHUNK:
                chunk_content(record.body)
            elif record.opcode == ATTACHMENT:
                read_attachment(record.body)
            elif record.opcode == METADATA:
                return read_metadata(record.body).name in (INFO_NAME, DETAIL_NAME)
            elif record.opcode in (MESSAGE_INDEX, CHUNK_INDEX):
                check_structure(record)
                return len(record.body) > 6
            elif record.opcode == DATA_END:
                return len(record.body) == 4 and record.end < len(self._raw)
            else:
                return record.opcode == FOOTER and len(record.body) == 20 and self._at_end_mark(record.end)
        except Bad:
            return False
        return True
