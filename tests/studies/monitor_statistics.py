"""Statistics of the gap monitor: false alarms an hour of manoeuvring, and how soon and by what name effects are noticed.

`python -m tests.studies.monitor_statistics [-n 40] [--hours 5] [--plane lateral|longitudinal] [--noise 1] [--seed 0] [--ideal]
[10 12 20 50 100 link]`: scans a second, or what comes over the link.
Nulls and changed derivatives are flown by the monitor's own equations of motion, with other random numbers than its calibration;
sudden failures by the simulator through its direct sensor model, which shares no code with it. Effects begin at 20 s of a minute.
Times are counted from the scan that is the first to differ from the same flight without the effect, same draws, by the noise of a
channel: before that no input has shown it. `--ideal`: beside each the share that no detector could pass. The last result is kept
in docs/validation/live.md.
"""

import argparse
import math
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from daq.identification.airframe import DERIVATIVES, SIGNALS, Airframe, Sample
from daq.identification.monitor import FALSE_ALARMS
from daq.identification.monitor.bank import PLANES, MonitoredEffect, MonitoredPlane, bank
from daq.identification.monitor.monitor import NAMED_WITHIN_S, GapMonitor
from daq.identification.monitor.nulls import NullConditions, fly, watched_step
from daq.identification.monitor.predictors import FlightsScan, Innovation, PredictorBank
from daq.identification.monitor.threshold import BEGIN_S, HOUR_S, Calibration, calibrated, scores, whitened
from estimation.aircraft.library import load_aircraft
from firmware_sim.physics.effects.sudden import BEGINS_S
from firmware_sim.runs.direct import direct_flights
from firmware_sim.world.scenario import load_scenario
from firmware_sim.world.simulation import derivatives_of
from sideslip.live_aircraft import airframe_of_file
from tests.studies.live_statistics import Case, airframe_for, through_link

Array = NDArray[np.float64]

USUAL = (1.0, 1.0)
WITHIN_S, BEFORE_S = 5.0, 10.0  # s after an effect is shown, and before, that a detector goes by
KNOWN = float(norm.isf(WITHIN_S / HOUR_S))
"""Standard deviations that one look every five seconds at one known change passes once an hour."""
FLIGHT_S, BEGINS = 60.0, BEGINS_S
LINK = NullConditions(rate=11.5, loss=0.05)
CHANGES = {
    "Cn_da": -0.008,
    "Cl_da": 0.03,
    "Cn_dr": 0.01,
    "Cl_p": 0.1,
    "Cn_beta": -0.008,
    "Cl_0": 0.004,
}
PITCH_CHANGES = {
    "Cm_de": 0.09,
    "Cm_alpha": 0.042,
    "Cm_q": 0.28,
    "CL_alpha": -0.3,
    "CD_0": 0.006,
    "Cm_0": 0.01,
    "mass": 0.1,
    "cg": 0.02,
}
"""A quarter of Cm_de and Cm_alpha, a tenth of lift slope and mass, 2 % of the chord."""
HIDDEN = {
    "elevon_stuck": ("Cl_da", "Cl_0", "Cl_beta", "Cl_p", "Cl_dr"),
    "vane_slipped": ("beta_bias", "CY_0", "Cl_0", "Cn_0"),
    "ice": ("Cl_da", "Cl_p", "Cl_beta"),
    "mass_shift": ("Cl_0", "Cl_beta"),
}
"""Sudden effects of the simulator, and names that say the right thing of them."""


@dataclass(frozen=True)
class Set:
    """A model and its calibration at one rate."""

    airframe: Airframe
    values: dict[str, float]
    effects: tuple[MonitoredEffect, ...]
    conditions: NullConditions
    calibration: Calibration
    plane: MonitoredPlane
    seed: int

    @property
    def predictors(self) -> PredictorBank:
        return PredictorBank(self.airframe, self.values, self.effects, self.plane)


