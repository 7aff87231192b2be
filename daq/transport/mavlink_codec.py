"""MAVLink 2 frames: an encoder, and a decoder that loses exactly the damaged ones.

The common Python decoder drops as many bytes as a damaged frame claims to have, and with them the frames behind it.
This one moves on by a single byte after every failure, so nothing behind a damaged frame is lost. Only MAVLink 2 is
accepted, with one exception: the MAVLink 1 RADIO_STATUS that SiK radios put into the stream, and only exactly that.
No byte sequence makes the decoder raise, and none makes it work much: what cannot begin a frame by its first three bytes
is passed over by a compiled search, and a checksum is computed only where length, flags and message id go together.
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
"""Messages from here on are Sideslip's own (docs/mavlink.md): stock programs do not know them."""
HEADER_BYTES = 10
CHECKSUM_BYTES = 2
MAX_FRAME_BYTES = HEADER_BYTES + 255 + CHECKSUM_BYTES + SIGNATURE_BYTES
SIGNED = 0x01

_mcrf4xx = fastcrc.crc16.mcrf4xx
_HEAD = struct.Struct("<6BHB")  # length, flags, 0, sequence, system, component, message id in two parts
_SIK_HEADER = bytes([51, 68])
"""System and component id that SiK radios give to what they inject ('3', 'D')."""
_SIK_PAYLOAD = 9
_SIK_FRAME = 6 + _SIK_PAYLOAD + CHECKSUM_BYTES
RADIO_STATUS_ID = 109

# Where a frame may begin, by as much of its head as is there: length not zero and flags known; or RADIO_STATUS of a SiK radio.
_BEGINS = re.compile(
    rb"\xfd(?:\Z|[^\x00](?:\Z|[\x00\x01]))"
    rb"|\xfe(?:\Z|\x09(?:\Z|.(?:\Z|\x33(?:\Z|\x44(?:\Z|\x6d)))))",
    re.DOTALL,
)

_BYTES = tuple(bytes([n]) for n in range(256))

_new_tuple: Callable[..., Any] = tuple.__new__  # without the function that names the fields: half of the time

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
        """The payload of a message; fields not given are zero.

        Raises ValueError for a field the message does not have or a value that does not fit it: a programming fault.
        """
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
        """The fields of a payload, whose trailing zeros may be missing."""
        numbers = self.codec.unpack(padded(payload, self.codec.size))
        out: dict[str, Value] = {}
        at = 0
        for name, count, text in zip(self.fields, self.counts, self.text, strict=True):
            if text:
                out[name] = numbers[at].split(b"\0", 1)[0].decode("utf-8", "replace")
            else:
                out[name] = numbers[at] if count == 1 else tuple(numbers[at : at + count])
            at += count
        return out


def padded(payload: bytes, size: int) -> bytes:
    """A payload with the trailing zeros that MAVLink 2 left out; bytes beyond `size` (newer extensions) dropped."""
    return payload[:size] if len(payload) >= size else payload + bytes(size - len(payload))


@cache
def message_types() -> Mapping[int, MessageType]:
    out = {}
    for msg_id, made in sideslip_dialect.mavlink_map.items():
        types = dict(zip(made.fieldnames, made.fieldtypes, strict=True))
        text = tuple(types[f] == "char" for f in made.ordered_fieldnames)
        counts = tuple(1 if t else max(1, n) for n, t in zip(made.array_lengths, text, strict=True))
        out[msg_id] = MessageType(
            msg_id, made.msgname, made.unpacker, tuple(made.ordered_fieldnames), counts, text, made.crc_extra
        )
    return out


@cache
def message_by_name() -> Mapping[str, MessageType]:
    return {m.name: m for m in message_types().values()}


@cache
def _checks() -> Mapping[int, tuple[int, int, bool]]:
    """CRC_EXTRA, longest payload, and whether it is of our dialect, by message id."""
    ours = {m.msg_id: (m.crc_extra, m.codec.size, True) for m in message_types().values()}
    return {i: (extra, size, False) for i, (extra, size) in sideslip_dialect.FOREIGN_MESSAGES.items()} | ours


class MavlinkFrame(NamedTuple):
    """A frame whose checksum holds; `raw` is every byte of it. A tuple, for there are thousands a second."""

    raw: bytes
    msg_id: int
    sequence: int
    system: int
    component: int
    payload: bytes
    signature: bytes | None = None

    @property
    def signed_part(self) -> bytes:
        """What the signature is over: magic to checksum."""
        return self.raw if self.signature is None else self.raw[:-SIGNATURE_BYTES]

    @property
    def known(self) -> bool:
        """Whether the dialect defines the message."""
        return self.msg_id in message_types()

    @property
    def name(self) -> str:
        """Name of the message; its number where the dialect does not define it."""
        made = message_types().get(self.msg_id)
        return made.name if made else f"MESSAGE_{self.msg_id}"

    def fields(self) -> dict[str, Value]:
        """The message's fields; KeyError for a message the dialect does not define."""
        return message_types()[self.msg_id].unpack(self.payload)


