"""The wiring of the simulated aircraft: which chip sits at which address and which instrument it looks at.

A laboratory brings simulated chips for sensors of its own by the entry point group `sideslip.chips`. The name of an entry point
is the sensor group, its value `module:make`; `make(instruments)` returns the chip, which sits at the address that
`[sensors.extra.GROUP]` of the logger's configuration says (docs/sensors.md).
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from importlib.metadata import entry_points

import numpy as np
from numpy.typing import NDArray

from daq.sensors.config import ExtraConfig, SensorsConfig
from daq.sensors.mounting import AS_PRINTED, rotation
from firmware_sim.hardware.autopilot_cockpit import AutopilotCockpit
from firmware_sim.hardware.cockpit import Cockpit
from firmware_sim.hardware.registers.ads1115 import Ads1115Chip
from firmware_sim.hardware.registers.ak09916 import Ak09916Chip
from firmware_sim.hardware.registers.as5600 import As5600Chip
from firmware_sim.hardware.registers.bmp390 import Bmp390Chip
from firmware_sim.hardware.registers.bmp581 import Bmp581Chip
from firmware_sim.hardware.registers.capture import CaptureChip
from firmware_sim.hardware.registers.chip import Inputs, PoweredChip
from firmware_sim.hardware.registers.dlvr import DlvrChip
from firmware_sim.hardware.registers.icm20948 import Icm20948Chip
from firmware_sim.hardware.registers.icm42688 import Icm42688Chip
from firmware_sim.hardware.registers.ms4525do import Ms4525doChip
from firmware_sim.hardware.registers.ms5525 import Ms5525Chip
from firmware_sim.hardware.registers.nau7802 import Nau7802Chip
from firmware_sim.hardware.registers.pca9685 import ALLCALL_ADDRESS, AllCall, Pca9685Chip
from firmware_sim.hardware.registers.sdp3x import Sdp3xChip
from firmware_sim.hardware.sensing.instruments import Instruments
from firmware_sim.hardware.sensing.sensor_models import AT, NAU7802_GAIN, SensorModels
from firmware_sim.tables import ScenarioError

ADC_WIRING: dict[str, tuple[str, str, str, str]] = {
    "analog_a": ("alpha_vane", "beta_vane", "elevon_left_pot", "elevon_right_pot"),
    "analog_b": ("rudder_pot", "supply", "sensor_supply", "analog_1"),
    "analog_c": ("analog_2", "analog_3", "analog_4", "analog_5"),
}
"""What is connected to AIN0 to AIN3 of each converter."""

SDP3X_NOISE_PA = 0.5
"""Of an SDP33 in flight: its data sheet's 0.2 Pa and what the tube makes."""

MAG_FROM_CHIP = np.diag((1.0, -1.0, -1.0))
"""The magnetometer die lies reversed in y and z inside the ICM-20948."""


@dataclass(frozen=True, slots=True)
class BoardWiring:
    """What chips are connected to. bend: the inputs of a device with its value faults in them, the same inputs without any.

    stuck: whether a device's measuring part is at a time [ns]. chips: those made so far, by device. sensors:
    what the logger expects.
    """

    instruments: Instruments
    bend: Callable[[str, Inputs], Inputs] = lambda device, inputs: inputs
    stuck: Callable[[str, int], bool] = lambda device, now_ns: False
    cockpit: Cockpit | AutopilotCockpit | None = None
    chips: dict[str, PoweredChip] = field(default_factory=dict)
    sensors: SensorsConfig = field(default_factory=SensorsConfig)

    def driver(self, device: str) -> str:
        """The driver that the logger has for a device; empty where it has none."""
        return getattr(self.sensors.section(device), "driver", "")

    @property
    def body_from_chip(self) -> NDArray[np.float64]:
        """Matrix (3, 3) that turns the IMU's printed axes into body axes: the scenario's, else as the logger has it mounted."""
        stated = self.instruments.models.imu.body_from_chip
        if stated is not None:
            return np.array(stated)
        turn = rotation(getattr(self.sensors.section("imu"), "mounting", AS_PRINTED))
        return np.array([turn(*unit) for unit in ((1, 0, 0), (0, 1, 0), (0, 0, 1))], float).T


