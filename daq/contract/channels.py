"""The one channel table: what the aircraft measures, from raw count to calibrated flight column.

Recorder schema, downlink message, calibration, viewer entities and flight columns are all derived from the tables
below, so a new channel appears everywhere by one row. Raw values are what the chip delivered (counts);
calibrated columns are SI and radians in body axes x forward, y right, z down. Rows of a laboratory's own come from its
installed packages (`daq.contract.laboratory`) and stand after the built-in ones.
"""

import math
from collections.abc import Iterable, Mapping
from importlib.metadata import entry_points

from daq.contract.channel_rows import Channel, ChannelGroup, Downlink, FlightColumn, Rate, RawType, TableRows
from daq.utilities.constants import DEGREE, GRAVITY, ZERO_CELSIUS

BUILT_IN_GROUPS: tuple[ChannelGroup, ...] = (
    ChannelGroup("imu", "accelerometer and gyro", "ICM-20948"),
    ChannelGroup("mag", "magnetometer", "AK09916"),
    ChannelGroup("attitude", "attitude filter", "imufusion"),
    ChannelGroup("analog_a", "vanes and elevon potentiometers", "ADS1115 0x48"),
    ChannelGroup("analog_b", "rudder potentiometer, supplies, analog 1", "ADS1115 0x49"),
    ChannelGroup("analog_c", "analog inputs 2 to 5", "ADS1115 0x4A"),
    ChannelGroup("pitot", "differential pressure", "MS4525DO"),
    ChannelGroup("static", "static pressure", "BMP390"),
    ChannelGroup("thrust", "thrust load cell", "NAU7802"),
    ChannelGroup("capture", "digital inputs and PWM widths", "capture co-processor"),
    ChannelGroup("gnss", "GPS", "u-blox NAV-PVT"),
    ChannelGroup("vane_alpha", "angle-of-attack vane, magnetic", "AS5600"),
    ChannelGroup("vane_beta", "sideslip vane, magnetic", "AS5600"),
)


def _axes(
    names: str, group: str, unit: str, meaning: str, scale: float, columns: str, downlink: Downlink = "fast"
) -> tuple[Channel, ...]:
    axis = {"x": "x forward", "y": "y right", "z": "z down"}
    return tuple(
        Channel(n, group, "i16", unit, f"{meaning}, {axis[n[-1]]}", scale, columns=(c,), downlink=downlink)
        for n, c in zip(names.split(), columns.split(), strict=True)
    )


_VOLT = 4.096 / 32768  # ADS1115 at +-4.096 V


def _volts(name: str, group: str, meaning: str, columns: str = "", downlink: Downlink = "fast") -> Channel:
    """One input of an ADS1115; columns: names with blanks between."""
    return Channel(name, group, "i16", "V", meaning, _VOLT, columns=tuple(columns.split()), downlink=downlink)


def _gnss(
    name: str, raw_type: RawType, unit: str, meaning: str, scale: float | None = None, column: str = ""
) -> Channel:
    """One field of a fix: comes less often than scans."""
    columns = (column,) if column else ()
    return Channel(name, "gnss", raw_type, unit, meaning, scale, rate=Rate.SLOW, downlink="slow", columns=columns)


def _pwm(output: int, columns: tuple[str, ...]) -> Channel:
    meaning = f"servo pulse width, output {output}"
    return Channel(f"pwm_{output}", "capture", "u16", "s", meaning, 1e-7, columns=columns)


def _encoder(angle: str, words: str) -> Channel:
    """Of an AS5600: 4096 counts a turn."""
    meaning = f"{words} vane, magnetic encoder, from its centre"
    group, scale = (
        f"vane_{angle}",
        math.tau / 4096,
    )  # not in each frame: a signed one would no longer fit a radio packet
    return Channel(f"{angle}_encoder", group, "i16", "rad", meaning, scale, downlink="slow", columns=(angle,))


