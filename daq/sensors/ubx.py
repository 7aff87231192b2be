"""The UBX protocol of u-blox receivers: framing, checksum, NAV-PVT, and the messages that set a receiver up.

u-blox M10 SPG 5.10 Interface Description (UBX-21035062), sections 3.1 to 3.4 (frame, checksum) and 3.15.13 (NAV-PVT); the older
configuration messages from the u-blox 8/M8 Receiver Description (UBX-13003221). The parser never gives up: after
anything that is not a frame it goes on at the next byte, so it loses exactly the damaged frames.
"""

import calendar
from collections.abc import Iterator
from functools import lru_cache
from itertools import accumulate
from struct import Struct
from typing import NamedTuple

SYNC = b"\xb5\x62"
NAV_PVT = (0x01, 0x07)
PAYLOAD_LIMIT = 256  # twice the longest message this driver asks for; a longer length is damage

_PVT = Struct("<IHBBBBBBIiBBBBiiiiIIiiiiiIIHH4xihH")
_VALID_DATE, _VALID_TIME, _FULLY_RESOLVED = 0x01, 0x02, 0x04
_FIX_OK = 0x01
_YEARS = range(2000, 2262)  # until nanoseconds since 1970 have more than 63 bits


def checksum(data: bytes) -> tuple[int, int]:
    """8-bit Fletcher checksum over class, id, length and payload."""
    return sum(data) & 0xFF, sum(accumulate(data)) & 0xFF


def frame(message: tuple[int, int], payload: bytes) -> bytes:
    """A complete UBX frame."""
    body = bytes(message) + len(payload).to_bytes(2, "little") + payload
    return SYNC + body + bytes(checksum(body))


class UbxParser:
    """Cuts a byte stream into UBX frames. `damaged` counts checksum failures, `skipped` bytes outside frames."""

    def __init__(self) -> None:
        self._buffer = bytearray()
        self.damaged = 0
        self.skipped = 0

    def feed(self, data: bytes) -> Iterator[tuple[tuple[int, int], bytes]]:
        """Message (class, id) and payload of each undamaged frame that `data` completes."""
        buffer = self._buffer
        buffer += data
        while True:
            start = buffer.find(SYNC)
            if start < 0:
                self._discard(len(buffer) - 1 if buffer[-1:] == SYNC[:1] else len(buffer))
                return
            if start:
                self._discard(start)
            if len(buffer) < 6:
                return
            length = buffer[4] | buffer[5] << 8
            if length > PAYLOAD_LIMIT:
                self._discard(1)
                continue
            end = 8 + length
            if len(buffer) < end:
                return
            if checksum(bytes(buffer[2 : end - 2])) == (buffer[end - 2], buffer[end - 1]):
                message, payload = (buffer[2], buffer[3]), bytes(buffer[6 : end - 2])
                del buffer[:end]
                yield message, payload
            else:
                self.damaged += 1
                self._discard(1)

    def _discard(self, count: int) -> None:
        self.skipped += count
        del self._buffer[:count]


class NavPvt(NamedTuple):
    """Position, velocity and time of one fix, as received (units in the names)."""

    itow_ms: int
    utc_ns: int  # since 1970; 0 while date and time are not valid and fully resolved
    time_accuracy_ns: int
    fix: int  # 0 none, 1 dead reckoning, 2 2-D, 3 3-D, 4 combined, 5 time only
    fix_ok: bool
    satellites: int
    longitude_e7: int
    latitude_e7: int
    height_msl_mm: int
    horizontal_accuracy_mm: int
    vertical_accuracy_mm: int
    velocity_north_mm: int
    velocity_east_mm: int
    velocity_down_mm: int
    speed_accuracy_mm: int


