"""What of a ULog is sound: a stream of messages that any reader of the format reads without searching.

pyulog goes on behind damage byte by byte and reads up to 64 kB at each, so that 1 MB of noise takes it minutes; and a format may
name itself, or arrays of arrays, until the memory is full. Here each message is looked at once, damage is passed over by
searching for the next message that an earlier one announced, and what the import does not use is left out.

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

MAGIC = b"ULog\x01\x12\x35"
SYNC = b"\x2f\x73\x13\x20\x25\x0c\xbb\x12"
HEADER = 16
_TYPES = frozenset(b"BFIMPQARDLCSO")
_DATA = ord("D")
_SAMPLE_HEAD = struct.Struct("<HBH")  # length without these three bytes, kind, topic
_NONE = (1, 0)
_SIZES = {
    "int8_t": 1, "uint8_t": 1, "int16_t": 2, "uint16_t": 2, "int32_t": 4, "uint32_t": 4, "int64_t": 8, "uint64_t": 8,
    "float": 4, "double": 8, "bool": 1, "char": 1,
}  # fmt: skip

MOST_BYTES = 2**16  # of one sample of a topic: the length of a message is a 16-bit number
MOST_FIELDS = 100_000  # of all topics of a log together; a PX4 log has some 10,000
MOST_LOGGED = 20_000  # messages in words, and parameters
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
    """The sound messages of a ULog, each looked at once. `data` begins with MAGIC.

    skipped: bytes of damage; dropouts: how many its logger reports, together dropped_ms long. logged: messages in words with
    their time [s]; parameters: each as last stated.
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
        self._bounds: dict[int, tuple[int, int]] = {}  # the same
        self._announced = self._fields = 0
        self._sync = -1
        self._appended: list[int] = []  # offsets where data were appended after a crash
        self._block: tuple[int, int, Integers] = (-1, -1, np.zeros(0, np.int64))
        self._run()

    @property
    def stream(self) -> bytes:
        """A ULog of formats, subscriptions and data only."""
        return b"".join([self._data[:HEADER], *self._head, *self._body])

    def _run(self) -> None:
        """Go through the file once."""
        start = HEADER
        while start < len(self._data):
            first, start = start, self._sound_data(start)
            if start > first:
                self._body.append(self._data[first:start])
                continue
            size = self._message_size(start)
            following = start + size if size else self._following(start + 1)
            boundary = next((offset for offset in self._appended if start < offset < following), None)
            if boundary is not None:  # the message that a crash has cut ends where the appended data begin
                size, following = 0, boundary
            if not (size and self._keep(self._data[start + 2], self._data[start + 3 : start + size])):
                self.skipped += following - start
            start = following

    def _sound_data(self, at: int) -> int:
        """Where the samples of known topics end that begin at `at` and follow one another: most of a log, in one tight loop."""
        data, bounds, head = self._data, self._bounds, _SAMPLE_HEAD.unpack_from
        end = min([len(data), *(offset for offset in self._appended if offset > at)])
        while at + _SAMPLE_HEAD.size <= end:
            size, kind, topic = head(data, at)
            shortest, longest = bounds.get(topic, _NONE)
            following = at + 3 + size
            if kind != _DATA or not shortest <= size - 2 <= longest or following > end:
                break
            at = following
        return at

    def _message_size(self, at: int) -> int:
        """Length of the message at `at` with its head, 0 where none begins."""
        data = self._data
        if at + 3 > len(data) or data[at + 2] not in _TYPES:
            return 0
        size = 3 + (data[at] | data[at + 1] << 8)
        if size == 3 or at + size > len(data):
            return 0
        if data[at + 2] == _DATA:
            topic = data[at + 3] | data[at + 4] << 8 if size > 4 else 0
            return size if self._topics[0, topic] <= size - 5 <= self._topics[1, topic] > 0 else 0
        return size if data[at + 2] != ord("S") or data[at + 3 : at + size] == SYNC else 0

    def _following(self, at: int) -> int:
        """Where the next message begins of which the bytes themselves say so: data of a known topic, a sync, a format."""
        if self._sync < at:  # each looked for once, not once for each damage before it
            position = self._data.find(_SYNC_MESSAGE, at)
            self._sync = position if position >= 0 else len(self._data)
        end = self._sync
        if not self._announced:
            match = _FORMAT_HEAD.search(self._data, at, end)
            return match.start() if match else end
        while at < end:
            positions = self._candidates(at // _BLOCK)
            index = int(np.searchsorted(positions, at))
            if index < positions.size:
                return min(end, int(positions[index]))
            at = (at // _BLOCK + 1) * _BLOCK
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

    def _keep(self, kind: int, body: bytes) -> bool:
        """Keep a message; False when its content is none."""
        match chr(kind):
            case "D":
                self._body.append(_message(kind, body))
            case "F":
                return self._format(body)
            case "A":
                return self._subscription(body)
            case "B":
                self._appended = sorted(_offsets(body))
                self._head.append(_message(kind, (body[:16] + bytes(40))[:40]))
            case "I" if b" ver_sw" in body[:40]:
                self._head.append(_message(kind, body))
            case "L" | "C" if len(self.logged) < MOST_LOGGED:
                self._logged(body[1:] if chr(kind) == "L" else body[3:])
            case "P" if len(self.parameters) < MOST_LOGGED:
                self._parameter(body)
            case "O":
                self.dropouts += 1
                self.dropped_ms += int.from_bytes(body[:2], "little")
        return True

    def _logged(self, body: bytes) -> None:
        """A message in words: time [us], text."""
        if len(body) > 8:
            self.logged.append((int.from_bytes(body[:8], "little") * 1e-6, body[8:].decode("utf-8", "replace")))

    def _parameter(self, body: bytes) -> None:
        """Length of the key, `int32_t NAME` or `float NAME`, value."""
        kind, _, name = body[1 : 1 + body[0]].decode("latin-1").partition(" ")
        raw = body[1 + body[0] : 5 + body[0]]
        if len(raw) == 4 and name and kind in ("int32_t", "float"):
            value = float(struct.unpack("<i" if kind == "int32_t" else "<f", raw)[0])
            if math.isfinite(value):
                self.parameters[name] = value

    def _format(self, body: bytes) -> bool:
        name, colon, text = body.partition(b":")
        matches = [_FIELD.fullmatch(piece) for piece in text.split(b";") if piece]
        fields = tuple(_Field(m[1].decode(), int(m[2] or 1), m[3].decode()) for m in matches if m)
        if not (colon and fields and len(fields) == len(matches) and name.isascii()) or self._announced:
            return False
        if name.decode() not in self._formats:
            self._head.append(_message(ord("F"), body))
        self._formats.setdefault(name.decode(), fields)
        return True

    def _subscription(self, body: bytes) -> bool:
        """Whether a topic can be read: announced once, of a known format with a time, of a length that a message can have."""
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
        self._body.append(_message(ord("A"), body))
        return True

    def _expanded(self, fields: tuple[_Field, ...], depth: int) -> tuple[int, int]:
        """Bytes and number of plain fields in `fields`; MOST_BYTES when they are too many, or a format holds itself."""
        size = count = 0
        for part in fields:
            element = (_SIZES[part.kind], 1) if part.kind in _SIZES else (MOST_BYTES, 0)
            if part.kind in self._formats and depth:
                element = self._expanded(self._formats[part.kind], depth - 1)
            size, count = size + part.count * element[0], count + part.count * element[1]
            if size >= MOST_BYTES:
                return MOST_BYTES, count
        return size, count


def _message(kind: int, body: bytes) -> bytes:
    return struct.pack("<HB", len(body), kind) + body


def _offsets(body: bytes) -> Iterator[int]:
    for i in range(16, min(len(body), 40) - 7, 8):
        offset = int.from_bytes(body[i : i + 8], "little")
        if offset:
            yield offset
