"""Individual instruments: every unit differs from the data sheet within its tolerances, and has to be calibrated.

`individual` draws such a set, the same for the same unit number on every flight. Tolerances are data-sheet limits read as two
standard deviations where one is given (ICM-20948 table 1 and 2, MS4525DO, NAU7802), engineering estimates elsewhere.
"""

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from firmware_sim.hardware.sensing.sensor_models import (
    Matrix,
    PotentiometerModel,
    SensorModels,
    TriadModel,
    VaneModel,
    Vector,
)

SCALE, ALIGNMENT_RAD = 0.005, 0.008  # of accelerometer and gyro axes
ACCEL_BIAS, GYRO_BIAS = 0.12, 0.008  # m/s2, rad/s
ACCEL_PER_K, GYRO_PER_K = 0.002, 1e-4
HARD_IRON, SOFT_IRON = 6e-6, 0.03  # T
CENTRE_V, SLOPE, CURVATURE = 0.04, 0.03, 0.02  # of vanes and potentiometers; V, relative, relative per rad2
PITOT_PA, PITOT_SLOPE, PITOT_PER_V = 8.0, 0.01, 30.0
STATIC_PA = 25.0
LOAD_SLOPE, LOAD_ZERO_N = 0.02, 0.3


def individual(models: SensorModels) -> SensorModels:
    """The instruments of unit `models.unit`; unit 0 is exactly as `models` says."""
    if models.unit == 0:
        return models
    rng = np.random.default_rng([models.unit, 0x0217])
    imu = models.imu
    return models.model_copy(
        update={
            "imu": imu.model_copy(
                update={
                    "accel": _triad(imu.accel, rng, SCALE, ALIGNMENT_RAD, ACCEL_BIAS, ACCEL_PER_K),
                    "gyro": _triad(imu.gyro, rng, SCALE, ALIGNMENT_RAD, GYRO_BIAS, GYRO_PER_K),
                }
            ),
            "mag": models.mag.model_copy(
                update={"field": _triad(models.mag.field, rng, SOFT_IRON, SOFT_IRON, HARD_IRON, 0.0)}
            ),
            **{name: _angle(getattr(models, name), rng) for name in _ANGLES},
            "pitot": models.pitot.model_copy(
                update={
                    "factor": models.pitot.factor * (1.0 + PITOT_SLOPE * rng.standard_normal()),
                    "offset_pa": models.pitot.offset_pa + PITOT_PA * rng.standard_normal(),
                    "offset_pa_per_v": models.pitot.offset_pa_per_v + PITOT_PER_V * rng.standard_normal(),
                }
            ),
            "static": models.static.model_copy(
                update={"offset_pa": models.static.offset_pa + STATIC_PA * rng.standard_normal()}
            ),
            "thrust": models.thrust.model_copy(
                update={
                    "counts_per_newton": models.thrust.counts_per_newton * (1.0 + LOAD_SLOPE * rng.standard_normal()),
                    "zero_n": models.thrust.zero_n + LOAD_ZERO_N * rng.standard_normal(),
                }
            ),
        }
    )


_Angle = TypeVar("_Angle", VaneModel, PotentiometerModel)
_ANGLES = ("alpha_vane", "beta_vane", "elevon_left", "elevon_right", "rudder")


def _angle(model: _Angle, rng: np.random.Generator) -> _Angle:
    slope = model.volts_per_rad * (1.0 + SLOPE * rng.standard_normal())
    return model.model_copy(
        update={
            "centre_v": model.centre_v + CENTRE_V * rng.standard_normal(),
            "volts_per_rad": slope,
            "cubic_v_per_rad3": model.cubic_v_per_rad3 + slope * CURVATURE * rng.standard_normal(),
        }
    )


def _triad(
    model: TriadModel, rng: np.random.Generator, scale: float, alignment: float, bias: float, per_kelvin: float
) -> TriadModel:
    off = alignment * rng.standard_normal((3, 3))
    np.fill_diagonal(off, scale * rng.standard_normal(3))
    matrix = np.array(model.matrix) @ (np.eye(3) + off)
    return model.model_copy(
        update={
            "matrix": _matrix(matrix),
            "bias": _vector(np.array(model.bias) + bias * rng.standard_normal(3)),
            "bias_per_kelvin": _vector(np.array(model.bias_per_kelvin) + per_kelvin * rng.standard_normal(3)),
        }
    )


def _vector(values: NDArray[np.float64]) -> Vector:
    x, y, z = (float(v) for v in values)
    return x, y, z


def _matrix(values: NDArray[np.float64]) -> Matrix:
    a, b, c = (_vector(row) for row in values)
    return a, b, c
