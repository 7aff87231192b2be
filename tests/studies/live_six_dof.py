"""Both planes live on flights of two simulators that share no code with the estimator: rms error and coverage.

`python -m tests.studies.live_six_dof [second|random] [--aircraft 20] [--first 0] [--rates 10 20 link 50] [--gust 0.1]`: aileron,
rudder and elevator by hand. second: the second truth (20 Hz, thinned for slower rates), derivatives within 10 % of beliefs, a
minute of two flights. random: aeroplanes of another simulator, beliefs 20 % off, a flight of 26 s in each plane, servos' lag
known. link: 11.5 Hz with 5 % lost. Nothing of it was used to choose a number of the program. The last result is kept in
docs/validation/live.md.
"""

import argparse
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from daq.identification.airframe import PITCH_SIGNALS, SIGNALS, Airframe, Belief, Sample
from daq.identification.live import JointEstimator
from daq.identification.regression import LATERAL, LONGITUDINAL
from estimation.aircraft.library import load_aircraft
from sideslip.live_aircraft import airframe_of_file
from tests.studies import random_aeroplanes, second_truth
from tests.studies.live_foreign import aircraft_of
from tests.studies.live_pitch_statistics import SEVEN
from tests.studies.live_statistics import EIGHT, joined, through_link
from tests.studies.random_aeroplanes import DEG, Aeroplane, Situation

Array = NDArray[np.float64]
BOTH = (LATERAL, LONGITUDINAL)
HALF = 30.0  # s after which the first answer is looked at


@dataclass(frozen=True)
class Flown:
    """One aircraft: columns of its flights one after the other, what is believed of it, and what it is."""

    columns: Mapping[str, Array]
    airframe: Airframe
    truth: Mapping[str, float]


def of_second(o: argparse.Namespace, rate: float) -> Iterator[Flown]:
    """Aircraft of the second truth, a minute each."""
    craft = replace(load_aircraft("cdfp"), mass=second_truth.MASS, **second_truth.INERTIA)
    airframe = airframe_of_file(craft, BOTH)
    about = second_truth.TRUE_DERIVATIVES
    airframe = replace(airframe, beliefs={n: Belief(about.get(n, b.value), b.std) for n, b in airframe.beliefs.items()})
    for seed in range(o.first, o.first + o.aircraft):
        rng = np.random.default_rng([51, seed])
        truth, speed = second_truth.perturbed_derivatives(rng, 0.1), rng.uniform(14.5, 19.0)
        requests = [
            second_truth.Request(
                40_000 + 2 * seed + part, speed, {}, o.gust * DEG, "all", truth, duration=HALF, centred=True
            )
            for part in range(2)
        ]
        yield Flown(thinned(joined(second_truth.fly(requests)), round(second_truth.SAMPLE / rate)), airframe, truth)


def of_random(o: argparse.Namespace, rate: float) -> Iterator[Flown]:
    """Random aeroplanes, one flight in each plane."""
    for seed in range(o.first, o.first + o.aircraft):
        rng = np.random.default_rng([52, seed])
        craft = Aeroplane.drawn(rng)
        situation = Situation("", rate=rate, gust=o.gust * DEG)
        flights = [
            random_aeroplanes.fly(craft, replace(situation, pitch=pitch), rng, flights=1)[0] for pitch in (False, True)
        ]
        thrust = float(flights[1]["thrust"][0])  # throughout; a lateral record of that simulator does without
        columns = joined([{"time": f.time, **f.columns, "thrust": np.full(f.time.size, thrust)} for f in flights])
        yield Flown(
            columns, airframe_of_file(aircraft_of(craft, rng, 0.2, situation.servo), BOTH), dict(craft.derivatives)
        )


def thinned(columns: Mapping[str, Array], every: int) -> dict[str, Array]:
    return {n: v[::every] for n, v in columns.items()}


SOURCES = {"second": of_second, "random": of_random}


def errors(flown: Flown) -> Iterator[list[tuple[str, float, float]]]:
    """After `HALF` and at the end: name, relative error, and error over bound of what is told."""
    estimator, half = JointEstimator(flown.airframe, BOTH), False
    rows = np.stack([flown.columns[n] for n in ("time", *SIGNALS, *PITCH_SIGNALS)], axis=1)
    for row in rows.tolist():
        if not half and row[0] > HALF:
            half = True
            yield _told(estimator, flown.truth)
        estimator.add(Sample(*row))
    yield _told(estimator, flown.truth)


def _told(estimator: JointEstimator, truth: Mapping[str, float]) -> list[tuple[str, float, float]]:
    known = estimator.estimates().derivatives
    told = [(n, known[n]) for n in (*EIGHT, *SEVEN) if known[n].told]
    return [(n, d.estimate / truth[n] - 1.0, (d.estimate - truth[n]) / d.std) for n, d in told]


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("source", nargs="?", choices=tuple(SOURCES), default="second")
    parser.add_argument("--aircraft", type=int, default=20)
    parser.add_argument("--first", type=int, default=0, help="number of the first of them")
    parser.add_argument("--rates", nargs="+", default=["10", "20", "link"])
    parser.add_argument("--gust", type=float, default=0.1, help="rms sideslip of the gusts [deg]")
    options = parser.parse_args(arguments)
    print("| scans a second | after | plane | told % | rms % | in 95 % bound % | each rms % |\n|" + "---|" * 7)
    for rate in options.rates:
        found: list[list[list[tuple[str, float, float]]]] = [[], []]
        for number, flown in enumerate(SOURCES[options.source](options, 20.0 if rate == "link" else float(rate))):
            sent = through_link(flown.columns, number, 0.05) if rate == "link" else flown.columns
            for at, answer in zip(found, errors(replace(flown, columns=sent)), strict=True):
                at.append(answer)
        for after, answers in zip(("half", "end"), found, strict=True):
            for plane, names in (("lateral", EIGHT), ("pitching", SEVEN)):
                told = [e for answer in answers for e in answer if e[0] in names]
                each = {n: rms([r for m, r, _ in told if m == n]) for n in names}
                inside = 100 * np.mean([abs(z) < 1.96 for *_, z in told]) if told else np.nan
                print(
                    f"| {rate} | {after} | {plane} | {100 * len(told) / (len(names) * len(answers)):.0f} "
                    f"| {rms([r for _, r, _ in told]):.1f} | {inside:.0f} "
                    f"| {', '.join(f'{n} {x:.1f}' for n, x in each.items())} |",
                    flush=True,
                )


def rms(relative: Sequence[float]) -> float:
    return 100.0 * float(np.sqrt(np.mean(np.square(relative)))) if relative else float("nan")


if __name__ == "__main__":
    main()
