"""MAVLink 2 frames: an encoder, and a decoder that loses only damaged frames.

The common Python decoder drops as many bytes as a damaged frame claims to have, and with them the frames behind it. This one
advances by a single byte after every failure, so that nothing behind a damaged frame is lost. Only MAVLink 2 is accepted, with
one exception: the MAVLink 1 RADIO_STATUS that SiK radios inject, in exactly their form. No byte sequence makes the decoder
raise, or take much time: a compiled search skips bytes that cannot begin a frame, and a checksum is computed only where length,
flags and message id are consistent.
"""

import re
import struct
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple

import fastcrc

from daq.contract.link.dialect import sideslip_dialect
from daq.transport.signing import SIGNATURE_BYTES, Signer

MAGIC = 0xFD
MAGIC_V1 = 0xFE
FIRST_OWN_ID = 44100
"""First message id of Sideslip's own messages (docs/mavlink.md), which other programs cannot decode."""
HEADER_BYTES = 10
CHECKSUM_BYTES = 2
MAX_FRAME_BYTES = HEADER_BYTES + 255 + CHECKSUM_BYTES + SIGNATURE_BYTES
SIGNED = 0x01

_mcrf4xx = fastcrc.crc16.mcrf4xx
_HEAD = struct.Struct("<6BHB")  # length, flags, 0, sequence, system, component, message id in two parts
_SIK_HEADER = bytes([51, 68])
"""System and component id of messages that SiK radios inject ('3', 'D')."""
_SIK_PAYLOAD = 9
_SIK_FRAME = 6 + _SIK_PAYLOAD + CHECKSUM_BYTES
RADIO_STATUS_ID = 109

# A possible start of a frame, by what there is of its header: length not zero and known flags, or a SiK radio's RADIO_STATUS.
_BEGINS = re.compile(
    rb"\xfd(?:\Z|[^\x00](?:\Z|[\x00\x01]))"
    rb"|\xfe(?:\Z|\x09(?:\Z|.(?:\Z|\x33(?:\Z|\x44(?:\Z|\x6d)))))",
    re.DOTALL,
)

_BYTES = tuple(bytes([n]) for n in range(256))

_new_tuple: Callable[..., Any] = tuple.__new__  # takes half the time of the named tuple's own constructor

Value = int | float | str | bytes | tuple[int | float, ...]


@dataclass(frozen=True)
class MessageType:
    """A message of the dialect."""

    msg_id: int
    name: str
    codec: struct.Struct
    fields: tuple[str, ...]  # wire order
    counts: tuple[int, ...]  # elements of each field in the struct's output
    text: tuple[bool, ...]
    crc_extra: int

    def pack(self, values: Mapping[str, Any]) -> bytes:
        """Encode the payload of a message; fields not given are zero. Raises ValueError for an unknown field, or a value that
        does not fit its field."""
        unknown = values.keys() - set(self.fields)
        if unknown:
            raise ValueError(f"{self.name} has no field {', '.join(sorted(unknown))}")
        arguments: list[Any] = []
        for name, count, text in zip(self.fields, self.counts, self.text, strict=True):
            value = values.get(name)
            if text:
                data = value.encode("utf-8", "replace") if isinstance(value, str) else value or b""
                arguments.append(data)
            elif count == 1:
                arguments.append(value or 0)
            else:
                elements = list(value or ())
                arguments += elements + [0] * (count - len(elements))
        try:
            return self.codec.pack(*arguments)
        except struct.error as error:
            raise ValueError(f"{self.name}: a value does not fit its field ({error})") from error

    def unpack(self, payload: bytes) -> dict[str, Value]:
        """Decode the fields of a payload, whose trailing zeros may be missing."""
        numbers = self.codec.unpack(padded(payload, self.codec.size))
        values: dict[str, Value] = {}
        index = 0
        for name, count, text in zip(self.fields, self.counts, self.text, strict=True):
            if text:
                values[name] = numbers[index].split(b"\0", 1)[0].decode("utf-8", "replace")
            else:
                values[name] = numbers[index] if count == 1 else tuple(numbers[index : index + count])
            index += count
        return values


def padded(payload: bytes, size: int) -> bytes:
    """A payload with the trailing zeros that MAVLink 2 drops, cut to `size` bytes, without newer extensions."""
    return payload[:size] if len(payload) >= size else payload + bytes(size - len(payload))


