"""The line to an autopilot as a source of samples: its messages, dated by its own clock, and the rates it is asked for.

MAVLink common.xml, versions 1 and 2. Everything that ArduPilot and PX4 stamp, and their answers to TIMESYNC, counts from their
start-up (GCS_Common.cpp, handle_timesync: AP_HAL::micros64; mavlink_timesync.cpp: hrt_absolute_time), some of it in 32 bits of
microseconds. ArduPilot grants an interval of whole milliseconds unless 0.8 of it is shorter than a loop, answers COMMAND_ACK
DENIED otherwise and says why in a STATUSTEXT (GCS_Common.cpp, cap_message_interval).
"""

import math
from collections import deque
from collections.abc import Callable, Iterator
from struct import Struct
from typing import Any, NamedTuple

from fastcrc import crc16

from daq.sensors.base import MS, SECOND
from daq.sensors.bus import SerialPortCalls
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
V1, V2 = 0xFE, 0xFD
SYSTEM, COMPONENT, AUTOPILOT = 1, 191, 1  # MAV_COMP_ID_ONBOARD_COMPUTER asks MAV_COMP_ID_AUTOPILOT1
_NO_AUTOPILOT, _ONBOARD_COMPUTER = 8, 18
_SET_MESSAGE_INTERVAL, _DENIED = 511, 2
BYTES = {HIGHRES_IMU: 75, ATTITUDE: 40, SCALED_PRESSURE: 28, SERVO_OUTPUT_RAW: 34}
"""On the wire, of messages that are wanted in each scan."""
SLOW_BYTES_PER_S = 900
"""Of positions, fixes, times, heartbeats and answers together."""
LINE_SHARE = 0.7
"""Of a serial line that streams may take: where it is full, an autopilot leaves messages out."""
_RESULTS = {0: "accepted", 1: "temporarily rejected", 2: "denied", 3: "unsupported", 4: "failed"}
_BASE_NS = 2**32 * 1000
"""All times of the sender are taken modulo the range of its shortest stamp, 71 minutes."""
_DRIFT = 100e-6
"""Of its clock against ours: twice what a crystal has."""
_JUMP_NS = 10 * SECOND
"""No message is under way so long: a time further from its clock is another start-up."""
_BACK_NS = 400 * MS
"""Times of one line follow one another, but that a fix is dated by its instant: going back by more is another start-up."""
_ONE_WAY_NS = 4 * MS
"""Without an answer to TIMESYNC: 40 bytes at 115200 baud take so long."""
_UNANSWERED_NS = 20 * MS
"""And what is known of the clock then: half a loop at the 50 Hz of an ArduPlane, twice, for the wait to be sent and read."""
ASK_NS, SYNC_NS = 300 * MS, 250 * MS
ASK_AGAIN_NS = 2 * SECOND
"""Between two requests of what comes, but too seldom."""
_MEASURED_OVER = 20  # messages; a rate over fewer is the jitter's
_READ_LIMIT = 4096


class AutopilotMessage(NamedTuple):
    """A message of the autopilot: fields in the order of the wire, when it was true and when it came, on our clock [ns]."""

    fields: tuple[Any, ...]
    sampled_ns: int
    arrived_ns: int


def frames(buffer: bytearray) -> Iterator[tuple[int, int, int, bytes]]:
    """Message, system, component and payload of the sound frames of a kind known here; the unfinished rest stays."""
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
    """Our clock minus the sender's, between two hard bounds: nothing arrives before it was sent, nor is answered before it
    was asked. Its middle has no error where both ways take as long."""

    def __init__(self) -> None:
        self._low, self._high, self._at_ns = -math.inf, math.inf, 0
        self._last = -math.inf  # what came last, unwrapped

    @property
    def known(self) -> bool:
        return self._high < math.inf

    @property
    def offset_ns(self) -> float:
        """Our clock minus the sender's [ns]; of a clock that is known."""
        return (self._low + self._high) / 2 if self._low > -math.inf else self._high - _ONE_WAY_NS

    @property
    def accuracy_ns(self) -> float:
        """How far the offset can be off [ns]."""
        return (self._high - self._low) / 2 if self._low > -math.inf else _UNANSWERED_NS

    def stamp(self, sender_ns: int, now_ns: int) -> int:
        """A time of the sender that has just arrived, unwrapped; the clock is begun anew where it fits nothing."""
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
        """The sender's clock was at `sender_ns` after we had asked."""
        self._narrow(asked_ns - self.stamp(sender_ns, now_ns), math.inf, now_ns)

    def _narrow(self, low: float, high: float, now_ns: int) -> None:
        drift = _DRIFT * (now_ns - self._at_ns)
        self._low, self._high, self._at_ns = max(self._low - drift, low), min(self._high + drift, high), now_ns
        if self._low > self._high:  # its clock was set, or runs otherwise than any crystal: what came last counts
            self._low, self._high = (low, math.inf) if low > -math.inf else (-math.inf, high)