def build_board(wiring: BoardWiring) -> dict[str, PoweredChip]:
    """All chips of the aircraft by device; with a cockpit the servo driver and the second capture co-processor too."""
    for device, (_, make) in CHIPS.items():
        if device not in ONLY_WITH_SEQUENCER or isinstance(wiring.cockpit, Cockpit):
            wiring.chips[device] = make(wiring, device)
    return wiring.chips


def sites(sensors: SensorsConfig) -> Mapping[str, int]:
    """Bus addresses of the devices: of those that the configuration puts in another's place, its own."""
    others = {g: s for g in sensors.fitted if (s := sensors.section(g)).driver in OTHERS}
    return {**ADDRESSES, **{group: section.address for group, section in others.items()}}


def addressed(board: Mapping[str, PoweredChip], places: Mapping[str, int]) -> dict[int, PoweredChip]:
    """The same chips by bus address; a servo driver answers at that of all such chips too."""
    moved = sorted(board, key=lambda device: places[device] != ADDRESSES[device])  # last: theirs is the address
    chips = {places[device]: board[device] for device in moved}
    driver = board.get("servo_driver")
    return chips if not isinstance(driver, Pca9685Chip) else {**chips, ALLCALL_ADDRESS: AllCall(driver)}


def _imu(wiring: BoardWiring, device: str) -> PoweredChip:
    instruments = wiring.instruments
    models = instruments.models.imu
    chip_from_body = wiring.body_from_chip.T
    raw = instruments.inputs(*(f"{s}_{a}" for s in ("accel", "gyro") for a in "xyz"), "imu_temperature")
    turn = np.zeros((7, 7))
    turn[:3, :3] = turn[3:6, 3:6] = chip_from_body
    turn[6, 6] = 1.0
    straight = bool(np.array_equal(turn, np.eye(7)))
    inputs: Inputs = raw if straight else lambda time_ns: turn @ np.asarray(raw(time_ns))
    turn_size = np.abs(chip_from_body)
    noise = (*(turn_size @ models.accel.noise), *(turn_size @ models.gyro.noise))
    chip = Icm42688Chip if wiring.driver(device) == "icm42688" else Icm20948Chip
    imu = chip(wiring.bend(device, inputs), noise, instruments.generator(device))
    imu.frozen = lambda now_ns: wiring.stuck(device, now_ns)
    return imu


def _mag(wiring: BoardWiring, device: str) -> PoweredChip:
    models, imu = wiring.instruments.models, wiring.chips["imu"]
    assert isinstance(imu, Icm20948Chip)
    turn = MAG_FROM_CHIP @ wiring.body_from_chip.T
    raw = wiring.instruments.inputs("mag_x", "mag_y", "mag_z")
    inputs = wiring.bend(device, lambda time_ns: turn @ np.asarray(raw(time_ns)))
    mag = Ak09916Chip(imu, inputs, max(models.mag.field.noise), wiring.instruments.generator(device))
    mag.frozen = lambda now_ns: wiring.stuck(device, now_ns)
    return mag


def _pitot(instruments: Instruments, wiring: BoardWiring) -> Inputs:
    """Impact pressure [Pa] at the sensor and its temperature [K], with the noise of the sensor and its value faults."""
    raw = instruments.inputs("pitot_pressure", "pitot_temperature")
    sigma, rng = instruments.models.pitot.noise_pa, instruments.generator("pitot")

    def inputs(time_ns: int) -> tuple[float, float]:
        pressure, temperature = raw(time_ns)
        return pressure + sigma * rng.standard_normal(), temperature

    return wiring.bend("pitot", inputs)


def _pitot_chip(wiring: BoardWiring, device: str) -> PoweredChip:
    inputs = _pitot(wiring.instruments, wiring)
    if wiring.driver(device) == "dlvr":
        assert wiring.sensors.pitot is not None
        return DlvrChip(inputs, wiring.sensors.pitot.span_pa[1])
    return Ms5525Chip(inputs) if wiring.driver(device) == "ms5525" else Ms4525doChip(inputs)


