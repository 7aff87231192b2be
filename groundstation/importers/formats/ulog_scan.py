"""The sound messages of a ULog, as a stream that pyulog reads quickly and within bounds.

After damage pyulog tries every byte and reads up to 64 kB at each, so 1 MB of noise takes it minutes; and a format that contains
itself, or arrays of arrays, can fill the memory. Here each message is checked once, the scan continues after damage at the next
message of an announced topic, and messages that the import does not use are left out.

Format: PX4 user guide, "ULog File Format".
"""

import math
import re
import struct
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Integers = NDArray[np.int64]

SYNC = b"\x2f\x73\x13\x20\x25\x0c\xbb\x12"
HEADER = 16
_TYPES = frozenset(b"BFIMPQARDLCSO")
_DATA = ord("D")
_SAMPLE_HEAD = struct.Struct("<HBH")  # length without these three bytes, kind, topic
_HEAD = 3  # bytes of a message before its content: length and kind
_FLAGS_SIZE, _FLAG_BITS_SIZE = 16, 40  # bytes of the flags in message B, and with three offsets of appended data
_NO_SIZES = (1, 0)  # least and largest size of an unknown topic's sample: none fits
_SIZES = {
    "int8_t": 1, "uint8_t": 1, "int16_t": 2, "uint16_t": 2, "int32_t": 4, "uint32_t": 4, "int64_t": 8, "uint64_t": 8,
    "float": 4, "double": 8, "bool": 1, "char": 1,
}  # fmt: skip

MOST_BYTES = 2**16  # of one sample of a topic: the length of a message is a 16-bit number
MOST_FIELDS = 100_000  # of all topics of a log together; a PX4 log has some 10,000
MOST_LOGGED = 20_000  # text messages; the same for parameters
DEEPEST = 16  # formats within formats; PX4 has two

_FIELD = re.compile(rb"([A-Za-z_][\w/]*)(?:\[(\d{1,5})\])? ([!-9<-~]+)")
_FORMAT_HEAD = re.compile(rb"(?s:..)F[A-Za-z_][\w/]{0,60}:")
_SYNC_MESSAGE = struct.pack("<HB", len(SYNC), ord("S")) + SYNC
_BLOCK = 2**16  # bytes searched at once for the next message of a known topic


@dataclass(frozen=True, slots=True)
class _Field:
    kind: str
    count: int
    name: str