def made(rate: str, hours: float, plane: MonitoredPlane, noise: float = 1.0, seed: int = 0) -> Set:
    airframe = airframe_for(Case("second", 0.1, False))
    if plane.name != "lateral":
        airframe = airframe_of_file(load_aircraft("cdfp"), (plane.regression,))
    values = {n: airframe.believed(n) for n in plane.regression.derivatives}
    effects, rng = bank(values, {}, plane), np.random.default_rng([seed, 1])
    conditions = LINK if rate == "link" else _on_board(float(rate))
    levels = {n: noise * getattr(conditions, n) for n in (*plane.channels, "surface", "V")}
    conditions = replace(conditions, **levels)  # type: ignore[arg-type]
    found = calibrated(airframe, values, effects, conditions, rng=rng, hours=hours, plane=plane)
    return Set(airframe, values, effects, conditions, found, plane, seed)


def _on_board(rate: float) -> NullConditions:
    """Of fast scans those that are looked at."""
    step = watched_step(1.0 / rate)
    return NullConditions(rate=1.0 / step, grid=step)


def alarms(s: Set, scans: Sequence[FlightsScan]) -> tuple[Array, Array]:
    """(times, 1 + flights) times, and whether either statistic is beyond its threshold; (times, flights, effects) what the
    longest window says of each effect, from which names come: zero where that is below the threshold."""
    above, known, times = [], [], []
    for time, score in scores(s.predictors, s.effects, s.calibration.whitening, scans):
        if time < BEGIN_S:
            continue
        z = np.abs(s.calibration.effects.of(score.z))
        u = np.nan_to_num(s.calibration.channels.of(np.log(score.unnamed)), nan=-9.0)
        above.append((z.max(axis=(1, 2)) > s.calibration.named) | (u.max(axis=1) > s.calibration.unnamed))
        known.append(np.abs(score.z[:, -1]) * (z[:, -1].max(axis=1) > s.calibration.named)[:, None])
        times.append(time)
    return np.column_stack([times, np.array(above)]), np.array(known)


def false_alarms(s: Set, hours: float, gust: float) -> str:
    """Alarms that stand apart by ten seconds, over so many hours."""
    conditions = replace(s.conditions, gust=gust * s.conditions.gust, gust_spread=USUAL)
    count, flown, hit, flights = 0, 0.0, 0, 0
    for batch in range(max(1, round(hours * 3600.0 / (100 * 90.0)))):
        rng = np.random.default_rng([batch, 71, s.seed])
        scans = fly(s.airframe, s.values, s.effects, conditions, rng, 100, 90.0, plane=s.plane)
        table, _ = alarms(s, scans)
        for flight in range(1, table.shape[1]):
            times = table[table[:, flight] > 0.5, 0]
            count += int(times.size > 0) + int(np.sum(np.diff(times) > 10.0))
            hit += int(times.size > 0)
        flown += 100 * (90.0 - BEGIN_S) / 3600.0
        flights += 100
    return f"| gusts x{gust:g} | {flown:.1f} | {count} | {count / flown:.2f} | {100 * hit / flights:.1f} |"


@dataclass(frozen=True)
class Changed:
    """Flights with an effect from 20 s on, the same ones without, and when each first shows it [s]."""

    scans: list[FlightsScan]
    without: list[FlightsScan]
    shown: Array


def changed(s: Set, name: str, size: float, n: int) -> Changed:
    """A change of the model's own motion at 20 s."""
    done: list[bool] = []

    def change(time: float, truth: dict[str, Array]) -> None:
        if time >= BEGINS and not done:
            effect = next(e for e in s.effects if e.name == name)
            for parameter, change in (effect.moves or {name: effect.step}).items():
                truth[parameter] = truth[parameter] + change * size / effect.step
            done.append(True)

    conditions = replace(s.conditions, gust_spread=USUAL)
    scans, without = (
        fly(s.airframe, s.values, s.effects, conditions, np.random.default_rng([9, n, s.seed]), n, FLIGHT_S, c, s.plane)
        for c in (change, None)
    )
    moved = np.array([a.measured - b.measured for a, b in zip(scans, without, strict=True)])
    return Changed(scans, without, first_shown(np.array([c.time for c in scans]), moved, s))