def _sdp3x(wiring: BoardWiring, device: str) -> PoweredChip:
    raw = wiring.instruments.inputs("pitot_pressure", "pitot_temperature", "static_pressure")
    rng = wiring.instruments.generator(device)

    def inputs(time_ns: int) -> tuple[float, float, float]:
        pressure, temperature, ambient = raw(time_ns)
        return pressure + SDP3X_NOISE_PA * rng.standard_normal(), temperature, ambient

    return Sdp3xChip(wiring.bend(device, inputs))


def _static(wiring: BoardWiring, device: str) -> PoweredChip:
    model = wiring.instruments.models.static
    inputs = wiring.bend(device, wiring.instruments.inputs("static_pressure", "static_temperature"))
    chip = Bmp581Chip if wiring.driver(device) == "bmp581" else Bmp390Chip
    static = chip(inputs, (model.noise_pa, model.noise_k), wiring.instruments.generator(device))
    static.frozen = lambda now_ns: wiring.stuck(device, now_ns)
    return static


def _thrust(wiring: BoardWiring, device: str) -> PoweredChip:
    instruments = wiring.instruments
    raw, rng, model = instruments.inputs("thrust_bridge"), instruments.generator(device), instruments.models.thrust
    sigma = abs(model.noise_n * model.counts_per_newton) * 0.5 / (NAU7802_GAIN * 2**23)
    return Nau7802Chip(wiring.bend(device, lambda time_ns: (raw(time_ns)[0] + sigma * rng.standard_normal(),)))


def _capture(wiring: BoardWiring, device: str) -> PoweredChip:
    names = (*(f"pwm_{i}" for i in range(1, 7)), *(f"digital_{i}" for i in range(1, 6)))
    raw, rng = wiring.instruments.inputs(*names), wiring.instruments.generator(device)
    sigma = wiring.instruments.models.capture.jitter_us * 1e-6

    def inputs(time_ns: int) -> NDArray[np.float64]:
        values = np.array(raw(time_ns))
        if wiring.cockpit is not None:
            values = wiring.cockpit.behind(time_ns, values)
        values[:6] += (values[:6] > 0.0) * (sigma * rng.standard_normal())
        return values

    return CaptureChip(wiring.bend(device, inputs))


def _pilot_inputs(wiring: BoardWiring, device: str) -> PoweredChip:
    cockpit, rng = wiring.cockpit, wiring.instruments.generator(device)
    sigma = wiring.instruments.models.capture.jitter_us * 1e-6
    assert isinstance(cockpit, Cockpit)

    def inputs(time_ns: int) -> NDArray[np.float64]:
        values = np.array(cockpit.receiver(time_ns))
        values[:6] += (values[:6] > 0.0) * (sigma * rng.standard_normal(6))
        return values

    return CaptureChip(wiring.bend(device, inputs))


def _servo_driver(wiring: BoardWiring, device: str) -> PoweredChip:
    assert isinstance(wiring.cockpit, Cockpit)
    return wiring.cockpit.chip


def _converter(wiring: BoardWiring, device: str) -> PoweredChip:
    clock_error = float(wiring.instruments.generator(f"{device} clock").uniform(-0.08, 0.08))
    sources = [_volts(wiring, name) for name in ADC_WIRING[device]]
    return Ads1115Chip(lambda channel, time_ns: sources[channel](time_ns), clock_error)


def _volts(wiring: BoardWiring, name: str) -> Callable[[int], float]:
    index, instruments = AT[name], wiring.instruments
    rng, sigma = instruments.generator(name), converter_noise(instruments.models, name)

    def volts(time_ns: int) -> float:
        return float(instruments.at(time_ns)[index]) + sigma * rng.standard_normal()

    def inputs(time_ns: int) -> tuple[float]:
        return (volts(time_ns),)

    bent = wiring.bend(name, inputs)
    return volts if bent is inputs else lambda time_ns: float(bent(time_ns)[0])


