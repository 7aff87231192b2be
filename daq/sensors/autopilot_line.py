"""The sensors' connection to an autopilot: its messages, dated by its own clock, and the rates requested of it.

MAVLink common.xml, versions 1 and 2. Everything that ArduPilot and PX4 stamp, and their answers to TIMESYNC, counts from their
start-up (GCS_Common.cpp, handle_timesync: AP_HAL::micros64; mavlink_timesync.cpp: hrt_absolute_time), some of it in 32 bits of
microseconds. ArduPilot rounds an interval to whole milliseconds. Where 0.8 of it is shorter than a loop it answers COMMAND_ACK
DENIED and gives the reason in a STATUSTEXT (GCS_Common.cpp, cap_message_interval).
"""

import math
from collections import deque
from collections.abc import Callable, Iterator
from struct import Struct
from typing import Any, NamedTuple

from fastcrc import crc16

from daq.contract.link.commands import DENIED, RESULT_WORDS, SET_MESSAGE_INTERVAL
from daq.sensors.base import MS, SECOND
from daq.sensors.bus import SerialPortCalls
from daq.transport.autopilot_requests import (
    AUTOPILOT,
    CLOCK_DRIFT,
    COMPONENT,
    REQUEST_AGAIN_NS,
    is_slow,
    least_loop_rate,
)
from daq.transport.mavlink_codec import FrameEncoder

HEARTBEAT, SYSTEM_TIME, PARAM_VALUE, GPS_RAW_INT, RAW_IMU, SCALED_PRESSURE, ATTITUDE = 0, 2, 22, 24, 27, 29, 30
GLOBAL_POSITION_INT, SERVO_OUTPUT_RAW, COMMAND_ACK, HIGHRES_IMU, TIMESYNC, STATUSTEXT = 33, 36, 77, 105, 111, 253
NAMES = {
    **{SYSTEM_TIME: "SYSTEM_TIME", GPS_RAW_INT: "GPS_RAW_INT", RAW_IMU: "RAW_IMU", ATTITUDE: "ATTITUDE"},
    **{SCALED_PRESSURE: "SCALED_PRESSURE", GLOBAL_POSITION_INT: "GLOBAL_POSITION_INT"},
    **{SERVO_OUTPUT_RAW: "SERVO_OUTPUT_RAW", HIGHRES_IMU: "HIGHRES_IMU"},
}
_WIRE = {
    HEARTBEAT: (50, Struct("<IBBBBB")),  # CRC_EXTRA, fields in the order of the wire
    SYSTEM_TIME: (137, Struct("<QI")),
    PARAM_VALUE: (220, Struct("<fHH16sB")),
    GPS_RAW_INT: (24, Struct("<QiiiHHHHBBiIII")),
    RAW_IMU: (144, Struct("<Q9hBh")),
    SCALED_PRESSURE: (115, Struct("<Iffhh")),
    ATTITUDE: (39, Struct("<I6f")),
    GLOBAL_POSITION_INT: (104, Struct("<Iiiii3hH")),
    SERVO_OUTPUT_RAW: (222, Struct("<I8HB")),
    COMMAND_ACK: (143, Struct("<HB")),
    HIGHRES_IMU: (93, Struct("<Q13fHB")),
    TIMESYNC: (34, Struct("<qq")),
    STATUSTEXT: (83, Struct("<B50s")),
}
_STAMP_NS = {  # place of the sender's time among the fields, nanoseconds in one of it
    **dict.fromkeys((RAW_IMU, HIGHRES_IMU, SERVO_OUTPUT_RAW), (0, 1000)),
    **dict.fromkeys((SCALED_PRESSURE, ATTITUDE, GLOBAL_POSITION_INT), (0, MS)),
    SYSTEM_TIME: (1, MS),
}
V1, V2 = 0xFE, 0xFD  # the first byte of a frame
SYSTEM = 1
_NO_AUTOPILOT, _ONBOARD_COMPUTER, _ACTIVE = 8, 18, 4  # MAV_AUTOPILOT, MAV_TYPE, MAV_STATE
BYTES = {HIGHRES_IMU: 75, ATTITUDE: 40, SCALED_PRESSURE: 28, SERVO_OUTPUT_RAW: 34}
"""Message that is wanted in each scan -> bytes of its frame."""
SLOW_BYTES_PER_S = 900
"""Bytes a second of positions, fixes, times, heartbeats and answers together."""
LINE_SHARE = 0.7
"""Share of a serial line that streams may use: on a full line an autopilot leaves messages out."""
_BASE_NS = 2**32 * 1000
"""All times of the sender are taken modulo the range of its shortest stamp, 71 minutes."""
_JUMP_NS = 10 * SECOND
"""No message is delayed so long: a time that differs more from the sender's clock is from another start-up."""
_BACK_NS = 400 * MS
"""Times on one line rise, except that a fix carries the earlier instant of its measurement: a larger step back is another
start-up."""
_ONE_WAY_NS = 4 * MS
"""Delay taken for a message before TIMESYNC is answered: 40 bytes at 115200 baud."""
_UNANSWERED_NS = 20 * MS
"""Error of the clock before then: half a loop at the 50 Hz of an ArduPlane, once for sending and once for reading."""
SYNC_NS = 250 * MS  # between two TIMESYNC requests
SLOW_REQUEST_NS = 2 * SECOND
"""Between two requests of a message that comes, but too seldom."""
_RATE_MESSAGES = 20  # over which a rate is taken: over fewer it shows jitter
_READ_LIMIT = 4096


