"""Standard MAVLink messages from raw scans, so that any ground station can show the aircraft.

They use nominal scales without calibration (`daq.telemetry.display`), for display only. A message whose values are missing, or
whose scales are not configured, is not sent.
"""

import math
from collections import OrderedDict
from collections.abc import Callable, Collection, Mapping

from daq.contract.channels import CHANNEL_BY_NAME
from daq.contract.recordings.recording import software_version
from daq.contract.scan import Scan, SensorState
from daq.telemetry import display as d
from daq.telemetry.config import DownlinkConfig
from daq.telemetry.send_queue import Item, item

FIXED_WING = 1
NO_AUTOPILOT, GENERIC = 8, 0
"""MAV_AUTOPILOT_INVALID: there is no autopilot that a station could arm, or whose mode it could change."""
ACTIVE, STANDBY = 4, 3

_SENSOR_BITS = {"imu": 1 | 2, "mag": 4, "static": 8, "pitot": 16, "gnss": 32, "attitude": 1 << 21}
_LOGGING_BIT = 1 << 24
_BATTERY_BIT = 1 << 25
_ALL_BITS = 2**32 - 1
_UNKNOWN_16 = 65535
_NAN = math.nan
_FRESH_S = 3.0
"""Greatest age of a fix that is sent as the present position: three intervals of a slow receiver."""
_FIXES = (3, 4)
"""gnss_fix of a position: three-dimensional, or combined with dead reckoning (5 is time only)."""
_HOME_FIXES = 5
"""Fixes in a row that must agree to set home, so that one bad first fix does not set it for the whole flight."""
_HOME_SPREAD_E7, _HOME_SPREAD_MM = 3_000, 30_000
"""Largest difference of fixes that agree: 0.0003 degrees (33 m) and 30 m of height, a few accuracies of a receiver just
started."""
_ALL_FUNCTIONS = 1  # MAV_BATTERY_FUNCTION_ALL
_CELLS = 10  # voltages in a BATTERY_STATUS
_NAMES = 64  # most named values
_LARGEST = 3.4e38  # of a 32-bit float
_MAVLINK_2 = 1 << 13
_PLAIN_PARAMETERS = 1 << 17  # MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_C_CAST
_OFFICIAL = 255
_THROTTLE_IDLE_S, _THROTTLE_SPAN_S = 1.0e-3, 1.0e-3  # pulse width: the usual range of servos


def heartbeat(recording: bool) -> Item:
    """HEARTBEAT: an aeroplane without an autopilot."""
    state = ACTIVE if recording else STANDBY
    return item("HEARTBEAT", type=FIXED_WING, autopilot=NO_AUTOPILOT, system_status=state, mavlink_version=3)


