"""A PX4 aeroplane in manual mode, as far as it decides whose sticks it flies by: COM_RC_IN_MODE.

From src/modules/manual_control/ManualControlSelector.cpp (isInputValid, updateWithNewInputSample) and its parameters:
0 receiver alone; 1 MANUAL_CONTROL alone; 2 whichever was chosen, the other when it has been silent for COM_RC_LOSS_T; 3 whichever
came first, until it is started anew; 4 none. Newer sources add 5 to 8, an order of precedence; of these 6: MANUAL_CONTROL as
long as it comes, then the receiver. Whatever is chosen is chosen for all axes and the throttle at once: nowhere is one added to
the other. Without any a failsafe flies (NAV_RCL_ACT); neutral sticks are a stand-in for it here. DO_SET_ACTUATOR (MAV_CMD 187)
reaches outputs with the function "peripheral via actuator set", and no surface.
"""

from collections.abc import Callable, Mapping

from firmware_sim.hardware.autopilots.frames import (
    COMMAND_ACK,
    COMMAND_LONG,
    HEARTBEAT,
    MANUAL_CONTROL,
    PARAM_REQUEST_READ,
    PARAM_VALUE,
    RC_CHANNELS,
    ReceivedFrame,
    text_of,
)
from firmware_sim.hardware.autopilots.looped import LEAST_US, MS, TRAVEL_US, TRIM_US, LoopedAutopilot

LOOP_NS = 4 * MS  # 250 Hz
RECEIVER, MAVLINK = "receiver", "mavlink"
PARAMETERS: Mapping[str, float] = {"COM_RC_IN_MODE": 3.0, "COM_RC_LOSS_T": 0.5}
_MANUAL = 1 << 16  # custom mode: main mode MANUAL
_SET_ACTUATOR = 187
_STREAM_LOOPS, _HEARTBEAT_LOOPS, _RECEIVER_LOOPS = 5, 250, 5
_REAL32 = 9

Sticks = tuple[float, float, float, float]
"""Roll, pitch, yaw -1 to 1, throttle 0 to 1."""


class Px4(LoopedAutopilot):
    """A Talker. receiver: channels 1 to 4 at a time [us] (roll, pitch, throttle, yaw), None while it is silent."""

    def __init__(
        self,
        receiver: Callable[[int], tuple[int, ...] | None],
        parameters: Mapping[str, float] | None = None,
        origin_ns: int = 0,
    ) -> None:
        super().__init__(LOOP_NS, origin_ns)
        self.parameters = {**PARAMETERS, **(parameters or {})}
        self.chosen: str | None = None
        """Whose sticks are flown by."""
        self.peripheral = 0.0
        self._receiver = receiver
        self._first: str | None = None
        self._newest: dict[str, tuple[int, Sticks]] = {}  # when each source came last, and what it said

    def loop(self, now_ns: int) -> None:
        """One turn."""
        channels = self._receiver(now_ns)
        if channels is not None and self.loops % _RECEIVER_LOOPS == 0:
            roll, pitch, throttle, yaw = channels[:4]
            travel = [(w - TRIM_US) / TRAVEL_US for w in (roll, pitch, yaw)]
            self._offer(RECEIVER, (travel[0], travel[1], travel[2], (throttle - 1000) / 1000), now_ns)
        for message in self.received(now_ns):
            self._handle_message(message, now_ns)
        if self.chosen is not None and not self._fresh(self.chosen, now_ns):
            self.chosen = None
        self._set_outputs(now_ns)
        if self.loops % _HEARTBEAT_LOOPS == 0:
            self.outward.send(self.packer.pack(HEARTBEAT, _MANUAL, 1, 12, 0x51, 4, 3), now_ns)
        if self.loops % _STREAM_LOOPS == 0 and channels is not None:
            boot_ms = (now_ns - self.origin_ns) // MS
            widths = (*channels, *(0,) * (18 - len(channels)))
            self.outward.send(self.packer.pack(RC_CHANNELS, boot_ms, *widths, len(channels), 255), now_ns)

    # ---------------------------------------------------------------------------------------- whose sticks

    def _offer(self, source: str, sticks: Sticks, now_ns: int) -> None:
        self._newest[source] = now_ns, sticks
        if self.chosen is not None and not self._fresh(self.chosen, now_ns):
            self.chosen = None
        if self._allowed(source, now_ns):
            self.chosen = source
            self._first = self._first or source

    def _fresh(self, source: str, now_ns: int) -> bool:
        came = self._newest.get(source)
        return came is not None and now_ns - came[0] < self.parameters["COM_RC_LOSS_T"] * 1e9

    def _allowed(self, source: str, now_ns: int) -> bool:
        mode = int(self.parameters["COM_RC_IN_MODE"])
        free = self.chosen in (None, source)
        return {
            0: source == RECEIVER,
            1: source == MAVLINK,
            2: free,
            3: self._first in (None, source),
            5: source == RECEIVER or free,
            6: source == MAVLINK or free,
        }.get(mode, False)

    def _set_outputs(self, now_ns: int) -> None:
        sticks = self._newest[self.chosen][1] if self.chosen is not None else (0.0, 0.0, 0.0, 0.0)
        surfaces = [TRIM_US + round(TRAVEL_US * s) for s in sticks[:3]]
        self.set_outputs(surfaces, LEAST_US + round(1000 * sticks[3]), now_ns)

    # ---------------------------------------------------------------------------------------- messages

    def _handle_message(self, message: ReceivedFrame, now_ns: int) -> None:
        f = message.fields
        if message.number == MANUAL_CONTROL.number:
            pitch, roll, throttle, yaw = (float(v) / 1000.0 for v in f[:4])
            self._offer(MAVLINK, (roll, pitch, yaw, throttle), now_ns)
        elif message.number == PARAM_REQUEST_READ.number and text_of(f[3]) in self.parameters:
            name = text_of(f[3])
            fields = (self.parameters[name], len(self.parameters), 65535, name.encode(), _REAL32)
            self.outward.send(self.packer.pack(PARAM_VALUE, *fields), now_ns)
        elif message.number == COMMAND_LONG.number:
            if int(f[7]) == _SET_ACTUATOR:
                self.peripheral = float(f[0])
            result = 0 if int(f[7]) == _SET_ACTUATOR else 3
            self.outward.send(self.packer.pack(COMMAND_ACK, int(f[7]), result), now_ns)
