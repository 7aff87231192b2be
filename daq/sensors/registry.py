"""Which driver serves which group: from the configuration's `driver` names to driver objects.

A driver of one's own needs no entry here: `[sensors.extra.GROUP]` names it as `module:Class`, and the class is built
as `Class(group, section, bus, now_ns)`.
"""

import importlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from daq.contract.channels import GROUP_NAMES
from daq.contract.errors import UserError
from daq.sensors.ads1115 import Ads1115
from daq.sensors.ak09916 import Ak09916
from daq.sensors.base import Driver
from daq.sensors.bmp390 import Bmp390
from daq.sensors.bus import I2cBus, SerialPortCalls
from daq.sensors.capture import Capture
from daq.sensors.config import ExtraConfig, SensorsConfig
from daq.sensors.icm20948 import Icm20948
from daq.sensors.mavlink_servo import MavlinkServo
from daq.sensors.ms4525do import Ms4525do
from daq.sensors.nau7802 import Nau7802
from daq.sensors.timebase import TimeBase
from daq.sensors.ublox import Ublox


class DriverConfigError(UserError):
    """A driver that the configuration asks for but that cannot be had."""


@dataclass(frozen=True, slots=True)
class Surroundings:
    """What drivers are connected to. `autopilot` is the serial port of `mavlink_servo`."""

    bus: I2cBus | None
    gnss: SerialPortCalls | None
    autopilot: SerialPortCalls | None
    now_ns: Callable[[], int]
    timebase: TimeBase

    def need_bus(self, group: str) -> I2cBus:
        """The bus. Raises DriverConfigError when there is none."""
        if self.bus is None:
            raise DriverConfigError(f"sensors.{group} needs an I2C bus and none was opened; set sensors.bus.device")
        return self.bus

    def need_port(self, port: SerialPortCalls | None, group: str) -> SerialPortCalls:
        """The serial port. Raises DriverConfigError when there is none."""
        if port is None:
            raise DriverConfigError(
                f"sensors.{group} needs a serial port and none was opened; set sensors.{group}.device"
            )
        return port


Builder = Callable[[str, SensorsConfig, Surroundings], Driver]


def _icm20948(group: str, config: SensorsConfig, around: Surroundings) -> Driver:
    return Icm20948(config.section(group), around.need_bus(group))


def _ak09916(group: str, config: SensorsConfig, around: Surroundings) -> Driver:
    return Ak09916(config.section(group), config.section("imu"), around.need_bus(group))


def _ads1115(group: str, config: SensorsConfig, around: Surroundings) -> Driver:
    return Ads1115(config.section(group), group, around.need_bus(group), around.now_ns)


def _ms4525do(group: str, config: SensorsConfig, around: Surroundings) -> Driver:
    return Ms4525do(config.section(group), around.need_bus(group))


def _bmp390(group: str, config: SensorsConfig, around: Surroundings) -> Driver:
    return Bmp390(config.section(group), around.need_bus(group))


def _nau7802(group: str, config: SensorsConfig, around: Surroundings) -> Driver:
    return Nau7802(config.section(group), around.need_bus(group))


def _capture(group: str, config: SensorsConfig, around: Surroundings) -> Driver:
    return Capture(config.section(group), around.need_bus(group), around.now_ns)


def _mavlink_servo(group: str, config: SensorsConfig, around: Surroundings) -> Driver:
    return MavlinkServo(config.section(group), around.need_port(around.autopilot, group), around.now_ns)


def _ublox(group: str, config: SensorsConfig, around: Surroundings) -> Driver:
    return Ublox(config.section(group), around.need_port(around.gnss, group), around.now_ns, around.timebase)


DRIVERS: dict[str, tuple[tuple[str, ...], Builder]] = {
    "icm20948": (("imu",), _icm20948),
    "ak09916": (("mag",), _ak09916),
    "ads1115": (("analog_a", "analog_b", "analog_c"), _ads1115),
    "ms4525do": (("pitot",), _ms4525do),
    "bmp390": (("static",), _bmp390),
    "nau7802": (("thrust",), _nau7802),
    "capture": (("capture",), _capture),
    "mavlink_servo": (("capture",), _mavlink_servo),
    "ublox": (("gnss",), _ublox),
}
"""Driver name -> groups it can serve, and how it is built."""

DERIVED_GROUPS = frozenset({"attitude"})
"""Groups computed from others, without a chip."""


def build_driver(group: str, config: SensorsConfig, around: Surroundings) -> Driver:
    """The driver of a fitted group. Raises DriverConfigError naming the key when there is none."""
    section = config.section(group)
    if isinstance(section, ExtraConfig):
        return _load(group, section, around)
    groups, builder = DRIVERS.get(section.driver, ((), None))
    if builder is None or group not in groups:
        known = ", ".join(name for name, (served, _) in DRIVERS.items() if group in served)
        raise DriverConfigError(f"key sensors.{group}.driver: no driver {section.driver!r} for this group; use {known}")
    return builder(group, config, around)


def build_drivers(config: SensorsConfig, around: Surroundings) -> dict[str, Driver]:
    """Drivers of all fitted groups with a chip, in table order."""
    return {g: build_driver(g, config, around) for g in GROUP_NAMES if g in config.fitted and g not in DERIVED_GROUPS}


def _load(group: str, section: ExtraConfig, around: Surroundings) -> Driver:
    module_name, _, class_name = section.driver.partition(":")
    try:
        factory: Any = getattr(importlib.import_module(module_name), class_name)
    except (ImportError, AttributeError) as error:
        raise DriverConfigError(
            f"key sensors.extra.{group}.driver: {section.driver} cannot be loaded ({error})"
        ) from error
    driver = factory(group, section, around.bus, around.now_ns)
    if not isinstance(driver, Driver):
        raise DriverConfigError(f"key sensors.extra.{group}.driver: {section.driver} is not a daq.sensors.base.Driver")
    return driver
