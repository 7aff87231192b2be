"""Reading of an MCAP file, intact or damaged, that yields all content which is certainly unaltered.

Standard readers stop at the first damage or return altered values. `Walk` accepts a record only when its checksum or structure
proves it, reports every damaged stretch, searches it for messages with a valid seal, and continues at the next record that can be
trusted. A file may hold several recordings one behind the other (`cat a b`, the image of a rescue tool): each but the first
begins with `Began`. Record layout: MCAP specification, https://mcap.dev/spec.

Time and memory are proportional to the size of the file, whatever its bytes (`daq.contract.recordings.expand.Effort`).
"""

import struct
from collections.abc import Iterator
from dataclasses import dataclass, field

from daq.contract.recordings.expand import Effort, Exhausted, crc_matches
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
    RECORD_HEAD,
    SCHEMA,
    SUMMARY_ONLY,
    Attachment,
    Bad,
    Cursor,
    McapRecord,
    Metadata,
    begins,
    check_structure,
    chunk_content,
    chunk_plausible,
    next_candidate,
    read_attachment,
    read_metadata,
)
from daq.contract.recordings.recording import DETAIL_NAME, INFO_NAME, LOG_TIME_NAME, SCHEMA_OF_TOPIC, RecordedMessage
from daq.contract.seal import seal_holds

MAX_DAMAGES = 1000
"""Damages reported one by one. Behind the last of them the rest of the file is searched as one stretch, in which intact messages
and compressed chunks are still found."""
MAX_PARTS = 1000
"""Recordings in one file that are separated; a session has a segment every two minutes, a card some hundred files."""
_PROVEN = (CHUNK, ATTACHMENT, MESSAGE, METADATA)
_BATCH = 1 << 20  # damaged bytes searched together: a search has a fixed cost, and a file may have many short stretches
_RECORD = struct.Struct("<BQ")  # code and length of a record
_MESSAGE_HEAD = struct.Struct("<HIQQ")  # channel, sequence, log and publish time
_HEAD_SPAN = 64  # bytes by which a possible record is recognised: its head and first fields
_SEPARATOR = bytes(8)  # between two stretches searched together
_NAMES = {CHUNK: "chunk", METADATA: "metadata", ATTACHMENT: "attachment", DATA_END: "end of data"}


@dataclass(frozen=True, slots=True)
class Damage:
    """An altered or missing stretch of the file: offset, length [bytes], and the kind in words."""

    at_byte: int
    length: int
    what: str


@dataclass(frozen=True, slots=True)
class Closed:
    """The end mark of a file that was closed in order."""

    at_byte: int


@dataclass(frozen=True, slots=True)
class Began:
    """The start of another recording in the same file; the items that follow belong to it."""

    at_byte: int


Item = RecordedMessage | Attachment | Metadata | Damage | Closed | Began


@dataclass(slots=True)
class _SalvagedPart:
    """State of the current recording, one of possibly several in a file."""

    at: int  # its first byte
    topics: dict[int, str] = field(default_factory=dict)
    schemas: dict[int, tuple[str, bytes]] = field(default_factory=dict)
    channel_schema: dict[str, int] = field(default_factory=dict)
    damaged: bool = False
    data_ended: bool = False
    closed: bool = False
    session: str | None = None


