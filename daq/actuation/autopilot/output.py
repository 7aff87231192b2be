"""Through an ArduPlane: what it must be before anything is overridden, and RC_CHANNELS_OVERRIDE on the channels of the surfaces.

By ArduPilot's source: overrides are taken from MAV_GCS_SYSID (SYSID_MYGCS before 4.7) alone (GCS_Common.cpp,
handle_rc_channels_override), for RC_OVERRIDE_TIME seconds each, 0 never and negative for ever (RC_Channel.cpp, has_override);
not with bit 1 of RC_OPTIONS, and with bit 0 the receiver is not listened to (RC_Channel::update). A switch with RCn_OPTION 46
refuses and clears them at low, takes them at high (do_aux_function_rc_override_enable). Sticks go straight to the
surfaces in MANUAL alone (mode_manual.cpp).

While a channel is overridden RC_CHANNELS shows the override, so the stick behind it cannot be seen: what tells the pilot's
hand then are the switch and the channels that are never overridden, the throttle above all. When nothing is put out any more,
0 is sent on every channel for RELEASES frames; if those are lost too, silence ends the override after RC_OVERRIDE_TIME.
"""

import math

from daq.actuation.autopilot.link import RELEASE, AutopilotLink, AutopilotPort
from daq.actuation.autopilot.proof import OverrideProof
from daq.actuation.config import LEAST_RATE_HZ, PX4_WORDS, AutopilotConfig, SequencerConfig
from daq.actuation.output import OutputObservation, SequencerCommand
from daq.contract.scan import Scan
from daq.contract.sequencing import State, switch_position

ARDUPILOT, PX4 = 3, 12
FIXED_WING = 1
MANUAL = 0
RC_OVERRIDE_ENABLE = 46
IGNORE_RECEIVER, IGNORE_OVERRIDES = 1 << 0, 1 << 1
SILENT_NS = 3_000_000_000
"""HEARTBEAT comes once a second, and at once when the mode changes (ArduPlane, system.cpp, Plane::set_mode)."""
SHORTEST_S = 0.06
"""Overrides that lapse between two frames of 20 ms, one of them lost, would let the surfaces jump."""
_GCS_NAMES = ("MAV_GCS_SYSID", "SYSID_MYGCS")


def wanted_parameters(config: AutopilotConfig) -> tuple[tuple[str, ...], ...]:
    """Names to ask for; of a tuple one."""
    return (("RC_OVERRIDE_TIME",), ("RC_OPTIONS",), _GCS_NAMES, (_switch_option(config),))


def _switch_option(config: AutopilotConfig) -> str:
    return f"RC{config.switch_channel}_OPTION"


def unmet(link: AutopilotLink, config: AutopilotConfig, now_ns: int, stale_ns: int) -> str:
    """The first demand that is not met, in words with what to do; empty when all are."""
    if link.port_fault:
        return link.port_fault
    heartbeat = link.heartbeat
    if heartbeat is None or now_ns - heartbeat.time_ns > SILENT_NS:
        return f"autopilot on {config.port} is silent; check wiring, baud rate and MAVLink 2 (SERIALn_PROTOCOL 2)"
    if heartbeat.autopilot == PX4:
        return PX4_WORDS
    if heartbeat.autopilot != ARDUPILOT or heartbeat.kind != FIXED_WING:
        return f"not an ArduPlane of fixed wing (MAV_AUTOPILOT {heartbeat.autopilot}, MAV_TYPE {heartbeat.kind})"
    return (
        wrong_parameter(link, config) or _wrong_mode(heartbeat.mode) or _stale_channels(link, config, now_ns, stale_ns)
    )


def wrong_parameter(link: AutopilotLink, config: AutopilotConfig) -> str:
    """The first parameter that is not known or not as it must be."""
    if link.missing:
        return f"autopilot has not told {', '.join(link.missing)}"
    parameters = link.parameters
    lasts, options = parameters["RC_OVERRIDE_TIME"], int(parameters["RC_OPTIONS"])
    longest = config.longest_override_s
    if not SHORTEST_S <= lasts <= longest + 1e-4:  # a parameter is a float32
        return f"RC_OVERRIDE_TIME is {lasts:g} s; set it to {longest:g}, at least {SHORTEST_S:g}"
    if options & IGNORE_OVERRIDES:
        return "RC_OPTIONS bit 1 is set: overrides are ignored; clear it"
    if options & IGNORE_RECEIVER:
        return "RC_OPTIONS bit 0 is set: the receiver is ignored; clear it"
    name = next(n for n in _GCS_NAMES if n in parameters)
    if parameters[name] != config.system_id:
        return f"{name} is {parameters[name]:g}: overrides of {config.system_id} are not taken; set sequencer.autopilot.system_id"
    option = _switch_option(config)
    if parameters[option] != RC_OVERRIDE_ENABLE:
        return f"{option} is {parameters[option]:g}; set it to {RC_OVERRIDE_ENABLE}, so that the switch stops overrides by itself"
    return ""