def ideal(s: Set, c: Changed) -> str:
    """Share of the flights that a detector notices within five seconds which is told what to look for: effect, size and onset,
    with the flight without it beside it. It has to allow for the model's own errors and for one false alarm an hour, as all
    have; by Neyman and Pearson's lemma none does better. Then, as a yardstick, of one that is told the onset alone and looks
    once, by the monitor's rate for any of its effects."""
    with_it, without = _white(s, c.scans), _white(s, c.without)
    times = np.array([t for t, _, _ in with_it])
    prior = np.array([e.prior / e.step for e in s.effects])
    modelled, distances = np.flatnonzero(prior), []
    for flight, shown in enumerate(c.shown):
        pairs = [(a, b) for t, a, b in zip(times, with_it, without, strict=True) if -BEFORE_S <= t - shown <= WITHIN_S]
        shift = np.concatenate([a[1][:, flight] - b[1][:, flight] for a, b in pairs] or [np.zeros(1)])
        errors = np.concatenate([b[2][:, modelled, flight] for _, b in pairs] or [np.zeros((1, modelled.size))])
        along = errors.T @ shift
        known = np.diag(1.0 / prior[modelled] ** 2) + errors.T @ errors
        distances.append(math.sqrt(max(shift @ shift - along @ np.linalg.solve(known, along), 0.0)))
    searched = float(norm.isf(FALSE_ALARMS * WITHIN_S / HOUR_S / (2 * len(s.effects))))
    shares = (100 * norm.cdf(np.array(distances) - threshold).mean() for threshold in (KNOWN, searched))
    return "".join(f" {share:.0f} |" for share in shares)


def _white(s: Set, scans: Sequence[FlightsScan]) -> list[tuple[float, Array, Array]]:
    """Time, white innovations (5, flights) and signatures (5, effects, flights) of each scan."""
    predictors, last, found = s.predictors, list[Innovation](), []
    for scan in scans:
        innovation = predictors.innovation(scan)
        last = [*last, innovation][-3:] if innovation is not None else last
        if innovation is not None and len(last) == 3:
            found.append((innovation.time, *whitened(s.calibration.whitening, last)))
    return found


def noticed(s: Set, name: str, c: Changed, size: float) -> str:
    """When the monitor notices it, and by what name."""
    scans, shown = c.scans, c.shown
    table, known = alarms(s, scans)
    after = table[:, 0] > BEGINS
    first, what = [], list[tuple[str, ...]]()
    for flight in range(1, table.shape[1]):
        at = np.flatnonzero(after & (table[:, flight] > 0.5))
        noticed_at = table[at[0], 0] if at.size else math.inf
        first.append(noticed_at)
        telling = known[(table[:, 0] >= noticed_at) & (table[:, 0] <= noticed_at + NAMED_WITHIN_S), flight - 1]
        sure = telling.size > 0 and telling.max() > 0.0
        leading = np.argsort(-telling.max(axis=0))[:2] if sure else ()
        what.append(tuple(s.effects[int(k)].name for k in leading))
    return row(name, f"{size:g}", first, shown, what, lambda w: w == name)


def first_shown(time: Array, changed: Array, s: Set) -> Array:
    """(flights,) times of the first scan, of those at `time` (scans,), that an effect moves by the noise of a channel; inf where
    none. changed: (scans, 5, flights) what it does to the measured channels."""
    noise = np.array([getattr(s.conditions, c) for c in s.plane.channels])[:, None]
    seen = (np.abs(changed) >= noise).any(axis=1)
    return np.where(seen.any(axis=0), time[seen.argmax(axis=0)], math.inf)


