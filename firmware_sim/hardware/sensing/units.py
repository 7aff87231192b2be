"""Individual instruments: every unit differs from the data sheet within its tolerances, and has to be calibrated.

`individual` draws a set of instruments, the same for the same unit number on every flight. Tolerances are limits of the data
sheet, taken as two standard deviations (ICM-20948 tables 1 and 2, MS4525DO, NAU7802), and engineering estimates where it has
none.

`calibration_truth` gives the exact factors of these instruments, for comparison with fitted ones. Keys are the instrument names
of the calibration files. Triads: physical = matrix (reading - bias - bias_per_kelvin (T - reference_temperature)) with the die
temperature T as the chip reports it, without the turn-on bias, which is new at every power-up. Angle sensors: volts = centre +
slope angle + cubic angle^3 at 5 V supply."""

import math
from collections.abc import Mapping
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel

from daq.utilities.constants import PSI
from firmware_sim.hardware.registers.bmp390 import calibration_bytes
from firmware_sim.hardware.sensing.sensor_models import (
    REFERENCE_TEMPERATURE,
    Matrix,
    PotentiometerModel,
    SensorModels,
    TriadModel,
    VaneModel,
    Vector,
)
from firmware_sim.world.truth import PULSE_CENTRE_US, PULSE_PER_RAD_US

# all as one standard deviation
SCALE, ALIGNMENT_RAD = 0.005, 0.008  # of accelerometer and gyro axes
ACCEL_BIAS, GYRO_BIAS = 0.12, 0.008  # m/s2, rad/s
ACCEL_PER_K, GYRO_PER_K = 0.002, 1e-4
HARD_IRON, SOFT_IRON = 6e-6, 0.03  # T, relative
CENTRE_V, SLOPE, CURVATURE = 0.04, 0.03, 0.02  # of vanes and potentiometers; V, relative, relative per rad2
PITOT_PA, PITOT_SLOPE, PITOT_PER_V = 8.0, 0.01, 30.0  # Pa, relative, Pa/V
STATIC_PA = 25.0
LOAD_SLOPE, LOAD_ZERO_N = 0.02, 0.3  # relative, N
UNIT_SEED = 0x0217  # besides the unit number


def individual(models: SensorModels) -> SensorModels:
    """The instruments of unit `models.unit`; unit 0 is exactly as `models` says."""
    if models.unit == 0:
        return models
    rng = np.random.default_rng([models.unit, UNIT_SEED])
    imu, pitot, thrust = models.imu, models.pitot, models.thrust
    accel = _drawn_triad(imu.accel, rng, SCALE, ALIGNMENT_RAD, ACCEL_BIAS, ACCEL_PER_K)
    gyro = _drawn_triad(imu.gyro, rng, SCALE, ALIGNMENT_RAD, GYRO_BIAS, GYRO_PER_K)
    field = _drawn_triad(models.mag.field, rng, SOFT_IRON, SOFT_IRON, HARD_IRON, 0.0)
    return _altered(
        models,
        imu=_altered(imu, accel=accel, gyro=gyro),
        mag=_altered(models.mag, field=field),
        **{name: _drawn_angle(getattr(models, name), rng) for name in _ANGLES},
        pitot=_altered(
            pitot,
            factor=pitot.factor * (1.0 + PITOT_SLOPE * rng.standard_normal()),
            offset_pa=pitot.offset_pa + PITOT_PA * rng.standard_normal(),
            offset_pa_per_v=pitot.offset_pa_per_v + PITOT_PER_V * rng.standard_normal(),
        ),
        static=_altered(models.static, offset_pa=models.static.offset_pa + STATIC_PA * rng.standard_normal()),
        thrust=_altered(
            thrust,
            counts_per_newton=thrust.counts_per_newton * (1.0 + LOAD_SLOPE * rng.standard_normal()),
            zero_n=thrust.zero_n + LOAD_ZERO_N * rng.standard_normal(),
        ),
    )


_Model = TypeVar("_Model", bound=BaseModel)


def _altered(model: _Model, **values: Any) -> _Model:
    return model.model_copy(update=values)


_Angle = TypeVar("_Angle", VaneModel, PotentiometerModel)
_ANGLES = ("alpha_vane", "beta_vane", "elevon_left", "elevon_right", "rudder")


def _drawn_angle(model: _Angle, rng: np.random.Generator) -> _Angle:
    slope = model.volts_per_rad * (1.0 + SLOPE * rng.standard_normal())
    return _altered(
        model,
        centre_v=model.centre_v + CENTRE_V * rng.standard_normal(),
        volts_per_rad=slope,
        cubic_v_per_rad3=model.cubic_v_per_rad3 + slope * CURVATURE * rng.standard_normal(),
    )


def _drawn_triad(
    model: TriadModel, rng: np.random.Generator, scale: float, alignment: float, bias: float, per_kelvin: float
) -> TriadModel:
    errors = alignment * rng.standard_normal((3, 3))
    np.fill_diagonal(errors, scale * rng.standard_normal(3))
    return _altered(
        model,
        matrix=_matrix(np.array(model.matrix) @ (np.eye(3) + errors)),
        bias=_vector(np.array(model.bias) + bias * rng.standard_normal(3)),
        bias_per_kelvin=_vector(np.array(model.bias_per_kelvin) + per_kelvin * rng.standard_normal(3)),
    )


def _vector(values: NDArray[np.float64]) -> Vector:
    x, y, z = (float(v) for v in values)
    return x, y, z


def _matrix(values: NDArray[np.float64]) -> Matrix:
    a, b, c = (_vector(row) for row in values)
    return a, b, c


PA_PER_COUNT = 2.0 * PSI / (0.8 * 16383.0)  # MS4525DO of 1 psi, differential: 80 % of 14 bits are 2 psi
ZERO_COUNT = 8191.5  # of the same, at no pressure


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
            "zero_count": ZERO_COUNT + m.pitot.offset_pa / PA_PER_COUNT,
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
    # the bias depends on the air's temperature; referred to the die, which is warmer, its constant part is smaller
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
