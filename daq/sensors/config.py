"""`[sensors]` of the logger's configuration: which chips are fitted, where, at what ranges, and how they are judged.

One section per sensor group of the channel table; a section that is left out means "not fitted" and its group is
recorded as off. Group sections of a laboratory's own go under `[sensors.extra.NAME]`.
"""

from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, field_validator, model_validator

from daq.contract.channels import CHANNEL_BY_NAME, GROUP_NAMES, channels_of

Axis = Literal["+x", "-x", "+y", "-y", "+z", "-z"]
Mounting = tuple[Axis, Axis, Axis]
Address = Annotated[int, Field(ge=0x08, le=0x77, description="7-bit I2C address")]
Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]


def one_of(*choices: float) -> AfterValidator:
    """A validator that accepts the listed values only."""

    def check(value: float) -> float:
        if value not in choices:
            raise ValueError(f"must be one of {', '.join(f'{c:g}' for c in choices)}")
        return value

    return AfterValidator(check)


GyroLowpass = Annotated[float, one_of(361.4, 196.6, 151.8, 119.5, 51.2, 23.9, 11.6, 5.7)]
AccelLowpass = Annotated[float, one_of(473.0, 246.0, 111.4, 50.4, 23.9, 11.5, 5.7)]
AdcRange = Annotated[float, one_of(6.144, 4.096, 2.048, 1.024, 0.512, 0.256)]
LoadCellSupply = Annotated[float, one_of(2.4, 2.7, 3.0, 3.3, 3.6, 3.9, 4.2, 4.5)]
AdcRate = Literal[8, 16, 32, 64, 128, 250, 475, 860]

_DETERMINANT_SIGN = {"xyz": 1, "yzx": 1, "zxy": 1, "xzy": -1, "zyx": -1, "yxz": -1}


