"""The gap monitor on flights of simulators that share no code with it: false alarms an hour, and how soon what is named.

`python -m tests.studies.monitor_foreign [random|second|sim] [--rates 10 20 50] [--noise 1] [--gust 0.15 0.6] [--aeroplanes 4]
[--flights 20] [--first 0] [--hours 1.5] [--quiet]`: lateral flights side by side, each aeroplane with thresholds of its own as
`watch` sets them. random: another aeroplane each time; second: the second truth (20 Hz); sim: the project's simulator. A change
is there from the beginning; times count from the first scan that differs by the noise of a channel from the same flight without
it. Nothing of it was used to choose a number of the program. The last result is kept in docs/validation/live.md.
"""

import argparse
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from daq.identification.airframe import Airframe, Belief
from daq.identification.monitor.bank import LATERAL_PLANE, bank
from daq.identification.monitor.monitor import NAMED_WITHIN_S
from daq.identification.monitor.motions import inputs_of
from daq.identification.monitor.nulls import watched_step
from daq.identification.monitor.predictors import FlightsScan
from daq.identification.monitor.threshold import BEGIN_S, HOUR_S, calibrated
from estimation.estimators.recursive import airframe_of
from estimation.models import load_model
from estimation.watch.over_file import conditions_of
from firmware_sim.runs.direct import ORDINARY_NOISE, direct_flights
from firmware_sim.world.scenario import load_scenario
from firmware_sim.world.simulation import derivatives_of
from groundstation.flight import Flight
from tests.studies import random_aeroplanes, second_truth
from tests.studies.live_foreign import aircraft_of
from tests.studies.live_statistics import Case, airframe_for
from tests.studies.monitor_statistics import Set, alarms, first_shown
from tests.studies.random_aeroplanes import DEG, Aeroplane, Situation

Array = NDArray[np.float64]
APART_S = 10.0  # s between alarms that count as two
FACTORS: Mapping[str, float] = {"Cl_da": 0.7, "Cn_dr": 0.7, "Cl_p": 0.75, "Cn_beta": 0.7, "CY_beta": 0.6}
"""Derivatives that are another share of the model's, and adverse yaw of `ADVERSE` of the rudder's effectiveness beside them."""
ADVERSE = 0.2


@dataclass(frozen=True)
class Flown:
    """Flights of one aeroplane side by side, what its model is, and the same flights with each change."""

    airframe: Airframe
    values: Mapping[str, float]
    quiet: Sequence[Flight]
    changed: Mapping[str, Sequence[Flight]]


def changes_of(values: Mapping[str, float]) -> dict[str, float]:
    """Derivative -> its other value."""
    return {n: f * values[n] for n, f in FACTORS.items()} | {"Cn_da": ADVERSE * values["Cn_dr"]}


def of_random(o: argparse.Namespace, seed: int, rate: float, gust: float) -> Flown:
    craft = Aeroplane.drawn(np.random.default_rng([48, seed]))
    aircraft = aircraft_of(craft, np.random.default_rng(0), 0.0, 0.035)
    situation = Situation("", rate=rate, noise=o.noise, gust=gust * DEG)

    def flights(hidden: Mapping[str, float]) -> list[Flight]:
        rng = np.random.default_rng([49, seed])
        return random_aeroplanes.fly(craft, replace(situation, hidden=hidden), rng, flights=o.flights)

    changes = {} if o.quiet else changes_of(craft.derivatives)
    airframe = airframe_of(load_model("lateral", aircraft), aircraft)
    return Flown(airframe, craft.derivatives, flights({}), {n: flights({n: v}) for n, v in changes.items()})


def of_second(o: argparse.Namespace, seed: int, rate: float, gust: float) -> Flown:
    def flights(hidden: Mapping[str, float]) -> list[Flight]:
        adverse = {"Cn_da": hidden["Cn_da"] / second_truth.TYPICAL["Cn_da"]} if "Cn_da" in hidden else {}
        other = {} if adverse else hidden
        requests = [
            second_truth.Request(
                9000 + 100 * seed + i, 14.5 + 4.5 * i / o.flights, adverse, gust * DEG, derivatives=other, centred=True
            )
            for i in range(o.flights)
        ]
        return [Flight.build("second", c.pop("time"), c) for c in second_truth.fly(requests)]

    values = second_truth.TRUE_DERIVATIVES
    changes = {} if o.quiet else changes_of(values)
    changed = {n: flights({n: v}) for n, v in changes.items()}
    return Flown(airframe_for(Case("second", gust, False)), values, flights({}), changed)


def of_sim(o: argparse.Namespace, seed: int, rate: float, gust: float) -> Flown:
    scenario = load_scenario("rich").altered(hidden=[], wind={"gust_deg": gust}, flight={"duration_s": 60.0})
    truth, noise = derivatives_of(scenario, 1), replace(ORDINARY_NOISE, scale=o.noise)
    columns = direct_flights([scenario] * o.flights, [1000 * seed + i for i in range(o.flights)], noise, rate_hz=rate)
    flights = [Flight.build("sim", c.pop("time"), c) for c in columns]
    return Flown(airframe_for(Case("sim", gust, False)), truth, flights, {})