@cache
def message_types() -> Mapping[int, MessageType]:
    types_by_id = {}
    for msg_id, generated in sideslip_dialect.mavlink_map.items():
        types = dict(zip(generated.fieldnames, generated.fieldtypes, strict=True))
        text = tuple(types[f] == "char" for f in generated.ordered_fieldnames)
        counts = tuple(1 if t else max(1, n) for n, t in zip(generated.array_lengths, text, strict=True))
        types_by_id[msg_id] = MessageType(
            msg_id,
            generated.msgname,
            generated.unpacker,
            tuple(generated.ordered_fieldnames),
            counts,
            text,
            generated.crc_extra,
        )
    return types_by_id


@cache
def message_by_name() -> Mapping[str, MessageType]:
    return {m.name: m for m in message_types().values()}


@cache
def _checks() -> Mapping[int, tuple[int, int, bool]]:
    """Message id -> CRC_EXTRA, longest payload, and whether our dialect defines it."""
    ours = {m.msg_id: (m.crc_extra, m.codec.size, True) for m in message_types().values()}
    return {i: (extra, size, False) for i, (extra, size) in sideslip_dialect.FOREIGN_MESSAGES.items()} | ours


class MavlinkFrame(NamedTuple):
    """A frame with a valid checksum; raw: all its bytes. A tuple for speed: there are thousands a second."""

    raw: bytes
    msg_id: int
    sequence: int
    system: int
    component: int
    payload: bytes
    signature: bytes | None = None

    @property
    def signed_part(self) -> bytes:
        """The bytes that the signature covers: magic to checksum."""
        return self.raw if self.signature is None else self.raw[:-SIGNATURE_BYTES]

    @property
    def known(self) -> bool:
        """Whether the dialect defines the message."""
        return self.msg_id in message_types()

    @property
    def name(self) -> str:
        """Name of the message; its number where the dialect does not define it."""
        message_type = message_types().get(self.msg_id)
        return message_type.name if message_type else f"MESSAGE_{self.msg_id}"

    def fields(self) -> dict[str, Value]:
        """The message's fields; KeyError for a message the dialect does not define."""
        return message_types()[self.msg_id].unpack(self.payload)


@dataclass(frozen=True, slots=True)
class Junk:
    """Consecutive bytes outside valid frames, and the number of damaged frames recognised in them."""

    raw: bytes
    damaged: int


@dataclass
class DecoderCounts:
    """Counters of a decoder; bytes in frames and bytes discarded add up to the bytes received."""

    received_bytes: int = 0
    frames: int = 0
    frame_bytes: int = 0
    damaged: int = 0
    discarded_bytes: int = 0


class FrameDecoder:
    """Finds frames in a stream of bytes that arrives in pieces of any size."""

    def __init__(self) -> None:
        self._rest = b""
        self._junk = bytearray()
        self._damaged = 0
        self.counts = DecoderCounts()

    def feed(self, data: bytes) -> list[MavlinkFrame | Junk]:
        """Frames and junk completed by `data`, in order of arrival."""
        return self._scan(data, last=False)

    def finish(self) -> list[MavlinkFrame | Junk]:
        """Frames and junk in the rest at the end of the stream: an incomplete frame may hide complete ones."""
        return self._scan(b"", last=True)

    def _scan(self, data: bytes, *, last: bool) -> list[MavlinkFrame | Junk]:
        counts = self.counts
        counts.received_bytes += len(data)
        buffer = self._rest + data if self._rest else data
        items: list[MavlinkFrame | Junk] = []
        offset, size = 0, len(buffer)
        while offset < size:
            if _BEGINS.match(buffer, offset) is None:
                possible = _BEGINS.search(buffer, offset)
                begin = possible.start() if possible is not None else size
                self._junk += buffer[offset:begin]
                offset = begin
                if offset == size:
                    break
            examine = _frame_at if buffer[offset] == MAGIC else _sik_frame_at
            result = examine(buffer, offset, size, last)
            if result is None:
                break
            if isinstance(result, MavlinkFrame):
                if self._junk:
                    self._flush_junk(items)
                items.append(result)
                length = len(result.raw)
                offset += length
                counts.frames += 1
                counts.frame_bytes += length
                continue
            self._damaged += result
            self._junk.append(buffer[offset])
            offset += 1
        self._rest = bytes(buffer[offset:])
        if self._junk and (last or len(self._junk) > MAX_FRAME_BYTES * 4):
            self._flush_junk(items)
        return items

    def _flush_junk(self, out: list[MavlinkFrame | Junk]) -> None:
        if not self._junk:
            return
        damaged = max(1, self._damaged)
        out.append(Junk(bytes(self._junk), damaged))
        self.counts.damaged += damaged
        self.counts.discarded_bytes += len(self._junk)
        self._junk.clear()
        self._damaged = 0