def _encoder(wiring: BoardWiring, device: str) -> PoweredChip:
    angle = device.removeprefix("vane_")
    models, rng = wiring.instruments.models, wiring.instruments.generator(device)
    sigma = (models.alpha_vane if angle == "alpha" else models.beta_vane).noise_rad
    raw = wiring.instruments.inputs(f"{angle}_encoder")

    def inputs(time_ns: int) -> tuple[float]:
        return (raw(time_ns)[0] + sigma * rng.standard_normal(),)

    encoder = As5600Chip(wiring.bend(device, inputs))
    encoder.frozen = lambda now_ns: wiring.stuck(device, now_ns)
    return encoder


CHIPS: Mapping[str, tuple[int, Callable[[BoardWiring, str], PoweredChip]]] = {
    "imu": (0x68, _imu),
    "pitot": (0x28, _pitot_chip),
    "capture": (0x40, _capture),
    "thrust": (0x2A, _thrust),
    "static": (0x77, _static),
    "mag": (0x0C, _mag),
    "analog_a": (0x48, _converter),
    "analog_b": (0x49, _converter),
    "analog_c": (0x4A, _converter),
    "servo_driver": (0x41, _servo_driver),
    "pilot_inputs": (0x42, _pilot_inputs),
    "vane_alpha": (0x36, _encoder),
    "vane_beta": (0x37, _encoder),
    "pitot_sdp3x": (0x21, _sdp3x),
}
"""Every chip of the simulated aircraft: its address on the bus and how it is wired. Value faults draw in this order."""

OTHERS = frozenset({"icm42688", "dlvr", "ms5525", "bmp581"})
"""Drivers whose chips sit in the place of the usual one, with its faults, when the configuration names them."""

ADDRESSES: Mapping[str, int] = {device: address for device, (address, _) in CHIPS.items()}
ONLY_WITH_SEQUENCER = frozenset({"servo_driver", "pilot_inputs"})
VALUE_DEVICES = CHIPS.keys() - ADC_WIRING.keys() - {"servo_driver"} | {
    name for row in ADC_WIRING.values() for name in row
}
"""What can be stuck or show spikes: chips, and of converters each input."""


def converter_noise(models: SensorModels, name: str) -> float:
    """Standard deviation of the voltage at a converter input [V], its own noise (a count) included."""
    converter_v = 6e-5
    pots = {"elevon_left_pot": models.elevon_left, "elevon_right_pot": models.elevon_right, "rudder_pot": models.rudder}
    vanes = {"alpha_vane": models.alpha_vane, "beta_vane": models.beta_vane}
    sensor = pots.get(name) or vanes.get(name)
    if sensor is not None:
        return math.hypot(converter_v, sensor.noise_rad * sensor.volts_per_rad)
    if name == "supply":
        return math.hypot(converter_v, 10.0 * models.supply.ripple_v / models.supply.main_divider)
    if name == "sensor_supply":
        return math.hypot(converter_v, models.supply.ripple_v / models.supply.sensor_divider)
    return math.hypot(converter_v, models.analog_noise_v)


ENTRY_POINTS = "sideslip.chips"


def laboratory_chips(extra: Mapping[str, ExtraConfig], instruments: Instruments) -> dict[int, PoweredChip]:
    """Chips by bus address for the sensors of one's own that have one; a sensor without one is absent in flight.

    Raises ScenarioError for a chip that cannot be had or whose address the configuration does not say.
    """
    chips: dict[int, PoweredChip] = {}
    for group, section in extra.items():
        for entry in entry_points(group=ENTRY_POINTS, name=group):
            if section.address is None:
                raise ScenarioError(f"sensors.extra.{group}: its simulated chip needs an address; add the key address")
            try:
                chips[section.address] = entry.load()(instruments)
            except (ImportError, AttributeError, TypeError) as error:
                raise ScenarioError(
                    f"entry point {ENTRY_POINTS} {group} = {entry.value}: no simulated chip there ({error})"
                ) from error
    return chips
