"""Neural Gauss-Newton against known truth over many simulated flights: bias, scatter, and coverage of its intervals.

    python -m tests.studies.ngn_study                 30 flights, both forms, 20 Hz, noise as usual
    python -m tests.studies.ngn_study --grid          noise levels and sample rates, all methods
    python -m tests.studies.ngn_study --csv a.csv b.csv --truth key.json   flights of another simulator

Prints tables in Markdown; the last result is in docs/ngn.md.
"""

import argparse
import json
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from estimation.aircraft import load_aircraft
from estimation.laboratory import run_method
from estimation.models import load_model
from firmware_sim.aerodynamics import TABLE_5_ML_MEANS
from firmware_sim.direct import DirectNoise, direct_flights
from firmware_sim.scenario import load_scenario
from groundstation.flight import Flight, read_flight

STRONG = ("CY_beta", "CY_dr", "Cl_beta", "Cl_p", "Cl_da", "Cn_beta", "Cn_r", "Cn_dr")


def flights_of(seeds: Sequence[int], noise: float = 1.0, rate_hz: float = 20.0) -> list[Flight]:
    """30 s flights with manoeuvres on aileron and rudder in light gusts."""
    scenarios = [load_scenario("rich")] * len(seeds)
    flown = direct_flights(scenarios, list(seeds), DirectNoise(scale=noise), rate_hz)
    return [
        Flight.build(f"seed{seed}", columns["time"], {k: v for k, v in columns.items() if k != "time"})
        for seed, columns in zip(seeds, flown, strict=True)
    ]


def table(flights: Sequence[Flight], truth: Mapping[str, float], methods: Sequence[str]) -> None:
    """Per parameter and method: mean and standard deviation of the error [%], rms error/bound and coverage [%]."""
    aircraft = load_aircraft("cdfp")
    model = load_model("lateral", aircraft)
    print("| method | parameter | bias % | scatter % | error/CRB | error/spread | coverage % |")
    print("|---|---|---|---|---|---|---|")
    for method in methods:
        found = [run_method(method, model, [f], aircraft).parameters for f in flights]
        hits = 0.0
        errors = []
        for name in STRONG:
            error = np.array([r[name].estimate - truth[name] for r in found])
            crb = np.array([r[name].std for r in found])
            wide = np.array([r[name].std_coloured for r in found])
            relative = 100 * error / truth[name]
            errors.append(relative)
            coverage = float(np.mean(np.abs(error) < 1.96 * wide))
            hits += coverage / len(STRONG)
            print(
                f"| {method} | {name} | {relative.mean():+.1f} | {relative.std(ddof=1):.1f} | {_rms(error / crb):.1f} "
                f"| {_rms(error / wide):.1f} | {100 * coverage:.0f} |",
                flush=True,
            )
        worst = max(abs(float(e.mean())) for e in errors)
        mean = float(np.mean(np.abs(errors)))
        print(f"| {method} | all | worst {worst:.1f} | mean size {mean:.1f} | | | {100 * hits:.0f} |", flush=True)


def grid(seeds: Sequence[int], methods: Sequence[str]) -> None:
    """Mean size of the error and largest bias of the well-excited derivatives, over noise and sample rate."""
    aircraft = load_aircraft("cdfp")
    model = load_model("lateral", aircraft)
    print("| rate Hz | noise | " + " | ".join(methods) + " |")
    print("|---|---|" + "---|" * len(methods))
    for rate in (11.5, 20.0, 50.0):
        for noise in (0.3, 1.0, 2.0):
            flights = flights_of(seeds, noise, rate)
            cells = []
            for method in methods:
                found = [run_method(method, model, [f], aircraft).parameters for f in flights]
                e = np.array([[100 * (r[n].estimate / TABLE_5_ML_MEANS[n] - 1) for n in STRONG] for r in found])
                cells.append(f"{np.abs(e).mean():.1f} ({np.abs(e.mean(axis=0)).max():.1f})")
            print(f"| {rate:g} | {noise:g} | " + " | ".join(cells) + " |", flush=True)


def _rms(values: np.ndarray) -> float:  # type: ignore[type-arg]
    return float(np.sqrt(np.mean(values**2)))


def main() -> None:
    """Command line of the study."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=30)
    parser.add_argument("--first", type=int, default=100)
    parser.add_argument("--methods", default="ngn,ngn-improved")
    parser.add_argument("--grid", action="store_true")
    parser.add_argument("--csv", nargs="+", type=Path)
    parser.add_argument("--truth", type=Path)
    given = parser.parse_args()
    methods = given.methods.split(",")
    seeds = range(given.first, given.first + given.seeds)
    if given.csv:
        truth = json.loads(given.truth.read_text())
        table([read_flight(p) for p in given.csv], truth.get("ordinary", truth)["derivatives"], methods)
    elif given.grid:
        grid(seeds, ["ml", "ls", *methods])
    else:
        table(flights_of(seeds), TABLE_5_ML_MEANS, methods)


if __name__ == "__main__":
    main()
