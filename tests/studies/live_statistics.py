"""Statistics of the recursive estimator over many flights: rms error, mean bias and coverage after 5 to 60 s.

`python -m tests.studies.live_statistics [SET ...] [--flights 200] [--seed 0]`: every set below unless named. A minute is two
flights of the second simulator with one aircraft, or one of the other's. Flights of two simulators
that share no code with the estimator: `tests.studies.second_truth` (second) and `firmware_sim.runs.direct` (sim), at 20 Hz and
at 11.5 Hz with 5 % lost (scans of the 20 Hz grid, so 50, 100, 150 ... ms apart).
The last result is kept in docs/validation/live.md.
"""

import argparse
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from daq.identification.airframe import DERIVATIVES, SIGNALS, Airframe, Belief, Sample
from daq.identification.live import LiveEstimator
from estimation.aircraft.library import load_aircraft
from firmware_sim.runs.direct import direct_flights
from firmware_sim.world.scenario import load_scenario
from firmware_sim.world.simulation import derivatives_of
from tests.studies import second_truth

EIGHT = ("CY_beta", "CY_dr", "Cl_beta", "Cl_p", "Cl_da", "Cn_beta", "Cn_r", "Cn_dr")
AT = (5.0, 10.0, 20.0, 30.0, 60.0)
BATCH = 20  # flights flown at once
PART, PAUSE = 100_000, 2.0  # between the seeds of two flights of one aircraft; s between them
SHARE = 11.5 / 20.0  # of the scans that are sent down
LOST = 0.05

Array = NDArray[np.float64]
Flown = tuple[Mapping[str, Array], Mapping[str, float]]


@dataclass(frozen=True)
class Case:
    """One set of flights. gust: rms sideslip of the gusts [deg]; sent: whether through the link; loss: share lost there."""

    simulator: str
    gust: float
    sent: bool
    loss: float = LOST
    seed: int = 0

    def flights(self, count: int) -> Iterator[Flown]:
        flown = (
            sim_flights(count, self.gust, self.seed)
            if self.simulator == "sim"
            else second_flights(count, self.gust, self.simulator, self.seed, parts=2)
        )
        for number, (columns, truth) in enumerate(flown):
            yield (through_link(columns, number, self.loss) if self.sent else columns), truth


def second_flights(
    count: int, gust: float, simulator: str = "second", seed: int = 0, *, parts: int = 1
) -> Iterator[Flown]:
    """Flights of the second simulator: another aircraft each time (derivatives 10 % about those believed), 14.5 to 19 m/s.

    It holds surfaces over 5 ms; as `early` they are recorded at the beginning of what they do, 2.5 ms before its middle.
    """
    for first in range(0, count, BATCH):
        rng = np.random.default_rng([first, 19, seed])
        truths = [second_truth.perturbed_derivatives(rng, 0.10) for _ in range(min(BATCH, count - first))]
        requests = [
            second_truth.Request(
                7000 + first + i + PART * part + seed,
                rng.uniform(14.5, 19.0),
                gust=math.radians(gust),
                derivatives=truth,
                centred=simulator == "second",
            )
            for part in range(parts)
            for i, truth in enumerate(truths)
        ]
        flown = second_truth.fly(requests)
        yield from zip((joined(flown[i :: len(truths)]) for i in range(len(truths))), truths, strict=True)


def joined(flown: Sequence[Mapping[str, Array]]) -> dict[str, Array]:
    """Columns of flights of the same aircraft one after the other, `PAUSE` seconds between."""
    columns = {n: np.concatenate([f[n] for f in flown]) for n in flown[0]}
    late = [k * (flown[0]["time"][-1] + PAUSE) for k in range(len(flown))]
    columns["time"] = np.concatenate([f["time"] + by for f, by in zip(flown, late, strict=True)])
    return columns


def sim_flights(count: int, gust: float, seed: int = 0) -> Iterator[Flown]:
    """Flights of the project's simulator through its direct sensor model."""
    scenario = load_scenario("rich").altered(wind={"gust_deg": gust}, flight={"duration_s": AT[-1]})
    for first in range(0, count, BATCH):
        seeds = list(range(seed + first + 1, seed + first + 1 + min(BATCH, count - first)))
        for seed, columns in zip(seeds, direct_flights([scenario] * len(seeds), seeds), strict=True):
            yield columns, derivatives_of(scenario, seed)


def through_link(columns: Mapping[str, Array], number: int, loss: float) -> dict[str, Array]:
    """The scans that arrive of those that are sent: every one that brings the count up to its share, less the lost ones."""
    scans = np.arange(columns["time"].size)
    sent = np.diff(np.floor(scans * SHARE), prepend=-1.0) > 0
    arrived = sent & (np.random.default_rng([number, 115]).uniform(size=scans.size) >= loss)
    return {k: v[arrived] for k, v in columns.items()}


