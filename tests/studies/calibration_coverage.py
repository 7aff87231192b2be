"""Study: do bench fits give back the instruments' truth within their stated uncertainty, over many individual units?

Run: python -m tests.studies.calibration_coverage [units]. Every bench of the simulator is recorded through chips and logger
for each unit, fitted, and compared with `firmware_sim.hardware.sensing.units`. Last result: docs/calibration.md.
"""

import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from firmware_sim.hardware.sensing.sensor_models import SensorModels
from firmware_sim.hardware.sensing.units import calibration_truth
from firmware_sim.runs.bench_recordings import record_bench
from groundstation.calibration import curves
from groundstation.calibration.bench import fit_bench
from groundstation.calibration.bench_plan import load_plan
from groundstation.calibration.calibration_set import NOMINAL_DIRECTORY
from groundstation.calibration.schema import Instrument

BENCHES = (
    "bench_angles",
    "bench_tunnel",
    "bench_load",
    "bench_chamber",
    "bench_faces",
    "bench_turntable",
    "bench_swing",
)
_ANGLE = ("alpha_vane", "beta_vane", "elevon_left", "elevon_right", "rudder")


def fit_unit(unit: int, name: str, folder: Path) -> list[Instrument]:
    """Record one bench of an individual unit and fit it."""
    made = record_bench(
        name, folder / f"{name}_{unit}", seed=unit, sensors={"unit": unit}, calibration=NOMINAL_DIRECTORY / "cdfp"
    )
    fits = fit_bench(folder / f"{name}_{unit}" / "onboard", load_plan(made.plan))
    return [fit.instrument for fit in fits]


def scores(item: Instrument, truth: Mapping[str, Any]) -> dict[str, float]:
    """Error over stated sigma of what was fitted: values of a curve at three inputs, elements of a triad."""
    if item.curve is not None:
        at = np.linspace(*item.curve.valid, 5)[1:-1]
        error = curves.evaluate(item.curve, at) - _true_output(item.instrument, truth, at)
        sigma = curves.standard_deviation(item.curve, at)
        return {f"{item.instrument}[{i}]": float(e / s) for i, (e, s) in enumerate(zip(error, sigma, strict=True))}
    if item.triad is not None:
        return _triad_scores(item, truth)
    if item.static is not None:
        return {"static": (item.static.pressure_offset - truth["pressure_offset"]) / item.static.uncertainty}
    raise ValueError(f"{item.instrument}: nothing to compare")


def _true_output(name: str, truth: Mapping[str, Any], at: np.ndarray) -> np.ndarray:
    if name in _ANGLE:
        angle = (at - truth["centre_v"]) / truth["volts_per_rad"]
        for _ in range(20):  # volts = centre + (slope + cubic angle^2) angle, solved for the angle
            angle = (at - truth["centre_v"]) / (truth["volts_per_rad"] + truth["cubic_v_per_rad3"] * angle**2)
        return np.asarray(angle)
    if name == "pitot":
        # zero of the sensor in counts, then the slope with the port's factor
        return np.asarray((at - truth["zero_count"]) * truth["pa_per_count"])
    return np.asarray((at - truth["zero_count"]) * truth["newton_per_count"])


# One sigma of a bias that is new at every power-up, which no bench can know.
TURN_ON = {"accelerometer": 0.02, "gyro": 0.001, "magnetometer": 0.0}


def _triad_scores(item: Instrument, truth: Mapping[str, Any]) -> dict[str, float]:
    assert item.triad is not None
    matrix, true = np.array(item.triad.matrix), np.array(truth["matrix"])
    if item.instrument == "magnetometer":
        # magnitudes do not show a rotation of the whole triad: compare the symmetric part
        true = _symmetric(true)
    slope, true_slope = np.array(item.triad.bias_per_kelvin), np.array(truth["bias_per_kelvin"])
    # both lines at the middle of the bench's temperatures, 10 K above the day's
    warm = 10.0
    error = np.array(item.triad.bias) - np.array(truth["bias"]) + warm * (slope - true_slope)
    sigma = np.hypot(np.array(item.triad.uncertainty), TURN_ON[item.instrument])
    out = {f"{item.instrument} bias {a}": float(e / s) for a, e, s in zip("xyz", error, sigma, strict=True)}
    for i in range(3):
        for j in range(3):
            out[f"{item.instrument} matrix {i}{j}"] = float((matrix - true)[i, j] / item.triad.matrix_uncertainty)
    return out


def _symmetric(matrix: np.ndarray) -> np.ndarray:
    """The symmetric factor of the polar decomposition, rotation on the left."""
    _, values, rows = np.linalg.svd(matrix)
    return np.asarray(rows.T @ np.diag(values) @ rows)


def main(units: int) -> None:
    """Print rms of error over sigma, and the share within one and two sigma, by bench."""
    print(
        "| bench | compared | rms of error/sigma | within 1 sigma | within 2 sigma | worst |\n|---|---|---|---|---|---|"
    )
    for name in BENCHES:
        found: list[float] = []
        for unit in range(1, units + 1):
            truth = calibration_truth(SensorModels().altered(unit=unit))
            with tempfile.TemporaryDirectory() as folder:
                for item in fit_unit(unit, name, Path(folder)):
                    found += scores(item, truth[item.instrument]).values()
        z = np.abs(found)
        print(
            f"| {name} | {z.size} | {np.sqrt(np.mean(z**2)):.2f} | {np.mean(z < 1):.0%} | {np.mean(z < 2):.0%} | {z.max():.1f} |",
            flush=True,
        )


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 20)
