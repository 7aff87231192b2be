"""The sequencer's connection to an autopilot: heartbeat, parameters and RC channels come in, requests and overrides go out.

MAVLink 2 on a port that never blocks. Each RC_CHANNELS carries the autopilot's time since boot. The offset to our clock is taken
from the message with the shortest delay, so that one that waited in a buffer or a router is dated as old as it is.

Two messages are not in the dialect of the link to the ground: MAVLink common.xml. RC_CHANNELS (65): u32 time since boot [ms],
18 x u16 channel [us], u8 how many, u8 rssi; where ArduPilot overrides a channel it shows the override. RC_CHANNELS_OVERRIDE
(70): 8 x u16, u8 system, u8 component; channels 9 to 18 are extensions. On channels 1 to 8 a value of 0 releases and 65535
leaves a channel alone; on 9 to 18 0 leaves it alone too, so that a message without the extensions does not touch them (ArduPilot,
GCS_Common.cpp, handle_rc_channels_override).
"""

from collections import deque
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from struct import Struct
from typing import Protocol

from daq.contract.link.commands import DENIED, SET_MESSAGE_INTERVAL
from daq.transport.autopilot_requests import (
    AUTOPILOT,
    CLOCK_DRIFT,
    COMPONENT,
    REQUEST_AGAIN_NS,
    is_slow,
    least_loop_rate,
)
from daq.transport.mavlink_codec import FrameDecoder, FrameEncoder, MavlinkFrame, frames_of, padded
from daq.utilities.errors import UserError

RC_CHANNELS, RC_CHANNELS_OVERRIDE = 65, 70
RELEASE, LEAVE = 0, 65535
OVERRIDDEN_CHANNELS = 8  # those on which 0 releases
_CHANNELS = Struct("<I18HBB")
_OVERRIDE = Struct("<8HBB")
_ABSENT = (0, 65535)


@dataclass(frozen=True, slots=True)
class Channels:
    """The pilot's channels as the autopilot uses them: the receiver's, or the overrides.

    sampled_ns: when they were sampled, on our clock. widths: channel number -> pulse width [us]; absent channels are left out.
    """

    sampled_ns: int
    widths: Mapping[int, float]


def read_channels(payload: bytes) -> tuple[int, dict[int, float]]:
    """Time since boot [ms] and widths [us] of an RC_CHANNELS."""
    boot_ms, *widths, count, _ = _CHANNELS.unpack(padded(payload, _CHANNELS.size))
    return boot_ms, {i + 1: float(w) for i, w in enumerate(widths[: min(count, 18)]) if w not in _ABSENT}


def override_payload(values: Mapping[int, int], system: int) -> bytes:
    """An RC_CHANNELS_OVERRIDE to the autopilot of this system id; channels not in `values` are left alone."""
    widths = [values.get(channel, LEAVE) for channel in range(1, OVERRIDDEN_CHANNELS + 1)]
    return _OVERRIDE.pack(*widths, system, 1)


_READ_BYTES = 4096  # more than arrives in a third of a second at 115200 baud
_REBOOT_MS = 1000  # time since boot that goes back by more is another boot, not a frame out of order
_RATE_MESSAGES = 25  # over which the rate is taken: half a second at 50 Hz
_FORGET_CHANNELS_NS = 10**9  # RC_CHANNELS older than this are replaced even by one dated earlier


class AutopilotPort(Protocol):
    """A port to an autopilot that never blocks: `daq.transport.ports`, or a simulated one."""

    def read(self, limit: int, /) -> bytes:
        """Bytes that have arrived, at most `limit`."""
        ...

    def write(self, data: bytes, /) -> int | None:
        """Send; how many bytes were taken."""
        ...


class AutopilotError(UserError):
    """An autopilot through which the sequencer cannot move the surfaces."""


@dataclass(frozen=True, slots=True)
class AutopilotHeartbeat:
    """A HEARTBEAT: arrival on our clock [ns], system id, MAV_AUTOPILOT, MAV_TYPE and custom mode."""

    time_ns: int
    system: int
    autopilot: int
    kind: int
    mode: int


