"""Study: is the whole sensor chain, from the truth to the calibrated flight, unbiased?

Run: python -m tests.studies.chain_bias [seeds]. Each seed is a flight through instruments, chips, drivers and logger, calibrated
from its recording. Printed per column: mean error over the flights with its standard error, spread of the flights' mean
errors, rms error, and the delay left against the truth. Last result: docs/calibration.md.
"""

import sys
import tempfile
from pathlib import Path

import numpy as np

from firmware_sim.runs.flight import prepare_flight
from firmware_sim.world.scenario import load_scenario
from groundstation.calibration.calibration_set import NOMINAL_DIRECTORY
from groundstation.calibration.recording import calibrate_recording
from groundstation.flight import read_flight

COLUMNS = (
    "ax", "ay", "az", "p", "q", "r", "phi", "theta", "psi", "alpha", "beta", "V", "delta_e", "delta_a", "delta_r", "thrust",
    "p_static", "p_dynamic", "rho", "temperature", "altitude", "vn", "ve", "vd",
)  # fmt: skip
SETTLED_S = 8.0
DURATION_S = 40.0


def errors(seed: int, folder: Path) -> dict[str, tuple[float, float, float]]:
    """Mean error, rms error and delay [s] of each column in one flight."""
    with prepare_flight(
        load_scenario("rich"), folder, seed=seed, calibration=NOMINAL_DIRECTORY / "cdfp", duration_s=DURATION_S
    ) as prepared:
        prepared.run()
    flight, truth = calibrate_recording(folder / "onboard"), read_flight(folder / "truth.csv")
    settled = flight.time - flight.time[0] > SETTLED_S
    out = {}
    for column in COLUMNS:
        error = flight[column] - truth[column]
        if column in ("phi", "psi"):
            error = (error + np.pi) % (2 * np.pi) - np.pi
        good = settled & np.isfinite(error)
        mean, rms = float(error[good].mean()), float(np.sqrt(np.mean(error[good] ** 2)))
        slope = np.gradient(truth[column], truth.time)[good]
        motion = float(slope @ slope)
        out[column] = (mean, rms, -float((error[good] - mean) @ slope) / motion if motion > 0 else float("nan"))
    return out


def main(seeds: int) -> None:
    """Print the table."""
    found: dict[str, list[tuple[float, float, float]]] = {c: [] for c in COLUMNS}
    for seed in range(1, seeds + 1):
        with tempfile.TemporaryDirectory() as folder:
            for column, values in errors(seed, Path(folder)).items():
                found[column].append(values)
    print(
        "| column | mean error | its standard error | spread over flights | rms error | delay left, ms |\n"
        + 6 * "|---"
        + "|"
    )
    for column, rows in found.items():
        mean, rms, delay = np.array(rows).T
        spread = float(np.std(mean, ddof=1))
        error = spread / np.sqrt(seeds)
        late = (
            f"{np.median(delay) * 1e3:+.1f}"
            if column in ("p", "q", "r", "phi", "theta", "psi", "beta", "delta_a", "delta_r", "ay")
            else ""
        )
        print(
            f"| {column} | {np.mean(mean):+.3g} | {error:.2g} | {spread:.2g} | {np.sqrt(np.mean(rms**2)):.2g} | {late} |",
            flush=True,
        )


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 20)
