"""Standard MAVLink messages made from raw scans, so that any ground station shows the aircraft.

They are for the eye: nominal datasheet scales, no calibration. Messages whose values are missing are not sent.
"""

import math

from daq.contract.channels import CHANNEL_BY_NAME
from daq.contract.scan import Scan, SensorState
from daq.telemetry.send_queue import Item, item

_SENSOR_BITS = {"imu": 1 | 2, "mag": 4, "static": 8, "pitot": 16, "gnss": 32}
_LOGGING_BIT = 1 << 24
_UNKNOWN_16 = 65535


def attitude(scan: Scan | None) -> Item | None:
    """ATTITUDE from the attitude filter's quaternion and the gyro."""
    names = ("quaternion_w", "quaternion_x", "quaternion_y", "quaternion_z")
    if scan is None or any(n not in scan.values for n in names):
        return None
    w, x, y, z = (scan.values[n] / 32767 for n in names)
    gyro = CHANNEL_BY_NAME["gyro_x"].scale or 0.0
    p, q, r = (scan.values.get(n, 0) * gyro for n in ("gyro_x", "gyro_y", "gyro_z"))
    return item(
        "ATTITUDE",
        time_boot_ms=scan.time_monotonic_ns // 1_000_000 % 2**32,
        roll=math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)),
        pitch=math.asin(max(-1.0, min(1.0, 2 * (w * y - z * x)))),
        yaw=math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)),
        rollspeed=p,
        pitchspeed=q,
        yawspeed=r,
    )


def gps_raw(scan: Scan | None) -> Item | None:
    """GPS_RAW_INT from the latest scan that had a fix report."""
    if scan is None:
        return None
    v = scan.values
    north, east = v.get("velocity_north_mm", 0), v.get("velocity_east_mm", 0)
    course = math.degrees(math.atan2(east, north)) % 360.0
    return item(
        "GPS_RAW_INT",
        time_usec=(scan.time_utc_ns or scan.time_monotonic_ns) // 1000,
        fix_type=min(3, max(1, int(v.get("gnss_fix", 0)))),
        lat=v.get("latitude_e7", 0),
        lon=v.get("longitude_e7", 0),
        alt=v.get("height_msl_mm", 0),
        eph=_UNKNOWN_16,
        epv=_UNKNOWN_16,
        vel=min(_UNKNOWN_16 - 1, round(math.hypot(north, east) / 10)),
        cog=round(course * 100) % 36000,
        satellites_visible=min(254, int(v.get("gnss_satellites", 255))),
        h_acc=v.get("horizontal_accuracy_mm", 0),
        v_acc=v.get("vertical_accuracy_mm", 0),
        vel_acc=v.get("speed_accuracy_mm", 0),
    )


def sys_status(scan: Scan | None, recording: bool, supply_volts_per_count: float | None) -> Item | None:
    """SYS_STATUS from sensor states; voltage only where the configuration gives the divider."""
    if scan is None:
        return None
    present = health = _LOGGING_BIT
    if not recording:
        health = 0
    for group, bits in _SENSOR_BITS.items():
        state = scan.groups.get(group)
        if state is None or state.state is SensorState.OFF:
            continue
        present |= bits
        if state.state in (SensorState.OK, SensorState.STALE):
            health |= bits
    volts = None if supply_volts_per_count is None else scan.values.get("supply", 0) * supply_volts_per_count
    return item(
        "SYS_STATUS",
        onboard_control_sensors_present=present,
        onboard_control_sensors_enabled=present,
        onboard_control_sensors_health=health,
        voltage_battery=_UNKNOWN_16 if volts is None else min(_UNKNOWN_16 - 1, max(0, round(volts * 1000))),
        current_battery=-1,
        battery_remaining=-1,
    )