class StandardMessages:
    """Makes the standard messages from the latest scan and fix, home and the estimated wind.

    recording: returns whether a recording is under way. facts: returns run-time facts of the sensors, by name.
    """

    def __init__(
        self,
        config: DownlinkConfig,
        recording: Callable[[], bool],
        facts: Callable[[], Mapping[str, str]] = dict,
    ) -> None:
        self.display = d.Display(config.display, facts)
        self.last: Scan | None = None
        self.fix: Scan | None = None
        """The latest scan with a fix report."""
        self.home: Scan | None = None
        """The scan with the last of the first _HOME_FIXES fixes that agree; heights are relative to it."""
        self._candidates: list[Scan] = []
        self._wind = d.WindMean()
        self._config = config
        self._recording = recording
        self._makers: Mapping[str, Callable[[Scan], Item | None]] = {
            "ATTITUDE": attitude,
            "GPS_RAW_INT": lambda _: gps_raw(self.fix),
            "SYS_STATUS": lambda scan: sys_status(scan, self._recording(), self.supply_voltage),
            "VFR_HUD": self._vfr_hud,
            "AOA_SSA": self._aoa_ssa,
            "GLOBAL_POSITION_INT": self._global_position,
            "SCALED_PRESSURE": self._scaled_pressure,
            "SERVO_OUTPUT_RAW": servo_output,
            "BATTERY_STATUS": self._battery,
            "WIND_COV": self._wind_cov,
            "HOME_POSITION": lambda _: self.home_position(),
            "NAMED_VALUE_FLOAT": self._next_named,
            "HIGH_LATENCY2": self._summary,
        }
        self._named_values: OrderedDict[str, float] = OrderedDict()  # in the order of sending

    def offer(self, scan: Scan) -> None:
        self.last = scan
        if "gnss_fix" not in scan.values:
            return
        self.fix = scan
        if self.home is None:
            self._seek_home(scan)
        wind = self.display.wind(scan)
        if wind is not None:
            self._wind.add(scan.time, wind)

    def _seek_home(self, scan: Scan) -> None:
        if not _is_position(scan):
            self._candidates.clear()
            return
        if self._candidates and not _agree(self._candidates[0], scan):
            self._candidates.clear()
        self._candidates.append(scan)
        if len(self._candidates) >= _HOME_FIXES:
            self.home = scan

    def set_named(self, name: str, value: float) -> None:
        """Set a value that is sent by name from now on, such as a derivative estimated on board.

        Named values are sent in turn, so that many of them do not crowd out other messages. Names are cut to ten bytes; beyond
        _NAMES further ones are ignored.
        """
        if name in self._named_values or len(self._named_values) < _NAMES:
            self._named_values[name] = value if abs(value) <= _LARGEST else _NAN

    def _next_named(self, scan: Scan) -> Item | None:
        if not self._named_values:
            return None
        name = next(iter(self._named_values))
        self._named_values.move_to_end(name)
        return item("NAMED_VALUE_FLOAT", time_boot_ms=_boot_ms(scan), name=name[:10], value=self._named_values[name])

    @property
    def names(self) -> Collection[str]:
        return self._makers.keys()

    def make(self, name: str) -> Item | None:
        """Make the present message of this name; None where its values are missing, or for an unknown name."""
        maker = self._makers.get(name)
        return None if maker is None or self.last is None else maker(self.last)

    def home_position(self) -> Item | None:
        """HOME_POSITION; None before the first fix."""
        if self.home is None:
            return None
        v = self.home.values
        north_up = (1.0, 0.0, 0.0, 0.0)
        return item(
            "HOME_POSITION",
            latitude=v.get("latitude_e7", 0),
            longitude=v.get("longitude_e7", 0),
            altitude=v.get("height_msl_mm", 0),
            q=north_up,
            approach_x=_NAN,
            approach_y=_NAN,
            approach_z=_NAN,
            time_usec=_usec(self.home),
        )

    @property
    def supply_voltage(self) -> float | None:
        """Main supply of the latest scan [V]."""
        scan = self.last
        return None if scan is None else self.display.supply_voltage(scan, self._config.supply_volts_per_count)

    def _summary(self, scan: Scan) -> Item:
        """HIGH_LATENCY2, for stations that ignore heartbeats without an autopilot, such as MAVProxy.

        Its integer fields have no value for "not known"; they are 0 then.
        """
        fix, turn = self._fresh_fix(scan), d.attitude(scan)
        v: Mapping[str, float] = {} if fix is None else fix.values
        speeds = (0.0, 0.0, 0.0) if fix is None else _speeds(fix)
        return item(
            "HIGH_LATENCY2",
            timestamp=_boot_ms(scan),
            type=FIXED_WING,
            autopilot=GENERIC,
            latitude=v.get("latitude_e7", 0),
            longitude=v.get("longitude_e7", 0),
            altitude=_clipped(round(v.get("height_msl_mm", 0) * 1e-3), 32767),
            heading=0 if turn is None else round(math.degrees(d.heading(turn)) / 2) % 180,
            airspeed=_fifths(self.display.airspeed(scan) or 0.0),
            groundspeed=_fifths(math.hypot(speeds[0], speeds[1])),
            battery=-1,
        )

    def _fresh_fix(self, scan: Scan) -> Scan | None:
        fix = self.fix
        if fix is None or not _is_position(fix) or scan.time - fix.time > _FRESH_S:
            return None
        return fix

    def _vfr_hud(self, scan: Scan) -> Item | None:
        speed, turn = self.display.airspeed(scan), d.attitude(scan)
        if speed is None or turn is None:
            return None
        fix = self._fresh_fix(scan)
        over_ground = None if fix is None else d.velocity(fix)
        throttle = d.measured(scan, "pwm_4")
        return item(
            "VFR_HUD",
            airspeed=speed,
            groundspeed=_NAN if over_ground is None else math.hypot(over_ground[0], over_ground[1]),
            heading=round(math.degrees(d.heading(turn))) % 360,
            throttle=0 if throttle is None else _percent(throttle * (CHANNEL_BY_NAME["pwm_4"].scale or 0.0)),
            alt=_NAN if fix is None else fix.values.get("height_msl_mm", 0) * 1e-3,
            climb=_NAN if over_ground is None else -over_ground[2],
        )

    def _aoa_ssa(self, scan: Scan) -> Item | None:
        alpha, beta = self.display.alpha(scan), self.display.beta(scan)
        if alpha is None or beta is None:
            return None
        return item("AOA_SSA", time_usec=_usec(scan), AOA=math.degrees(alpha), SSA=math.degrees(beta))

    def _global_position(self, scan: Scan) -> Item | None:
        fix = self._fresh_fix(scan)
        if fix is None or self.home is None:
            return None
        turn, v = d.attitude(scan), fix.values
        height = int(v.get("height_msl_mm", 0))
        return item(
            "GLOBAL_POSITION_INT",
            time_boot_ms=_boot_ms(fix),
            lat=v.get("latitude_e7", 0),
            lon=v.get("longitude_e7", 0),
            alt=height,
            relative_alt=_clipped(height - int(self.home.values.get("height_msl_mm", 0)), 2**31 - 1),
            **{name: _clipped(round(u * 100), 32767) for name, u in zip(("vx", "vy", "vz"), _speeds(fix), strict=True)},
            hdg=_UNKNOWN_16 if turn is None else round(math.degrees(d.heading(turn)) * 100) % 36000,
        )

    def _scaled_pressure(self, scan: Scan) -> Item | None:
        self.display.look_up_facts()
        static, dynamic = self.display.static(scan), self.display.dynamic_pressure(scan)
        if static is None:
            return None
        return item(
            "SCALED_PRESSURE",
            time_boot_ms=_boot_ms(scan),
            press_abs=static[0] / 100,
            press_diff=_NAN if dynamic is None else dynamic / 100,
            temperature=_clipped(round(d.celsius(static[1]) * 100), 32767),
        )

    def _battery(self, scan: Scan) -> Item | None:
        volts = self.supply_voltage
        if volts is None:
            return None
        return item(
            "BATTERY_STATUS",
            battery_function=_ALL_FUNCTIONS,
            temperature=32767,
            voltages=(_millivolts(volts), *(_UNKNOWN_16 for _ in range(_CELLS - 1))),
            current_battery=-1,
            current_consumed=-1,
            energy_consumed=-1,
            battery_remaining=-1,
        )

    def _wind_cov(self, scan: Scan) -> Item | None:
        wind = self._wind.estimate(scan.time)
        if wind is None:
            return None
        fix = self._fresh_fix(scan)
        return item(
            "WIND_COV",
            time_usec=_usec(scan),
            wind_x=wind.mean[0],
            wind_y=wind.mean[1],
            wind_z=wind.mean[2],
            var_horiz=wind.horizontal,
            var_vert=wind.vertical,
            wind_alt=_NAN if fix is None else fix.values.get("height_msl_mm", 0) * 1e-3,
        )


