"""Neural Gauss-Newton against known truth over many simulated flights: bias, scatter, and coverage of its intervals.

    python -m tests.studies.ngn_study                 30 flights, both forms, 20 Hz, noise as usual
    python -m tests.studies.ngn_study --seeds 200     the same, for a statement about coverage
    python -m tests.studies.ngn_study --grid --seeds 10   three noise levels at three sample rates, all methods
    python -m tests.studies.ngn_study --axis longitudinal --methods ml,ls,ngn,ngn-improved
    python -m tests.studies.ngn_study --csv a.csv b.csv --truth key.json   flights of another simulator
    python -m tests.studies.ngn_study --second         flights of the second simulator of the tests

Every estimate is kept in a file of JSON lines (--store) and not made again, so that a study can be stopped (--budget)
and taken up. Prints tables in Markdown; the last result is in docs/ngn.md.
"""

import argparse
import json
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import product
from pathlib import Path

import numpy as np

from estimation.aircraft import load_aircraft
from estimation.estimators.neural_gauss_newton import estimate_ngn
from estimation.models import load_model
from estimation.session.runner import run_method
from firmware_sim.physics.aerodynamics import simulation_of, true_derivatives
from firmware_sim.runs.direct import DirectNoise, direct_flights
from firmware_sim.world.scenario import load_scenario
from groundstation.flight import Flight, read_flight
from tests.studies import second_truth

FLOWN = simulation_of(load_aircraft("cdfp")).derivatives
STRONG = {
    "lateral": ("CY_beta", "CY_dr", "Cl_beta", "Cl_p", "Cl_da", "Cn_beta", "Cn_r", "Cn_dr"),
    "longitudinal": ("CL_alpha", "CD_0", "CD_k", "Cm_0", "Cm_alpha", "Cm_q", "Cm_de"),
}
SCENARIOS = {"lateral": "rich", "longitudinal": "longitudinal"}
AT_ONCE = 20  # flights simulated side by side
Make = Callable[[Sequence[int]], Sequence[Flight]]
RATES, NOISES = (11.5, 20.0, 50.0), (0.3, 1.0, 2.0)

NETWORKS = ("ngn", "ngn-improved")


