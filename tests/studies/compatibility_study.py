"""Do planted instrument factors come back within their bounds?

`python -m tests.studies.compatibility_study [seeds [table ...]]`: flights of the simulated aircraft through the direct
sensor model; factors are planted in the columns. `... chain [seeds]`: flights through instruments, chips, drivers, logger,
attitude filter and calibration, factors planted in the instruments. `... steps FIRST LAST TABLE`: the first Gauss-Newton
step from the truth for seeds FIRST up to LAST, which costs a tenth. Prints, per factor, mean error, root-mean-square of
error over bound, and how often the 95 % interval covers the truth.
"""

import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from estimation.compatibility.problem import USEFUL, CompatibilityProblem, information_and_gradient
from estimation.compatibility.reconstruction import FactorEstimate, compatibility
from estimation.models.kinematic import MEASUREMENTS, STANDARD_FACTORS, compatibility_model
from firmware_sim.runs.direct import DirectNoise, direct_flights
from firmware_sim.runs.flight import prepare_flight
from firmware_sim.world.scenario import Scenario, load_scenario
from groundstation.calibration.calibration_set import NOMINAL_DIRECTORY
from groundstation.calibration.recording import calibrate_recording
from groundstation.flight import Flight

PLANTED: Mapping[str, float] = {
    "dax": 0.03,
    "day": -0.05,
    "daz": 0.04,
    "dp": 0.002,
    "dq": -0.001,
    "dr": 0.0015,
    "K_beta": 1.08,
    "dbeta": 0.0045,
}
GEOMETRY: Mapping[str, float] = {"x_vane": 0.35, "x_imu": 0.06, "tau_beta": 0.06}


def planted_flights(seeds: list[int], factors: Mapping[str, float]) -> list[Flight]:
    """Flights with the factors in their columns: noise comes after them, as in an instrument."""
    scenario = load_scenario("rich")
    exact = direct_flights([scenario] * len(seeds), seeds, DirectNoise(scale=0.0))
    noise = direct_flights([scenario] * len(seeds), seeds, DirectNoise())
    return [plant(f"seed{s}", e, n, factors) for s, e, n in zip(seeds, exact, noise, strict=True)]


def plant(
    name: str, exact: Mapping[str, np.ndarray], noisy: Mapping[str, np.ndarray], factors: Mapping[str, float]
) -> Flight:
    """One flight with factors planted."""
    time = exact["time"]
    columns = {k: noisy[k].copy() for k in noisy if k != "time"}
    rates = {r: np.gradient(exact[r], time) for r in "pqr"}
    p, q, r = (exact[k] for k in "pqr")
    x = factors.get("x_imu", 0.0)
    columns["ax"] += -(q**2 + r**2) * x
    columns["ay"] += (rates["r"] + p * q) * x
    columns["az"] += (-rates["q"] + p * r) * x
    for axis in "xyz":
        columns[f"a{axis}"] += factors.get(f"da{axis}", 0.0)
    for rate in "pqr":
        columns[rate] += factors.get(f"d{rate}", 0.0)
    v = exact["V"]
    moved = exact["beta"] + r * factors.get("x_vane", 0.0) / v
    late = np.interp(time - factors.get("tau_beta", 0.0), time, moved)
    shown = factors.get("K_beta", 1.0) * late + factors.get("dbeta", 0.0)
    columns["beta"] = shown + (noisy["beta"] - exact["beta"])
    return Flight.build(name, time, columns)


def score(
    results: list[Mapping[str, FactorEstimate]], truth: Mapping[str, float]
) -> dict[str, tuple[float, float, float]]:
    """Factor -> (mean error, rms error over corrected bound, coverage of the 95 % interval)."""
    table = {}
    for name in results[0]:
        neutral = 1.0 if name.startswith("K_") else 0.0
        error = np.array([r[name].estimate - truth.get(name, neutral) for r in results])
        ratio = error / np.array([r[name].std_coloured for r in results])
        table[name] = (float(error.mean()), float(np.sqrt(np.mean(ratio**2))), float(np.mean(np.abs(ratio) < 1.96)))
    return table


STUDIES: Sequence[tuple[str, Mapping[str, float], tuple[str, ...]]] = (
    ("Table 2 factors", PLANTED, STANDARD_FACTORS),
    (
        "with vane position and delay, IMU position known",
        {**PLANTED, **GEOMETRY},
        (*STANDARD_FACTORS, "x_vane", "tau_beta"),
    ),
    (
        "with IMU position and delay, vane position known",
        {**PLANTED, **GEOMETRY},
        (*STANDARD_FACTORS, "x_imu", "tau_beta"),
    ),
)


