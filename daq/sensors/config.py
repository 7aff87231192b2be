"""`[sensors]` of the logger's configuration: fitted chips, their addresses and ranges, and limits of their health.

One section per sensor group of the channel table; a group without a section is not fitted and recorded as off. Sections of a
laboratory's own groups are under `[sensors.extra.NAME]`.
"""

import importlib
from typing import Annotated, Any

from pydantic import Field, field_validator, model_validator

from daq.contract.channels import CHANNEL_BY_NAME, GROUP_NAMES, channels_of
from daq.sensors.ads1115 import Ads1115, AnalogConfig
from daq.sensors.ak09916 import Ak09916, MagConfig
from daq.sensors.as5600 import As5600, EncoderConfig
from daq.sensors.autopilot import SENDERS, AutopilotGroup, AutopilotSection, MavlinkServo
from daq.sensors.base import (
    Address,
    Driver,
    DriverConfigError,
    DriverContext,
    NotNegative,
    Positive,
    SensorConfigSection,
    SensorSection,
)
from daq.sensors.bmp390 import Bmp390, StaticConfig
from daq.sensors.bmp581 import Bmp581
from daq.sensors.capture import Capture, CaptureConfig
from daq.sensors.dlvr import Dlvr
from daq.sensors.gpio_pwm import GpioPwm
from daq.sensors.icm20948 import Icm20948, ImuConfig
from daq.sensors.icm42688 import Icm42688
from daq.sensors.ms4525do import Ms4525do, PitotConfig
from daq.sensors.ms5525 import Ms5525
from daq.sensors.nau7802 import Nau7802, ThrustConfig
from daq.sensors.sbus import BAUD as SBUS_BAUD
from daq.sensors.sbus import Sbus
from daq.sensors.sdp3x import Sdp3x
from daq.sensors.ublox import GnssConfig, Ublox

CHIPS: tuple[type[Driver], ...] = (
    Icm20948,
    Icm42688,
    Ak09916,
    Ads1115,
    Ms4525do,
    Sdp3x,
    Dlvr,
    Ms5525,
    Bmp390,
    Bmp581,
    As5600,
    Nau7802,
    Capture,
    MavlinkServo,
    Sbus,
    GpioPwm,
    AutopilotGroup,
    Ublox,
)
"""All drivers. Each class defines its name, groups, order on the bus and limits of health, and its module the section with its
keys; `SensorsConfig` assigns sections to groups."""

DERIVED_GROUPS = frozenset({"attitude"})
"""Groups that are computed from others on board, unless an autopilot sends them."""


class BusConfig(SensorConfigSection):
    """`[sensors.bus]`: the I2C adapter. timeout_ms: longest transfer, on a bus that is held low."""

    device: str = "/dev/i2c-1"
    timeout_ms: Annotated[int, Field(ge=10, le=1000, multiple_of=10)] = 10


class AttitudeConfig(SensorSection):
    """`[sensors.attitude]`: the onboard attitude filter (imufusion).

    gain: weight of accelerometer and magnetometer against the gyro [1/s]; aided_gain: the same while GPS velocities give the
    acceleration of the flight path, which makes the direction of gravity more certain. acceleration_rejection_deg,
    magnetic_rejection_deg: a measured direction further off than this is not used; rejection_timeout_s: for at most so long.
    airspeed_correction: without GPS, subtract the centripetal acceleration of a turn, by the airspeed at the pitot's nominal
    scale, from the accelerometer. antenna_m: position of the GPS antenna relative to the IMU, body axes [m]. hard_iron_ut: offset
    subtracted from the magnetometer, body axes [uT]. declination_deg: positive east, added to the heading.
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
    standstill_dps: Positive = 1.5  # rates below this for standstill_s count as standstill
    standstill_s: Positive = 2.0


class HealthConfig(SensorConfigSection):
    """`[sensors.health]`: limits beyond which a sensor's samples are marked.

    stuck_s: channel -> longest time without a change [s]; other channels are not checked. plausible: channel -> lowest and
    highest raw value, where narrower than its raw type. max_step: channel -> largest change from one sample to the next
    [counts]; a single sample beyond it is marked out of range, a second one that agrees with it becomes the new level.
    """

    stuck_s: dict[str, Positive] = Field(
        default_factory=lambda: {c: s for chip in CHIPS for c, s in chip.stuck_s.items()}
    )
    plausible: dict[str, tuple[float, float]] = Field(default_factory=dict)
    max_step: dict[str, Positive] = Field(
        default_factory=lambda: {c: s for chip in CHIPS for c, s in chip.max_step.items()}
    )
    stale_s: Positive = 0.5  # a chip without new samples for longer is checked, and set up again
    trust_after: Annotated[int, Field(ge=1, le=1000)] = 5  # samples marked recovering after a failure
    retry_s: Positive = 0.1  # first pause before a missing sensor is set up again, doubled up to retry_limit_s
    retry_limit_s: Positive = 2.0

    @field_validator("stuck_s", "plausible", "max_step")
    @classmethod
    def _known_channels(cls, table: dict[str, Any]) -> dict[str, Any]:
        unknown = sorted(set(table) - set(CHANNEL_BY_NAME))
        if unknown:
            raise ValueError(f"{', '.join(unknown)}: no such channel")
        return table


class ExtraConfig(SensorSection):
    """`[sensors.extra.GROUP]`: a laboratory's own driver, `module:Class`, for a group of the channel table."""

    driver: Annotated[str, Field(pattern=r"^[\w.]+:\w+$")]
    address: Address | None = None
    options: dict[str, Any] = Field(default_factory=dict)