class AutopilotMessage(NamedTuple):
    """A message of the autopilot: fields in the order of the wire; times of sampling and of arrival, on our clock [ns]."""

    fields: tuple[Any, ...]
    sampled_ns: int
    arrived_ns: int


def frames(buffer: bytearray) -> Iterator[tuple[int, int, int, bytes]]:
    """Message, system, component and payload of each intact frame with a message of `_WIRE`. Takes them out of the buffer; an
    unfinished frame remains in it."""
    while buffer:
        if buffer[0] not in (V1, V2):
            del buffer[0]
            continue
        header = 10 if buffer[0] == V2 else 6
        if len(buffer) < header:
            return
        message = int.from_bytes(buffer[7:10], "little") if header == 10 else buffer[5]
        end = header + buffer[1] + 2
        if message not in _WIRE:
            del buffer[0]  # another message, or damage: only its first byte is surely not the start of one of ours
            continue
        if len(buffer) < end:
            return
        checksum = buffer[end - 2] | buffer[end - 1] << 8
        if crc16.mcrf4xx(bytes(buffer[1 : end - 2]) + bytes((_WIRE[message][0],))) != checksum:
            del buffer[0]
            continue
        system, component = buffer[header - 5 : header - 3] if header == 10 else buffer[3:5]
        payload = bytes(buffer[header : end - 2])
        del buffer[: end + (13 if header == 10 and buffer[2] & 1 else 0)]
        yield message, system, component, payload


class SenderClock:
    """Our clock minus the sender's, between two hard bounds: nothing arrives before it was sent, and no answer is sent before
    the request. The middle of the bounds has no error where both directions take equally long."""

    def __init__(self) -> None:
        self._low, self._high, self._at_ns = -math.inf, math.inf, 0
        self._last = -math.inf  # latest time of the sender, unwrapped [ns]

    @property
    def known(self) -> bool:
        return self._high < math.inf

    @property
    def offset_ns(self) -> float:
        """Our clock minus the sender's [ns]; only where `known`."""
        return (self._low + self._high) / 2 if self._low > -math.inf else self._high - _ONE_WAY_NS

    @property
    def accuracy_ns(self) -> float:
        """Largest error of the offset [ns]."""
        return (self._high - self._low) / 2 if self._low > -math.inf else _UNANSWERED_NS

    def stamp(self, sender_ns: int, now_ns: int) -> int:
        """A time of the sender [ns] that has just arrived, unwrapped; one that does not fit restarts the clock."""
        if self.known:
            expected = now_ns - self.offset_ns
            unwrapped = expected + (sender_ns - expected + _BASE_NS / 2) % _BASE_NS - _BASE_NS / 2
            if abs(unwrapped - expected) < _JUMP_NS and unwrapped > self._last - _BACK_NS:
                self._last = max(self._last, unwrapped)
                self._narrow(-math.inf, now_ns - unwrapped, now_ns)
                return round(unwrapped)
        self._last = sender_ns % _BASE_NS
        self._low, self._high, self._at_ns = -math.inf, now_ns - self._last, now_ns
        return round(self._last)

    def answered(self, sender_ns: int, asked_ns: int, now_ns: int) -> None:
        """Take an answer to TIMESYNC: the sender's clock stood at `sender_ns` between `asked_ns` and `now_ns` of ours."""
        self._narrow(asked_ns - self.stamp(sender_ns, now_ns), math.inf, now_ns)

    def _narrow(self, low: float, high: float, now_ns: int) -> None:
        drift = CLOCK_DRIFT * (now_ns - self._at_ns)
        self._low, self._high, self._at_ns = max(self._low - drift, low), min(self._high + drift, high), now_ns
        if self._low > self._high:  # its clock was set, or drifts more than a crystal: the latest bound counts
            self._low, self._high = (low, math.inf) if low > -math.inf else (-math.inf, high)


