"""The part of noisy measured inputs in a predicted bound.

A Cramer-Rao bound assumes exact inputs. The surfaces, airspeed, angle of attack and pitch of a flight are measured: their noise
passes through the aircraft into the residuals, where it is coloured and larger than that of the sensors. So the motion is
prepared DRAWS times like a flight, each time with other noise on its inputs. The differences d of the outputs have the covariance
D between samples, and the estimates have the covariance

    M^-1 (S' W (R + D) W S) M^-1,    M = S' W S,    W = (R + D_0)^-1

with the sensitivities S of outputs to parameters and initial states, the noise R of the sensors, and D_0 the part of D within a
sample, to which maximum likelihood fits its noise (R. V. Jategaonkar, Flight Vehicle System Identification, 2nd ed.,
section 4.10: errors in inputs; the form is that of an M-estimator, P. J. Huber 1967).
"""

import math
from collections.abc import Mapping

import numpy as np

from estimation.design.predict import NOISE, RANK, DesignSetting, PredictedMotion, output_noise, sampled
from estimation.engine.simulate import Simulator
from estimation.errors import EstimationError
from estimation.models.base import Signal
from estimation.prepare.flight_data import FlightData
from estimation.prepare.pipeline import prepare_all
from groundstation.flight import Array, Flight

DRAWS = 50
"""Flights with noisy inputs: from these, the added standard deviation is known to 10 %."""
LEAST_DRAWS = 20
"""For a long manoeuvre, whose flights take longer to prepare: 16 %."""
USUAL_SAMPLES = 400  # 20 s at 20 Hz
LEAST_SENSOR_SHARE = 0.25
"""Least share of the sensor in the variance of a channel's residuals: with less, the noise assumed of the inputs is too large."""
INPUT_NOISE = {**NOISE, "thrust": 0.15, "V_dot": 0.0, "rho": 0.0}
"""Noise of the inputs where no estimate gives one, 1 sigma; air density is computed, not measured sample by sample."""
SURFACE_NOISE = math.radians(0.07)
"""Of a potentiometer read with 12 bits, 1 sigma [rad]."""


def expected_errors(
    setting: DesignSetting, motion: PredictedMotion, bounds: Mapping[str, float], seed: int, draws: int = DRAWS
) -> dict[str, float]:
    """Parameter -> standard deviation of estimates from this motion with all sensors noisy.

    bounds: Cramer-Rao bounds with exact inputs; infinite ones stay infinite. draws: flights with noisy inputs; fewer, but at
    least LEAST_DRAWS, for a manoeuvre of more than USUAL_SAMPLES. Raises EstimationError where the model diverges.
    """
    rng = np.random.default_rng([seed, 21])
    simulator = Simulator.build(setting.model)
    values = {**setting.model.starts(), **setting.values}
    x0 = np.array([setting.condition.trim_value(s.name) for s in setting.model.states])
    run = simulator.run(_flight(setting, motion, None).segments[0], values, x0, sensitivities=True)
    if run.dy is None or not run.finite:
        raise EstimationError(
            f"model {setting.model.name} leaves all bounds in this manoeuvre; make it smaller or shorter"
        )
    count = draws if len(run.y) <= USUAL_SAMPLES else max(LEAST_DRAWS, draws * USUAL_SAMPLES // len(run.y))
    output_errors = [
        simulator.run(_flight(setting, motion, rng).segments[0], values, x0).y - run.y for _ in range(count)
    ]
    finite = [d for d in output_errors if np.isfinite(d).all()]
    if not finite:
        raise EstimationError(
            f"model {setting.model.name} leaves all bounds where its inputs are as noisy as measured ones"
        )
    error_covariance = np.mean([d.T @ d / len(d) for d in finite], axis=0)
    std = _scatter(run.dy, _sensor_noise(setting, run.y, np.diag(error_covariance)), error_covariance, finite)
    return {n: float(std[i]) if math.isfinite(bounds[n]) else math.inf for i, n in enumerate(simulator.free)}


def _sensor_noise(setting: DesignSetting, y: Array, from_inputs: Array) -> Array:
    """(ny, ny) covariance R of the sensors. from_inputs (ny,): variance that noisy inputs add to the residuals."""
    variance = np.array([output_noise(setting, s, y[:, i]) ** 2 for i, s in enumerate(setting.model.outputs)])
    return np.diag(
        np.maximum(variance - from_inputs, LEAST_SENSOR_SHARE * variance) if setting.noise_of_residuals else variance
    )


def _scatter(sensitivities: Array, sensor_noise: Array, error_covariance: Array, output_errors: list[Array]) -> Array:
    """Standard deviation of each unknown. sensitivities (N, ny, n); sensor_noise, error_covariance (ny, ny): R, D_0;
    output_errors: (N, ny) draws of d."""
    weight = np.linalg.inv(sensor_noise + error_covariance)
    weighted = np.einsum("tyn,yz->tzn", sensitivities, weight)
    scale = np.sqrt(np.maximum(np.einsum("tyn,tyn->n", weighted, sensitivities), 1e-300))
    weighted = weighted / scale
    inverse = np.linalg.pinv(np.einsum("tyn,tym->nm", weighted, sensitivities / scale), rcond=RANK, hermitian=True)
    middle = np.einsum("tyn,yz,tzm->nm", weighted, sensor_noise, weighted)
    for d in output_errors:
        slope = np.einsum("tyn,ty->n", weighted, d)
        middle += np.outer(slope, slope) / len(output_errors)
    return np.sqrt(np.diag(inverse @ middle @ inverse)) / scale


def _flight(setting: DesignSetting, motion: PredictedMotion, rng: np.random.Generator | None) -> FlightData:
    """The motion prepared for the model like a recorded flight. rng: of the noise on the inputs, None for exact ones."""
    keep = sampled(setting, motion)
    columns = {}
    for signal in (*setting.model.inputs, *setting.model.states, *setting.model.outputs):
        values = motion.surfaces.get(signal.name, motion.signals.get(signal.name))
        columns[signal.source] = (
            np.full(keep.size, setting.condition.trim_value(signal.name)) if values is None else values[keep]
        )
    if rng is not None:
        for signal in setting.model.inputs:
            columns[signal.source] = columns[signal.source] + input_noise(setting, signal) * rng.standard_normal(
                keep.size
            )
    return prepare_all(setting.model, Flight.build("predicted", motion.time[keep], columns))[0]


def input_noise(setting: DesignSetting, signal: Signal) -> float:
    """Noise of one input's instrument, 1 sigma; 0 where it is not known."""
    if signal.control:
        return setting.noise.get(signal.name, SURFACE_NOISE)
    return setting.noise.get(signal.name, INPUT_NOISE.get(signal.name, 0.0))
