"""What a perfect calibration of the simulated instruments would find: exact factors, for comparison with fitted ones.

Keys are the instrument names of the calibration files. Triads are given the way they are applied: physical = matrix
(reading - bias - bias_per_kelvin (T - reference_temperature)) with the die temperature T as the chip reports it; turn-on
biases, new at every power-up, are left out. Angle sensors: volts = centre + slope angle + cubic angle^3 at 5 V supply.
"""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from daq.contract.constants import PSI
from firmware_sim.hardware.registers.bmp390 import calibration_bytes
from firmware_sim.hardware.sensing.instruments import REFERENCE_TEMPERATURE
from firmware_sim.hardware.sensing.sensor_models import PotentiometerModel, SensorModels, TriadModel, VaneModel
from firmware_sim.hardware.sensing.units import individual
from firmware_sim.world.truth import PULSE_CENTRE_US, PULSE_PER_RAD_US

PA_PER_COUNT = 2.0 * PSI / (0.8 * 16383.0)


def calibration_truth(models: SensorModels) -> dict[str, Mapping[str, Any]]:
    """The exact calibration of each instrument of `models` (of its individual unit), SI and radians."""
    m = individual(models)
    warm = m.imu.die_above_air_k
    truth: dict[str, Mapping[str, Any]] = {
        "accelerometer": _triad(m.imu.accel, warm) | {"position": m.imu.position},
        "gyro": _triad(m.imu.gyro, warm),
        "magnetometer": _triad(m.mag.field, 0.0),
        "alpha_vane": _vane(m.alpha_vane),
        "beta_vane": _vane(m.beta_vane),
        "elevon_left": _angle(m.elevon_left),
        "elevon_right": _angle(m.elevon_right),
        "rudder": _angle(m.rudder),
        "pitot": {
            "zero_count": 8191.5 + m.pitot.offset_pa / PA_PER_COUNT,
            "pa_per_count": PA_PER_COUNT / m.pitot.factor,
            "offset_pa": m.pitot.offset_pa,
            "factor": m.pitot.factor,
            "offset_pa_per_v": m.pitot.offset_pa_per_v,
            "delay": m.pitot.lag_s,
        },
        "static": {
            "nvm": calibration_bytes().hex(),
            "position_error": m.static.position_error,
            "pressure_offset": -m.static.offset_pa,
            "temperature_offset": -m.static.die_above_air_k,
        },
        "thrust": {
            "newton_per_count": 1.0 / m.thrust.counts_per_newton,
            "zero_count": m.thrust.zero_n * m.thrust.counts_per_newton,
        },
        "supply": {"volts_per_volt": m.supply.main_divider},
        "sensor_supply": {"volts_per_volt": m.supply.sensor_divider},
        "attitude": {"declination": 0.0},
    }
    for name, signal in (("alpha_vane", "alpha_vane"), ("beta_vane", "beta_vane"), ("pitot", "pitot_pressure")):
        truth[name] = {**truth[name], "delay": truth[name]["delay"] + m.delays.get(signal, 0.0)}
    for i in (1, 2, 3):
        truth[f"pwm_{i}"] = {"centre_s": PULSE_CENTRE_US * 1e-6, "rad_per_s": 1e6 / PULSE_PER_RAD_US}
    return truth


def _triad(model: TriadModel, die_above_air_k: float) -> dict[str, Any]:
    per_kelvin = np.array(model.bias_per_kelvin)
    # The bias follows the air's temperature; seen against the warmer die it is less by the difference.
    bias = np.array(model.bias) - per_kelvin * die_above_air_k
    return {
        "matrix": np.linalg.inv(np.array(model.matrix)),
        "bias": bias,
        "bias_per_kelvin": per_kelvin,
        "reference_temperature": REFERENCE_TEMPERATURE,
    }


def _vane(model: VaneModel) -> dict[str, Any]:
    return _angle(model) | {
        "position": model.position,
        "wash_factor": model.wash_factor,
        "wash_offset": model.wash_offset,
        "delay": model.damping / (math.pi * model.frequency_hz),
    }


def _angle(model: VaneModel | PotentiometerModel) -> dict[str, Any]:
    return {
        "centre_v": model.centre_v,
        "volts_per_rad": model.volts_per_rad,
        "cubic_v_per_rad3": model.cubic_v_per_rad3,
    }
