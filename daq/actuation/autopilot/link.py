"""The line to an autopilot: what it says of itself, what it is asked, and the overrides it is given.

MAVLink 2 on a port that never waits. Each RC_CHANNELS is dated by the autopilot's own time since boot, carried to our clock by
the quickest message of late: one that lay in a buffer, or took its time through a router, is as old as it is.

Two messages are not in the dialect of the link to the ground: MAVLink common.xml. RC_CHANNELS (65): u32 time since boot [ms],
18 x u16 channel [us], u8 how many, u8 rssi; where ArduPilot overrides a channel it shows the override. RC_CHANNELS_OVERRIDE
(70): 8 x u16, u8 system, u8 component; channels 9 to 18 are extensions. On channels 1 to 8 a value of 0 releases and 65535
leaves alone; on 9 to 18 0 leaves alone too, so that a message without them says nothing of them (ArduPilot, GCS_Common.cpp,
handle_rc_channels_override).
"""

import math
from collections import deque
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from struct import Struct
from typing import Protocol

from daq.transport.mavlink_codec import FrameDecoder, FrameEncoder, MavlinkFrame, frames_of, padded
from daq.utilities.errors import UserError

RC_CHANNELS, RC_CHANNELS_OVERRIDE = 65, 70
RELEASE, LEAVE = 0, 65535
SETTABLE = 8
"""Channels on which 0 releases."""
_CHANNELS = Struct("<I18HBB")
_OVERRIDE = Struct("<8HBB")
_ABSENT = (0, 65535)


@dataclass(frozen=True, slots=True)
class Channels:
    """The pilot's channels as the autopilot takes them, or what stands in their place.

    sampled_ns: when they were, on our clock. widths: by channel number [us]; channels that are not there are left out.
    """

    sampled_ns: int
    widths: Mapping[int, float]


def read_channels(payload: bytes) -> tuple[int, dict[int, float]]:
    """Time since boot [ms] and widths [us] of an RC_CHANNELS."""
    boot_ms, *widths, count, _ = _CHANNELS.unpack(padded(payload, _CHANNELS.size))
    return boot_ms, {i + 1: float(w) for i, w in enumerate(widths[: min(count, 18)]) if w not in _ABSENT}


def override_payload(values: Mapping[int, int], system: int) -> bytes:
    """An RC_CHANNELS_OVERRIDE to the autopilot of this system id; channels not in `values` are left alone."""
    widths = [values.get(channel, LEAVE) for channel in range(1, SETTABLE + 1)]
    return _OVERRIDE.pack(*widths, system, 1)


COMPONENT = 191  # MAV_COMP_ID_ONBOARD_COMPUTER
ASK_NS = 300_000_000  # between two requests of what has not been answered
_READ_BYTES = 4096  # more than arrives in a third of a second at 115200 baud
_ANEW_MS = 1000  # time since boot that goes back by more is another boot, not a frame that came out of order
_CLOCK_DRIFT = 100e-6  # of the autopilot's clock against ours: twice what a crystal has
_RATE_OF = 25  # messages
_SET_MESSAGE_INTERVAL = 511
_DENIED = 2  # MAV_RESULT
_LOOP_SHARE = 0.8
_AUTOPILOT = 1  # MAV_COMP_ID_AUTOPILOT1


class AutopilotPort(Protocol):
    """A port to an autopilot that never waits: `daq.transport.ports`, or a simulated one."""

    def read(self, limit: int, /) -> bytes:
        """Bytes that have arrived, at most `limit`."""
        ...

    def write(self, data: bytes, /) -> int | None:
        """Send; how many bytes were taken."""
        ...


class AutopilotError(UserError):
    """An autopilot that the sequencer cannot go through."""


@dataclass(frozen=True, slots=True)
class AutopilotHeartbeat:
    """A HEARTBEAT: when it came, whose it is, and MAV_AUTOPILOT, MAV_TYPE and custom mode in it."""

    time_ns: int
    system: int
    autopilot: int
    kind: int
    mode: int