def parse_nav_pvt(payload: bytes) -> NavPvt:
    """The payload of NAV-PVT (92 bytes). Raises ValueError for another length."""
    if len(payload) != _PVT.size:
        raise ValueError(f"NAV-PVT has {_PVT.size} bytes, not {len(payload)}")
    f = _PVT.unpack(payload)
    itow, year, month, day, hour, minute, second, valid, time_accuracy, nano = f[:10]
    resolved = _VALID_DATE | _VALID_TIME | _FULLY_RESOLVED
    utc = 0
    if valid & resolved == resolved and _is_date(year, month, day, hour, minute, second):
        utc = (_midnight(year, month, day) + hour * 3600 + minute * 60 + second) * 1_000_000_000 + nano
    head = (itow, max(utc, 0), time_accuracy, f[10], f[11] & _FIX_OK != 0)
    return NavPvt._make(
        (*head, *f[13:16], *f[17:23], f[25])
    )  # in the order of the message, without what is left unread


def _is_date(year: int, month: int, day: int, hour: int, minute: int, second: int) -> bool:
    """Whether a receiver that vouches for its date says one: a checksum of 16 bits passes other things now and then."""
    return year in _YEARS and 1 <= month <= 12 and 1 <= day <= 31 and hour < 24 and minute < 60 and second <= 60


@lru_cache(maxsize=2)
def _midnight(year: int, month: int, day: int) -> int:
    """The beginning of a day [s since 1970]."""
    return calendar.timegm((year, month, day, 0, 0, 0, 0, 0, 0))


# Configuration keys of generation 9 and 10 (CFG-VALSET): key, size in bytes.
_RATE_MEASURE_MS = (0x30210001, 2)
_DYNAMIC_MODEL = (0x20110021, 1)
_OUT_UBX = {"UART1": (0x10740001, 1), "USB": (0x10780001, 1), "UART2": (0x10760001, 1)}
_OUT_NMEA = {"UART1": (0x10740002, 1), "USB": (0x10780002, 1), "UART2": (0x10760002, 1)}
_OUT_NAV_PVT = {"UART1": (0x20910007, 1), "USB": (0x20910009, 1), "UART2": (0x20910008, 1)}
ACK_ACK, ACK_NAK = (0x05, 0x01), (0x05, 0x00)
AIRBORNE_2G = 7
_RAM = 0x01


def setup_m9(rate_hz: float) -> list[bytes]:
    """CFG-VALSET: NAV-PVT at every fix, no NMEA, airborne dynamics, fixes at `rate_hz`.

    The outputs of each port in a message of their own: nobody knows which port the receiver hangs on, and a receiver refuses a
    whole message for one key it has not (a MAX-M10S has neither USB nor UART2).
    """
    messages = [_valset(((_RATE_MEASURE_MS, round(1000 / rate_hz)), (_DYNAMIC_MODEL, AIRBORNE_2G)))]
    ports = zip(_OUT_UBX.values(), _OUT_NMEA.values(), _OUT_NAV_PVT.values(), strict=True)
    return [*messages, *(_valset(((ubx, 1), (nmea, 0), (pvt, 1))) for ubx, nmea, pvt in ports)]


def _valset(values: tuple[tuple[tuple[int, int], int], ...]) -> bytes:
    body = bytes((0, _RAM, 0, 0))
    for (key, size), value in values:
        body += key.to_bytes(4, "little") + value.to_bytes(size, "little")
    return frame((0x06, 0x8A), body)


def setup_m8(rate_hz: float) -> list[bytes]:
    """CFG-RATE, CFG-NAV5 and CFG-MSG: the same for generation 8; NMEA sentences are turned off one by one."""
    rate = Struct("<HHH").pack(round(1000 / rate_hz), 1, 1)
    dynamics = Struct("<HB33x").pack(0x0001, AIRBORNE_2G)
    nmea = [frame((0x06, 0x01), bytes((0xF0, sentence, 0))) for sentence in (0, 1, 2, 3, 4, 5)]
    return [*nmea, frame((0x06, 0x08), rate), frame((0x06, 0x24), dynamics), frame((0x06, 0x01), bytes((*NAV_PVT, 1)))]