SOURCES = {"random": of_random, "second": of_second, "sim": of_sim}


def side_by_side(flights: Sequence[Flight]) -> list[FlightsScan]:
    """Their scans that are looked at, which are at the same times."""
    step = flights[0].sample_interval
    driving = inputs_of(LATERAL_PLANE)
    table = {n: np.stack([f[n] for f in flights], axis=1) for n in (*LATERAL_PLANE.channels, *driving._fields[:-2])}
    return [
        FlightsScan(
            float(time),
            np.stack([table[c][k] for c in LATERAL_PLANE.channels]),
            driving(*(table[n][k] for n in driving._fields[:-2])),
        )
        for k, time in enumerate(flights[0].time)
        if k % round(watched_step(step) / step) == 0
    ]


def set_of(flown: Flown, hours: float, seed: int) -> Set:
    """The monitor of this aeroplane, exact but for 1 and 5 %."""
    names = LATERAL_PLANE.regression.derivatives
    airframe = replace(flown.airframe, beliefs={n: Belief(flown.values.get(n, 0.0), 0.0) for n in names})
    values = {n: airframe.believed(n) for n in names}
    effects, conditions = bank(values, {}), conditions_of(flown.quiet[0], LATERAL_PLANE)
    found = calibrated(airframe, values, effects, conditions, rng=np.random.default_rng([50, seed]), hours=hours)
    return Set(airframe, values, effects, conditions, found, LATERAL_PLANE, seed)


def counted(table: Array) -> int:
    """Alarms of all flights. table: (times, 1 + flights), see `alarms`."""
    hits = [table[table[:, f] > 0.5, 0] for f in range(1, table.shape[1])]
    return sum(int(t.size > 0) + int(np.sum(np.diff(t) > APART_S)) for t in hits)


def noticed(s: Set, name: str, quiet: Sequence[FlightsScan], changed: Sequence[FlightsScan]) -> list[tuple[float, int]]:
    """Of each flight: s from the first scan that shows it to the alarm, and the place of the right name (0: not named)."""
    moved = np.array([a.measured - b.measured for a, b in zip(changed, quiet, strict=True)])
    shown = first_shown(np.array([c.time for c in changed]), moved, s)
    table, known = alarms(s, changed)
    right, found = [e.name for e in s.effects].index(name), list[tuple[float, int]]()
    for flight in range(table.shape[1] - 1):
        at = np.flatnonzero(table[:, 1 + flight] > 0.5)
        if not at.size:
            found.append((math.inf, 0))
            continue
        time = table[at[0], 0]
        said = known[(table[:, 0] >= time) & (table[:, 0] <= time + NAMED_WITHIN_S), flight].max(axis=0)
        place = 1 + int(np.sum(said > said[right])) if said[right] > 0.0 else 0
        found.append((time - max(shown[flight], changed[0].time + BEGIN_S), place))
    return found


def study(o: argparse.Namespace, source: str, rate: float, gust: float) -> None:
    hours, false, times = 0.0, 0, dict[str, list[tuple[float, int]]]()
    for seed in range(o.first, o.first + o.aeroplanes):
        flown = SOURCES[source](o, seed, rate, gust)
        s, quiet = set_of(flown, o.hours, seed), side_by_side(flown.quiet)
        hours += len(flown.quiet) * (quiet[-1].time - quiet[0].time - BEGIN_S) / HOUR_S
        false += counted(alarms(s, quiet)[0])
        for name, flights in flown.changed.items():
            times.setdefault(name, []).extend(noticed(s, name, quiet, side_by_side(flights)))
    every = [x for found in times.values() for x in found]
    within = {n: 100 * np.mean([t <= 5.0 for t, _ in found]) for n, found in times.items()}
    alarmed = [place for t, place in every if math.isfinite(t)]
    print(
        f"| {source} | {rate:g} | {o.noise:g} | {gust:g} | {hours:.1f} | {false} | {false / hours:.2f} "
        f"| {np.mean(list(within.values()) or [math.nan]):.0f} "
        f"| {100 * np.mean([0 < place < 3 for place in alarmed] or [math.nan]):.0f} "
        f"| {', '.join(f'{n} {x:.0f}' for n, x in within.items())} |",
        flush=True,
    )


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sources", nargs="*", default=["random"], help=", ".join(SOURCES))
    parser.add_argument("--rates", type=float, nargs="+", default=[20.0])
    parser.add_argument("--noise", type=float, default=1.0)
    parser.add_argument("--gust", type=float, nargs="+", default=[0.15, 0.6], help="rms sideslip [deg]")
    parser.add_argument("--aeroplanes", type=int, default=4)
    parser.add_argument("--flights", type=int, default=20, help="of each aeroplane")
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--hours", type=float, default=1.5, help="of simulated manoeuvring behind the thresholds")
    parser.add_argument("--quiet", action="store_true", help="no changes")
    o = parser.parse_args(arguments)
    print("| flights of | scans a second | noise | gust deg | hours | false alarms | an hour | within 5 s % |", end=" ")
    print("right name of two % | each within 5 s % |\n|" + "---|" * 10)
    for source in o.sources:
        for rate in o.rates:
            for gust in o.gust:
                study(o, source, rate, gust)


if __name__ == "__main__":
    main()