class Walk:
    """One pass over the bytes of a file, by iteration. `schemas` and `channel_schema` are those of the current recording."""

    def __init__(self, data: bytes) -> None:
        self._data = memoryview(data)
        self._raw = data
        self._effort = Effort.for_size(len(data))
        self._part = _SalvagedPart(0)
        self._damages = 0
        self._parts = 0
        self._unsearched: list[bytes] = []
        self._unsearched_bytes = 0
        self._unproven: McapRecord | None = None  # the last record, if only its own lengths prove it
        self._content: tuple[int, bytes | memoryview] = (-1, b"")  # offset and content of the chunk expanded last

    @property
    def schemas(self) -> dict[int, tuple[str, bytes]]:
        """Schema number -> name and definition, as declared in the current recording."""
        return self._part.schemas

    @property
    def channel_schema(self) -> dict[str, int]:
        """Topic -> number of its schema, as declared in the current recording."""
        return self._part.channel_schema

    def __iter__(self) -> Iterator[Item]:
        offset = len(MAGIC) if self._ends(0) else 0
        header_missing = offset == 0
        try:
            while offset < len(self._raw):
                if begins(self._raw, offset):
                    yield from self._begin(offset)
                    offset += len(MAGIC)
                elif header_missing or self._part.closed or self._given_up:
                    header_missing = False
                    start, offset = offset, len(self._raw) if self._given_up else self._next_trusted(offset)
                    yield from self._stray(start, offset)
                else:
                    items, offset = self._step(offset)
                    yield from items
            yield from self._search()
        except Exhausted:
            yield self._damage(
                offset, len(self._raw) - offset, "more records than a file of its size can hold: the rest left out"
            )
        if not self._part.closed:
            yield self._damage(offset, 0, "the file ends without an end mark: it was cut off or never closed")

    # ------------------------------------------------------------------------------------------ records

    def _step(self, at: int) -> tuple[list[Item], int]:
        """The items of the record at a byte, and the offset of the next."""
        try:
            record = self._record(at)
            items = self._chunk(record) if record.opcode == CHUNK else list(self._items(record))
        except Bad as error:
            return self._recover(at, error)
        self._unproven = None if record.opcode in _PROVEN else record
        end = record.end
        if record.opcode == FOOTER and (self._ends(end) or len(self._raw) - end < len(MAGIC)):
            end = min(end + len(MAGIC), len(self._raw))
        return items, end

    def _stray(self, at: int, end: int) -> Iterator[Item]:
        """Handle bytes where a file should begin, up to the next trusted record, which starts a part of its own."""
        if not at:
            yield from self._damaged_stretch(
                0, end, "the file does not begin like an MCAP file", shown=min(end, len(MAGIC))
            )
            return
        yield from self._begin(at)
        reason = f"{MAX_DAMAGES} damaged places before it" if self._given_up else "bytes behind the end mark"
        yield from self._damaged_stretch(at, end, reason)

    @property
    def _given_up(self) -> bool:
        return self._damages >= MAX_DAMAGES

    def _record(self, at: int) -> McapRecord:
        if at + RECORD_HEAD > len(self._raw):
            raise Bad("cut off")
        self._effort.record()
        opcode, length = _RECORD.unpack_from(self._raw, at)
        if not HEADER <= opcode <= DATA_END:
            raise Bad(f"no record has the code {opcode}")
        if at + RECORD_HEAD + length > len(self._raw):
            raise Bad("cut off, or its length altered")
        return McapRecord(at, opcode, self._data[at + RECORD_HEAD : at + RECORD_HEAD + length])

    def _items(self, record: McapRecord) -> Iterator[Item]:
        self._effort.check(len(record.body))
        if record.opcode == MESSAGE:
            yield self._message(record.body)
        elif record.opcode in (SCHEMA, CHANNEL):
            self._declare(record)
        elif record.opcode == ATTACHMENT:
            yield read_attachment(record.body, self._effort)
        elif record.opcode == METADATA:
            yield from self._metadata(record)
        elif record.opcode == DATA_END:
            yield from self._data_end(record)
        elif record.opcode == FOOTER:
            yield from self._footer(record)
        else:
            check_structure(record)
            if record.opcode in SUMMARY_ONLY and not self._part.data_ended:
                self._part.data_ended = True
                if not self._part.damaged:
                    yield self._damage(record.at, 0, "the end of the data is not marked")

    def _chunk(self, record: McapRecord) -> list[Item]:
        """The messages of a chunk; a long flight has hundreds of thousands, hence one loop without generators."""
        content = memoryview(self._expanded(record))
        head, count, message = _RECORD.unpack_from, self._effort.record, self._message
        messages: list[Item] = []
        offset, size = 0, len(content)
        while offset < size:
            body_at = offset + RECORD_HEAD
            if body_at > size:
                raise Bad("its content breaks off")
            count()
            opcode, length = head(content, offset)
            end = body_at + length
            if end > size:
                raise Bad("its content breaks off")
            if opcode == MESSAGE:
                messages.append(message(content[body_at:end]))
            elif opcode in (SCHEMA, CHANNEL):
                self._declare(McapRecord(offset, opcode, content[body_at:end]))
            offset = end
        return messages

    def _expanded(self, record: McapRecord) -> bytes | memoryview:
        if self._content[0] != record.at:
            self._content = (record.at, chunk_content(record.body, self._effort))
        return self._content[1]

    def _message(self, body: memoryview) -> RecordedMessage:
        if len(body) < _MESSAGE_HEAD.size:
            raise Bad("shorter than a message can be")
        channel, sequence, log_time, publish_time = _MESSAGE_HEAD.unpack_from(body)
        data = body[_MESSAGE_HEAD.size :].tobytes()
        topic = self._part.topics.get(channel)
        if topic is None or topic in SCHEMA_OF_TOPIC:
            possible = [topic] if topic else SCHEMA_OF_TOPIC
            topic = next((t for t in possible if seal_holds(SCHEMA_OF_TOPIC[t], data)), None)
            if topic is None:
                raise Bad("a message in it fails its checksum or belongs to a channel that was not declared")
        return RecordedMessage(topic, log_time, publish_time, sequence, data)

    def _declare(self, record: McapRecord) -> None:
        cursor = Cursor(record.body)
        number = cursor.number(2)
        if record.opcode == SCHEMA:
            name = cursor.text()
            cursor.text()
            content = cursor.take(cursor.number(4))
            cursor.finish()
            if number not in self._part.schemas:
                self._part.schemas[number] = (name, bytes(content))
            return
        schema_id = cursor.number(2)
        topic = cursor.text()
        cursor.text()
        cursor.texts()
        cursor.finish()
        if number not in self._part.topics:
            self._part.topics[number] = topic
            self._part.channel_schema.setdefault(topic, schema_id)

    def _metadata(self, record: McapRecord) -> Iterator[Item]:
        metadata = read_metadata(record.body, self._effort)
        if metadata.name == INFO_NAME:
            session = metadata.fields.get("session")
            if self._part.session not in (None, session):
                yield from self._begin(record.at)
            self._part.session = session
        yield metadata

    def _data_end(self, record: McapRecord) -> Iterator[Item]:
        cursor = Cursor(record.body)
        checksum = cursor.number(4)
        cursor.finish()
        if self._part.data_ended:
            raise Bad("the data has ended before")
        checked_bytes = self._data[self._part.at : record.at]
        if checksum and not self._part.damaged and not crc_matches(checksum, checked_bytes, self._effort):
            yield self._damage(self._part.at, 0, "a byte outside the chunks was altered (checksum of the data section)")
        self._part.data_ended = True

    def _footer(self, record: McapRecord) -> Iterator[Item]:
        cursor = Cursor(record.body)
        start, _, checksum = cursor.number(8), cursor.number(8), cursor.number(4)
        cursor.finish()
        if self._part.closed:
            raise Bad("the file has ended before")
        begin = self._part.at + start if start else record.at
        if not self._part.at <= begin <= record.at:
            raise Bad("it points outside the file")
        checked_bytes = self._data[begin : record.end - 4]
        if checksum and not crc_matches(checksum, checked_bytes, self._effort):
            yield self._damage(begin, record.at - begin, "index at the end: checksum does not match")
        if not self._ends(record.end):
            yield self._damage(record.end, min(len(MAGIC), len(self._raw) - record.end), "the end mark is damaged")
        self._part.closed = True
        yield Closed(record.at)

    # ------------------------------------------------------------------------------------------ several recordings

    def _begin(self, at: int) -> Iterator[Item]:
        """Start another recording, unless it is the first of the file."""
        yield from self._search()
        if at:
            if not self._part.closed:
                yield self._damage(at, 0, "cut off or never closed: another recording begins here")
            yield Began(at)
            self._parts += 1
            if self._parts > MAX_PARTS:
                self._damages = MAX_DAMAGES
        self._part = _SalvagedPart(at, damaged=not begins(self._raw, at))

    # ------------------------------------------------------------------------------------------ damaged stretches

    def _damage(self, at: int, length: int, what: str) -> Damage:
        self._part.damaged = True
        self._damages += 1
        return Damage(at, length, what)

    def _damaged_stretch(
        self, at: int, end: int, what: str, *, shown: int | None = None, search_from: int | None = None
    ) -> Iterator[Item]:
        """Report a damaged stretch, and queue it for the search. shown: length to report, if other than the stretch's;
        search_from: start of the search, if before the stretch."""
        yield self._damage(at, end - at if shown is None else shown, what)
        region = self._raw[at if search_from is None else search_from : end]
        self._unsearched.append(region)
        self._unsearched_bytes += len(region)
        if self._unsearched_bytes >= _BATCH:
            yield from self._search()

    def _search(self) -> Iterator[RecordedMessage]:
        """Search the queued stretches, and yield the messages in them."""
        region = _SEPARATOR.join(self._unsearched)
        self._unsearched, self._unsearched_bytes = [], 0
        yield from salvage_region(region, self._effort)

    def _recover(self, at: int, error: Bad) -> tuple[list[Item], int]:
        """Handle an altered record: a chunk under a wrong code, or a stretch to be searched. Returns as `_step`."""
        name = _NAMES.get(self._raw[at], "record")
        if self._raw[at] != CHUNK:
            try:
                record = self._record_as_chunk(at)
                entries = list(self._chunk(record))
            except Bad:
                pass
            else:
                return [self._damage(at, 1, f"{name}: {error}; it is a chunk, and whole"), *entries], record.end
        previous, self._unproven = self._unproven, None
        inner_start = self._record_within(previous, at) if previous else None
        if previous and inner_start is not None:
            return list(self._damaged_stretch(previous.at, inner_start, "record: it runs over others")), inner_start
        resume = self._resume(at)
        begin = previous.at if previous else at  # its content may be the start of a message
        return list(self._damaged_stretch(at, resume, f"{name}: {error}", search_from=begin)), resume

    def _record_within(self, before: McapRecord, at: int) -> int | None:
        """Offset of a trusted record within the unproven one before the bad one; None without.

        The length of a record that is cut off in its middle (`cat torn whole`) covers the first bytes of the next file.
        """
        try:
            self._effort.check(len(before.body))
        except Bad:
            return None
        candidate = next_candidate(self._raw, before.at + 1, at + _HEAD_SPAN)
        while candidate < at and not self._trusted(candidate):
            candidate = next_candidate(self._raw, candidate + 1, at + _HEAD_SPAN)
        return candidate if candidate < at else None

    def _record_as_chunk(self, at: int) -> McapRecord:
        if at + RECORD_HEAD > len(self._raw):
            raise Bad("cut off")
        body = self._data[at + RECORD_HEAD : at + RECORD_HEAD + struct.unpack_from("<Q", self._raw, at + 1)[0]]
        if not chunk_plausible(body):
            raise Bad("no chunk")
        return McapRecord(at, CHUNK, body)

    def _resume(self, at: int) -> int:
        """Offset of the next trusted record after a bad one."""
        if at + RECORD_HEAD <= len(self._raw):
            stated_end = at + RECORD_HEAD + int.from_bytes(self._raw[at + 1 : at + RECORD_HEAD], "little")
            if stated_end < len(self._raw) and self._trusted(stated_end):
                return stated_end
        return self._next_trusted(at + 1)

    def _next_trusted(self, at: int) -> int:
        candidate = next_candidate(self._raw, at)
        while candidate < len(self._raw) and not self._trusted(candidate):
            candidate = next_candidate(self._raw, candidate + 1)
        return candidate

    def _trusted(self, at: int) -> bool:
        """Whether checksum or structure prove that a record begins here; kinds too short for a proof are not trusted."""
        if begins(self._raw, at):
            return True
        try:
            record = self._record(at)
            if record.opcode == CHUNK:
                if not chunk_plausible(record.body):
                    return False
                self._expanded(record)
            elif record.opcode == ATTACHMENT:
                read_attachment(record.body, self._effort)
            elif record.opcode == METADATA:
                return read_metadata(record.body, self._effort).name in (INFO_NAME, DETAIL_NAME, LOG_TIME_NAME)
            elif record.opcode in (MESSAGE_INDEX, CHUNK_INDEX):
                check_structure(record)
                return len(record.body) > 6
            elif record.opcode == DATA_END:
                return len(record.body) == 4 and record.end < len(self._raw)
            else:
                return record.opcode == FOOTER and len(record.body) == 20 and self._ends(record.end)
        except Bad:
            return False
        return True

    def _ends(self, at: int) -> bool:
        return self._raw[at : at + len(MAGIC)] == MAGIC