class AutopilotLink:
    """system: our own system id; the autopilot accepts overrides from one id only (MAV_GCS_SYSID). rate_hz: wanted rate of
    RC_CHANNELS. names: parameters to request; of alternative names, in one tuple, one answer is enough."""

    def __init__(self, port: AutopilotPort, system: int, rate_hz: float, names: Iterable[tuple[str, ...]]) -> None:
        self._port = port
        self._encoder = FrameEncoder(system, COMPONENT)
        self._decoder = FrameDecoder()
        self._interval_us = round(1e6 / rate_hz)
        self._names = tuple(names)
        self._offset_ns: float | None = None  # our clock minus the autopilot's, by the message with the shortest delay
        self._offset_at_ns = self._boot_ms = 0
        self._requested_ns = -REQUEST_AGAIN_NS
        self._arrivals: deque[int] = deque(maxlen=_RATE_MESSAGES)
        self.heartbeat: AutopilotHeartbeat | None = None
        self.channels: Channels | None = None
        self.parameters: Mapping[str, float] = {}
        self.port_fault = ""
        self.refusal = ""
        """Why RC_CHANNELS does not come at the requested rate, with the remedy; empty where it does."""
        self._refusal_text = ""  # the autopilot's own STATUSTEXT on it

    # ---------------------------------------------------------------------------------------- received

    def poll(self, now_ns: int) -> None:
        """Process what has arrived, and request again what has not."""
        try:
            data = self._port.read(_READ_BYTES)
            self.port_fault = ""
        except OSError as error:
            self.port_fault = f"port cannot be read ({error.strerror or error})"
            return
        for frame in frames_of(self._decoder.feed(data)):
            if frame.component == AUTOPILOT:
                self._handle_frame(frame, now_ns)
        if self.heartbeat is not None and now_ns - self._requested_ns >= REQUEST_AGAIN_NS:
            self._request(now_ns)

    def request_parameters_anew(self) -> None:
        """Discard the parameters and request them again: somebody may have changed them."""
        self.parameters = {}
        self._requested_ns = -REQUEST_AGAIN_NS

    @property
    def missing(self) -> tuple[str, ...]:
        """Requested parameters that have not come yet."""
        return tuple(" or ".join(names) for names in self._unanswered())

    def _unanswered(self) -> list[tuple[str, ...]]:
        return [names for names in self._names if not any(name in self.parameters for name in names)]

    def rate_hz(self, now_ns: int) -> float:
        """Rate of RC_CHANNELS [Hz] over the last messages."""
        if len(self._arrivals) < 2:
            return 0.0
        return (len(self._arrivals) - 1) * 1e9 / max(now_ns - self._arrivals[0], 1)

    def _handle_frame(self, frame: MavlinkFrame, now_ns: int) -> None:
        if frame.msg_id == RC_CHANNELS:
            self._note_channels(frame, now_ns)
        elif frame.name == "HEARTBEAT":
            numbers = [_integer(frame, field) for field in ("autopilot", "type", "custom_mode")]
            self.heartbeat = AutopilotHeartbeat(now_ns, frame.system, *numbers)
        elif frame.name == "STATUSTEXT":
            text = str(frame.fields()["text"])
            self._refusal_text = text if f"message ID {RC_CHANNELS} " in text else self._refusal_text
        elif frame.name == "COMMAND_ACK" and _integer(frame, "command") == SET_MESSAGE_INTERVAL:
            self._note_interval_answer(_integer(frame, "result"))
        elif frame.name == "PARAM_VALUE":
            fields = frame.fields()
            value = fields["param_value"]
            if isinstance(value, float):
                self.parameters = {**self.parameters, str(fields["param_id"]): value}

    def _note_interval_answer(self, result: int) -> None:
        """The MAV_RESULT of SET_MESSAGE_INTERVAL."""
        if not result:
            self.refusal = self._refusal_text = ""
            return
        rate = 1e6 / self._interval_us
        cure = f"set SCHED_LOOP_RATE to {least_loop_rate(rate)} or more, 100 advised, and restart it"
        words = f" ({self._refusal_text})" if self._refusal_text else ""
        answer = "denied" if result == DENIED else f"not taken (MAV_RESULT {result})"
        self.refusal = f"RC_CHANNELS at {rate:.0f} Hz is {answer}{words}: {cure}"

    def _note_channels(self, frame: MavlinkFrame, now_ns: int) -> None:
        boot_ms, widths = read_channels(frame.payload)
        offset = now_ns - boot_ms * 1e6
        if self._offset_ns is None or boot_ms < self._boot_ms - _REBOOT_MS:
            self._offset_ns = offset
        else:
            drifted = self._offset_ns + CLOCK_DRIFT * (now_ns - self._offset_at_ns)
            self._offset_ns = min(offset, drifted)
        self._offset_at_ns, self._boot_ms = now_ns, boot_ms
        sampled = round(boot_ms * 1e6 + self._offset_ns)
        if (
            self.channels is None
            or sampled >= self.channels.sampled_ns
            or now_ns - self.channels.sampled_ns > _FORGET_CHANNELS_NS
        ):
            self.channels = Channels(sampled, widths)
            self._arrivals.append(now_ns)

    # ---------------------------------------------------------------------------------------- sent

    def override(self, values: Mapping[int, int]) -> bool:
        """Override channels [us], or release them (0); False before a heartbeat, or when the port does not accept the bytes."""
        if self.heartbeat is None:
            return False
        payload = override_payload(values, self.heartbeat.system)
        return self._send(self._encoder.frame(RC_CHANNELS_OVERRIDE, payload))

    def _request(self, now_ns: int) -> None:
        """Request RC_CHANNELS where it comes too seldom, and the parameters that have not come."""
        self._requested_ns = now_ns
        if self.heartbeat is None:
            return
        target = {"target_system": self.heartbeat.system, "target_component": AUTOPILOT}
        if is_slow(self.rate_hz(now_ns), self._interval_us):
            interval = {
                "command": SET_MESSAGE_INTERVAL,
                "param1": float(RC_CHANNELS),
                "param2": float(self._interval_us),
            }
            self._send(self._encoder.message("COMMAND_LONG", **target, **interval))
        for name in (name for names in self._unanswered() for name in names):
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


def _integer(frame: MavlinkFrame, field: str) -> int:
    value = frame.fields()[field]
    return value if isinstance(value, int) else 0