def airframe_for(case: Case) -> Airframe:
    """What the estimator is told: second simulator, the values about which its aircraft scatter; sim, the aircraft's own file."""
    craft = load_aircraft("cdfp")
    beliefs = {n: Belief(p.value, p.std or 0.0) for n in DERIVATIVES if (p := craft.prior(n)) is not None}
    if case.simulator != "sim":
        about = second_truth.TRUE_DERIVATIVES
        beliefs = {n: Belief(about[n], b.std) for n, b in beliefs.items()}
    lag = None if craft.servos is None else craft.servos.lag
    return Airframe(craft.span, craft.area, craft.mass, craft.Ixx, craft.Iyy, craft.Izz, craft.Ixz, beliefs, lag)


def samples(columns: Mapping[str, Array]) -> Iterator[Sample]:
    """Scans of a flight in order."""
    for row in np.stack([columns[n] for n in ("time", *SIGNALS)], axis=1).tolist():
        yield Sample(*row)


@dataclass(frozen=True)
class Errors:
    """At one time over all flights, (flights, EIGHT): relative errors, errors in units of the bound, and whether shown."""

    relative: Array
    in_bounds: Array
    shown: NDArray[np.bool_]


def errors(case: Case, flights: int) -> dict[float, Errors]:
    """Fly and estimate all flights of a case."""
    airframe = airframe_for(case)
    found: dict[float, list[tuple[list[float], list[float], list[bool]]]] = {at: [] for at in AT}
    for columns, truth in case.flights(flights):
        estimator, due = LiveEstimator(airframe), list(AT)
        last = columns["time"][-1]
        for sample in samples(columns):
            estimator.add(sample)
            if due and sample.time >= min(due[0], last):
                found[due.pop(0)].append(_judged(estimator, truth))
    return {at: Errors(*(np.array(v) for v in zip(*rows, strict=True))) for at, rows in found.items()}  # type: ignore[arg-type]


def _judged(estimator: LiveEstimator, truth: Mapping[str, float]) -> tuple[list[float], list[float], list[bool]]:
    known = estimator.estimates().derivatives
    off = [known[n].estimate - truth[n] for n in EIGHT]
    return (
        [d / abs(truth[n]) for d, n in zip(off, EIGHT, strict=True)],
        [d / known[n].std for d, n in zip(off, EIGHT, strict=True)],
        [known[n].told for n in EIGHT],
    )


def rms(values: Array) -> float:
    return float(np.sqrt(np.nanmean(values**2)))


def table(found: Mapping[float, Errors]) -> Iterator[str]:
    """Over all eight: shown share, rms and median error, coverage of all and of what is shown."""
    yield "| after s | shown % | rms error %, all | rms error %, shown | median error % | covered %, all | covered %, shown |"
    yield "|---|---|---|---|---|---|---|"
    for at, e in found.items():
        inside = np.abs(e.in_bounds) < 1.96
        there = np.isfinite(e.relative)
        shown = (
            [f"{100 * rms(e.relative[e.shown]):.1f}", f"{100 * inside[e.shown].mean():.1f}"]
            if e.shown.any()
            else ["-"] * 2
        )
        yield (
            f"| {at:g} | {100 * e.shown.mean():.0f} | {100 * rms(e.relative):.1f} | {shown[0]} "
            f"| {100 * float(np.nanmedian(np.abs(e.relative))):.1f} | {100 * inside[there].mean():.1f} | {shown[1]} |"
        )


def by_name(e: Errors) -> Iterator[str]:
    """Each of the eight at the end."""
    yield "| | bias % | rms error % | rms error / bound | covered % |"
    yield "|---|---|---|---|---|"
    for i, name in enumerate(EIGHT):
        r, b = e.relative[:, i], e.in_bounds[:, i]
        inside = 100 * np.mean(np.abs(b) < 1.96)
        yield f"| {name} | {100 * np.nanmean(r):+.2f} | {100 * rms(r):.2f} | {rms(b):.2f} | {inside:.1f} |"


CASES: Mapping[str, Case] = {
    f"{simulator}-{air}-{rate}": Case(simulator, gust, rate == "link")
    for simulator in ("second", "early", "sim")
    for air, gust in (("still", 0.0), ("gusts", 0.10), ("rough", 0.30))
    for rate in ("20hz", "link")
}


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("cases", nargs="*", choices=[*CASES, []], default=[])
    parser.add_argument("--flights", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args(arguments)
    for name in given.cases or CASES:
        found = errors(replace(CASES[name], seed=given.seed), given.flights)
        print(f"\n{name}, {given.flights} flights")
        print("\n".join([*table(found), "", *by_name(found[AT[-1]])]), flush=True)


if __name__ == "__main__":
    main()