def _attitude(axis: str, part: str) -> Channel:
    meaning = f"attitude, NED to body, {part}"
    return Channel(f"quaternion_{axis}", "attitude", "i16", "", meaning, 1 / 32767, columns=("phi", "theta", "psi"))


_ATTITUDE_STATUS = (
    "filter flags: bit 0 initialising, 1 rate recovery, 2 acceleration rejected, 3 magnetic field rejected, "
    "4 magnetometer used"
)
_PWM_COLUMNS = (("cmd_e", "cmd_a"), ("cmd_e", "cmd_a"), ("cmd_r",), ("throttle",), (), ())
_PITOT_DIE = "pitot sensor die, 11-bit count"
_PITOT = ("p_dynamic", "V", "V_cas")
_STATIC = ("p_static", "altitude", "rho", "V")
_AIR = ("temperature", "rho", "p_static", "altitude", "V")

BUILT_IN_CHANNELS: tuple[Channel, ...] = (
    # ICM-20948 at +-8 g and +-500 deg/s; axes already turned from chip to body axes by the driver's mounting matrix.
    *_axes("accel_x accel_y accel_z", "imu", "m/s2", "specific force at the IMU", GRAVITY / 4096, "ax ay az"),
    *_axes("gyro_x gyro_y gyro_z", "imu", "rad/s", "angular rate", DEGREE / 65.5, "p q r"),
    # die temperature, sensor supply and air temperature are sent with each fast frame (2 + 2 + 4 bytes), because fast columns
    # are corrected with them: a flight from telemetry then equals the onboard one exactly, whichever frames were lost
    Channel("imu_temperature", "imu", "i16", "K", "IMU die", 1 / 333.87, 21.0 + ZERO_CELSIUS),
    *_axes("mag_x mag_y mag_z", "mag", "T", "magnetic field", 0.15e-6, "mx my mz", "slow"),
    Channel("mag_status", "mag", "u8", "", "AK09916 ST2: bit 3 overflow", downlink="none"),
    _attitude("w", "scalar part"),
    *(_attitude(axis, axis) for axis in "xyz"),
    Channel("attitude_status", "attitude", "u8", "", _ATTITUDE_STATUS, downlink="slow"),
    _volts("alpha_vane", "analog_a", "angle-of-attack vane, + nose up", "alpha"),
    _volts("beta_vane", "analog_a", "sideslip vane, + wind from the right", "beta"),
    _volts("elevon_left_pot", "analog_a", "left elevon, + trailing edge down", "delta_e delta_a"),
    _volts("elevon_right_pot", "analog_a", "right elevon, + trailing edge down", "delta_e delta_a"),
    _volts("rudder_pot", "analog_b", "rudder, + trailing edge to port", "delta_r"),
    _volts("supply", "analog_b", "main supply behind a divider", "supply_voltage", "slow"),
    _volts("sensor_supply", "analog_b", "5 V sensor supply behind a divider"),
    _volts("analog_1", "analog_b", "free analog input", "analog_1", "slow"),
    *(_volts(f"analog_{i}", "analog_c", "free analog input", f"analog_{i}", "slow") for i in range(2, 6)),
    Channel("pitot_pressure", "pitot", "u16", "Pa", "dynamic pressure, 14-bit count", columns=_PITOT),
    Channel("pitot_temperature", "pitot", "u16", "K", _PITOT_DIE, 200 / 2047, -50 + ZERO_CELSIUS, downlink="slow"),
    Channel("static_pressure", "static", "u32", "Pa", "24-bit uncompensated pressure", columns=_STATIC),
    Channel("static_temperature", "static", "u32", "K", "24-bit uncompensated temperature", columns=_AIR),
    Channel("thrust_load", "thrust", "i32", "N", "load cell, + forward", columns=("thrust",)),
    *(_pwm(i, columns) for i, columns in enumerate(_PWM_COLUMNS, start=1)),
    Channel("digital_1", "capture", "bit", "", "digital input: event switch", columns=("digital_1",)),
    *(Channel(f"digital_{i}", "capture", "bit", "", "digital input", columns=(f"digital_{i}",)) for i in range(2, 6)),
    _gnss("gnss_itow", "u32", "ms", "GPS time of week of the fix"),
    _gnss("gnss_utc_ns", "u64", "ns", "UTC of the fix since 1970; 0 while not resolved"),
    _gnss("gnss_fix", "u8", "", "fix type: 0 none, 2 2-D, 3 3-D"),
    _gnss("gnss_satellites", "u8", "", "satellites used"),
    _gnss("latitude_e7", "i32", "deg", "latitude, + north", 1e-7, "latitude"),
    _gnss("longitude_e7", "i32", "deg", "longitude, + east", 1e-7, "longitude"),
    _gnss("height_msl_mm", "i32", "m", "height above mean sea level", 1e-3, "altitude_gnss"),
    _gnss("velocity_north_mm", "i32", "m/s", "ground velocity, + north", 1e-3, "vn"),
    _gnss("velocity_east_mm", "i32", "m/s", "ground velocity, + east", 1e-3, "ve"),
    _gnss("velocity_down_mm", "i32", "m/s", "ground velocity, + down", 1e-3, "vd"),
    _gnss("time_accuracy_ns", "u32", "s", "time accuracy estimate", 1e-9),
    _gnss("horizontal_accuracy_mm", "u32", "m", "horizontal accuracy estimate", 1e-3),
    _gnss("vertical_accuracy_mm", "u32", "m", "vertical accuracy estimate", 1e-3),
    _gnss("speed_accuracy_mm", "u32", "m/s", "speed accuracy estimate", 1e-3),
    _encoder("alpha", "angle of attack"),
    _encoder("beta", "sideslip"),
)