def sudden(s: Set, name: str, n: int, rate: str) -> str:
    """A failure of the simulated aircraft, through the monitor sample by sample."""
    scenario = load_scenario("rich").altered(hidden=[{"name": name}], flight={"duration_s": FLIGHT_S})
    truth = derivatives_of(scenario, 1)
    values = {k: truth[k] for k in DERIVATIVES}
    first, what = [], list[tuple[str, ...]]()
    shown: list[float] = []
    seeds = list(range(s.seed + 1, s.seed + n + 1))
    sound = direct_flights([scenario.altered(hidden=[])] * n, seeds)
    for seed, (flown, as_before) in enumerate(zip(direct_flights([scenario] * n, seeds), sound, strict=True)):
        changed = np.stack([flown[c] - as_before[c] for c in s.plane.channels], axis=1)[:, :, None]
        shown += list(first_shown(flown["time"], changed, s))
        columns = through_link(flown, seed, 0.05) if rate == "link" else flown
        monitor = GapMonitor(s.airframe, values, s.effects, s.calibration)
        for sample in (Sample(*r) for r in np.stack([columns[c] for c in ("time", *SIGNALS)], axis=1).tolist()):
            monitor.add(sample)
        after = [a for a in monitor.alarms if a.time > columns["time"][0] + BEGINS]
        first.append(after[0].time if after else math.inf)
        what.append(tuple(n.effect for n in after[0].leading[:2]) if after else ())  # as last told
    return row(name, "1", first, np.array(shown), what, lambda w: w in HIDDEN[name])


def row(
    name: str,
    size: str,
    first: Sequence[float],
    shown: Array,
    what: Sequence[tuple[str, ...]],
    right: Callable[[str], bool],
) -> str:
    """first: times of the first alarm; shown: of the first scan that shows the effect; what: the first two names given."""
    times = np.array(first) - shown
    found = np.isfinite(times)
    named = [[any(right(n) for n in w[:k]) for k in (1, 2)] for w, f in zip(what, found, strict=True) if f]
    most = ", ".join(f"{w} {c}" for w, c in Counter(w[0] if w else "none" for w in what).most_common(3))
    share, of_two = 100.0 * np.mean(named, axis=0) if named else (0.0, 0.0)
    middle = float(np.median(times[found])) if found.any() else math.nan
    return (
        f"| {name} | {size} | {len(times)} | {100 * found.mean():.0f} | {np.median(shown) - BEGINS:.1f} | {middle:.1f} "
        f"| {100 * np.mean(times <= 5.0):.0f} | {share:.0f}; {of_two:.0f} | {most} |"
    )


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("rates", nargs="*", default=["20", "link"])
    parser.add_argument("-n", type=int, default=40, help="flights of each effect")
    parser.add_argument("--hours", type=float, default=5.0, help="of nulls, and of the calibration")
    parser.add_argument("--plane", choices=tuple(PLANES), default="lateral")
    parser.add_argument("--noise", type=float, default=1.0, help="times the usual of every instrument")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--ideal", action="store_true", help="what could be noticed at all, nothing else")
    given = parser.parse_args(arguments)
    for rate in given.rates:
        s = made(rate, given.hours, PLANES[given.plane], given.noise, given.seed)
        print(
            f"\n{rate}: thresholds {s.calibration.named:.2f}, {s.calibration.unnamed:.2f} from {s.calibration.hours:.1f} h"
        )
        print("| air | hours | alarms | an hour | % of flights of 90 s |\n|---|---|---|---|---|")
        for gust in () if given.ideal else (1.0, 3.0):
            print(false_alarms(s, given.hours, gust), flush=True)
        print(
            "| effect | size | flights | noticed % | shown after s | median s | within 5 s % | right name first; of two % "
            "| first names | could be within 5 s %, told which | not told |"
        )
        print("|" + 11 * "---|")
        for name, size in (CHANGES if given.plane == "lateral" else PITCH_CHANGES).items():
            c = changed(s, name, size, given.n)
            print(noticed(s, name, c, size) + (ideal(s, c) if given.ideal else ""), flush=True)
        for name in HIDDEN if given.plane == "lateral" and not given.ideal else ():
            print(sudden(s, name, min(given.n, 10), rate), flush=True)


if __name__ == "__main__":
    main()
