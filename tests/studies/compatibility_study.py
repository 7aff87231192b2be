"""Do planted instrument factors come back within their bounds? `python -m tests.studies.compatibility_study [seeds]`.

Flights of the simulated aircraft through the direct sensor model; factors are planted in the columns. Prints, per
factor, mean error, root-mean-square of error over bound, and how often the 95 % interval covers the truth.
"""

import sys
from collections.abc import Mapping

import numpy as np

from estimation.compatibility.reconstruction import Factor, compatibility
from estimation.models.kinematic import STANDARD_FACTORS
from firmware_sim.direct import DirectNoise, direct_flights
from firmware_sim.scenario import load_scenario
from groundstation.flight import Flight

PLANTED: Mapping[str, float] = {
    "dax": 0.03, "day": -0.05, "daz": 0.04, "dp": 0.002, "dq": -0.001, "dr": 0.0015, "K_beta": 1.08, "dbeta": 0.0045,
}  # fmt: skip
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


def score(results: list[Mapping[str, Factor]], truth: Mapping[str, float]) -> dict[str, tuple[float, float, float]]:
    """Factor -> (mean error, rms error over corrected bound, coverage of the 95 % interval)."""
    table = {}
    for name in results[0]:
        neutral = 1.0 if name.startswith("K_") else 0.0
        error = np.array([r[name].estimate - truth.get(name, neutral) for r in results])
        ratio = error / np.array([r[name].std_coloured for r in results])
        table[name] = (float(error.mean()), float(np.sqrt(np.mean(ratio**2))), float(np.mean(np.abs(ratio) < 1.96)))
    return table


def main(count: int) -> None:
    """Print the tables."""
    seeds = list(range(100, 100 + count))
    for title, truth, factors in (
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
    ):
        known = {n: v for n, v in truth.items() if n not in factors}
        results = [compatibility(f, factors, known=known).factors for f in planted_flights(seeds, truth)]
        print(f"\n{title}, {count} seeds\n\n| factor | planted | mean error | rms error/bound | coverage of 95 % |")
        print("|---|---|---|---|---|")
        for name, (bias, ratio, cover) in score(results, truth).items():
            print(f"| {name} | {truth.get(name, 0.0):g} | {bias:+.2g} | {ratio:.2f} | {cover:.2f} |")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 50)