@dataclass(frozen=True, slots=True)
class Junk:
    """Consecutive bytes that are part of no sound frame, and how many broken frames were recognised in them."""

    raw: bytes
    damaged: int


@dataclass
class DecoderCounts:
    """What a decoder has seen so far; bytes in frames and bytes discarded add up to the bytes received."""

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
        """What remains when nothing more will come: an incomplete frame may still hide complete ones."""
        return self._scan(b"", last=True)

    def _scan(self, data: bytes, *, last: bool) -> list[MavlinkFrame | Junk]:
        counts = self.counts
        counts.received_bytes += len(data)
        buffer = self._rest + data if self._rest else data
        out: list[MavlinkFrame | Junk] = []
        at, size = 0, len(buffer)
        while at < size:
            if _BEGINS.match(buffer, at) is None:
                possible = _BEGINS.search(buffer, at)
                begin = possible.start() if possible is not None else size
                self._junk += buffer[at:begin]
                at = begin
                if at == size:
                    break
            examine = _frame_at if buffer[at] == MAGIC else _sik_frame_at
            found = examine(buffer, at, size, last)
            if found is None:
                break
            if isinstance(found, MavlinkFrame):
                if self._junk:
                    self._flush_junk(out)
                out.append(found)
                length = len(found.raw)
                at += length
                counts.frames += 1
                counts.frame_bytes += length
                continue
            self._damaged += found
            self._junk.append(buffer[at])
            at += 1
        self._rest = bytes(buffer[at:])
        if self._junk and (last or len(self._junk) > MAX_FRAME_BYTES * 4):
            self._flush_junk(out)
        return out

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
    """The sound frame that begins at a byte, if one does: work and memory of one frame, whatever the bytes."""
    if at >= len(buffer):
        return None
    find = {MAGIC: _frame_at, MAGIC_V1: _sik_frame_at}.get(buffer[at])
    found = find(buffer, at, len(buffer), True) if find else None
    return found if isinstance(found, MavlinkFrame) else None


def _frame_at(buffer: bytes, at: int, size: int, last: bool) -> MavlinkFrame | int | None:
    """The frame that begins at `at`; None when bytes are wanting; else how many broken frames this looks like (0, 1)."""
    if size - at < HEADER_BYTES:
        return 0 if last else None
    length, flags = buffer[at + 1], buffer[at + 2]
    msg_id = buffer[at + 7] | buffer[at + 8] << 8 | buffer[at + 9] << 16
    check = _checks().get(msg_id)
    if check is None or flags & ~SIGNED or length > check[1] or not length:
        return 0
    body = at + HEADER_BYTES + length
    end = body + CHECKSUM_BYTES + (SIGNATURE_BYTES if flags & SIGNED else 0)
    looks = 1 if check[2] else 0
    if end > size:
        return looks if last else None
    checksum = _mcrf4xx(buffer[at + 1 : body] + _BYTES[check[0]])
    if checksum != buffer[body] | buffer[body + 1] << 8:
        return looks
    signature = buffer[end - SIGNATURE_BYTES : end] if flags & SIGNED else None
    payload = buffer[at + HEADER_BYTES : body]
    fields = buffer[at:end], msg_id, buffer[at + 4], buffer[at + 5], buffer[at + 6], payload, signature
    frame: MavlinkFrame = _new_tuple(MavlinkFrame, fields)
    return frame


def _sik_frame_at(buffer: bytes, at: int, size: int, last: bool) -> MavlinkFrame | int | None:
    """A MAVLink 1 RADIO_STATUS as SiK radios inject it, payload length, ids and checksum all as they make them."""
    head = buffer[at + 1 : at + 6]
    wanted = (head[0:1] in (b"", bytes([_SIK_PAYLOAD])), head[2:4] in (b"", _SIK_HEADER[: len(head[2:4])], _SIK_HEADER))
    if not all(wanted) or head[4:5] not in (b"", bytes([RADIO_STATUS_ID])):
        return 0
    if size - at < _SIK_FRAME:
        return 0 if last else None
    body = buffer[at + 6 : at + 6 + _SIK_PAYLOAD]
    checksum = _mcrf4xx(buffer[at + 1 : at + 6] + body + bytes([_checks()[RADIO_STATUS_ID][0]]))
    if checksum != buffer[at + 15] | buffer[at + 16] << 8:
        return 1
    return MavlinkFrame(buffer[at : at + _SIK_FRAME], RADIO_STATUS_ID, head[1], head[2], head[3], body)


class FrameEncoder:
    """Makes frames of one sender: counts the sequence and signs if there is a signer.

    private: the component that sends Sideslip's own messages, by a sequence of its own. A stock program cannot read those,
    so that in one sequence with the others it would count each of them as lost. None: the same component.
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
        """A frame of a message by name and fields; fields not given are zero."""
        made = message_by_name()[name]
        return self.frame(made.msg_id, made.pack(values))

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