class SensorsConfig(SensorConfigSection):
    """`[sensors]`."""

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
    vane_alpha: EncoderConfig | None = None
    vane_beta: EncoderConfig | None = None
    autopilot: AutopilotSection | None = None
    health: HealthConfig = HealthConfig()
    extra: dict[str, ExtraConfig] = Field(default_factory=dict)

    def section(self, group: str) -> Any:
        """The section of a group of the channel table, a SensorSection; None when not fitted."""
        return self.extra.get(group) or getattr(self, group, None)

    @property
    def fitted(self) -> tuple[str, ...]:
        """Groups that are fitted, in table order."""
        return tuple(g for g in GROUP_NAMES if self.section(g) is not None)

    @property
    def from_sender(self) -> tuple[str, ...]:
        """Groups that an autopilot sends, dated by its clock."""
        return tuple(g for g in self.fitted if self.section(g).driver in SENDERS)

    @property
    def derived(self) -> tuple[str, ...]:
        """Groups that are computed from others on board."""
        return tuple(g for g in self.fitted if g in DERIVED_GROUPS and g not in self.from_sender)

    @property
    def autopilot_port(self) -> tuple[str, int] | None:
        """Device and baud rate of the port to an autopilot or an SBUS receiver; None where neither sends a group."""
        if self.has_sbus and self.capture is not None:
            return self.capture.device, SBUS_BAUD
        if not self.from_sender:
            return None
        capture = self.capture
        if capture is not None and capture.driver == MavlinkServo.name:
            return capture.device, capture.baud
        return None if self.autopilot is None else (self.autopilot.device, self.autopilot.baud)

    @property
    def without_bus(self) -> bool:
        """Whether pulse widths come from GPIO lines or a receiver's SBUS, not from the I2C bus."""
        return self.capture is not None and self.capture.driver in (GpioPwm.name, Sbus.name)

    @property
    def has_sbus(self) -> bool:
        """Whether pulse widths come from a receiver's SBUS."""
        return self.capture is not None and self.capture.driver == Sbus.name

    @model_validator(mode="after")
    def _consistent(self) -> "SensorsConfig":
        for group in self.extra:
            if group not in GROUP_NAMES or not channels_of(group):
                raise ValueError(f"extra.{group}: the channel table has no such group with channels")
            if getattr(self, group, None) is not None:
                raise ValueError(f"extra.{group} and {group} both claim the group; keep one")
        behind = self.imu is not None and self.imu.driver == "icm20948"
        if self.mag is not None and self.mag.driver == "ak09916" and not behind:
            raise ValueError("mag sits behind the imu, an ICM-20948; add that as [sensors.imu] or remove [sensors.mag]")
        self._check_autopilot()
        if "attitude" in self.derived and self.imu is None:
            raise ValueError("attitude needs the imu; add [sensors.imu] or remove [sensors.attitude]")
        self._check_addresses()
        return self

    def _check_autopilot(self) -> None:
        servo = self.capture is not None and self.capture.driver == MavlinkServo.name
        others = [g for g in self.from_sender if g != "capture" or not servo]
        if others and self.autopilot is None:
            raise ValueError(f"{others[0]} comes from the autopilot; add [sensors.autopilot] with its device and baud")
        if others and (servo or self.has_sbus):
            raise ValueError("capture listens on a port of its own; write driver = 'autopilot' in [sensors.capture]")

    def _check_addresses(self) -> None:
        group_at: dict[int, str] = {}
        for group in self.fitted:
            section = self.section(group)
            address = getattr(section, "address", None)
            if address is None or group in self.from_sender:
                continue
            if address in group_at:
                raise ValueError(f"{group_at[address]} and {group} share the I2C address 0x{address:02x}")
            group_at[address] = group


def build_drivers(config: SensorsConfig, context: DriverContext) -> dict[str, Driver]:
    """Drivers of all fitted groups that are not computed, in table order. Raises DriverConfigError, naming the key, for an
    unknown driver."""
    return {g: _driver(g, config, context) for g in config.fitted if g not in config.derived}


def _driver(group: str, config: SensorsConfig, context: DriverContext) -> Driver:
    section = config.section(group)
    if isinstance(section, ExtraConfig):
        return _laboratory_driver(group, section, context)
    serving = {chip.name: chip for chip in CHIPS if group in chip.groups}
    if section.driver not in serving:
        raise DriverConfigError(
            f"key sensors.{group}.driver: no driver {section.driver!r} for this group; use {', '.join(serving)}"
        )
    return serving[section.driver].build(group, context)


def _laboratory_driver(group: str, section: ExtraConfig, context: DriverContext) -> Driver:
    """A laboratory's own driver, built as `Class(group, section, bus, now_ns)`."""
    module_name, _, class_name = section.driver.partition(":")
    try:
        factory: Any = getattr(importlib.import_module(module_name), class_name)
    except (ImportError, AttributeError) as error:
        raise DriverConfigError(
            f"key sensors.extra.{group}.driver: {section.driver} cannot be loaded ({error})"
        ) from error
    driver = factory(group, section, context.bus, context.now_ns)
    if not isinstance(driver, Driver):
        raise DriverConfigError(f"key sensors.extra.{group}.driver: {section.driver} is not a daq.sensors.base.Driver")
    return driver
