"""MAVLink 2 frames of an autopilot (MAVLink common.xml), implemented independently of the decoder on board.

Payloads are `struct` formats in the order of the wire; each message has its CRC_EXTRA.
"""

from binascii import crc_hqx
from collections.abc import Iterator
from dataclasses import dataclass
from struct import Struct

from firmware_sim.hardware.radio import MAGIC_V2

_HEADER = 10
_REVERSED = bytes(int(f"{i:08b}"[::-1], 2) for i in range(256))


@dataclass(frozen=True, slots=True)
class Message:
    """A message: number, CRC_EXTRA, and format of the payload with its extensions."""

    number: int
    crc_extra: int
    codec: Struct


HEARTBEAT = Message(0, 50, Struct("<IBBBBB"))  # custom mode, type, autopilot, base mode, status, version
SYSTEM_TIME = Message(2, 137, Struct("<QI"))  # UTC, time
PARAM_REQUEST_READ = Message(20, 214, Struct("<hBB16s"))  # index, system, component, id
PARAM_VALUE = Message(22, 220, Struct("<fHH16sB"))  # value, count, index, id, type
PARAM_SET = Message(23, 168, Struct("<fBB16sB"))  # value, system, component, id, type
GPS_RAW_INT = Message(
    24, 24, Struct("<QiiiHHHHBBiIII")
)  # time, place, eph, epv, speed, course, fix, satellites, accuracies
RAW_IMU = Message(27, 144, Struct("<Q9hBh"))  # time, force, rates, field, id, temperature
SCALED_PRESSURE = Message(29, 115, Struct("<Iffhh"))  # time, static, pitot, temperatures
ATTITUDE = Message(30, 39, Struct("<I6f"))  # time, angles, rates
GLOBAL_POSITION_INT = Message(33, 104, Struct("<Iiiii3hH"))  # time, place, height, velocity, heading
SERVO_OUTPUT_RAW = Message(36, 222, Struct("<I8HB"))  # time, widths, port
RC_CHANNELS = Message(65, 118, Struct("<I18HBB"))  # time, widths, count, rssi
MANUAL_CONTROL = Message(69, 243, Struct("<hhhhHB"))  # x, y, z, r, buttons, system
RC_CHANNELS_OVERRIDE = Message(70, 124, Struct("<8HBB10H"))  # 1 to 8, system, component, 9 to 18
COMMAND_LONG = Message(76, 152, Struct("<7fHBBB"))  # parameters, command, system, component, confirmation
COMMAND_ACK = Message(77, 143, Struct("<HB"))  # command, result
HIGHRES_IMU = Message(
    105, 93, Struct("<Q13fHB")
)  # time, force, rates, field, pressures, height, temperature, updated, id
TIMESYNC = Message(111, 34, Struct("<qq"))  # its time, ours
STATUSTEXT = Message(253, 83, Struct("<B50s"))  # severity, text
_REQUESTS = (PARAM_REQUEST_READ, PARAM_SET, MANUAL_CONTROL, RC_CHANNELS_OVERRIDE, COMMAND_LONG, TIMESYNC)
TAKEN = {m.number: m for m in _REQUESTS}


@dataclass(frozen=True, slots=True)
class ReceivedFrame:
    """A received message: its number, the sender's system id, and its fields in the order of the wire."""

    number: int
    system: int
    fields: tuple[int | float | bytes, ...]


class Packer:
    """Encodes the frames of one sender."""

    def __init__(self, system: int = 1, component: int = 1) -> None:
        self._ids = bytes([system, component])
        self._sequence = 0

    def pack(self, message: Message, *fields: float | bytes) -> bytes:
        """Encode a message; MAVLink 2 drops the payload's trailing zeros."""
        payload = message.codec.pack(*fields).rstrip(b"\0") or b"\0"
        head = bytes([len(payload), 0, 0, self._sequence]) + self._ids + message.number.to_bytes(3, "little")
        self._sequence = (self._sequence + 1) & 0xFF
        body = head + payload
        return bytes([MAGIC_V2]) + body + checksum(body + bytes([message.crc_extra]))


class Unpacker:
    """Decodes the messages that an autopilot accepts."""

    def __init__(self) -> None:
        self._buffer = bytearray()

    def feed(self, data: bytes) -> Iterator[ReceivedFrame]:
        """Yield the messages completed by `data`; others, and damaged ones, are skipped."""
        self._buffer += data
        buffer = self._buffer
        while buffer:
            if buffer[0] != MAGIC_V2:
                del buffer[0]
                continue
            if len(buffer) < _HEADER or len(buffer) < _HEADER + buffer[1] + 2:
                return
            end = _HEADER + buffer[1]
            message = TAKEN.get(int.from_bytes(buffer[7:10], "little"))
            if message is None or not self._checksum_valid(message, end):
                del buffer[0]
                continue
            payload = bytes(buffer[_HEADER:end]).ljust(message.codec.size, b"\0")[: message.codec.size]
            yield ReceivedFrame(message.number, buffer[5], message.codec.unpack(payload))
            del buffer[: end + 2]

    def _checksum_valid(self, message: Message, end: int) -> bool:
        return checksum(bytes(self._buffer[1:end]) + bytes([message.crc_extra])) == self._buffer[end : end + 2]


def checksum(data: bytes) -> bytes:
    """CRC-16/MCRF4XX, lower byte first: the CRC of `binascii` with reversed bits."""
    return crc_hqx(data.translate(_REVERSED), 0xFFFF).to_bytes(2, "big").translate(_REVERSED)


def text_of(field: float | bytes) -> str:
    """The text of a character field; empty for a number."""
    return field.split(b"\0", 1)[0].decode("ascii", "replace") if isinstance(field, bytes) else ""
