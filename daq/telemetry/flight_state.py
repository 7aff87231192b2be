"""Whether the aircraft may be flying, judged from raw scans alone: the guard of commands meant for the ground."""

from collections.abc import Sequence

from daq.contract.scan import Scan
from daq.sensors.standstill import pitot_unrest, unrest


def flight_evidence(scans: Sequence[Scan]) -> str | None:
    """Why the aircraft may not be standing still, in words; None when nothing speaks for motion.

    Too little data speaks for motion: a command that must not act in flight then does nothing.
    """
    pitot = [s.values["pitot_pressure"] for s in scans if "pitot_pressure" in s.values]
    without_imu = not any("gyro_x" in s.values for s in scans)
    return (unrest(scans) if scans else None) or pitot_unrest(pitot, level_tells=without_imu)
