"""An ArduPlane with elevons and rudder on a serial line: its loop, mixing, failsafe, streams and commands.

The order within a loop is that of ArduPlane's scheduler: servos are set from earlier readings, then the receiver is read, ten
times a second the switches, and then messages are processed and sent. A message therefore reaches the servos two loops after the
one that processes it. After ArduPlane 4.5 (radio.cpp, mode_manual.cpp, system.cpp; RC_Channel as in `rc_input`):

* In MANUAL (0) sticks move the surfaces directly. In other modes they are commands to a controller, for which a third of the
  deflection stands in here. HEARTBEAT is sent once a second and whenever the mode changes.
* Overrides count as a working receiver (Plane::read_radio), so that its loss is not detected while they come. Without either,
  roll, pitch and yaw go to trim after 1 s, and the mode becomes CIRCLE (1) after 1.5 s.
* RC_CHANNELS_OVERRIDE is accepted only from the system id in MAV_GCS_SYSID (SYSID_MYGCS before 4.7). DO_SET_SERVO fails on an
  output with a function (AP_ServoRelayEvents::do_set_servo). SET_MESSAGE_INTERVAL sets a stream's interval in whole milliseconds;
  where 0.8 of it is shorter than a loop (cap_message_interval) it is DENIED with a STATUSTEXT.
"""

from collections.abc import Callable, Mapping

from firmware_sim.hardware.autopilots.frames import (
    COMMAND_ACK,
    COMMAND_LONG,
    HEARTBEAT,
    PARAM_REQUEST_READ,
    PARAM_SET,
    PARAM_VALUE,
    RC_CHANNELS,
    RC_CHANNELS_OVERRIDE,
    SERVO_OUTPUT_RAW,
    STATUSTEXT,
    ReceivedFrame,
    text_of,
)
from firmware_sim.hardware.autopilots.looped import LEAST_US, MS, TRAVEL_US, TRIM_US, LoopedAutopilot
from firmware_sim.hardware.autopilots.rc_input import CHANNELS, RcInput

RECEIVER_NS, RECEIVER_PHASE_NS = 22 * MS, 3 * MS  # period of the receiver's frames, and delay of the first
SILENT_NS, SHORT_FAILSAFE_NS = 1000 * MS, 1500 * MS
THROTTLE_FAILSAFE_US = 950
MANUAL, CIRCLE = 0, 1  # custom modes
STAND_IN = 1.0 / 3.0  # gain of the sticks in modes with a controller
OUTPUTS = 4
_SET_SERVO, _SET_MESSAGE_INTERVAL = 183, 511
_ACCEPTED, _DENIED, _UNSUPPORTED, _FAILED = 0, 2, 3, 4
_REAL32 = 9  # MAV_PARAM_TYPE_REAL32

PARAMETERS: Mapping[str, float] = {
    "RC_OVERRIDE_TIME": 0.1,
    "RC_OPTIONS": 32.0,
    "SYSID_MYGCS": 255.0,
    "RC5_OPTION": 46.0,
    "SERVO1_FUNCTION": 77.0,  # elevon left, elevon right, rudder, throttle
    "SERVO2_FUNCTION": 78.0,
    "SERVO3_FUNCTION": 21.0,
    "SERVO4_FUNCTION": 70.0,
    "MIXING_GAIN": 1.0,
    "SCHED_LOOP_RATE": 100.0,
}
"""The parameters that docs/sequencer.md asks for."""