class UlogScan:
    """The sound messages of a ULog, each checked once. data: begins with ULOG_MAGIC.

    skipped: damaged bytes; dropouts: their number by the logger; dropped_ms: their total time [ms]. logged: text messages with
    their time [s]; parameters: last values.
    """

    def __init__(self, data: bytes) -> None:
        self._data = data
        self._head: list[bytes] = []
        self._body: list[bytes] = []
        self.skipped = self.dropouts = self.dropped_ms = 0
        self.logged: list[tuple[float, str]] = []
        self.parameters: dict[str, float] = {}
        self._formats: dict[str, tuple[_Field, ...]] = {}
        # shortest and longest sample by message id, 0 where not announced
        self._topics = np.zeros((2, 2**16), np.int64)
        self._bounds: dict[int, tuple[int, int]] = {}  # the same, for single messages
        self._announced = self._fields = 0
        self._sync = -1
        self._appended: list[int] = []  # offsets where data were appended after a crash
        self._block: tuple[int, int, Integers] = (-1, -1, np.zeros(0, np.int64))
        self._scan()

    @property
    def stream(self) -> bytes:
        """A ULog of formats, subscriptions and data only."""
        return b"".join([self._data[:HEADER], *self._head, *self._body])

    def _scan(self) -> None:
        """Scan the file."""
        start = HEADER
        while start < len(self._data):
            first, start = start, self._end_of_samples(start)
            if start > first:
                self._body.append(self._data[first:start])
                continue
            size = self._message_size(start)
            following = start + size if size else self._following(start + 1)
            boundary = next((offset for offset in self._appended if start < offset < following), None)
            if boundary is not None:  # a message cut by a crash ends where the appended data begin
                size, following = 0, boundary
            if not (size and self._use(self._data[start + 2], self._data[start + _HEAD : start + size])):
                self.skipped += following - start
            start = following

    def _end_of_samples(self, offset: int) -> int:
        """Offset of the end of consecutive samples of known topics that begin at `offset`: most of a log, in one tight loop."""
        data, bounds, head = self._data, self._bounds, _SAMPLE_HEAD.unpack_from
        end = min([len(data), *(appended for appended in self._appended if appended > offset)])
        while offset + _SAMPLE_HEAD.size <= end:
            size, kind, topic = head(data, offset)
            shortest, longest = bounds.get(topic, _NO_SIZES)
            following = offset + _HEAD + size
            if kind != _DATA or not shortest <= size - 2 <= longest or following > end:
                break
            offset = following
        return offset

    def _message_size(self, offset: int) -> int:
        """Length of the message at `offset` with its head; 0 where none begins."""
        data = self._data
        if offset + _HEAD > len(data) or data[offset + 2] not in _TYPES:
            return 0
        size = _HEAD + (data[offset] | data[offset + 1] << 8)
        if size == _HEAD or offset + size > len(data):
            return 0
        if data[offset + 2] == _DATA:
            topic = data[offset + 3] | data[offset + 4] << 8 if size > 4 else 0
            return size if self._topics[0, topic] <= size - 5 <= self._topics[1, topic] > 0 else 0
        return size if data[offset + 2] != ord("S") or data[offset + _HEAD : offset + size] == SYNC else 0

    def _following(self, offset: int) -> int:
        """Offset of the next message that its bytes show to be one: data of a known topic, a sync, or a format before topics."""
        if self._sync < offset:  # the next sync is searched once, not again after each damage before it
            position = self._data.find(_SYNC_MESSAGE, offset)
            self._sync = position if position >= 0 else len(self._data)
        end = self._sync
        if not self._announced:
            match = _FORMAT_HEAD.search(self._data, offset, end)
            return match.start() if match else end
        while offset < end:
            positions = self._candidates(offset // _BLOCK)
            index = int(np.searchsorted(positions, offset))
            if index < positions.size:
                return min(end, int(positions[index]))
            offset = (offset // _BLOCK + 1) * _BLOCK
        return end

    def _candidates(self, block: int) -> Integers:
        """Positions in a block of the file at which data of a known topic can begin, in order."""
        if self._block[:2] == (block, self._announced):
            return self._block[2]
        start = block * _BLOCK
        d = np.frombuffer(self._data, np.uint8, min(_BLOCK + 5, len(self._data) - start), start).astype(np.int64)
        if d.size < 5:
            return np.zeros(0, np.int64)
        size, topic = d[:-4] + 256 * d[1:-3] - 2, d[3:-1] + 256 * d[4:]
        low, high = self._topics[:, topic]
        positions = start + np.flatnonzero((d[2:-2] == _DATA) & (high > 0) & (low <= size) & (size <= high))
        self._block = (block, self._announced, positions)
        return positions

    def _use(self, kind: int, body: bytes) -> bool:
        """Use a message; returns False for invalid content."""
        match chr(kind):
            case "D":
                self._body.append(_encoded(kind, body))
            case "F":
                return self._use_format(body)
            case "A":
                return self._use_subscription(body)
            case "B":
                self._appended = sorted(_appended_offsets(body))
                self._head.append(_encoded(kind, (body[:_FLAGS_SIZE] + bytes(_FLAG_BITS_SIZE))[:_FLAG_BITS_SIZE]))
            case "I" if b" ver_sw" in body[:40]:
                self._head.append(_encoded(kind, body))
            case "L" | "C" if len(self.logged) < MOST_LOGGED:
                self._use_text(body[1:] if chr(kind) == "L" else body[3:])
            case "P" if len(self.parameters) < MOST_LOGGED:
                self._use_parameter(body)
            case "O":
                self.dropouts += 1
                self.dropped_ms += int.from_bytes(body[:2], "little")
        return True

    def _use_text(self, body: bytes) -> None:
        """A text message: time [us], text."""
        if len(body) > 8:
            self.logged.append((int.from_bytes(body[:8], "little") * 1e-6, body[8:].decode("utf-8", "replace")))

    def _use_parameter(self, body: bytes) -> None:
        """A parameter: length of the key, the key `int32_t NAME` or `float NAME`, value."""
        kind, _, name = body[1 : 1 + body[0]].decode("latin-1").partition(" ")
        raw = body[1 + body[0] : 5 + body[0]]
        if len(raw) == 4 and name and kind in ("int32_t", "float"):
            value = float(struct.unpack("<i" if kind == "int32_t" else "<f", raw)[0])
            if math.isfinite(value):
                self.parameters[name] = value

    def _use_format(self, body: bytes) -> bool:
        """Keep a format, of which the first of a name counts; returns False for an invalid one, or one after the topics."""
        name, colon, text = body.partition(b":")
        matches = [_FIELD.fullmatch(piece) for piece in text.split(b";") if piece]
        fields = tuple(_Field(m[1].decode(), int(m[2] or 1), m[3].decode()) for m in matches if m)
        if not (colon and fields and len(fields) == len(matches) and name.isascii()) or self._announced:
            return False
        if name.decode() not in self._formats:
            self._head.append(_encoded(ord("F"), body))
        self._formats.setdefault(name.decode(), fields)
        return True

    def _use_subscription(self, body: bytes) -> bool:
        """Keep a topic; returns False for one that is announced twice, of unknown format, without time, or too long."""
        fields = self._formats.get(body[3:].decode("latin-1"), ())
        if not any((f.kind, f.count, f.name) == ("uint64_t", 1, "timestamp") for f in fields):
            return False
        topic = body[1] | body[2] << 8
        longest, count = self._expanded(fields, DEEPEST)
        unpadded = len(fields) - next((i for i, f in enumerate(fields[::-1]) if not f.name.startswith("_padding")), 0)
        shortest, _ = self._expanded(fields[:unpadded], DEEPEST)
        if self._topics[1, topic] or longest >= MOST_BYTES - 2 or self._fields + count > MOST_FIELDS:
            return False
        self._topics[:, topic] = self._bounds[topic] = shortest, longest
        self._fields += count
        self._announced += 1
        self._body.append(_encoded(ord("A"), body))
        return True

    def _expanded(self, fields: tuple[_Field, ...], depth: int) -> tuple[int, int]:
        """Bytes and number of elementary fields in `fields`; MOST_BYTES where they are too many, or a format contains itself."""
        size = count = 0
        for part in fields:
            element = (_SIZES[part.kind], 1) if part.kind in _SIZES else (MOST_BYTES, 0)
            if part.kind in self._formats and depth:
                element = self._expanded(self._formats[part.kind], depth - 1)
            size, count = size + part.count * element[0], count + part.count * element[1]
            if size >= MOST_BYTES:
                return MOST_BYTES, count
        return size, count


def _encoded(kind: int, body: bytes) -> bytes:
    return struct.pack("<HB", len(body), kind) + body


def _appended_offsets(body: bytes) -> Iterator[int]:
    """The offsets of appended data in a message of flag bits (B)."""
    for i in range(_FLAGS_SIZE, min(len(body), _FLAG_BITS_SIZE) - 7, 8):
        offset = int.from_bytes(body[i : i + 8], "little")
        if offset:
            yield offset