class MessageWish:
    """A message requested at a rate, with alternatives in order of preference: other messages, and slower rates."""

    def __init__(self, alternatives: tuple[int, ...], rates_hz: tuple[float, ...]) -> None:
        self.choices = [(message, rate) for message in alternatives for rate in rates_hz]
        self._choice = 0
        self.refusal = ""
        self.next_request_ns = 0

    @property
    def message(self) -> int:
        return self.choices[self._choice][0]

    @property
    def interval_us(self) -> int:
        return round(1e6 / self.choices[self._choice][1])

    def refused(self, result: int, words: str) -> None:
        """Take the autopilot's refusal (MAV_RESULT, and its own text). Denied: try the next choice, which may be a slower rate of
        the same message; otherwise try the next message."""
        rate = 1e6 / self.interval_us
        answer = RESULT_WORDS.get(result, f"result {result}")
        loop = f": SCHED_LOOP_RATE of at least {least_loop_rate(rate)} grants it" if result == DENIED else ""
        self.refusal = f"{NAMES[self.message]} at {rate:.0f} Hz is {answer}{loop}" + (f" ({words})" if words else "")
        self._next_choice(other_message=result != DENIED)

    def unanswered(self) -> None:
        """Neither the message nor an answer came: try the next message."""
        self._next_choice(other_message=True)

    def _next_choice(self, *, other_message: bool) -> None:
        message, self.next_request_ns = self.message, 0
        while self._choice + 1 < len(self.choices):
            self._choice += 1
            if not other_message or self.message != message:
                return


