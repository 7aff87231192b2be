"""Which trial an output needs before a flight."""

from collections.abc import Callable, Iterator

from daq.actuation.autopilot.trial import AutopilotTrial
from daq.actuation.config import SequencerConfig
from daq.actuation.devices import Devices
from daq.actuation.finding import TrialFinding
from daq.actuation.pwm.trial import Trial
from daq.contract.scan import Scan


def findings(config: SequencerConfig, devices: Devices, take_scan: Callable[[], Scan]) -> Iterator[TrialFinding]:
    """Try the configured output; take_scan: one scan of the aircraft's sensors, now."""
    if config.through == "ardupilot":
        if devices.autopilot is None:
            return iter([TrialFinding("sequencer", False, "no port to the autopilot is open; set sequencer.autopilot")])
        return AutopilotTrial(config, devices.autopilot, devices.clock, take_scan).findings()
    if devices.bus is None or devices.heartbeat is None:
        words = "no bus or heartbeat line is open; set sequencer.heartbeat"
        return iter([TrialFinding("sequencer", False, words)])
    return Trial(config, devices.bus, devices.heartbeat, devices.clock, take_scan).findings()