def attitude(scan: Scan) -> Item | None:
    """ATTITUDE from the attitude filter's quaternion and the gyro."""
    turn = d.attitude(scan)
    if turn is None:
        return None
    w, x, y, z = turn
    gyro = CHANNEL_BY_NAME["gyro_x"].scale or 0.0
    p, q, r = (scan.values.get(n, 0) * gyro for n in ("gyro_x", "gyro_y", "gyro_z"))
    return item(
        "ATTITUDE",
        time_boot_ms=_boot_ms(scan),
        roll=math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)),
        pitch=math.asin(max(-1.0, min(1.0, 2 * (w * y - z * x)))),
        yaw=math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)),
        rollspeed=p,
        pitchspeed=q,
        yawspeed=r,
    )


def gps_raw(scan: Scan | None) -> Item | None:
    """GPS_RAW_INT from the latest scan with a fix report; None without one."""
    if scan is None:
        return None
    v = scan.values
    north, east = v.get("velocity_north_mm", 0), v.get("velocity_east_mm", 0)
    course = math.degrees(math.atan2(east, north)) % 360.0
    return item(
        "GPS_RAW_INT",
        time_usec=_usec(scan),
        fix_type=3 if _is_position(scan) else 1,
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


def sys_status(scan: Scan, recording: bool, volts: float | None) -> Item:
    """SYS_STATUS from the states of the sensors. volts: the main supply, None where not known.

    The bit of a sensor that is not fitted is healthy: a station that reads the health bits alone (MAVProxy for its geofence)
    would report a breach otherwise.
    """
    present = _LOGGING_BIT | (0 if volts is None else _BATTERY_BIT)
    unhealthy = 0 if recording else _LOGGING_BIT
    for group, bits in _SENSOR_BITS.items():
        state = scan.groups.get(group)
        if state is None or state.state is SensorState.OFF:
            continue
        present |= bits
        if state.state not in (SensorState.OK, SensorState.STALE):
            unhealthy |= bits
    return item(
        "SYS_STATUS",
        onboard_control_sensors_present=present,
        onboard_control_sensors_enabled=present,
        onboard_control_sensors_health=_ALL_BITS & ~unhealthy,
        voltage_battery=_UNKNOWN_16 if volts is None else _millivolts(volts),
        current_battery=-1,
        battery_remaining=-1,
    )


def servo_output(scan: Scan) -> Item | None:
    """SERVO_OUTPUT_RAW: measured pulse widths [us], 0 for those not measured; None without any."""
    scale = (CHANNEL_BY_NAME["pwm_1"].scale or 0.0) * 1e6
    widths = {f"servo{i}_raw": d.measured(scan, f"pwm_{i}") for i in range(1, 7)}
    if all(w is None for w in widths.values()):
        return None
    return item(
        "SERVO_OUTPUT_RAW",
        time_usec=scan.time_monotonic_ns // 1000 % 2**32,
        **{name: min(_UNKNOWN_16 - 1, round(width * scale)) for name, width in widths.items() if width is not None},
    )


def autopilot_version() -> Item:
    """AUTOPILOT_VERSION: version of the software, with MAVLink 2 and parameters by value as the only capabilities."""
    numbers = [int("".join(c for c in part if c.isdigit()) or 0) for part in software_version().split(".")[:3]]
    major, minor, patch = (min(255, n) for n in [*numbers, 0, 0, 0][:3])
    return item(
        "AUTOPILOT_VERSION",
        capabilities=_MAVLINK_2 | _PLAIN_PARAMETERS,
        flight_sw_version=major << 24 | minor << 16 | patch << 8 | _OFFICIAL,
    )


def _is_position(scan: Scan) -> bool:
    """Whether the fix is valid (gnssFixOK) and of a type with a position."""
    status = scan.groups.get("gnss")
    return status is not None and status.state is SensorState.OK and scan.values.get("gnss_fix", 0) in _FIXES


def _agree(first: Scan, second: Scan) -> bool:
    limits = (("latitude_e7", _HOME_SPREAD_E7), ("longitude_e7", _HOME_SPREAD_E7), ("height_msl_mm", _HOME_SPREAD_MM))
    return all(abs(first.values.get(name, 0) - second.values.get(name, 0)) <= limit for name, limit in limits)


def _boot_ms(scan: Scan) -> int:
    return scan.time_monotonic_ns // 1_000_000 % 2**32


def _usec(scan: Scan) -> int:
    return (scan.time_utc_ns or scan.time_monotonic_ns) // 1000


def _speeds(fix: Scan) -> d.Vector:
    return d.velocity(fix) or (0.0, 0.0, 0.0)


def _percent(pulse_s: float) -> int:
    return round(100 * min(1.0, max(0.0, (pulse_s - _THROTTLE_IDLE_S) / _THROTTLE_SPAN_S)))


def _fifths(speed: float) -> int:
    return min(255, round(speed * 5))


def _millivolts(volts: float) -> int:
    return min(_UNKNOWN_16 - 1, max(0, round(volts * 1000)))


def _clipped(value: int, limit: int) -> int:
    return min(limit, max(-limit, value))