class AutopilotLink:
    """system: our own system id, which must be the one whose overrides are taken. rate_hz: of RC_CHANNELS. names: of the
    parameters to ask for; of alternatives, in one tuple, one answer is enough."""

    def __init__(self, port: AutopilotPort, system: int, rate_hz: float, names: Iterable[tuple[str, ...]]) -> None:
        self._port = port
        self._encoder = FrameEncoder(system, COMPONENT)
        self._decoder = FrameDecoder()
        self._interval_us = round(1e6 / rate_hz)
        self._names = tuple(names)
        self._offset_ns: float | None = None  # our clock minus the autopilot's, by the quickest message
        self._offset_at_ns = self._boot_ms = 0
        self._asked_ns = -ASK_NS
        self._arrivals: deque[int] = deque(maxlen=_RATE_OF)
        self.heard: AutopilotHeartbeat | None = None
        self.channels: Channels | None = None
        self.parameters: Mapping[str, float] = {}
        self.port_fault = ""
        self.refusal = ""
        """Why RC_CHANNELS is not sent as often as it was asked for, with the cure; empty where it is."""
        self._text = ""  # what the autopilot said of it

    # ---------------------------------------------------------------------------------------- what it says

    def poll(self, now_ns: int) -> None:
        """Take what has arrived, and ask again for what has not."""
        try:
            data = self._port.read(_READ_BYTES)
            self.port_fault = ""
        except OSError as error:
            self.port_fault = f"port cannot be read ({error.strerror or error})"
            return
        for frame in frames_of(self._decoder.feed(data)):
            if frame.component == _AUTOPILOT:
                self._handle_frame(frame, now_ns)
        if self.heard is not None and now_ns - self._asked_ns >= ASK_NS:
            self._ask(now_ns)

    def forget(self) -> None:
        """Ask for the parameters anew: somebody may have changed them."""
        self.parameters = {}
        self._asked_ns = -ASK_NS

    @property
    def missing(self) -> tuple[str, ...]:
        """Parameters that have not been told."""
        return tuple(" or ".join(n) for n in self._names if not any(name in self.parameters for name in n))

    def rate_hz(self, now_ns: int) -> float:
        """RC_CHANNELS a second, by those that came last."""
        if len(self._arrivals) < 2:
            return 0.0
        return (len(self._arrivals) - 1) * 1e9 / max(now_ns - self._arrivals[0], 1)

    def _handle_frame(self, frame: MavlinkFrame, now_ns: int) -> None:
        if frame.msg_id == RC_CHANNELS:
            self._note_channels(frame, now_ns)
        elif frame.name == "HEARTBEAT":
            numbers = [_whole(frame, field) for field in ("autopilot", "type", "custom_mode")]
            self.heard = AutopilotHeartbeat(now_ns, frame.system, *numbers)
        elif frame.name == "STATUSTEXT":
            text = str(frame.fields()["text"])
            self._text = text if f"message ID {RC_CHANNELS} " in text else self._text
        elif frame.name == "COMMAND_ACK" and _whole(frame, "command") == _SET_MESSAGE_INTERVAL:
            self._answered(_whole(frame, "result"))
        elif frame.name == "PARAM_VALUE":
            fields = frame.fields()
            value = fields["param_value"]
            if isinstance(value, float):
                self.parameters = {**self.parameters, str(fields["param_id"]): value}

    def _answered(self, result: int) -> None:
        """SET_MESSAGE_INTERVAL was taken, or was not: ArduPilot sends at 0.8 of its loop rate at most (cap_message_interval)."""
        if not result:
            self.refusal = self._text = ""
            return
        rate = 1e6 / self._interval_us
        cure = f"set SCHED_LOOP_RATE to {math.ceil(rate / _LOOP_SHARE)} or more, 100 advised, and restart it"
        words = f" ({self._text})" if self._text else ""
        answer = "denied" if result == _DENIED else f"not taken (MAV_RESULT {result})"
        self.refusal = f"RC_CHANNELS at {rate:.0f} Hz is {answer}{words}: {cure}"

    def _note_channels(self, frame: MavlinkFrame, now_ns: int) -> None:
        boot_ms, widths = read_channels(frame.payload)
        offset = now_ns - boot_ms * 1e6
        if self._offset_ns is None or boot_ms < self._boot_ms - _ANEW_MS:
            self._offset_ns = offset
        else:
            drifted = self._offset_ns + _CLOCK_DRIFT * (now_ns - self._offset_at_ns)
            self._offset_ns = min(offset, drifted)
        self._offset_at_ns, self._boot_ms = now_ns, boot_ms
        sampled = round(boot_ms * 1e6 + self._offset_ns)
        if self.channels is None or sampled >= self.channels.sampled_ns or now_ns - self.channels.sampled_ns > 10**9:
            self.channels = Channels(sampled, widths)
            self._arrivals.append(now_ns)

    # ---------------------------------------------------------------------------------------- what it is told

    def override(self, values: Mapping[int, int]) -> bool:
        """Override channels [us], or release them (0); False when the port does not take it."""
        if self.heard is None:
            return False
        payload = override_payload(values, self.heard.system)
        return self._send(self._encoder.frame(RC_CHANNELS_OVERRIDE, payload))

    def _ask(self, now_ns: int) -> None:
        """Ask for RC_CHANNELS where it is slow, and for parameters that have not been told."""
        self._asked_ns = now_ns
        if self.heard is None:
            return
        target = {"target_system": self.heard.system, "target_component": _AUTOPILOT}
        if self.rate_hz(now_ns) < 0.9e6 / self._interval_us:
            wish = {"command": _SET_MESSAGE_INTERVAL, "param1": float(RC_CHANNELS), "param2": float(self._interval_us)}
            self._send(self._encoder.message("COMMAND_LONG", **target, **wish))
        for names in self._names:
            if not any(name in self.parameters for name in names):
                for name in names:
                    self._send(self._encoder.message("PARAM_REQUEST_READ", **target, param_id=name, param_index=-1))

    def _send(self, data: bytes) -> bool:
        try:
            accepted = self._port.write(data)
        except OSError as error:
            self.port_fault = f"port cannot be written ({error.strerror or error})"
            return False
        if accepted is not None and accepted < len(data):
            self.port_fault = "port takes no more; is the line too slow?"
            return False
        return True


def _whole(frame: MavlinkFrame, field: str) -> int:
    value = frame.fields()[field]
    return value if isinstance(value, int) else 0
