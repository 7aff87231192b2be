"""Statistics of the maximum-likelihood estimates over many seeds: error against both bounds, and coverage.

`python -m tests.studies.output_error_statistics [SET ...] [--seeds 200] [--method ml|fem]`: every set below unless named.
Flights of three simulators that share no code: `tests.unit.estimation.truth` (made), `tests.studies.second_truth` (second) and
`firmware_sim.runs.direct` (sim). Each flight is fitted by itself, and every four of one aircraft together with coefficients at
rest of their own. The last result is kept in docs/estimation.md.
"""

import argparse
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace

import numpy as np

from estimation.estimators.filter_error import filter_error
from estimation.estimators.output_error import OutputErrorOptions, output_error
from estimation.models import load_model
from estimation.prepare.pipeline import prepare_all
from firmware_sim.runs.direct import direct_flights
from firmware_sim.world.scenario import load_scenario
from firmware_sim.world.simulation import derivatives_of
from groundstation.flight import Flight
from tests.studies import second_truth
from tests.unit.estimation.truth import DEG, NOISE, STRONG, TRUE, Case, fly

TOGETHER = 4
BATCH = 5  # flights flown at once; those of the first simulator share the timing of their edges
PLAIN = {k: v for k, v in NOISE.items() if k in ("beta", "p", "r", "phi", "ay")}
SPEEDS = (14.5, 16.5, 19.0, 17.0)
AT_REST = ("CY_0", "Cl_0", "Cn_0")

Group = tuple[list[Flight], Mapping[str, float]]