class SensorConfigSection(BaseModel):
    """Base of the sections: unknown keys are mistakes, values do not change after reading."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class SensorSection(SensorConfigSection):
    """What all sensors have in common.

    every: read in every n-th scan; left out, the smallest n at which the chip can deliver a new sample each time.
    required: a flight is refused by the preflight check while this sensor is not well.
    """

    every: Annotated[int, Field(ge=1, le=100_000)] | None = None
    required: bool = True


class BusConfig(SensorConfigSection):
    """`[sensors.bus]`: the I2C adapter. timeout_ms bounds a transfer on a bus that is held low."""

    device: str = "/dev/i2c-1"
    timeout_ms: Annotated[int, Field(ge=10, le=1000, multiple_of=10)] = 10


def check_mounting(mounting: Mounting) -> Mounting:
    """A mounting that is a rotation: each chip axis once, right-handed. Raises ValueError otherwise."""
    letters = "".join(axis[1] for axis in mounting)
    if letters not in _DETERMINANT_SIGN:
        raise ValueError(f"mounting must name each of x, y and z once, not {', '.join(mounting)}")
    sign = _DETERMINANT_SIGN[letters]
    for axis in mounting:
        sign *= -1 if axis[0] == "-" else 1
    if sign < 0:
        raise ValueError(f"mounting {', '.join(mounting)} is a mirror image, not a rotation; change one sign")
    return mounting


class ImuConfig(SensorSection):
    """`[sensors.imu]`: ICM-20948 accelerometer and gyro.

    mounting: the chip axis that lies along body x (forward), y (right) and z (down).
    lowpass: 3 dB bandwidths of the chip's filters [Hz]; one value of the datasheet's list.
    """

    driver: str = "icm20948"
    address: Address = 0x68
    accel_range_g: Literal[2, 4, 8, 16] = 8
    gyro_range_dps: Literal[250, 500, 1000, 2000] = 500
    accel_lowpass_hz: AccelLowpass = 11.5
    gyro_lowpass_hz: GyroLowpass = 11.6
    mounting: Mounting = ("+x", "+y", "+z")

    _rotation = field_validator("mounting")(check_mounting)


class MagConfig(SensorSection):
    """`[sensors.mag]`: AK09916, reached through the IMU's bypass; it turns with the IMU's mounting."""

    driver: str = "ak09916"
    address: Address = 0x0C
    rate_hz: Literal[10, 20, 50, 100] = 100


class AttitudeConfig(SensorSection):
    """`[sensors.attitude]`: the onboard attitude filter (imufusion).

    gain: weight of accelerometer and magnetometer against the gyro [1/s]; aided_gain: the same while GPS velocities tell
    the accelerations of the path, so that the plumb line deserves more. rejection_deg: a direction further off
    than this is not used. airspeed_correction: without GPS, take the turn's centripetal acceleration, from the pitot's
    nominal transfer function, out of the accelerometer before it is used as a plumb line.
    antenna_m: the GPS antenna's place from the IMU, body axes [m].
    hard_iron_ut: body-axes offset taken off the magnetometer [uT]; declination_deg: + east, added to the heading.
    """

    driver: str = "imufusion"
    gain: Annotated[float, Field(ge=0, le=10)] = 0.2
    aided_gain: Annotated[float, Field(ge=0, le=10)] = 0.4
    acceleration_rejection_deg: Annotated[float, Field(ge=0, le=90)] = 10.0
    magnetic_rejection_deg: Annotated[float, Field(ge=0, le=90)] = 20.0
    rejection_timeout_s: NotNegative = 5.0
    use_magnetometer: bool = True
    airspeed_correction: bool = True
    antenna_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    hard_iron_ut: tuple[float, float, float] = (0.0, 0.0, 0.0)
    declination_deg: Annotated[float, Field(ge=-180, le=180)] = 0.0
    standstill_dps: Positive = 1.5  # rates below this for standstill_s count as standing still
    standstill_s: Positive = 2.0


class AnalogConfig(SensorSection):
    """`[sensors.analog_a]` and so on: one ADS1115. inputs: the chip input of each channel of the group, in order."""

    driver: str = "ads1115"
    address: Address
    range_v: AdcRange = 4.096
    samples_per_second: AdcRate = 860
    inputs: tuple[int, int, int, int] = (0, 1, 2, 3)

    @field_validator("inputs")
    @classmethod
    def _each_once(cls, inputs: tuple[int, ...]) -> tuple[int, ...]:
        if sorted(inputs) != [0, 1, 2, 3]:
            raise ValueError("inputs must name each of 0, 1, 2 and 3 once")
        return inputs


class PitotConfig(SensorSection):
    """`[sensors.pitot]`: MS4525DO; output type A spans 10 to 90 % of the counts, type B 5 to 95 %."""

    driver: str = "ms4525do"
    address: Address = 0x28
    output: Literal["A", "B"] = "A"
    range_pa: tuple[float, float] = (-6894.757, 6894.757)

    @field_validator("range_pa")
    @classmethod
    def _rising(cls, range_pa: tuple[float, float]) -> tuple[float, float]:
        if range_pa[0] >= range_pa[1]:
            raise ValueError("range_pa must be [lowest, highest]")
        return range_pa


class StaticConfig(SensorSection):
    """`[sensors.static]`: BMP390 or BMP388."""

    driver: str = "bmp390"
    address: Literal[0x76, 0x77] = 0x77
    chip: Literal["bmp390", "bmp388"] = "bmp390"
    rate_hz: Literal[25, 50, 100, 200] = 50
    pressure_oversampling: Literal[1, 2, 4, 8, 16, 32] = 8
    temperature_oversampling: Literal[1, 2, 4, 8, 16, 32] = 1

    @model_validator(mode="after")
    def _fits_the_interval(self) -> "StaticConfig":
        # BMP390 datasheet rev 1.7, section 3.9.2: conversion time by oversampling
        conversion = 234 + 392 + self.pressure_oversampling * 2020 + 163 + self.temperature_oversampling * 2020
        if conversion * self.rate_hz > 1_000_000:
            raise ValueError(
                f"a conversion takes {conversion / 1000:.1f} ms, longer than 1/rate_hz; lower the oversampling or rate_hz"
            )
        return self


class ThrustConfig(SensorSection):
    """`[sensors.thrust]`: load cell on a NAU7802."""

    driver: str = "nau7802"
    address: Address = 0x2A
    gain: Literal[1, 2, 4, 8, 16, 32, 64, 128] = 128
    rate_hz: Literal[10, 20, 40, 80, 320] = 80
    supply_v: LoadCellSupply = 3.0


class CaptureConfig(SensorSection):
    """`[sensors.capture]`: PWM widths and digital inputs.

    driver `capture` is the co-processor on I2C; `mavlink_servo` listens to an autopilot's SERVO_OUTPUT_RAW on the
    serial `device` instead (no digital inputs then). pwm_inputs: how many of the six are wired and must be alive.
    """

    driver: str = "capture"
    address: Address = 0x40
    timeout_ms: Annotated[int, Field(ge=10, le=250)] = 50
    debounce_ms: Annotated[int, Field(ge=0, le=250)] = 10
    pwm_inputs: Annotated[int, Field(ge=0, le=6)] = 4
    device: str = "/dev/ttyACM0"
    baud: Annotated[int, Field(ge=1200)] = 115200


class GnssConfig(SensorSection):
    """`[sensors.gnss]`: u-blox receiver.

    generation: how it is told what to send; `m9` (and M10) by CFG-VALSET, `m8` by the older messages, `none` leaves
    the receiver as it was set up. latency_s: from the instant of a fix to the first byte of its message, the receiver's
    computing time; the time on the line follows from `baud`. No data sheet states it: measure it once against a pulse.
    pps: sysfs file of the kernel's pulse-per-second stamps, e.g. /sys/class/pps/pps0/assert.
    """

    driver: str = "ublox"
    device: str = "/dev/serial0"
    baud: Annotated[int, Field(ge=9600)] = 115200
    rate_hz: Annotated[float, Field(gt=0, le=25)] = 10.0
    generation: Literal["m9", "m8", "none"] = "m9"
    latency_s: Annotated[float, Field(ge=0, le=1)] = 0.05
    pps: str | None = None

    @property
    def arrival_s(self) -> float:
        """From the instant of a fix to the last byte of its NAV-PVT message: 100 bytes of ten bits [s]."""
        return self.latency_s + 1000.0 / self.baud


# A quiet chip still shows its own noise: these are many times the longest run of equal codes that noise permits.
_STUCK_S: dict[str, float] = {
    **dict.fromkeys(("accel_x", "accel_y", "accel_z", "gyro_x", "gyro_y", "gyro_z"), 1.0),
    **dict.fromkeys(("mag_x", "mag_y", "mag_z"), 3.0),
    **dict.fromkeys(("alpha_vane", "beta_vane"), 2.0),
    **dict.fromkeys(("elevon_left_pot", "elevon_right_pot", "rudder_pot"), 10.0),
    "pitot_pressure": 3.0,
    "static_pressure": 1.0,
    "thrust_load": 1.0,
}

# Per sample at 20 Hz; far beyond what a 3 kg aircraft does in 50 ms, far below what a broken wire does.
_MAX_STEP: dict[str, float] = {
    **dict.fromkeys(("accel_x", "accel_y", "accel_z"), 20000.0),
    **dict.fromkeys(("gyro_x", "gyro_y", "gyro_z"), 30000.0),
    **dict.fromkeys(("alpha_vane", "beta_vane"), 12000.0),
    "pitot_pressure": 1500.0,
    "static_pressure": 40000.0,
}


class HealthConfig(SensorConfigSection):
    """`[sensors.health]`: when a sensor is no longer believed.

    stuck_s: longest time a channel may show one and the same value; channels not named are not watched.
    plausible: lowest and highest raw value of a channel, where narrower than its raw type.
    max_step: largest change from one sample to the next [counts]; a single sample beyond it is marked out of range,
    a second one that agrees with it is taken as the new level.
    """

    stuck_s: dict[str, Positive] = Field(default_factory=lambda: dict(_STUCK_S))
    plausible: dict[str, tuple[float, float]] = Field(default_factory=dict)
    max_step: dict[str, Positive] = Field(default_factory=lambda: dict(_MAX_STEP))
    stale_s: Positive = 0.5  # an answering chip without new samples for longer is looked into, then set up anew
    trust_after: Annotated[int, Field(ge=1, le=1000)] = 5  # good samples after a return before they count again
    retry_s: Positive = 0.1  # first wait before an absent sensor is tried again, doubled up to retry_limit_s
    retry_limit_s: Positive = 2.0

    @field_validator("stuck_s", "plausible", "max_step")
    @classmethod
    def _known_channels(cls, table: dict[str, Any]) -> dict[str, Any]:
        unknown = sorted(set(table) - set(CHANNEL_BY_NAME))
        if unknown:
            raise ValueError(f"{', '.join(unknown)}: no such channel")
        return table


class ExtraConfig(SensorSection):
    """`[sensors.extra.GROUP]`: a driver of one's own, `module:Class`, for a group of the channel table."""

    driver: Annotated[str, Field(pattern=r"^[\w.]+:\w+$")]
    address: Address | None = None
    options: dict[str, Any] = Field(default_factory=dict)


