"""Whether the aircraft stands still, from raw scans: GPS speed, throttle, gyros, accelerometers, and the pitot's spread.

The pitot's level is used only without an IMU: at rest an MS4525DO that was not zeroed reads 30 to 140 Pa and more, and a gauge
sensor reads the bottom of its range.
"""

import math
from collections.abc import Sequence
from statistics import fmean, pstdev

from daq.contract.channels import CHANNEL_BY_NAME
from daq.contract.scan import Scan, SensorState

GROUND_SPEED_LIMIT = 2.0
"""GPS ground speed above this counts as motion [m/s]: a receiver at rest shows less."""
RATE_LIMIT = 0.15
"""Angular rate above this counts as motion [rad/s]."""
RATE_SPREAD = 0.02
"""Standard deviation of a rate at rest stays below this [rad/s]: ten times a gyro's noise; no aircraft flies so still."""
ACCEL_SPREAD = 0.25
"""Standard deviation of specific force at rest stays below this [m/s2]: a few times the noise of an unfiltered chip."""
THROTTLE_LIMIT = 1.2e-3
"""Throttle pulse above this counts as a running engine [s]."""
PITOT_CENTRE = 8192  # counts
PITOT_LIMIT = 60
"""Without an IMU, a mean pitot reading this far from the centre of its range (63 Pa) counts as airspeed [counts]."""
PITOT_PASCAL = 1.052
"""Pressure of a count of an MS4525DO at +-1 psi [Pa], the default for pitots."""
PITOT_SPREAD_PA = 12.6
"""Standard deviation of a pitot at rest stays below this; wind on the ground shakes it more."""
LEAST_SCANS = 20
"""Pitot readings needed for a judgement: a second at 20 Hz."""
_FIXES = (3, 4)  # 3-D fix, without and with dead reckoning (u-blox fixType)
_OK = SensorState.OK
_RATES, _FORCES = ("gyro_x", "gyro_y", "gyro_z"), ("accel_x", "accel_y", "accel_z")


def ground_speed(scan: Scan) -> float | None:
    """GPS ground speed [m/s] of a valid 3-D fix; None in a scan without one."""
    status = scan.groups.get("gnss")
    if status is None or status.state is not _OK or scan.values.get("gnss_fix", 0) not in _FIXES:
        return None
    return math.hypot(scan.values.get("velocity_north_mm", 0), scan.values.get("velocity_east_mm", 0)) * 1e-3


def motion_evidence(scans: Sequence[Scan]) -> str | None:
    """The first sign of motion in the scans, in words; None without any. Counts are scaled as in the channel table."""
    speed = next((s for s in map(ground_speed, reversed(scans)) if s is not None), None)
    if speed is not None and speed > GROUND_SPEED_LIMIT:
        return f"GPS ground speed {speed:.1f} m/s"
    throttle = scans[-1].values.get("pwm_4", 0) * (CHANNEL_BY_NAME["pwm_4"].scale or 0.0)
    if throttle > THROTTLE_LIMIT:
        return f"throttle pulse {throttle * 1e3:.2f} ms"
    rate = max((abs(v) for name in _RATES for v in measured(scans, name)), default=0.0)
    if rate > RATE_LIMIT:
        return f"angular rate {rate:.2f} rad/s"
    for names, limit, unit in ((_RATES, RATE_SPREAD, "rad/s"), (_FORCES, ACCEL_SPREAD, "m/s2")):
        spread = max((pstdev(measured(scans, name) or [0.0]) for name in names), default=0.0)
        if spread > limit:
            return f"{names[0][:-2]} unsteady by {spread:.2f} {unit} (limit {limit:g})"
    return None


def pitot_motion_evidence(pitot: Sequence[float], *, check_level: bool, pascal: float = PITOT_PASCAL) -> str | None:
    """A sign of motion in the pitot's counts, in words; None without any.

    check_level: judge the level too, where there is no IMU. pascal: pressure of a count [Pa].
    """
    if len(pitot) < LEAST_SCANS:
        return f"only {len(pitot)} pitot readings so far"
    if check_level and abs(fmean(pitot) - PITOT_CENTRE) > PITOT_LIMIT:
        return f"pitot reads {fmean(pitot) - PITOT_CENTRE:+.0f} counts from the centre of its range"
    if pstdev(pitot) * pascal > PITOT_SPREAD_PA:
        return f"pitot unsteady by {pstdev(pitot):.0f} counts"
    return None


def measured(scans: Sequence[Scan], name: str) -> list[float]:
    """The values of a channel, scaled as in the channel table."""
    scale = CHANNEL_BY_NAME[name].scale or 0.0
    return [s.values[name] * scale for s in scans if name in s.values]


def counts(scans: Sequence[Scan], name: str) -> list[float]:
    """The counts of a channel from scans in which its sensor is OK."""
    group = CHANNEL_BY_NAME[name].group
    return [
        float(s.values[name]) for s in scans if name in s.values and group in s.groups and s.groups[group].state is _OK
    ]
