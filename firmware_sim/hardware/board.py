"""The wiring of the simulated aircraft: which chip sits at which address and which instrument it looks at."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from firmware_sim.hardware.autopilot_cockpit import AutopilotCockpit
from firmware_sim.hardware.bus import Chip
from firmware_sim.hardware.cockpit import Cockpit
from firmware_sim.hardware.faults import ADDRESSES, FaultSet
from firmware_sim.hardware.registers.ads1115 import Ads1115Chip
from firmware_sim.hardware.registers.ak09916 import Ak09916Chip
from firmware_sim.hardware.registers.bmp390 import Bmp390Chip
from firmware_sim.hardware.registers.capture import CaptureChip
from firmware_sim.hardware.registers.chip import Inputs
from firmware_sim.hardware.registers.icm20948 import Icm20948Chip
from firmware_sim.hardware.registers.ms4525do import Ms4525doChip
from firmware_sim.hardware.registers.nau7802 import Nau7802Chip
from firmware_sim.hardware.registers.pca9685 import ALLCALL_ADDRESS, AllCall
from firmware_sim.hardware.sensing.instruments import Instruments
from firmware_sim.hardware.sensing.sensor_models import NAU7802_GAIN, SensorModels
from firmware_sim.hardware.sensing.signals import AT

ADC_WIRING: dict[str, tuple[str, str, str, str]] = {
    "analog_a": ("alpha_vane", "beta_vane", "elevon_left_pot", "elevon_right_pot"),
    "analog_b": ("rudder_pot", "supply", "sensor_supply", "analog_1"),
    "analog_c": ("analog_2", "analog_3", "analog_4", "analog_5"),
}
"""What is connected to AIN0 to AIN3 of each converter."""

MAG_FROM_CHIP = np.diag((1.0, -1.0, -1.0))
"""The magnetometer die lies reversed in y and z inside the ICM-20948."""


@dataclass(frozen=True, slots=True)
class Board:
    """The chips by bus address, and some of them by name for those who want to break one."""

    chips: dict[int, Chip]
    imu: Icm20948Chip
    capture: CaptureChip
    pitot: Ms4525doChip


def build_board(instruments: Instruments, faults: FaultSet, cockpit: Cockpit | AutopilotCockpit | None = None) -> Board:
    """All chips of the aircraft, looking at these instruments through the value faults of the scenario.

    cockpit: with a sequencer, whose servo driver and second capture co-processor then are on the bus too, unless it goes through
    an autopilot.
    """
    models = instruments.models
    imu = _imu(instruments, faults)
    pitot = Ms4525doChip(_pitot(instruments, faults))
    capture = CaptureChip(_capture(instruments, faults, cockpit))
    thrust = Nau7802Chip(_thrust(instruments, faults))
    static = Bmp390Chip(
        faults.bend("static", instruments.inputs("static_pressure", "static_temperature")),
        (models.static.noise_pa, models.static.noise_k),
        instruments.generator("static"),
    )
    static.frozen = lambda now_ns: faults.quiet("static", now_ns)
    chips: dict[int, Chip] = {
        ADDRESSES["imu"]: imu,
        ADDRESSES["mag"]: _mag(imu, instruments, faults),
        ADDRESSES["pitot"]: pitot,
        ADDRESSES["static"]: static,
        ADDRESSES["thrust"]: thrust,
        ADDRESSES["capture"]: capture,
    }
    for device, wiring in ADC_WIRING.items():
        clock_error = float(instruments.generator(f"{device} clock").uniform(-0.08, 0.08))
        chips[ADDRESSES[device]] = Ads1115Chip(_volts(instruments, faults, wiring), clock_error)
    if isinstance(cockpit, Cockpit):
        chips[ADDRESSES["servo_driver"]] = cockpit.chip
        chips[ALLCALL_ADDRESS] = AllCall(cockpit.chip)
        chips[ADDRESSES["pilot_inputs"]] = CaptureChip(_pilot_inputs(instruments, faults, cockpit))
    return Board(chips, imu, capture, pitot)


def _imu(instruments: Instruments, faults: FaultSet) -> Icm20948Chip:
    models = instruments.models.imu
    chip_from_body = np.array(models.body_from_chip).T
    raw = instruments.inputs(*(f"{s}_{a}" for s in ("accel", "gyro") for a in "xyz"), "imu_temperature")
    turn = np.zeros((7, 7))
    turn[:3, :3] = turn[3:6, 3:6] = chip_from_body
    turn[6, 6] = 1.0
    straight = bool(np.array_equal(turn, np.eye(7)))
    inputs: Inputs = raw if straight else lambda time_ns: turn @ np.asarray(raw(time_ns))
    turned = np.abs(chip_from_body)
    noise = (*(turned @ models.accel.noise), *(turned @ models.gyro.noise))
    imu = Icm20948Chip(faults.bend("imu", inputs), noise, instruments.generator("imu"))
    imu.frozen = lambda now_ns: faults.quiet("imu", now_ns)
    return imu


def _mag(imu: Icm20948Chip, instruments: Instruments, faults: FaultSet) -> Ak09916Chip:
    models = instruments.models
    turn = MAG_FROM_CHIP @ np.array(models.imu.body_from_chip).T
    raw = instruments.inputs("mag_x", "mag_y", "mag_z")
    inputs = faults.bend("mag", lambda time_ns: turn @ np.asarray(raw(time_ns)))
    mag = Ak09916Chip(imu, inputs, max(models.mag.field.noise), instruments.generator("mag"))
    mag.frozen = lambda now_ns: faults.quiet("mag", now_ns)
    return mag


def _pitot(instruments: Instruments, faults: FaultSet) -> Inputs:
    raw = instruments.inputs("pitot_pressure", "pitot_temperature")
    sigma, rng = instruments.models.pitot.noise_pa, instruments.generator("pitot")

    def inputs(time_ns: int) -> tuple[float, float]:
        pressure, temperature = raw(time_ns)
        return pressure + sigma * rng.standard_normal(), temperature

    return faults.bend("pitot", inputs)


def _thrust(instruments: Instruments, faults: FaultSet) -> Inputs:
    raw, rng, model = instruments.inputs("thrust_bridge"), instruments.generator("thrust"), instruments.models.thrust
    sigma = abs(model.noise_n * model.counts_per_newton) * 0.5 / (NAU7802_GAIN * 2**23)
    return faults.bend("thrust", lambda time_ns: (raw(time_ns)[0] + sigma * rng.standard_normal(),))


def _capture(instruments: Instruments, faults: FaultSet, cockpit: Cockpit | AutopilotCockpit | None) -> Inputs:
    names = (*(f"pwm_{i}" for i in range(1, 7)), *(f"digital_{i}" for i in range(1, 6)))
    raw, rng = instruments.inputs(*names), instruments.generator("capture")
    sigma = instruments.models.capture.jitter_us * 1e-6

    def inputs(time_ns: int) -> NDArray[np.float64]:
        values = np.array(raw(time_ns))
        if cockpit is not None:
            values = cockpit.behind(time_ns, values)
        values[:6] += (values[:6] > 0.0) * (sigma * rng.standard_normal())
        return values

    return faults.bend("capture", inputs)


def _pilot_inputs(instruments: Instruments, faults: FaultSet, cockpit: Cockpit) -> Inputs:
    rng, sigma = instruments.generator("pilot_inputs"), instruments.models.capture.jitter_us * 1e-6

    def inputs(time_ns: int) -> NDArray[np.float64]:
        values = np.array(cockpit.receiver(time_ns))
        values[:6] += (values[:6] > 0.0) * (sigma * rng.standard_normal(6))
        return values

    return faults.bend("pilot_inputs", inputs)


def _volts(
    instruments: Instruments, faults: FaultSet, wiring: tuple[str, str, str, str]
) -> Callable[[int, int], float]:
    sources = [_volt_source(instruments, faults, name) for name in wiring]
    return lambda channel, time_ns: sources[channel](time_ns)


def _volt_source(instruments: Instruments, faults: FaultSet, name: str) -> Callable[[int], float]:
    at, rng = AT[name], instruments.generator(name)
    sigma = converter_noise(instruments.models, name)
    plain: Callable[[int], float] = lambda time_ns: float(instruments.at(time_ns)[at]) + sigma * rng.standard_normal()  # noqa: E731
    bent = faults.bend(name, lambda time_ns: (plain(time_ns),))
    if not any(f.device == name for f in faults.of("stuck_value", "spikes")):
        return plain
    return lambda time_ns: float(bent(time_ns)[0])


def converter_noise(models: SensorModels, name: str) -> float:
    """Standard deviation of the voltage at a converter input [V], its own noise (a count) included."""
    own = 6e-5
    pots = {"elevon_left_pot": models.elevon_left, "elevon_right_pot": models.elevon_right, "rudder_pot": models.rudder}
    vanes = {"alpha_vane": models.alpha_vane, "beta_vane": models.beta_vane}
    sensor = pots.get(name) or vanes.get(name)
    if sensor is not None:
        return math.hypot(own, sensor.noise_rad * sensor.volts_per_rad)
    if name == "supply":
        return math.hypot(own, 10.0 * models.supply.ripple_v / models.supply.main_divider)
    if name == "sensor_supply":
        return math.hypot(own, models.supply.ripple_v / models.supply.sensor_divider)
    return math.hypot(own, models.analog_noise_v)
