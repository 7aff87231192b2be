"""Trial of the sequencer's hardware before a flight, with the switch at off: servo driver, pilot's signals, heartbeat and
multiplexer.

Meanwhile the driver sends no pulses to the servos, so that a multiplexer which wrongly selects it shows by servo pulses that are
not the pilot's.
"""

from collections.abc import Callable, Iterator
from statistics import fmean

from daq.actuation.config import SequencerConfig
from daq.actuation.pwm.heartbeat import HeartbeatLine
from daq.actuation.pwm.output import US_PER_COUNT, PilotInputs, PilotSignals, ServoDriver
from daq.actuation.servos import TrialFinding, try_manoeuvre
from daq.clock import Clock
from daq.contract.scan import Scan
from daq.contract.sequencing import Switch
from daq.sensors.base import MS
from daq.sensors.bus import I2cBus

TRIAL_FRAMES = 40
"""0.8 s at 50 Hz; only the second half is judged."""
HEARTBEAT_END_MS = 250
"""Wait for the monostable to end (100 ms) and the co-processor to drop the last pulses (50 ms), with 100 ms to spare."""
PASS_THROUGH_US = 25.0
"""Largest difference of the pilot's pulses before and behind the multiplexer: two captures with 10 us of jitter each, and
rounding."""


class ServoDriverTrial:
    """take_scan: samples the aircraft's sensors once, now."""

    def __init__(
        self,
        config: SequencerConfig,
        bus: I2cBus,
        heartbeat: HeartbeatLine,
        clock: Clock,
        take_scan: Callable[[], Scan],
    ) -> None:
        self._config, self._heartbeat, self._clock, self._take_scan = config, heartbeat, clock, take_scan
        self._driver = ServoDriver(config, bus)
        inputs = [o.pilot_input for o in config.output.values()]
        self._pilot = PilotInputs(config.pilot, inputs, bus, clock.monotonic_ns, 100 * MS)

    def findings(self) -> Iterator[TrialFinding]:
        """All findings, in order, without those that depend on a failed one. Releases the heartbeat at the end."""
        yield try_manoeuvre(self._config)
        try:
            beating = [self._frame(beat=True) for _ in range(TRIAL_FRAMES)][TRIAL_FRAMES // 2 :]
        except OSError as error:
            yield TrialFinding("heartbeat", False, f"line cannot be written ({error.strerror or error})")
            return
        finally:
            self._release()
        yield self._chip()
        yield self._switch(beating)
        if not self._driver.part.up or beating[-1][0].sticks is None:
            return
        yield self._frequency(beating)
        yield self._multiplexer(beating)
        yield self._gate()

    def _frame(self, *, beat: bool) -> tuple[PilotSignals, Scan]:
        clock = self._clock
        start = clock.monotonic_ns()
        scan = self._take_scan()
        signals = self._pilot.poll(clock.monotonic_ns())
        fault = self._driver.fault(clock.monotonic_ns(), running=False)
        if beat and not fault and self._driver.write(None, 1.0, clock.monotonic_ns()):
            self._heartbeat.beat()
        clock.sleep_until(start + 20 * MS)
        return signals, scan

    def _release(self) -> None:
        try:
            self._heartbeat.release()
        except OSError:
            return  # reported by `findings` already; the monostable ends by itself

    def _chip(self) -> TrialFinding:
        if not self._driver.part.up:
            return TrialFinding("servo driver", False, f"{self._driver.part.fault}; check wiring, strap and supply")
        return TrialFinding(
            "servo driver", True, f"answers at 0x{self._config.chip.address:02x} and keeps its settings"
        )

    def _switch(self, frames: list[tuple[PilotSignals, Scan]]) -> TrialFinding:
        signals = frames[-1][0]
        if signals.sticks is None:
            reason = self._pilot.part.fault or "no pulses on an input; is the transmitter on?"
            return TrialFinding("pilot's signals", False, reason)
        if signals.switch is not Switch.OFF:
            return TrialFinding("pilot's signals", False, f"switch is at {signals.switch.name.lower()}; put it to off")
        return TrialFinding("pilot's signals", True, "all there, switch at off")

    def _frequency(self, frames: list[tuple[PilotSignals, Scan]]) -> TrialFinding:
        pulses = [s.loopback_us for s, _ in frames if s.loopback_us is not None]
        if len(pulses) < len(frames) // 2:
            return TrialFinding(
                "output frequency", False, "no pulses come back on the loopback; check its wire, OE and heartbeat"
            )
        error = self._driver.loopback_us / fmean(pulses) - 1.0
        limit = self._config.limits.frequency_error
        text = f"{100 * error:+.2f} % off (limit {100 * limit:g} %)"
        advice = "" if abs(error) <= limit else "; set sequencer.chip.oscillator_hz to what is measured"
        return TrialFinding("output frequency", abs(error) <= limit, text + advice)

    def _multiplexer(self, frames: list[tuple[PilotSignals, Scan]]) -> TrialFinding:
        largest_error = 0.0
        for index, (name, output) in enumerate(self._config.output.items()):
            if not output.readback:
                continue
            pairs = [
                (s.sticks[index], scan.values[f"pwm_{output.readback}"] * US_PER_COUNT)
                for s, scan in frames
                if s.sticks is not None and f"pwm_{output.readback}" in scan.values
            ]
            if not pairs:
                return TrialFinding("multiplexer", False, f"no pulses of {name} behind it, though the switch is at off")
            largest_error = max(largest_error, abs(fmean(a for a, _ in pairs) - fmean(b for _, b in pairs)))
        if largest_error > PASS_THROUGH_US:
            return TrialFinding(
                "multiplexer",
                False,
                f"servo pulses are {largest_error:.0f} us off the pilot's, though his switch is at off",
            )
        return TrialFinding("multiplexer", True, f"passes the pilot's signals, within {largest_error:.0f} us")

    def _gate(self) -> TrialFinding:
        """Without a heartbeat the driver's outputs must be off."""
        end_ns = self._clock.monotonic_ns() + HEARTBEAT_END_MS * MS
        signals, _ = self._frame(beat=False)
        while self._clock.monotonic_ns() < end_ns:
            signals, _ = self._frame(beat=False)
        if signals.loopback_us is not None:
            return TrialFinding(
                "heartbeat", False, "servo driver goes on without it: OE is not wired to the monostable"
            )
        return TrialFinding("heartbeat", True, "without it the servo driver is dead")