class MessageWish:
    """A message that is wanted at a rate, or another in its place; what it takes to get it."""

    def __init__(self, alternatives: tuple[int, ...], rates_hz: tuple[float, ...]) -> None:
        self.choices = [(message, rate) for message in alternatives for rate in rates_hz]
        self._choice = 0
        self.refusal = ""
        self.rests_until_ns = 0  # it was asked for, or asked for again

    @property
    def message(self) -> int:
        return self.choices[self._choice][0]

    @property
    def interval_us(self) -> int:
        return round(1e6 / self.choices[self._choice][1])

    def refused(self, result: int, words: str) -> None:
        """The autopilot will not: a slower rate of the same where it was denied, else the message that can replace it."""
        rate = 1e6 / self.interval_us
        answer = _RESULTS.get(result, f"result {result}")
        loop = f": SCHED_LOOP_RATE of at least {math.ceil(rate / 0.8)} grants it" if result == _DENIED else ""
        self.refusal = f"{NAMES[self.message]} at {rate:.0f} Hz is {answer}{loop}" + (f" ({words})" if words else "")
        self._go_on(anyhow=result == _DENIED)

    def unheard(self) -> None:
        """Neither it nor an answer came."""
        self._go_on(anyhow=False)

    def _go_on(self, *, anyhow: bool) -> None:
        message, self.rests_until_ns = self.message, 0
        while self._choice + 1 < len(self.choices):
            self._choice += 1
            if anyhow or self.message != message:
                return


class AutopilotLine:
    """device: the port's name, for sentences. names: parameters to ask for. One line serves the drivers of all groups."""

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
        self._turn = 0
        self._words = ""
        self._next_names_ns = self._next_sync_ns = self._next_beat_ns = now_ns()

    def want(self, alternatives: tuple[int, ...], *rates_hz: float) -> MessageWish:
        """Ask for a message from now on; rates in the order of preference. Groups of one message share the wish."""
        wish = MessageWish(alternatives, rates_hz)
        same = [w for w in self._wishes if w.choices == wish.choices]
        self._wishes += [] if same else [wish]
        return same[0] if same else wish

    def newest(self, message: int) -> AutopilotMessage | None:
        """The message that was true last; None before the first."""
        return self._newest.get(message)

    @property
    def complete(self) -> bool:
        """Whether every parameter asked for has been told."""
        return all(name in self.parameters for name in self._names)

    def rate_hz(self, message: int) -> float:
        """How often it comes, by those that came last."""
        times = self._arrivals.get(message)
        return (len(times) - 1) * 1e9 / max(self._now() - times[0], 1) if times else 0.0

    def poll(self) -> None:
        """Take what has arrived, and ask for what is missing. Raises OSError of the port."""
        now_ns = self._now()
        available = min(self._port.in_waiting, _READ_LIMIT)
        if available:
            self._buffer += self._port.read(available)
            for message, system, component, payload in frames(self._buffer):
                if component == AUTOPILOT and self._system in (None, system):
                    self._take(message, system, payload, now_ns)
        self._speak(now_ns)

    def _take(self, message: int, system: int, payload: bytes, now_ns: int) -> None:
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
            self._words = text if "message ID" in text else self._words
        elif message == COMMAND_ACK:
            self._answered(fields[0], fields[1])
        elif message != SERVO_OUTPUT_RAW or fields[9] == 0:  # port 0: the main outputs
            self._note(message, fields, now_ns)

    def _note(self, message: int, fields: tuple[Any, ...], now_ns: int) -> None:
        sampled = now_ns
        if message in _STAMP_NS:
            place, unit = _STAMP_NS[message]
            sampled = round(self.clock.stamp(int(fields[place]) * unit, now_ns) + self.clock.offset_ns)
        last = self._newest.get(message)
        if last is None or sampled > last.sampled_ns or now_ns - last.arrived_ns > SECOND:
            self._newest[message] = AutopilotMessage(fields, min(sampled, now_ns), now_ns)
            self._arrivals.setdefault(message, deque(maxlen=_MEASURED_OVER)).append(now_ns)

    def _answered(self, command: int, result: int) -> None:
        if command == _SET_MESSAGE_INTERVAL and self._asked is not None:
            wish, message, _ = self._asked
            self._asked = None
            if result and wish.message == message:
                wish.refused(result, self._words)
            self._words = ""

    # ---------------------------------------------------------------------------------------- what it is told

    def _speak(self, now_ns: int) -> None:
        if now_ns >= self._next_beat_ns:
            self._next_beat_ns = now_ns + SECOND
            self._send("HEARTBEAT", type=_ONBOARD_COMPUTER, autopilot=_NO_AUTOPILOT, system_status=4, mavlink_version=3)
        if self._system is None:
            return
        if now_ns >= self._next_sync_ns:
            self._next_sync_ns = now_ns + SYNC_NS
            self._send("TIMESYNC", tc1=0, ts1=now_ns)
        if self._asked is not None and now_ns - self._asked[2] > ASK_NS:
            wish, message, _ = self._asked
            self._asked = None
            if wish.message == message and message not in self._newest:
                wish.unheard()
        if self._asked is None:
            self._ask(now_ns, self._system)

    def _ask(self, now_ns: int, system: int) -> None:
        """Ask for one message that comes too seldom: an answer does not say to which it belongs."""
        target = {"target_system": system, "target_component": AUTOPILOT}
        for name in self._names if now_ns >= self._next_names_ns else ():
            self._next_names_ns = now_ns + ASK_AGAIN_NS
            if name not in self.parameters:
                self._send("PARAM_REQUEST_READ", **target, param_id=name, param_index=-1)
        for k in range(len(self._wishes)):
            wish = self._wishes[(self._turn + k) % len(self._wishes)]
            if now_ns >= wish.rests_until_ns and self.rate_hz(wish.message) < 0.9e6 / wish.interval_us:
                self._turn = (self._turn + k + 1) % len(self._wishes)
                self._asked, wish.rests_until_ns = (wish, wish.message, now_ns), now_ns + ASK_AGAIN_NS
                wanted = {"param1": float(wish.message), "param2": float(wish.interval_us)}
                self._send("COMMAND_LONG", **target, command=_SET_MESSAGE_INTERVAL, **wanted)
                return

    def _send(self, name: str, **fields: object) -> None:
        self._port.write(self._encoder.message(name, **fields))