_FORCE = "specific force at the CG, {} axis"
_ELEVATOR = "elevator, (left + right)/2, + trailing edge down"
_RUDDER = "rudder, + trailing edge to port: force to +y, nose left"

BUILT_IN_COLUMNS: tuple[FlightColumn, ...] = (
    *(FlightColumn(f"a{x}", "m/s2", _FORCE.format(x), "/acceleration", (-120.0, 120.0)) for x in "xyz"),
    FlightColumn("p", "rad/s", "roll rate, + right wing down", "/rates", (-10.0, 10.0)),
    FlightColumn("q", "rad/s", "pitch rate, + nose up", "/rates", (-10.0, 10.0)),
    FlightColumn("r", "rad/s", "yaw rate, + nose right", "/rates", (-10.0, 10.0)),
    FlightColumn("phi", "rad", "bank angle, + right wing down", "/attitude", (-math.pi, math.pi)),
    FlightColumn("theta", "rad", "pitch attitude, + nose up", "/attitude", (-math.pi / 2, math.pi / 2)),
    FlightColumn("psi", "rad", "heading from true north, + clockwise", "/attitude", (-math.pi, 2 * math.pi)),
    FlightColumn("alpha", "rad", "angle of attack, + wind from below", "/airdata/angles", (-math.pi / 2, math.pi / 2)),
    FlightColumn("beta", "rad", "sideslip, + wind from the right", "/airdata/angles", (-math.pi / 2, math.pi / 2)),
    FlightColumn("V", "m/s", "true airspeed", "/airdata/speed", (0.0, 350.0)),
    FlightColumn("V_cas", "m/s", "calibrated airspeed", "/airdata/speed", (0.0, 350.0)),
    FlightColumn("delta_e", "rad", _ELEVATOR, "/controls/measured", (-1.0, 1.0)),
    FlightColumn("delta_a", "rad", "aileron, + rolls left", "/controls/measured", (-1.0, 1.0)),
    FlightColumn("delta_r", "rad", _RUDDER, "/controls/measured", (-1.0, 1.0)),
    FlightColumn("cmd_e", "rad", "elevator commanded by PWM", "/controls/commanded", (-1.0, 1.0)),
    FlightColumn("cmd_a", "rad", "aileron commanded by PWM", "/controls/commanded", (-1.0, 1.0)),
    FlightColumn("cmd_r", "rad", "rudder commanded by PWM", "/controls/commanded", (-1.0, 1.0)),
    FlightColumn("throttle", "1", "throttle commanded by PWM, 0 to 1", "/controls/throttle", (-0.1, 1.1)),
    FlightColumn("thrust", "N", "thrust, + forward", "/propulsion", (-1e5, 1e6)),
    FlightColumn("rho", "kg/m3", "air density", "/airdata/density", (0.08, 1.6)),
    FlightColumn("p_static", "Pa", "static pressure", "/airdata/static", (5.0e3, 1.1e5)),
    FlightColumn("p_dynamic", "Pa", "pitot minus static pressure", "/airdata/dynamic", (-500.0, 7.0e4)),
    FlightColumn("temperature", "K", "outside air temperature", "/airdata/temperature", (180.0, 340.0)),
    FlightColumn("latitude", "deg", "latitude, + north", "/gnss/position", (-90.0, 90.0)),
    FlightColumn("longitude", "deg", "longitude, + east", "/gnss/position", (-180.0, 180.0)),
    FlightColumn("altitude", "m", "pressure altitude above mean sea level", "/airdata/altitude", (-500.0, 20_000.0)),
    FlightColumn("altitude_gnss", "m", "GPS height above mean sea level", "/gnss/altitude", (-500.0, 20_000.0)),
    FlightColumn("vn", "m/s", "ground velocity, + north", "/gnss/velocity", (-400.0, 400.0)),
    FlightColumn("ve", "m/s", "ground velocity, + east", "/gnss/velocity", (-400.0, 400.0)),
    FlightColumn("vd", "m/s", "ground velocity, + down", "/gnss/velocity", (-400.0, 400.0)),
    *(FlightColumn(f"m{x}", "T", f"magnetic field, {x} axis", "/magnetic", (-1e-4, 1e-4)) for x in "xyz"),
    *(FlightColumn(f"analog_{i}", "V", f"analog input {i}", "/inputs/analog", (-0.5, 6.5)) for i in range(1, 6)),
    *(FlightColumn(f"digital_{i}", "1", f"digital input {i}", "/inputs/digital", (0.0, 1.0)) for i in range(1, 6)),
    FlightColumn("supply_voltage", "V", "main supply", "/power", (0.0, 60.0)),
)


def _whole_table() -> TableRows:
    """The built-in rows and those of laboratory packages; the latter need pydantic, so only where there are any."""
    table = TableRows(BUILT_IN_GROUPS, BUILT_IN_CHANNELS, BUILT_IN_COLUMNS)
    packages = entry_points(group="sideslip.channels")
    if not packages:
        return table
    from daq.contract.laboratory import with_packages

    return with_packages(packages, table)


GROUPS, CHANNELS, COLUMNS = _whole_table()
CHANNEL_BY_NAME: Mapping[str, Channel] = {c.name: c for c in CHANNELS}
COLUMN_BY_NAME: Mapping[str, FlightColumn] = {c.name: c for c in COLUMNS}
GROUP_NAMES: tuple[str, ...] = tuple(g.name for g in GROUPS)


def channels_of(group: str, channels: Iterable[Channel] = CHANNELS) -> tuple[Channel, ...]:
    """The channels read in one group, in table order."""
    return tuple(c for c in channels if c.group == group)


def sources_of(column: str, channels: Iterable[Channel] = CHANNELS) -> tuple[Channel, ...]:
    """The raw channels a calibrated column is made from, in table order."""
    return tuple(c for c in channels if column in c.columns)
