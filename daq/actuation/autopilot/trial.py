"""An autopilot tried out before a flight, the switch at off: who it is, its parameters and mode, its stream, and that it refuses.

That an override is taken, lapses and is released is tried in the air, each time the switch goes to go (`proof`): at off the
autopilot's own gate has to refuse it, and that is tried here.
"""

from collections.abc import Callable, Iterator

from daq.actuation.autopilot.link import AutopilotPort
from daq.actuation.autopilot.output import ArduPilotOutput, unmet, wrong_parameter
from daq.actuation.autopilot.proof import PROBE_US, REFUSAL_S
from daq.actuation.config import LEAST_RATE_HZ, SequencerConfig
from daq.actuation.output import OutputObservation
from daq.actuation.servos import TrialFinding, try_manoeuvre
from daq.clock import Clock
from daq.contract.scan import Scan
from daq.contract.sequencing import Switch
from daq.sensors.base import MS

PERIOD_NS = 20 * MS
LISTEN_FRAMES = 100
"""2 s: a HEARTBEAT comes once a second, and what is asked for after it within another third."""


class AutopilotTrial:
    """take_scan: one scan of the aircraft's sensors, now."""

    def __init__(
        self, config: SequencerConfig, port: AutopilotPort, clock: Clock, take_scan: Callable[[], Scan]
    ) -> None:
        self._config, self._clock, self._take_scan = config, clock, take_scan
        self._output = ArduPilotOutput(config, port)
        self._stale_ns = round(config.limits.stale_ms * MS)

    def findings(self) -> Iterator[TrialFinding]:
        """Everything, in order; what depends on a thing that fails is left out."""
        yield try_manoeuvre(self._config)
        link, autopilot = self._output.link, self._config.autopilot
        for _ in range(LISTEN_FRAMES):
            glimpse = self._frame()
        if link.heartbeat is not None and not link.missing:
            mistake = wrong_parameter(link, autopilot)
            listing = ", ".join(f"{name} {value:g}" for name, value in sorted(link.parameters.items()))
            yield TrialFinding("parameters", not mistake, mistake or listing)
        fault = unmet(link, autopilot, self._clock.monotonic_ns(), self._stale_ns)
        yield TrialFinding("autopilot", not fault, fault or "an ArduPlane in MANUAL")
        if fault:
            return
        yield self._rate()
        switch = self._switch(glimpse)
        yield switch
        if switch.well:
            yield self._refusal()

    def _frame(self) -> OutputObservation:
        start = self._clock.monotonic_ns()
        scan = self._take_scan()
        glimpse = self._output.observe(scan, self._clock.monotonic_ns())
        self._clock.sleep_until(start + PERIOD_NS)
        return glimpse

    def _rate(self) -> TrialFinding:
        rate = self._output.link.rate_hz(self._clock.monotonic_ns())
        if rate < 0.9 * LEAST_RATE_HZ:
            cure = self._output.link.refusal or f"raise baud rate or SRn_RC_CHAN to {LEAST_RATE_HZ:.0f}"
            words = f"RC_CHANNELS comes {rate:.0f} times a second; {cure}"
            return TrialFinding("autopilot stream", False, words)
        return TrialFinding("autopilot stream", True, f"RC_CHANNELS {rate:.0f} times a second")

    def _switch(self, glimpse: OutputObservation) -> TrialFinding:
        if glimpse.pilot is None:
            return TrialFinding(
                "pilot's signals", False, "a stick's channel is not in RC_CHANNELS; is the transmitter on?"
            )
        if glimpse.switch is not Switch.OFF:
            return TrialFinding("pilot's signals", False, f"switch is at {glimpse.switch.name.lower()}; put it to off")
        return TrialFinding("pilot's signals", True, "all there, switch at off")

    def _refusal(self) -> TrialFinding:
        outputs = list(self._config.output.values())
        sticks = self._frame().pilot or ()
        probe = {o.channel: round(w) + PROBE_US for o, w in zip(outputs, sticks, strict=True)}
        accepted = False
        end_ns = self._clock.monotonic_ns() + round(REFUSAL_S * 1e9)
        while self._clock.monotonic_ns() < end_ns:
            self._output.link.override(probe)
            channels = dict(zip(probe, self._frame().readback, strict=True))
            accepted = accepted or all(channels[channel] == width for channel, width in probe.items())
        self._output.link.override(dict.fromkeys(probe, 0))
        if accepted:
            words = "takes overrides though the switch is at off; is its channel the one with RCn_OPTION 46?"
            return TrialFinding("override gate", False, words)
        return TrialFinding("override gate", True, "at off the autopilot refuses overrides")
