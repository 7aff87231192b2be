"""A u-blox receiver at byte level (u-blox 8 / M8 protocol specification, UBX-13003221 R28).

It sends UBX-NAV-PVT (32.17.15) for every fix, the bytes leaving at the speed of the line some tens of milliseconds after
the instant they describe, acknowledges UBX-CFG messages and answers a poll of UBX-MON-VER. Rate and messages follow
UBX-CFG-RATE and UBX-CFG-MSG, or UBX-CFG-VALSET of the newer generations (UBX-18010854 R07).
"""

import datetime as dt
import math
import struct
from dataclasses import dataclass

SYNC = b"\xb5\x62"
NAV_PVT, ACK_ACK, ACK_NAK, MON_VER = (0x01, 0x07), (0x05, 0x01), (0x05, 0x00), (0x0A, 0x04)
CFG_PRT, CFG_MSG, CFG_RATE, CFG_VALSET = (0x06, 0x00), (0x06, 0x01), (0x06, 0x08), (0x06, 0x8A)
KEY_RATE_MEAS, KEY_NAV_PVT_UART1 = 0x30210001, 0x20910007
VALUE_BYTES = {1: 1, 2: 1, 3: 2, 4: 4, 5: 8}  # by the size field of a key
GPS_EPOCH = dt.datetime(1980, 1, 6, tzinfo=dt.UTC)
LEAP_SECONDS = 18
_WEEK_MS = 7 * 86_400_000


@dataclass(frozen=True, slots=True)
class ReceiverFix:
    """One navigation solution as the receiver believes it; degrees, metres, metres per second, seconds."""

    utc_ns: int  # since 1970
    fix_type: int
    satellites: int
    latitude_deg: float
    longitude_deg: float
    height_msl_m: float
    velocity_ned: tuple[float, float, float]
    time_accuracy_s: float
    horizontal_accuracy_m: float
    vertical_accuracy_m: float
    speed_accuracy_m_s: float
    resolved: bool = True


def frame(kind: tuple[int, int], payload: bytes) -> bytes:
    """A UBX frame: sync, class, id, length, payload and the two sums of RFC 1145."""
    body = bytes(kind) + len(payload).to_bytes(2, "little") + payload
    return SYNC + body + fletcher(body)


def fletcher(body: bytes) -> bytes:
    """The two check bytes over class, id, length and payload."""
    a = b = 0
    for byte in body:
        a = (a + byte) & 0xFF
        b = (b + a) & 0xFF
    return bytes([a, b])


def nav_pvt(fix: ReceiverFix) -> bytes:
    """UBX-NAV-PVT of one fix, 100 bytes."""
    whole_s, fraction_ns = divmod(fix.utc_ns, 1_000_000_000)
    if fraction_ns > 500_000_000:  # nano is signed; seconds are rounded to the nearest
        whole_s, fraction_ns = whole_s + 1, fraction_ns - 1_000_000_000
    utc = dt.datetime.fromtimestamp(whole_s, dt.UTC)
    gps_ms = round((fix.utc_ns - GPS_EPOCH.timestamp() * 1e9) / 1e6) + LEAP_SECONDS * 1000
    north, east, down = fix.velocity_ned
    speed = math.hypot(north, east)
    heading = math.degrees(math.atan2(east, north)) % 360.0
    valid = 0x07 if fix.resolved else 0x00
    payload = struct.pack(
        "<IHBBBBBBIiBBBBiiiiIIiiiiiIIHH4xihH",
        gps_ms % _WEEK_MS,
        utc.year,
        utc.month,
        utc.day,
        utc.hour,
        utc.minute,
        utc.second,
        valid,
        round(fix.time_accuracy_s * 1e9),
        fraction_ns,
        fix.fix_type,
        0x01 if fix.fix_type >= 2 else 0x00,
        0xE0 if fix.resolved else 0x20,
        fix.satellites,
        round(fix.longitude_deg * 1e7),
        round(fix.latitude_deg * 1e7),
        round((fix.height_msl_m - 55.0) * 1e3),  # the ellipsoid lies above the geoid there
        round(fix.height_msl_m * 1e3),
        round(fix.horizontal_accuracy_m * 1e3),
        round(fix.vertical_accuracy_m * 1e3),
        round(north * 1e3),
        round(east * 1e3),
        round(down * 1e3),
        round(speed * 1e3),
        round(heading * 1e5),
        round(fix.speed_accuracy_m_s * 1e3),
        round(5.0 * 1e5),
        150,
        0,
        0,
        0,
        0,
    )
    return frame(NAV_PVT, payload)


class UbloxReceiver:
    """The receiver's message side: gives bytes for fixes, takes configuration bytes and gives the answers.

    saved_period_ms: navigation period of a configuration with NAV-PVT kept in the receiver; None: factory settings.
    """

    def __init__(self, saved_period_ms: int | None = None) -> None:
        self._saved_period_ms = saved_period_ms
        self.period_ms = 1000
        self.enabled = False
        self._pending = bytearray()
        self.restart()

    def restart(self) -> None:
        """Come up after power: as saved, or as from the factory, which is one fix a second and no NAV-PVT."""
        self.period_ms = self._saved_period_ms or 1000
        self.enabled = self._saved_period_ms is not None
        self._pending.clear()

    def report(self, fix: ReceiverFix) -> bytes:
        """The bytes sent for a fix."""
        return nav_pvt(fix) if self.enabled else b""

    def command(self, data: bytes) -> bytes:
        """Take configuration bytes; returns the answers."""
        self._pending += data
        answers = b""
        while (start := self._pending.find(SYNC)) >= 0:
            del self._pending[:start]
            if len(self._pending) < 6:
                break
            length = int.from_bytes(self._pending[4:6], "little")
            if len(self._pending) < length + 8:
                break
            body, check = bytes(self._pending[2 : 6 + length]), bytes(self._pending[6 + length : 8 + length])
            if check != fletcher(body):
                del self._pending[:2]
                continue
            del self._pending[: length + 8]
            answers += self._obey((body[0], body[1]), body[4:])
        return answers

    def _obey(self, kind: tuple[int, int], payload: bytes) -> bytes:
        if kind == MON_VER:
            return frame(MON_VER, b"ROM CORE 3.01 (107888)".ljust(30, b"\0") + b"00080000".ljust(10, b"\0"))
        if kind[0] != 0x06:
            return b""
        if kind == CFG_RATE and len(payload) == 6:
            self.period_ms = max(int.from_bytes(payload[:2], "little"), 40)
        elif kind == CFG_VALSET and not self._set_values(payload[4:]):
            return frame(ACK_NAK, bytes(kind))
        elif kind == CFG_MSG and len(payload) in (3, 8) and tuple(payload[:2]) == NAV_PVT:
            self.enabled = any(payload[2:])
        return frame(ACK_ACK, bytes(kind))

    def _set_values(self, data: bytes) -> bool:
        """Take key-value pairs (UBX-18010854, configuration interface); whether they were well formed."""
        while data:
            if len(data) < 4:
                return False
            key = int.from_bytes(data[:4], "little")
            size = VALUE_BYTES.get(key >> 28 & 7)
            if size is None or len(data) < 4 + size:
                return False
            value = int.from_bytes(data[4 : 4 + size], "little")
            if key == KEY_RATE_MEAS:
                self.period_ms = max(value, 40)
            elif key == KEY_NAV_PVT_UART1:
                self.enabled = bool(value)
            data = data[4 + size :]
        return True
