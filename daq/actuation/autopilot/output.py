"""Through an ArduPlane: RC_CHANNELS_OVERRIDE on the channels of the surfaces, only while something is put out.

While a channel is overridden RC_CHANNELS shows the override, so the stick behind it cannot be seen: what tells the pilot's
hand then are the switch and the channels that are never overridden, the throttle above all. When nothing is put out any more,
0 is sent on every channel for RELEASES frames; if those are lost too, silence ends the override after RC_OVERRIDE_TIME.
"""

import math

from daq.actuation.autopilot.demands import unmet, wanted_parameters
from daq.actuation.autopilot.link import AutopilotLink
from daq.actuation.autopilot.messages import RELEASE
from daq.actuation.autopilot.proof import OverrideProof
from daq.actuation.config import LEAST_RATE_HZ, SequencerConfig
from daq.actuation.devices import AutopilotPort
from daq.actuation.seen import Glimpse
from daq.actuation.sequencer import SequencerCommand
from daq.contract.scan import Scan
from daq.contract.sequencing import State, switch_position

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

    def look(self, scan: Scan, now_ns: int) -> Glimpse:
        """RC_CHANNELS, and what is wrong with the autopilot."""
        self.link.poll(now_ns)
        channels = self.link.channels
        fault = unmet(self.link, self._config, now_ns, self._stale_ns)
        if channels is None or now_ns - channels.sampled_ns > self._stale_ns:
            return Glimpse(fault=fault, readback=(None,) * len(self._outputs))
        widths = channels.widths
        shown = tuple(widths.get(o.channel) for o in self._outputs)
        known = tuple(w for w in shown if w is not None)
        hidden = self._hidden(channels.sampled_ns)
        return Glimpse(
            switch=switch_position(widths.get(self._config.switch_channel)),
            pilot=known if len(known) == len(shown) and not hidden else None,
            hidden=hidden,
            watched=tuple(widths.get(n, 0.0) for n in self._config.watch),
            fault=fault,
            readback=shown,
        )

    def _hidden(self, sampled_ns: int) -> bool:
        if self._overridden_ns is None:
            return False
        return sampled_ns - self._overridden_ns <= round(self._config.longest_override_s * 1e9) + LINGERS_NS

    def put(self, frame: SequencerCommand, now_ns: int) -> tuple[float, ...] | None:
        """Override, or release for some frames after the last override."""
        if frame.state is State.IDLE and self._asked_in is not State.IDLE:
            self.link.forget()  # somebody may change parameters between two manoeuvres
        self._asked_in = frame.state
        if frame.state.beats and frame.pulses is not None:
            return self._override(frame.pulses, now_ns)
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