class ArduPlane(LoopedAutopilot):
    """A `Talker`. receiver: time [ns] -> the pilot's eight channels [us], None while it is silent. parameters: in addition to
    PARAMETERS, or instead."""

    def __init__(
        self,
        receiver: Callable[[int], tuple[int, ...] | None],
        parameters: Mapping[str, float] | None = None,
        origin_ns: int = 0,
    ) -> None:
        self.parameters = {**PARAMETERS, **(parameters or {})}
        self._loop_hz = round(self.parameters["SCHED_LOOP_RATE"])
        super().__init__(round(1e9 / self._loop_hz), origin_ns)
        self.rc = RcInput(self.parameters)
        self.mode = MANUAL
        self._receiver = receiver
        self._last_frame = (origin_ns - RECEIVER_PHASE_NS) // RECEIVER_NS
        self._valid_ns = origin_ns  # when the receiver last counted as working
        self._streams: dict[int, tuple[int, int]] = {}  # message number -> interval and next time [ns]

    # ---------------------------------------------------------------------------------------- mode

    def set_mode(self, mode: int, now_ns: int) -> None:
        """Change the mode, as a switch, a command or the failsafe does."""
        if mode != self.mode:
            self.mode = mode
            self._send_heartbeat(now_ns)

    # ---------------------------------------------------------------------------------------- a loop

    def loop(self, now_ns: int) -> None:
        """Run the loop once."""
        self._set_servos(now_ns)
        self._read_radio(now_ns)
        if self.loops % (self._loop_hz // 10) == 0:
            self.rc.read_switch(now_ns)
        for message in self.received(now_ns):
            self._handle_message(message, now_ns)
        if self.loops % self._loop_hz == 0:
            self._send_heartbeat(now_ns)
        for number, (interval, due) in self._streams.items():
            if now_ns >= due:
                self._streams[number] = interval, max(due + interval, now_ns)
                self._send_stream(number, now_ns)

    def _set_servos(self, now_ns: int) -> None:
        roll, pitch, throttle, yaw = self.rc.widths[:4]
        gain = self.parameters["MIXING_GAIN"] * (1.0 if self.mode == MANUAL else STAND_IN)
        aileron, elevator, rudder = (gain * _travel(w) for w in (roll, pitch, yaw))
        deflections = (elevator - aileron, elevator + aileron, rudder)
        surfaces = [TRIM_US + round(min(max(w, -TRAVEL_US), TRAVEL_US)) for w in deflections]
        self.set_outputs(surfaces, throttle or LEAST_US, now_ns)

    def _read_radio(self, now_ns: int) -> None:
        number = (now_ns - RECEIVER_PHASE_NS) // RECEIVER_NS
        frame = None
        if number > self._last_frame:
            self._last_frame = number
            frame = self._receiver(number * RECEIVER_NS + RECEIVER_PHASE_NS)
        if self.rc.read(frame, now_ns) and self.rc.widths[2] > THROTTLE_FAILSAFE_US:
            self._valid_ns = now_ns
        if now_ns - self._valid_ns > SILENT_NS:
            for i in (0, 1, 3):
                self.rc.widths[i] = TRIM_US
        if now_ns - self._valid_ns > SHORT_FAILSAFE_NS and self.mode == MANUAL:
            self.set_mode(CIRCLE, now_ns)

    # ---------------------------------------------------------------------------------------- messages

    def _handle_message(self, message: ReceivedFrame, now_ns: int) -> None:
        f = message.fields
        if message.number == RC_CHANNELS_OVERRIDE.number:
            if message.system == self._ground_system():
                self.rc.override(tuple(int(v) for v in f[:CHANNELS]), now_ns)
        elif message.number == PARAM_REQUEST_READ.number:
            self._send_parameter(text_of(f[3]), now_ns)
        elif message.number == PARAM_SET.number:
            name = text_of(f[3])
            if name in self.parameters:
                self.parameters[name] = float(f[0])
            self._send_parameter(name, now_ns)
        elif message.number == COMMAND_LONG.number:
            result = self._command(int(f[7]), [float(v) for v in f[:7]], now_ns)
            self._send(self.packer.pack(COMMAND_ACK, int(f[7]), result), now_ns)

    def _ground_system(self) -> float:
        return self.parameters.get("MAV_GCS_SYSID", self.parameters.get("SYSID_MYGCS", 255.0))

    def _command(self, command: int, values: list[float], now_ns: int) -> int:
        if command == _SET_MESSAGE_INTERVAL and int(values[0]) in (RC_CHANNELS.number, SERVO_OUTPUT_RAW.number):
            return self._set_interval(int(values[0]), int(values[1] / 1000), now_ns)
        if command == _SET_SERVO:
            return _FAILED if self.parameters.get(f"SERVO{int(values[0])}_FUNCTION", 0.0) else _ACCEPTED
        return _UNSUPPORTED

    def _set_interval(self, number: int, interval_ms: int, now_ns: int) -> int:
        if interval_ms * 800 < 1e6 / self._loop_hz:
            words = f"Requested rate for message ID {number} too fast. Increase SCHED_LOOP_RATE"
            self._send(self.packer.pack(STATUSTEXT, 4, words.encode()[:50]), now_ns)
            return _DENIED
        self._streams[number] = interval_ms * MS, now_ns
        return _ACCEPTED

    def _send_parameter(self, name: str, now_ns: int) -> None:
        if name in self.parameters:
            fields = (self.parameters[name], len(self.parameters), 65535, name.encode(), _REAL32)
            self._send(self.packer.pack(PARAM_VALUE, *fields), now_ns)

    def _send_heartbeat(self, now_ns: int) -> None:
        self._send(self.packer.pack(HEARTBEAT, self.mode, 1, 3, 0x51, 4, 3), now_ns)

    def _send_stream(self, number: int, now_ns: int) -> None:
        if number == RC_CHANNELS.number:
            boot_ms = (now_ns - self.origin_ns) // MS
            widths = (*self.rc.widths, *(0,) * (18 - CHANNELS))
            self._send(self.packer.pack(RC_CHANNELS, boot_ms, *widths, 16, 255), now_ns)
        else:
            boot_us = (now_ns - self.origin_ns) // 1000 & 0xFFFFFFFF
            outputs = (*self.newest_us, *(0,) * (8 - OUTPUTS))
            self._send(self.packer.pack(SERVO_OUTPUT_RAW, boot_us, *outputs, 0), now_ns)

    def _send(self, data: bytes, now_ns: int) -> None:
        self.outward.send(data, now_ns)


def _travel(width: int) -> float:
    """Travel of a stick about trim [us]; a channel that was never read is at trim."""
    return float(min(max(width - TRIM_US, -TRAVEL_US), TRAVEL_US)) if width else 0.0