class AutopilotLine:
    """device: the port's name, for messages. names: parameters to request. One line serves the drivers of all groups."""

    def __init__(
        self, port: SerialPortCalls, now_ns: Callable[[], int], device: str, names: tuple[str, ...] = ()
    ) -> None:
        self.device = device
        self.clock = SenderClock()
        self.parameters: dict[str, float] = {}
        self._port, self._now, self._names = port, now_ns, names
        self._encoder = FrameEncoder(SYSTEM, COMPONENT)
        self._buffer = bytearray()
        self._system: int | None = None
        self._newest: dict[int, AutopilotMessage] = {}
        self._arrivals: dict[int, deque[int]] = {}
        self._wishes: list[MessageWish] = []
        self._asked: tuple[MessageWish, int, int] | None = None  # the wish, its message, when
        self._turn = 0  # index of the wish that is considered first
        self._refusal_text = ""  # the autopilot's own STATUSTEXT on a refused message
        self._next_names_ns = self._next_sync_ns = self._next_heartbeat_ns = now_ns()

    def want(self, alternatives: tuple[int, ...], *rates_hz: float) -> MessageWish:
        """Request a message from now on; rates in the order of preference. Groups that need the same message share one wish."""
        wish = MessageWish(alternatives, rates_hz)
        same = [w for w in self._wishes if w.choices == wish.choices]
        self._wishes += [] if same else [wish]
        return same[0] if same else wish

    def newest(self, message: int) -> AutopilotMessage | None:
        """The message that was sampled last; None before the first."""
        return self._newest.get(message)

    @property
    def complete(self) -> bool:
        """Whether every requested parameter has come."""
        return all(name in self.parameters for name in self._names)

    def rate_hz(self, message: int) -> float:
        """Rate of a message [Hz] over the last of it."""
        times = self._arrivals.get(message)
        return (len(times) - 1) * 1e9 / max(self._now() - times[0], 1) if times else 0.0

    def poll(self) -> None:
        """Process what has arrived, and request what is missing. Raises OSError of the port."""
        now_ns = self._now()
        available = min(self._port.in_waiting, _READ_LIMIT)
        if available:
            self._buffer += self._port.read(available)
            for message, system, component, payload in frames(self._buffer):
                if component == AUTOPILOT and self._system in (None, system):
                    self._handle(message, system, payload, now_ns)
        self._transmit(now_ns)

    def _handle(self, message: int, system: int, payload: bytes, now_ns: int) -> None:
        codec = _WIRE[message][1]
        fields = codec.unpack(payload[: codec.size].ljust(codec.size, b"\0"))  # MAVLink 2 trims trailing zeros
        if message == HEARTBEAT:
            self._system = system if fields[2] != _NO_AUTOPILOT else self._system
        elif message == TIMESYNC:
            if fields[0] and 0 < now_ns - fields[1] < _JUMP_NS:  # an answer to us
                self.clock.answered(fields[0], fields[1], now_ns)
        elif message == PARAM_VALUE:
            self.parameters[fields[3].split(b"\0")[0].decode("ascii", "replace")] = fields[0]
        elif message == STATUSTEXT:
            text = fields[1].split(b"\0")[0].decode("ascii", "replace")
            self._refusal_text = text if "message ID" in text else self._refusal_text
        elif message == COMMAND_ACK:
            self._note_ack(fields[0], fields[1])
        elif message != SERVO_OUTPUT_RAW or fields[9] == 0:  # port 0: the main outputs
            self._note_sample(message, fields, now_ns)

    def _note_sample(self, message: int, fields: tuple[Any, ...], now_ns: int) -> None:
        sampled = now_ns
        if message in _STAMP_NS:
            place, unit = _STAMP_NS[message]
            sampled = round(self.clock.stamp(int(fields[place]) * unit, now_ns) + self.clock.offset_ns)
        last = self._newest.get(message)
        if last is None or sampled > last.sampled_ns or now_ns - last.arrived_ns > SECOND:
            self._newest[message] = AutopilotMessage(fields, min(sampled, now_ns), now_ns)
            self._arrivals.setdefault(message, deque(maxlen=_RATE_MESSAGES)).append(now_ns)

    def _note_ack(self, command: int, result: int) -> None:
        if command == SET_MESSAGE_INTERVAL and self._asked is not None:
            wish, message, _ = self._asked
            self._asked = None
            if result and wish.message == message:
                wish.refused(result, self._refusal_text)
            self._refusal_text = ""

    # ---------------------------------------------------------------------------------------- sent

    def _transmit(self, now_ns: int) -> None:
        if now_ns >= self._next_heartbeat_ns:
            self._next_heartbeat_ns = now_ns + SECOND
            self._send(
                "HEARTBEAT", type=_ONBOARD_COMPUTER, autopilot=_NO_AUTOPILOT, system_status=_ACTIVE, mavlink_version=3
            )
        if self._system is None:
            return
        if now_ns >= self._next_sync_ns:
            self._next_sync_ns = now_ns + SYNC_NS
            self._send("TIMESYNC", tc1=0, ts1=now_ns)
        if self._asked is not None and now_ns - self._asked[2] > REQUEST_AGAIN_NS:
            wish, message, _ = self._asked
            self._asked = None
            if wish.message == message and message not in self._newest:
                wish.unanswered()
        if self._asked is None:
            self._request_next(now_ns, self._system)

    def _request_next(self, now_ns: int, system: int) -> None:
        """Request the parameters, and one message that comes too seldom: one at a time, for COMMAND_ACK does not name it."""
        target = {"target_system": system, "target_component": AUTOPILOT}
        for name in self._names if now_ns >= self._next_names_ns else ():
            self._next_names_ns = now_ns + SLOW_REQUEST_NS
            if name not in self.parameters:
                self._send("PARAM_REQUEST_READ", **target, param_id=name, param_index=-1)
        for k in range(len(self._wishes)):
            wish = self._wishes[(self._turn + k) % len(self._wishes)]
            if now_ns >= wish.next_request_ns and is_slow(self.rate_hz(wish.message), wish.interval_us):
                self._turn = (self._turn + k + 1) % len(self._wishes)
                self._asked, wish.next_request_ns = (wish, wish.message, now_ns), now_ns + SLOW_REQUEST_NS
                wanted = {"param1": float(wish.message), "param2": float(wish.interval_us)}
                self._send("COMMAND_LONG", **target, command=SET_MESSAGE_INTERVAL, **wanted)
                return

    def _send(self, name: str, **fields: object) -> None:
        self._port.write(self._encoder.message(name, **fields))