def frame_at(buffer: bytes, at: int) -> MavlinkFrame | None:
    """The valid frame that begins at a byte, None without one; takes time and memory of one frame, whatever the bytes."""
    if at >= len(buffer):
        return None
    find = {MAGIC: _frame_at, MAGIC_V1: _sik_frame_at}.get(buffer[at])
    frame = find(buffer, at, len(buffer), True) if find else None
    return frame if isinstance(frame, MavlinkFrame) else None


def _frame_at(buffer: bytes, at: int, size: int, last: bool) -> MavlinkFrame | int | None:
    """The frame that begins at `at`; None while bytes are missing; otherwise 1 for a damaged frame, 0 for no frame."""
    if size - at < HEADER_BYTES:
        return 0 if last else None
    length, flags = buffer[at + 1], buffer[at + 2]
    msg_id = buffer[at + 7] | buffer[at + 8] << 8 | buffer[at + 9] << 16
    check = _checks().get(msg_id)
    if check is None or flags & ~SIGNED or length > check[1] or not length:
        return 0
    body = at + HEADER_BYTES + length
    end = body + CHECKSUM_BYTES + (SIGNATURE_BYTES if flags & SIGNED else 0)
    damaged = 1 if check[2] else 0
    if end > size:
        return damaged if last else None
    checksum = _mcrf4xx(buffer[at + 1 : body] + _BYTES[check[0]])
    if checksum != buffer[body] | buffer[body + 1] << 8:
        return damaged
    signature = buffer[end - SIGNATURE_BYTES : end] if flags & SIGNED else None
    payload = buffer[at + HEADER_BYTES : body]
    fields = buffer[at:end], msg_id, buffer[at + 4], buffer[at + 5], buffer[at + 6], payload, signature
    frame: MavlinkFrame = _new_tuple(MavlinkFrame, fields)
    return frame


def _sik_frame_at(buffer: bytes, at: int, size: int, last: bool) -> MavlinkFrame | int | None:
    """A MAVLink 1 RADIO_STATUS with payload length, ids and checksum of a SiK radio; returns as `_frame_at`."""
    head = buffer[at + 1 : at + 6]
    fits = (head[0:1] in (b"", bytes([_SIK_PAYLOAD])), head[2:4] in (b"", _SIK_HEADER[: len(head[2:4])], _SIK_HEADER))
    if not all(fits) or head[4:5] not in (b"", bytes([RADIO_STATUS_ID])):
        return 0
    if size - at < _SIK_FRAME:
        return 0 if last else None
    body = buffer[at + 6 : at + 6 + _SIK_PAYLOAD]
    checksum = _mcrf4xx(buffer[at + 1 : at + 6] + body + bytes([_checks()[RADIO_STATUS_ID][0]]))
    if checksum != buffer[at + 15] | buffer[at + 16] << 8:
        return 1
    return MavlinkFrame(buffer[at : at + _SIK_FRAME], RADIO_STATUS_ID, head[1], head[2], head[3], body)


class FrameEncoder:
    """Encodes the frames of one sender: numbers them, and signs them if there is a signer.

    private: component id of Sideslip's own messages, with a sequence of its own; None: `component`. Other programs cannot decode
    these messages, and would count each as lost if they shared a sequence with the others.
    """

    def __init__(
        self, system: int, component: int, signer: Signer | None = None, *, private: int | None = None
    ) -> None:
        self.system = system
        self.component = component
        self._private = component if private is None else private
        self._signer = signer
        self._sequences = dict.fromkeys((self.component, self._private), 0)

    def message(self, name: str, **values: Any) -> bytes:
        """Encode a message by name and fields; fields not given are zero."""
        message_type = message_by_name()[name]
        return self.frame(message_type.msg_id, message_type.pack(values))

    def frame(self, msg_id: int, payload: bytes) -> bytes:
        payload = payload.rstrip(b"\0") or payload[:1]
        flags = SIGNED if self._signer else 0
        component = self._private if msg_id >= FIRST_OWN_ID else self.component
        sequence = self._sequences[component]
        head = _HEAD.pack(len(payload), flags, 0, sequence, self.system, component, msg_id & 0xFFFF, msg_id >> 16)
        self._sequences[component] = (sequence + 1) & 255
        extra = _checks()[msg_id][0]
        body = head + payload
        frame = bytes([MAGIC]) + body + _mcrf4xx(body + bytes([extra])).to_bytes(2, "little")
        return frame + self._signer.sign(frame) if self._signer else frame


def frames_of(items: Iterable[MavlinkFrame | Junk]) -> list[MavlinkFrame]:
    """Only the frames of what a decoder returned."""
    return [i for i in items if isinstance(i, MavlinkFrame)]