def made(case: Case) -> Callable[[int], Iterator[Group]]:
    """Groups of the first simulator; the edges of a servo fall elsewhere between samples in every flight of a group."""

    def groups(seeds: int) -> Iterator[Group]:
        rng = np.random.default_rng(1)
        for _ in range(-(-seeds // (TOGETHER * BATCH))):
            phases = rng.uniform(0.0, 0.05, TOGETHER) if case.servo is not None else np.zeros(TOGETHER)
            flown = [fly(replace(case, phase=float(phase)), rng, BATCH)[0] for phase in phases]
            for group in zip(*flown, strict=True):
                yield list(group), TRUE

    return groups


def second(gust: float) -> Callable[[int], Iterator[Group]]:
    """Groups of the second simulator: another aircraft every time, four speeds. gust: rms sideslip [rad]."""

    def groups(seeds: int) -> Iterator[Group]:
        for k in range(seeds // TOGETHER):
            derivatives = second_truth.perturbed_derivatives(np.random.default_rng([k, 3]))
            requests = [
                second_truth.Request(5000 + k * TOGETHER + i, speed, gust=gust, derivatives=derivatives)
                for i, speed in enumerate(SPEEDS)
            ]
            yield [_flight(c) for c in second_truth.fly(requests)], derivatives

    return groups


def sim(gust_deg: float) -> Callable[[int], Iterator[Group]]:
    """Groups of the project's simulator through its direct sensor model."""

    def groups(seeds: int) -> Iterator[Group]:
        scenario = load_scenario("rich").altered(wind={"gust_deg": gust_deg})
        crowd = BATCH * TOGETHER
        for first in range(0, seeds, crowd):
            flown = [_flight(c) for c in direct_flights([scenario] * crowd, list(range(first + 1, first + 1 + crowd)))]
            for k in range(0, crowd, TOGETHER):
                yield flown[k : k + TOGETHER], derivatives_of(scenario, first + 1)

    return groups


def _flight(columns: Mapping[str, np.ndarray]) -> Flight:
    return Flight.build("flight", columns["time"], {k: v for k, v in columns.items() if k != "time"})


SETS: Mapping[str, tuple[str, Callable[[int], Iterator[Group]]]] = {
    "white": ("made: white output noise, exact inputs", made(Case(noise=PLAIN, servo=None))),
    "still": ("made: still air, all sensors noisy, servo lag", made(Case(noise=NOISE))),
    "straight": (
        "made: still air, all sensors noisy, surfaces straight between samples",
        made(Case(noise=NOISE, servo=None)),
    ),
    "gusts": ("made: gusts 0.12 m/s, exact inputs", made(Case(noise=PLAIN, servo=None, gust=0.12))),
    "both": ("made: gusts 0.12 m/s, all sensors noisy, servo lag", made(Case(noise=NOISE, gust=0.12))),
    "strong": ("made: gusts 0.3 m/s, all sensors noisy, servo lag", made(Case(noise=NOISE, gust=0.3))),
    "second-still": ("second: still air, all sensors noisy", second(0.0)),
    "second-gusts": ("second: gusts 0.15 deg, all sensors noisy", second(0.15 * DEG)),
    "sim-still": ("sim: still air, all sensors noisy", sim(0.0)),
    "sim-gusts": ("sim: gusts 0.10 deg, all sensors noisy", sim(0.10)),
}


class Tally:
    """Errors of one kind of fit: relative, and in units of both bounds; (fits, parameters)."""

    def __init__(self) -> None:
        self.relative: list[list[float]] = []
        self.plain: list[list[float]] = []
        self.corrected: list[list[float]] = []

    def add(self, parameters: Mapping[str, object], truth: Mapping[str, float]) -> None:
        e = [parameters[n] for n in STRONG]
        off = [x.estimate - truth[x.name] for x in e]  # type: ignore[attr-defined]
        self.relative.append([d / abs(truth[n]) for d, n in zip(off, STRONG, strict=True)])
        self.plain.append([d / x.std for d, x in zip(off, e, strict=True)])  # type: ignore[attr-defined]
        self.corrected.append([d / x.std_coloured for d, x in zip(off, e, strict=True)])  # type: ignore[attr-defined]

    def rows(self) -> Iterator[str]:
        relative, plain, corrected = (np.array(v) for v in (self.relative, self.plain, self.corrected))
        for i, name in enumerate((*STRONG, "all")):
            pick = slice(None) if name == "all" else [i]
            r, p, c = relative[:, pick], plain[:, pick], corrected[:, pick]
            bias = "" if name == "all" else f"{100 * r.mean():+.2f}"
            yield (
                f"| {name} | {bias} | {100 * rms(r):.2f} | {rms(p):.2f} | {rms(c):.2f} "
                f"| {100 * np.mean(np.abs(c) < 1.96):.1f} |"
            )


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def study(name: str, seeds: int, method: str) -> None:
    """Fit the flights of one set and print its tables."""
    title, groups = SETS[name]
    model = load_model("lateral", "cdfp")
    options = OutputErrorOptions()
    fit = {"ml": output_error, "fem": filter_error}[method]
    alone, joint, failed = Tally(), Tally(), 0
    started = time.perf_counter()
    for flights, truth in groups(seeds):
        data = prepare_all(model, flights)
        for flight in data:
            result = fit(model, [flight], options=options)
            failed += not result.converged
            if result.converged:
                alone.add(result.parameters, truth)
        together = fit(model.with_local(*AT_REST), data, options=options)
        failed += not together.converged
        if together.converged:
            joint.add(together.parameters, truth)
    spent = time.perf_counter() - started
    head = (
        "| | bias % | rms error % | error / Cramer-Rao | error / corrected | 95 % coverage |\n|---|---|---|---|---|---|"
    )
    for kind, tally in (("one flight", alone), (f"{TOGETHER} flights together", joint)):
        print(f"\n{title}; {method}, {kind}, {len(tally.plain)} fits\n{head}")
        print("\n".join(tally.rows()))
    print(f"{failed} fits failed; {spent:.0f} s", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sets", nargs="*", choices=[*SETS, []], default=[])
    parser.add_argument("--seeds", type=int, default=200)
    parser.add_argument("--method", choices=("ml", "fem"), default="ml")
    arguments = parser.parse_args()
    for name in arguments.sets or SETS:
        study(name, arguments.seeds, arguments.method)


if __name__ == "__main__":
    main()
