"""Whether the aircraft stands still, judged from raw scans by what moves: GPS speed, gyros, accelerometer, the pitot's spread.

The pitot's level says nothing of rest where an IMU can be asked: an MS4525DO that was not zeroed rests at 30 to 140 Pa and
more, and a gauge sensor at the bottom of its range.
"""

import math
from collections.abc import Sequence
from statistics import fmean, pstdev

from daq.contract.channels import CHANNEL_BY_NAME
from daq.contract.scan import Scan, SensorState

GROUND_SPEED_LIMIT = 2.0
"""GPS ground speed taken as motion [m/s]."""
RATE_LIMIT = 0.15
"""Angular rate taken as motion [rad/s]."""
RATE_UNREST = 0.02
"""Standard deviation of a rate at rest stays below this [rad/s]: ten times a gyro's noise; no aircraft flies so still."""
ACCEL_UNREST = 0.25
"""Standard deviation of specific force at rest stays below this [m/s2]: a few times the noise of an unfiltered chip."""
THROTTLE_LIMIT = 1.2e-3
"""Throttle pulse taken as running engine [s]."""
PITOT_CENTRE = 8192
PITOT_LIMIT = 60
"""Where no IMU can be asked, a mean pitot reading this far from the centre of its range (63 Pa) is taken as airspeed [counts]."""
PITOT_PASCAL = 1.052
"""A count of an MS4525DO at +-1 psi [Pa]: of any pitot that does not say otherwise."""
PITOT_UNREST_PA = 12.6
"""Standard deviation of a pitot at rest stays below this; wind on the ground shakes it more."""
LEAST_SCANS = 20
_FIXES = (3, 4)
_OK = SensorState.OK  # asked of each scan in the window, once a second
_RATES, _FORCES = ("gyro_x", "gyro_y", "gyro_z"), ("accel_x", "accel_y", "accel_z")


def ground_speed(scan: Scan) -> float | None:
    """GPS ground speed [m/s] by a fix the receiver vouches for; None in a scan without one."""
    status = scan.groups.get("gnss")
    if status is None or status.state is not _OK or scan.values.get("gnss_fix", 0) not in _FIXES:
        return None
    return math.hypot(scan.values.get("velocity_north_mm", 0), scan.values.get("velocity_east_mm", 0)) * 1e-3


def unrest(scans: Sequence[Scan]) -> str | None:
    """What moves, in words; None when nothing does. Counts are taken at the channel table's scale."""
    speed = next((s for s in map(ground_speed, reversed(scans)) if s is not None), None)
    if speed is not None and speed > GROUND_SPEED_LIMIT:
        return f"GPS ground speed {speed:.1f} m/s"
    throttle = scans[-1].values.get("pwm_4", 0) * (CHANNEL_BY_NAME["pwm_4"].scale or 0.0)
    if throttle > THROTTLE_LIMIT:
        return f"throttle pulse {throttle * 1e3:.2f} ms"
    rate = max((abs(v) for name in _RATES for v in measured(scans, name)), default=0.0)
    if rate > RATE_LIMIT:
        return f"angular rate {rate:.2f} rad/s"
    for names, limit, unit in ((_RATES, RATE_UNREST, "rad/s"), (_FORCES, ACCEL_UNREST, "m/s2")):
        spread = max((pstdev(measured(scans, name) or [0.0]) for name in names), default=0.0)
        if spread > limit:
            return f"{names[0][:-2]} unsteady by {spread:.2f} {unit} (limit {limit:g})"
    return None


def pitot_unrest(pitot: Sequence[float], *, level_tells: bool, pascal: float = PITOT_PASCAL) -> str | None:
    """What the pitot's counts say of motion, in words; level_tells: where nothing else can be asked; pascal: a count [Pa]."""
    if len(pitot) < LEAST_SCANS:
        return f"only {len(pitot)} pitot readings so far"
    if level_tells and abs(fmean(pitot) - PITOT_CENTRE) > PITOT_LIMIT:
        return f"pitot reads {fmean(pitot) - PITOT_CENTRE:+.0f} counts from the centre of its range"
    if pstdev(pitot) * pascal > PITOT_UNREST_PA:
        return f"pitot unsteady by {pstdev(pitot):.0f} counts"
    return None


def measured(scans: Sequence[Scan], name: str) -> list[float]:
    """The values of a channel, at the channel table's scale."""
    scale = CHANNEL_BY_NAME[name].scale or 0.0
    return [s.values[name] * scale for s in scans if name in s.values]


def counts(scans: Sequence[Scan], name: str) -> list[float]:
    """The counts of a channel while its sensor vouches for them."""
    group = CHANNEL_BY_NAME[name].group
    return [
        float(s.values[name]) for s in scans if name in s.values and group in s.groups and s.groups[group].state is _OK
    ]