def _wrong_mode(mode: int) -> str:
    return "" if mode == MANUAL else f"autopilot is in mode {mode}; surfaces follow the sticks in MANUAL (0) alone"


def _stale_channels(link: AutopilotLink, config: AutopilotConfig, now_ns: int, stale_ns: int) -> str:
    if link.channels is None or now_ns - link.channels.sampled_ns > stale_ns:
        return link.refusal or f"no RC_CHANNELS for {stale_ns * 1e-6:.0f} ms"
    absent = [n for n in (config.switch_channel, *config.watch) if n not in link.channels.widths]
    return f"RC_CHANNELS shows no channel {absent[0]}" if absent else ""


RELEASES = 5
"""Frames, 0.1 s: four of them may be lost."""
LINGERS_NS = 80_000_000
"""After it has lapsed it is still shown for so long: the receiver's next frame, two loops of 20 ms, and one to spare."""


class ArduPilotOutput:
    """config: with `[sequencer.autopilot]`. port: to the autopilot, nobody else reading it."""

    def __init__(self, config: SequencerConfig, port: AutopilotPort) -> None:
        self._config = config.autopilot
        self._outputs = tuple(config.output.values())
        self._stale_ns = round(config.limits.stale_ms * 1e6)
        names = wanted_parameters(self._config)
        self.link = AutopilotLink(port, self._config.system_id, LEAST_RATE_HZ, names)
        self.proof = OverrideProof(self._config.longest_override_s)
        self._overridden_ns: int | None = None  # when an override was sent last
        self._releases = 0
        self._asked_in = State.IDLE

    def observe(self, scan: Scan, now_ns: int) -> OutputObservation:
        """RC_CHANNELS, and what is wrong with the autopilot."""
        self.link.poll(now_ns)
        channels = self.link.channels
        fault = unmet(self.link, self._config, now_ns, self._stale_ns)
        if channels is None or now_ns - channels.sampled_ns > self._stale_ns:
            return OutputObservation(fault=fault, readback=(None,) * len(self._outputs))
        widths = channels.widths
        readback = tuple(widths.get(o.channel) for o in self._outputs)
        sticks = tuple(w for w in readback if w is not None)
        hidden = self._hidden(channels.sampled_ns)
        return OutputObservation(
            switch=switch_position(widths.get(self._config.switch_channel)),
            pilot=sticks if len(sticks) == len(readback) and not hidden else None,
            hidden=hidden,
            watched=tuple(widths.get(n, 0.0) for n in self._config.watch),
            fault=fault,
            readback=readback,
        )

    def _hidden(self, sampled_ns: int) -> bool:
        if self._overridden_ns is None:
            return False
        return sampled_ns - self._overridden_ns <= round(self._config.longest_override_s * 1e9) + LINGERS_NS

    def apply(self, command: SequencerCommand, now_ns: int) -> tuple[float, ...] | None:
        """Override, or release for some frames after the last override."""
        if command.state is State.IDLE and self._asked_in is not State.IDLE:
            self.link.request_parameters_anew()  # somebody may change parameters between two manoeuvres
        self._asked_in = command.state
        if command.state.beats and command.pulses is not None:
            return self._override(command.pulses, now_ns)
        if self._releases and not self.proof.silent:
            self._releases -= 1
            self._release()
        return None

    def _override(self, pulses: tuple[float, ...], now_ns: int) -> tuple[float, ...] | None:
        widths = [
            min(max(round(p), math.ceil(o.lowest_us)), math.floor(o.highest_us))
            for p, o in zip(pulses, self._outputs, strict=True)
        ]
        if not self.link.override({o.channel: w for o, w in zip(self._outputs, widths, strict=True)}):
            return None
        self._overridden_ns, self._releases = now_ns, RELEASES
        return tuple(float(w) for w in widths)

    def _release(self) -> None:
        self.link.override(dict.fromkeys((o.channel for o in self._outputs), RELEASE))

    def close(self, now_ns: int) -> None:
        """Release at the end; silence does the rest."""
        if self._releases:
            self._releases = 0
            self._release()
