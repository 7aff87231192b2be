"""The one channel table: what the aircraft measures, from raw count to calibrated flight column.

Recorder schema, downlink message, calibration, viewer entities and flight columns are all derived from the two
tables below, so a new channel appears everywhere by one row. Raw values are what the chip delivered (counts);
calibrated columns are SI and radians in body axes x forward, y right, z down.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Literal

RawType = Literal["bit", "u8", "u16", "u32", "u64", "i16", "i32", "f32"]
Downlink = Literal["fast", "slow", "none"]


class Rate(StrEnum):
    """How often a channel carries a new value."""

    SCAN = "scan"  # once a scan, 20 Hz by default
    SLOW = "slow"  # slower than the scan (GPS, temperatures): absent from scans without a new value


@dataclass(frozen=True, slots=True)
class Group:
    """Channels read together in one bus conversation: one read offset and one sensor state for all of them."""

    name: str
    title: str
    device: str


@dataclass(frozen=True, slots=True)
class Channel:
    """One raw channel as recorded.

    `scale` and `offset` turn the count into `unit` where the transfer function is fixed by the datasheet at the
    default range (physical = count * scale + offset); it is None where a calibration file decides.
    `columns` names the calibrated flight columns the channel contributes to.
    """

    name: str
    group: str
    raw_type: RawType
    unit: str
    meaning: str
    scale: float | None = None
    offset: float = 0.0
    rate: Rate = Rate.SCAN
    logged: bool = True
    downlink: Downlink = "fast"
    columns: tuple[str, ...] = ()

    def limits(self) -> tuple[float, float]:
        """Smallest and largest raw value the raw type can carry."""
        return RAW_LIMITS[self.raw_type]


@dataclass(frozen=True, slots=True)
class Column:
    """One calibrated flight column: SI, radians, body axes."""

    name: str
    unit: str
    meaning: str
    entity: str  # path of the viewer entity that carries it; columns sharing an entity are drawn together
    plausible: tuple[float, float]
    title: str = ""


RAW_LIMITS: Mapping[str, tuple[float, float]] = {
    "bit": (0, 1),
    "u8": (0, 2**8 - 1),
    "u16": (0, 2**16 - 1),
    "u32": (0, 2**32 - 1),
    "u64": (0, 2**64 - 1),
    "i16": (-(2**15), 2**15 - 1),
    "i32": (-(2**31), 2**31 - 1),
    "f32": (-3.4e38, 3.4e38),
}

GROUPS: tuple[Group, ...] = (
    Group("imu", "accelerometer and gyro", "ICM-20948"),
    Group("mag", "magnetometer", "AK09916"),
    Group("attitude", "attitude filter", "imufusion"),
    Group("analog_a", "vanes and elevon potentiometers", "ADS1115 0x48"),
    Group("analog_b", "rudder potentiometer, supplies, analog 1", "ADS1115 0x49"),
    Group("analog_c", "analog inputs 2 to 5", "ADS1115 0x4A"),
    Group("pitot", "differential pressure", "MS4525DO"),
    Group("static", "static pressure", "BMP390"),
    Group("thrust", "thrust load cell", "NAU7802"),
    Group("capture", "digital inputs and PWM widths", "capture co-processor"),
    Group("gnss", "GPS", "u-blox NAV-PVT"),
)

_G = 9.80665
_DEG = 0.017453292519943295


def _axes(
    names: str, group: str, unit: str, meaning: str, scale: float, columns: str, downlink: Downlink = "fast"
) -> tuple[Channel, ...]:
    axis = {"x": "x forward", "y": "y right", "z": "z down"}
    return tuple(
        Channel(n, group, "i16", unit, f"{meaning}, {axis[n[-1]]}", scale, columns=(c,), downlink=downlink)
        for n, c in zip(names.split(), columns.split(), strict=True)
    )


_VOLT = 4.096 / 32768  # ADS1115 at +-4.096 V

CHANNELS: tuple[Channel, ...] = (
    # ICM-20948 at +-8 g and +-500 deg/s; axes already turned from chip to body axes by the driver's mounting matrix.
    *_axes("accel_x accel_y accel_z", "imu", "m/s2", "specific force at the IMU", _G / 4096, "ax ay az"),
    *_axes("gyro_x gyro_y gyro_z", "imu", "rad/s", "angular rate", _DEG / 65.5, "p q r"),
    # die temperature, sensor supply and air temperature are sent with each fast frame (2 + 2 + 4 bytes), because fast columns
    # are corrected with them: a flight from telemetry then equals the onboard one exactly, whichever frames were lost
    Channel("imu_temperature", "imu", "i16", "K", "IMU die", 1 / 333.87, 21.0 + 273.15),
    *_axes("mag_x mag_y mag_z", "mag", "T", "magnetic field", 0.15e-6, "mx my mz", "slow"),
    Channel("mag_status", "mag", "u8", "", "AK09916 ST2: bit 3 overflow", downlink="none"),
    Channel("quaternion_w", "attitude", "i16", "", "attitude, NED to body, scalar part", 1 / 32767,
            columns=("phi", "theta", "psi")),
    Channel("quaternion_x", "attitude", "i16", "", "attitude, NED to body, x", 1 / 32767, columns=("phi", "theta", "psi")),
    Channel("quaternion_y", "attitude", "i16", "", "attitude, NED to body, y", 1 / 32767, columns=("phi", "theta", "psi")),
    Channel("quaternion_z", "attitude", "i16", "", "attitude, NED to body, z", 1 / 32767, columns=("phi", "theta", "psi")),
    Channel("attitude_status", "attitude", "u8", "", "filter flags: bit 0 initialising, 1 rate recovery, "
            "2 acceleration rejected, 3 magnetic field rejected, 4 magnetometer used", downlink="slow"),
    Channel("alpha_vane", "analog_a", "i16", "V", "angle-of-attack vane, + nose up", _VOLT, columns=("alpha",)),
    Channel("beta_vane", "analog_a", "i16", "V", "sideslip vane, + wind from the right", _VOLT, columns=("beta",)),
    Channel("elevon_left_pot", "analog_a", "i16", "V", "left elevon, + trailing edge down", _VOLT,
            columns=("delta_e", "delta_a")),
    Channel("elevon_right_pot", "analog_a", "i16", "V", "right elevon, + trailing edge down", _VOLT,
            columns=("delta_e", "delta_a")),
    Channel("rudder_pot", "analog_b", "i16", "V", "rudder, + trailing edge to port", _VOLT, columns=("delta_r",)),
    Channel("supply", "analog_b", "i16", "V", "main supply behind a divider", _VOLT, downlink="slow",
            columns=("supply_voltage",)),
    Channel("sensor_supply", "analog_b", "i16", "V", "5 V sensor supply behind a divider", _VOLT),
    Channel("analog_1", "analog_b", "i16", "V", "free analog input", _VOLT, downlink="slow", columns=("analog_1",)),
    *(Channel(f"analog_{i}", "analog_c", "i16", "V", "free analog input", _VOLT, downlink="slow",
              columns=(f"analog_{i}",)) for i in range(2, 6)),
    Channel("pitot_pressure", "pitot", "u16", "Pa", "dynamic pressure, 14-bit count", columns=("p_dynamic", "V", "V_cas")),
    Channel("pitot_temperature", "pitot", "u16", "K", "pitot sensor die, 11-bit count", 200 / 2047, -50 + 273.15,
            downlink="slow"),
    Channel("static_pressure", "static", "u32", "Pa", "24-bit uncompensated pressure", columns=("p_static", "altitude",
            "rho", "V")),
    Channel("static_temperature", "static", "u32", "K", "24-bit uncompensated temperature",
            columns=("temperature", "rho", "p_static", "altitude", "V")),
    Channel("thrust_load", "thrust", "i32", "N", "load cell, + forward", columns=("thrust",)),
    *(Channel(f"pwm_{i}", "capture", "u16", "s", f"servo pulse width, output {i}", 1e-7,
              columns={1: ("cmd_e", "cmd_a"), 2: ("cmd_e", "cmd_a"), 3: ("cmd_r",), 4: ("throttle",)}.get(i, ()))
      for i in range(1, 7)),
    *(Channel(f"digital_{i}", "capture", "bit", "", "digital input" + (": event switch" if i == 1 else ""),
              columns=(f"digital_{i}",)) for i in range(1, 6)),
    Channel("gnss_itow", "gnss", "u32", "ms", "GPS time of week of the fix", rate=Rate.SLOW, downlink="slow"),
    Channel("gnss_utc_ns", "gnss", "u64", "ns", "UTC of the fix since 1970; 0 while not resolved", rate=Rate.SLOW,
            downlink="slow"),
    Channel("gnss_fix", "gnss", "u8", "", "fix type: 0 none, 2 2-D, 3 3-D", rate=Rate.SLOW, downlink="slow"),
    Channel("gnss_satellites", "gnss", "u8", "", "satellites used", rate=Rate.SLOW, downlink="slow"),
    Channel("latitude_e7", "gnss", "i32", "deg", "latitude, + north", 1e-7, rate=Rate.SLOW, downlink="slow",
            columns=("latitude",)),
    Channel("longitude_e7", "gnss", "i32", "deg", "longitude, + east", 1e-7, rate=Rate.SLOW, downlink="slow",
            columns=("longitude",)),
    Channel("height_msl_mm", "gnss", "i32", "m", "height above mean sea level", 1e-3, rate=Rate.SLOW, downlink="slow",
            columns=("altitude_gnss",)),
    Channel("velocity_north_mm", "gnss", "i32", "m/s", "ground velocity, + north", 1e-3, rate=Rate.SLOW,
            downlink="slow", columns=("vn",)),
    Channel("velocity_east_mm", "gnss", "i32", "m/s", "ground velocity, + east", 1e-3, rate=Rate.SLOW, downlink="slow",
            columns=("ve",)),
    Channel("velocity_down_mm", "gnss", "i32", "m/s", "ground velocity, + down", 1e-3, rate=Rate.SLOW, downlink="slow",
            columns=("vd",)),
    Channel("time_accuracy_ns", "gnss", "u32", "s", "time accuracy estimate", 1e-9, rate=Rate.SLOW, downlink="slow"),
    Channel("horizontal_accuracy_mm", "gnss", "u32", "m", "horizontal accuracy estimate", 1e-3, rate=Rate.SLOW,
            downlink="slow"),
    Channel("vertical_accuracy_mm", "gnss", "u32", "m", "vertical accuracy estimate", 1e-3, rate=Rate.SLOW,
            downlink="slow"),
    Channel("speed_accuracy_mm", "gnss", "u32", "m/s", "speed accuracy estimate", 1e-3, rate=Rate.SLOW,
            downlink="slow"),
)  # fmt: skip

_PI = 3.141592653589793

COLUMNS: tuple[Column, ...] = (
    *(Column(f"a{x}", "m/s2", f"specific force at the CG, {x} axis", "/acceleration", (-120.0, 120.0)) for x in "xyz"),
    Column("p", "rad/s", "roll rate, + right wing down", "/rates", (-10.0, 10.0)),
    Column("q", "rad/s", "pitch rate, + nose up", "/rates", (-10.0, 10.0)),
    Column("r", "rad/s", "yaw rate, + nose right", "/rates", (-10.0, 10.0)),
    Column("phi", "rad", "bank angle, + right wing down", "/attitude", (-_PI, _PI)),
    Column("theta", "rad", "pitch attitude, + nose up", "/attitude", (-_PI / 2, _PI / 2)),
    Column("psi", "rad", "heading from true north, + clockwise", "/attitude", (-_PI, 2 * _PI)),
    Column("alpha", "rad", "angle of attack, + wind from below", "/airdata/angles", (-_PI / 2, _PI / 2)),
    Column("beta", "rad", "sideslip, + wind from the right", "/airdata/angles", (-_PI / 2, _PI / 2)),
    Column("V", "m/s", "true airspeed", "/airdata/speed", (0.0, 350.0)),
    Column("V_cas", "m/s", "calibrated airspeed", "/airdata/speed", (0.0, 350.0)),
    Column("delta_e", "rad", "elevator, (left + right)/2, + trailing edge down", "/controls/measured", (-1.0, 1.0)),
    Column("delta_a", "rad", "aileron, + rolls left", "/controls/measured", (-1.0, 1.0)),
    Column("delta_r", "rad", "rudder, + trailing edge to port: force to +y, nose left", "/controls/measured",
           (-1.0, 1.0)),
    Column("cmd_e", "rad", "elevator commanded by PWM", "/controls/commanded", (-1.0, 1.0)),
    Column("cmd_a", "rad", "aileron commanded by PWM", "/controls/commanded", (-1.0, 1.0)),
    Column("cmd_r", "rad", "rudder commanded by PWM", "/controls/commanded", (-1.0, 1.0)),
    Column("throttle", "1", "throttle commanded by PWM, 0 to 1", "/controls/throttle", (-0.1, 1.1)),
    Column("thrust", "N", "thrust, + forward", "/propulsion", (-1e5, 1e6)),
    Column("rho", "kg/m3", "air density", "/airdata/density", (0.08, 1.6)),
    Column("p_static", "Pa", "static pressure", "/airdata/static", (5.0e3, 1.1e5)),
    Column("p_dynamic", "Pa", "pitot minus static pressure", "/airdata/dynamic", (-500.0, 7.0e4)),
    Column("temperature", "K", "outside air temperature", "/airdata/temperature", (180.0, 340.0)),
    Column("latitude", "deg", "latitude, + north", "/gnss/position", (-90.0, 90.0)),
    Column("longitude", "deg", "longitude, + east", "/gnss/position", (-180.0, 180.0)),
    Column("altitude", "m", "pressure altitude above mean sea level", "/airdata/altitude", (-500.0, 20_000.0)),
    Column("altitude_gnss", "m", "GPS height above mean sea level", "/gnss/altitude", (-500.0, 20_000.0)),
    Column("vn", "m/s", "ground velocity, + north", "/gnss/velocity", (-400.0, 400.0)),
    Column("ve", "m/s", "ground velocity, + east", "/gnss/velocity", (-400.0, 400.0)),
    Column("vd", "m/s", "ground velocity, + down", "/gnss/velocity", (-400.0, 400.0)),
    *(Column(f"m{x}", "T", f"magnetic field, {x} axis", "/magnetic", (-1e-4, 1e-4)) for x in "xyz"),
    *(Column(f"analog_{i}", "V", f"analog input {i}", "/inputs/analog", (-0.5, 6.5)) for i in range(1, 6)),
    *(Column(f"digital_{i}", "1", f"digital input {i}", "/inputs/digital", (0.0, 1.0)) for i in range(1, 6)),
    Column("supply_voltage", "V", "main supply", "/power", (0.0, 60.0)),
)  # fmt: skip

CHANNEL_BY_NAME: Mapping[str, Channel] = {c.name: c for c in CHANNELS}
COLUMN_BY_NAME: Mapping[str, Column] = {c.name: c for c in COLUMNS}
GROUP_NAMES: tuple[str, ...] = tuple(g.name for g in GROUPS)


def channels_of(group: str, channels: Iterable[Channel] = CHANNELS) -> tuple[Channel, ...]:
    """The channels read in one group, in table order."""
    return tuple(c for c in channels if c.group == group)


def sources_of(column: str, channels: Iterable[Channel] = CHANNELS) -> tuple[Channel, ...]:
    """The raw channels a calibrated column is made from, in table order."""
    return tuple(c for c in channels if column in c.columns)