def chain(seeds: Sequence[int]) -> None:
    """Flights of the scenarios cdfp_ld1 to cdfp_ld4 through instruments, chips, drivers, logger and calibration."""
    ratios: dict[str, list[float]] = {}
    errors: dict[str, list[float]] = {}
    for name in ("cdfp_ld1", "cdfp_ld2", "cdfp_ld3", "cdfp_ld4"):
        scenario = load_scenario(name)
        for seed in seeds:
            with tempfile.TemporaryDirectory() as folder:
                with prepare_flight(
                    scenario, Path(folder), seed=seed, calibration=NOMINAL_DIRECTORY / "cdfp"
                ) as prepared:
                    prepared.run()
                found = compatibility(calibrate_recording(Path(folder) / "onboard")).factors
            for factor, truth in planted_in(scenario).items():
                error = found[factor].estimate - truth
                errors.setdefault(factor, []).append(error)
                ratios.setdefault(factor, []).append(error / found[factor].std_coloured)
            print(name, seed, " ".join(f"{f} {r[-1]:+.2f}" for f, r in ratios.items()), flush=True)
    print("\n| factor | mean error | rms error | rms error/bound | coverage of 95 % |\n|---|---|---|---|---|")
    for factor, r in ratios.items():
        e, cover = np.array(errors[factor]), np.mean(np.abs(r) < 1.96)
        print(
            f"| {factor} | {e.mean():+.2g} | {np.sqrt(np.mean(e**2)):.2g} | {np.sqrt(np.mean(np.square(r))):.2f} | {cover:.2f} |"
        )


def planted_in(scenario: Scenario) -> dict[str, float]:
    """The factors of Table 2 that a scenario's sensors were given."""
    sensors = scenario.sensors
    force, rate, vane = sensors["imu"]["accel"]["bias"], sensors["imu"]["gyro"]["bias"], sensors["beta_vane"]
    return {
        **{f"da{a}": b for a, b in zip("xyz", force, strict=True)},
        **{f"d{a}": b for a, b in zip("pqr", rate, strict=True)},
        "K_beta": vane["wash_factor"],
        "dbeta": vane["wash_offset"],
    }


def first_steps(seeds: Sequence[int], wanted: int) -> None:
    """The first Gauss-Newton step from the planted factors, over its bound: cheaper than an estimate, and near it."""
    _, truth, factors = STUDIES[wanted]
    known = {n: v for n, v in truth.items() if n not in factors}
    model = compatibility_model(factors, tuple(MEASUREMENTS), known)
    p = np.array([truth[n] for n in model.parameter_names])
    sizes = np.array([1e-3 * USEFUL[q.unit] for q in model.parameters])
    ratios = []
    for flight in planted_flights(list(seeds), truth):
        problem = CompatibilityProblem(model, [flight])
        problem.settle_turbulence(p)
        runs = problem.relax(p, 3)
        information, gradient = information_and_gradient(runs, problem.slopes(p, sizes))
        ratios.append(-np.linalg.solve(information, gradient) / np.sqrt(np.diag(np.linalg.inv(information))))
    print("| factor | mean step/bound | rms step/bound | coverage of 95 % |\n|---|---|---|---|")
    for name, r in zip(model.parameter_names, np.array(ratios).T, strict=True):
        print(f"| {name} | {r.mean():+.2f} | {np.sqrt(np.mean(r**2)):.2f} | {np.mean(np.abs(r) < 1.96):.2f} |")


def main(count: int, wanted: Sequence[int]) -> None:
    """Print the tables numbered `wanted`, 0 upward."""
    seeds = list(range(100, 100 + count))
    for title, truth, factors in (STUDIES[i] for i in wanted):
        known = {n: v for n, v in truth.items() if n not in factors}
        results = [compatibility(f, factors, known=known).factors for f in planted_flights(seeds, truth)]
        print(f"\n{title}, {count} seeds\n\n| factor | planted | mean error | rms error/bound | coverage of 95 % |")
        print("|---|---|---|---|---|")
        for name, (bias, ratio, cover) in score(results, truth).items():
            print(f"| {name} | {truth.get(name, 0.0):g} | {bias:+.2g} | {ratio:.2f} | {cover:.2f} |", flush=True)


if __name__ == "__main__":
    arguments = sys.argv[1:]
    if arguments[:1] == ["chain"]:
        chain(range(201, 201 + int(arguments[1])))
    elif arguments[:1] == ["steps"]:
        first_steps(range(int(arguments[1]), int(arguments[2])), int(arguments[3]))
    else:
        main(int(arguments[0]) if arguments else 50, [int(a) for a in arguments[1:]] or range(len(STUDIES)))