@dataclass
class Store:
    """Estimates made so far, by (set of flights, flight, method): estimate, bound and spread of each parameter."""

    path: Path
    until: float
    bootstraps: int | None
    done: dict[tuple[str, str, str], dict[str, list[float]]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.path.exists():
            for line in self.path.read_text(encoding="utf-8").splitlines():
                row = json.loads(line)
                self.done[row["set"], row["flight"], row["method"]] = row["found"]

    def fill(self, name: str, seeds: Sequence[int], make: Make, methods: Sequence[str], axis: str) -> None:
        """Make the estimates that are not known yet, as far as the time goes."""
        for first in range(0, len(seeds), AT_ONCE):
            missing = [
                s
                for s in seeds[first : first + AT_ONCE]
                if any((name, f"seed{s}", m) not in self.done for m in methods)
            ]
            if missing and time.monotonic() < self.until:
                self.estimate(name, make(missing), methods, axis)

    def estimate(self, name: str, flights: Sequence[Flight], methods: Sequence[str], axis: str) -> None:
        """Estimates of flights, those that are not known yet."""
        aircraft = load_aircraft("cdfp")
        model = load_model(axis, aircraft)
        for flight, method in product(flights, methods):
            if (name, flight.name, method) in self.done or time.monotonic() > self.until:
                continue
            if method in NETWORKS:
                result = estimate_ngn(
                    aircraft, flight, model=model, improved=method == "ngn-improved", bootstraps=self.bootstraps
                )
            else:
                result = run_method(method, model, [flight], aircraft)
            found = {n: [e.estimate, e.std, e.std_coloured] for n, e in result.parameters.items()}
            self.done[name, flight.name, method] = found
            self.path.parent.mkdir(parents=True, exist_ok=True)
            with self.path.open("a", encoding="utf-8") as file:
                row = {"set": name, "flight": flight.name, "method": method, "found": found}
                file.write(json.dumps(row) + "\n")

    def known(self, name: str, flights: Sequence[str], method: str) -> list[dict[str, list[float]]]:
        """Estimates of those flights that there was time for."""
        return [self.done[name, f, method] for f in flights if (name, f, method) in self.done]


def flights_of(seeds: Sequence[int], noise: float = 1.0, rate_hz: float = 20.0, scenario: str = "rich") -> list[Flight]:
    """30 s flights with manoeuvres in light gusts."""
    scenarios = [load_scenario(scenario)] * len(seeds)
    flown = direct_flights(scenarios, list(seeds), DirectNoise(scale=noise), rate_hz)
    return [_flight(f"seed{seed}", columns) for seed, columns in zip(seeds, flown, strict=True)]


def second_flights(seeds: Sequence[int]) -> list[Flight]:
    """The same from a simulator that shares no code with this project's, at three speeds."""
    requests = [second_truth.Request(s, speed=(14.5, 16.5, 19.0)[s % 3], gust=0.1 * second_truth.DEG) for s in seeds]
    return [_flight(f"seed{s}", c) for s, c in zip(seeds, second_truth.fly(requests), strict=True)]


def named(seeds: Sequence[int]) -> list[str]:
    """Names of the flights of these seeds."""
    return [f"seed{s}" for s in seeds]


def _flight(name: str, columns: Mapping[str, np.ndarray]) -> Flight:  # type: ignore[type-arg]
    return Flight.build(name, columns["time"], {k: v for k, v in columns.items() if k != "time"})


def table(
    store: Store, name: str, flights: Sequence[str], truth: Mapping[str, float], methods: Sequence[str], axis: str
) -> Iterator[str]:
    """Per parameter and method: mean and standard deviation of the error [%], rms error/bound and coverage [%]."""
    yield "| method | parameter | bias % | scatter % | error/CRB | error/spread | coverage % |"
    yield "|---|---|---|---|---|---|---|"
    for method in methods:
        found = store.known(name, flights, method)
        if len(found) < 2:
            continue
        inside, relative = [], []
        for parameter in STRONG[axis]:
            estimate, crb, wide = np.array([f[parameter] for f in found]).T
            error = estimate - truth[parameter]
            percent = 100 * error / truth[parameter]
            inside.append(np.abs(error) < 1.96 * wide)
            relative.append(percent)
            scatter = float(percent.std(ddof=1))
            yield (
                f"| {method} | {parameter} | {percent.mean():+.1f} ± {scatter / len(percent) ** 0.5:.1f} "
                f"| {scatter:.1f} | {_rms(error / crb):.1f} | {_rms(error / wide):.1f} | {100 * inside[-1].mean():.0f} |"
            )
        worst = max(abs(float(e.mean())) for e in relative)
        yield (
            f"| {method} | all, {len(found)} flights | worst {worst:.1f} | mean size {np.mean(np.abs(relative)):.1f} "
            f"| | | {100 * np.mean(inside):.1f} |"
        )


def grid(store: Store, seeds: Sequence[int], methods: Sequence[str]) -> Iterator[str]:
    """Mean size of the error and largest bias of the well-excited derivatives, over noise and sample rate."""
    yield "| rate Hz | noise | " + " | ".join(methods) + " |"
    yield "|---|---|" + "---|" * len(methods)
    names = STRONG["lateral"]
    for rate in RATES:
        for noise in NOISES:
            name = f"lateral {rate:g} Hz noise {noise:g}"
            store.fill(name, seeds, partial(flights_of, noise=noise, rate_hz=rate), methods, "lateral")
            cells = []
            for method in methods:
                found = store.known(name, named(seeds), method)
                if not found:
                    cells.append("")
                    continue
                error = np.array([[f[n][0] - FLOWN[n] for n in names] for f in found])
                percent = 100 * error / np.array([FLOWN[n] for n in names])
                bias = np.abs(percent.mean(axis=0)).max()
                cells.append(f"{np.abs(percent).mean():.1f} ({bias:.1f})")
            yield f"| {rate:g} | {noise:g} | " + " | ".join(cells) + " |"


def _rms(values: np.ndarray) -> float:  # type: ignore[type-arg]
    return float(np.sqrt(np.mean(values**2)))


def main() -> None:
    """Command line of the study."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=30)
    parser.add_argument("--first", type=int, default=100)
    parser.add_argument("--methods", default="ngn,ngn-improved")
    parser.add_argument("--axis", default="lateral", choices=tuple(STRONG))
    parser.add_argument("--grid", action="store_true")
    parser.add_argument("--second", action="store_true")
    parser.add_argument("--csv", nargs="+", type=Path)
    parser.add_argument("--truth", type=Path)
    parser.add_argument("--store", type=Path, default=Path("build/ngn_study.jsonl"))
    parser.add_argument("--budget", type=float, default=float("inf"), help="seconds after which no estimate is begun")
    given = parser.parse_args()
    methods = given.methods.split(",")
    seeds = list(range(given.first, given.first + given.seeds))
    # bias needs no bootstrap, and the grid is for that; its estimates are not to be taken for those of the table
    store = Store(given.store, time.monotonic() + given.budget, 0 if given.grid else None)
    if given.csv:
        key = json.loads(given.truth.read_text())
        truth = key.get("ordinary", key)["derivatives"]
        flights = [read_flight(p) for p in given.csv]
        store.estimate("csv", flights, methods, "lateral")
        lines = table(store, "csv", [f.name for f in flights], truth, methods, "lateral")
    elif given.second:
        store.fill("second", seeds, second_flights, methods, "lateral")
        lines = table(store, "second", named(seeds), second_truth.TRUE_DERIVATIVES, methods, "lateral")
    elif given.grid:
        lines = grid(store, seeds, methods)
    else:
        store.fill(given.axis, seeds, partial(flights_of, scenario=SCENARIOS[given.axis]), methods, given.axis)
        truth = {**true_derivatives(load_aircraft("cdfp"), {}), **FLOWN}
        lines = table(store, given.axis, named(seeds), truth, methods, given.axis)
    for line in lines:
        print(line, flush=True)


if __name__ == "__main__":
    main()