class SensorsConfig(SensorConfigSection):
    """The whole of `[sensors]`."""

    bus: BusConfig = BusConfig()
    imu: ImuConfig | None = None
    mag: MagConfig | None = None
    attitude: AttitudeConfig | None = None
    analog_a: AnalogConfig | None = None
    analog_b: AnalogConfig | None = None
    analog_c: AnalogConfig | None = None
    pitot: PitotConfig | None = None
    static: StaticConfig | None = None
    thrust: ThrustConfig | None = None
    capture: CaptureConfig | None = None
    gnss: GnssConfig | None = None
    health: HealthConfig = HealthConfig()
    extra: dict[str, ExtraConfig] = Field(default_factory=dict)

    def section(self, group: str) -> Any:
        """The section that decides about a group of the channel table: a SensorSection, or None when not fitted."""
        return self.extra.get(group) or getattr(self, group, None)

    @property
    def fitted(self) -> tuple[str, ...]:
        """Groups that are fitted, in table order."""
        return tuple(g for g in GROUP_NAMES if self.section(g) is not None)

    @model_validator(mode="after")
    def _consistent(self) -> "SensorsConfig":
        for group in self.extra:
            if group not in GROUP_NAMES or not channels_of(group):
                raise ValueError(f"extra.{group}: the channel table has no such group with channels")
            if getattr(self, group, None) is not None:
                raise ValueError(f"extra.{group} and {group} both claim the group; keep one")
        if self.mag is not None and self.mag.driver == "ak09916" and self.imu is None:
            raise ValueError("mag sits behind the imu; add [sensors.imu] or remove [sensors.mag]")
        if self.attitude is not None and self.imu is None:
            raise ValueError("attitude needs the imu; add [sensors.imu] or remove [sensors.attitude]")
        self._check_addresses()
        return self

    def _check_addresses(self) -> None:
        taken: dict[int, str] = {}
        for group in self.fitted:
            section = self.section(group)
            address = getattr(section, "address", None)
            if address is None or section.driver == "mavlink_servo":
                continue
            if address in taken:
                raise ValueError(f"{taken[address]} and {group} share the I2C address 0x{address:02x}")
            taken[address] = group


def cdfp_sensors() -> SensorsConfig:
    """The CDFP's full fit at its default addresses and ranges."""
    return SensorsConfig(
        imu=ImuConfig(),
        mag=MagConfig(),
        attitude=AttitudeConfig(),
        analog_a=AnalogConfig(address=0x48),
        analog_b=AnalogConfig(address=0x49),
        analog_c=AnalogConfig(address=0x4A, required=False),
        pitot=PitotConfig(),
        static=StaticConfig(),
        thrust=ThrustConfig(required=False),
        capture=CaptureConfig(),
        gnss=GnssConfig(required=False),
    )
