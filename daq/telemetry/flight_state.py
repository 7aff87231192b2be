"""Whether the aircraft may be flying, judged from raw scans alone: the guard of commands meant for the ground."""

import math
from collections.abc import Sequence
from statistics import fmean, pstdev

from daq.contract.channels import CHANNEL_BY_NAME
from daq.contract.scan import Scan

GROUND_SPEED_LIMIT = 2.0
"""GPS ground speed taken as motion [m/s]."""
RATE_LIMIT = 0.15
"""Angular rate taken as motion [rad/s]."""
THROTTLE_LIMIT = 1.2e-3
"""Throttle pulse taken as running engine [s]."""
PITOT_CENTRE = 8192
PITOT_LIMIT = 60
"""Mean pitot reading this far from the centre of its range (63 Pa, 10 m/s) is taken as airspeed where GPS does not vouch for rest
[counts]: unzeroed sensors rest at up to twice that."""
PITOT_PA_PER_COUNT = 2.0 * 6894.757 / (0.8 * 16384)
"""Of the MS4525DO of +-1 psi of the standard fit: 10 to 90 % of 14 bits (data sheet, output type A)."""
PITOT_UNREST = 12.0
"""Standard deviation of a pitot at rest stays below this [counts]."""
LEAST_SCANS = 20


def flight_evidence(scans: Sequence[Scan]) -> str | None:
    """Why the aircraft may not be standing still, in words; None when nothing speaks for motion.

    Too little data speaks for motion: a command that must not act in flight then does nothing.
    """
    pitot = [s.values["pitot_pressure"] for s in scans if "pitot_pressure" in s.values]
    if len(pitot) < LEAST_SCANS:
        return f"only {len(pitot)} pitot readings so far"
    speed = ground_speed(scans)
    if speed is not None and speed > GROUND_SPEED_LIMIT:
        return f"GPS ground speed {speed:.1f} m/s"
    last = scans[-1].values
    throttle = last.get("pwm_4", 0) * (CHANNEL_BY_NAME["pwm_4"].scale or 0.0)
    if throttle > THROTTLE_LIMIT:
        return f"throttle pulse {throttle * 1e3:.2f} ms"
    scale = CHANNEL_BY_NAME["gyro_x"].scale or 0.0
    rate = max((abs(s.values.get(g, 0)) * scale for s in scans for g in ("gyro_x", "gyro_y", "gyro_z")), default=0.0)
    if rate > RATE_LIMIT:
        return f"angular rate {rate:.2f} rad/s"
    if speed is None and abs(fmean(pitot) - PITOT_CENTRE) > PITOT_LIMIT:
        return f"pitot reads {fmean(pitot) - PITOT_CENTRE:+.0f} counts from the centre of its range"
    if pstdev(pitot) > PITOT_UNREST:
        return f"pitot unsteady by {pstdev(pitot):.0f} counts"
    return None


def ground_speed(scans: Sequence[Scan]) -> float | None:
    """Speed over ground [m/s] by the newest scan with a fix of two dimensions or more; None without one."""
    for scan in reversed(scans):
        if scan.values.get("gnss_fix", 0) >= 2 and "velocity_north_mm" in scan.values:
            return math.hypot(scan.values["velocity_north_mm"], scan.values.get("velocity_east_mm", 0)) * 1e-3
    return None


def pitot_offset(scans: Sequence[Scan]) -> tuple[float, float] | None:
    """(mean, standard deviation) [Pa] of what the pitot of the standard fit reads; None with too few readings."""
    counts = [s.values["pitot_pressure"] for s in scans if "pitot_pressure" in s.values]
    if len(counts) < LEAST_SCANS:
        return None
    return (fmean(counts) - PITOT_CENTRE) * PITOT_PA_PER_COUNT, pstdev(counts) * PITOT_PA_PER_COUNT
