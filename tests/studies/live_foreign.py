"""Live numbers and the monitor on aeroplanes of another simulator (`random_aeroplanes`), at every rate of scans.

`python -m tests.studies.live_foreign [--aeroplanes 8] [--first 0] [--rates 10 12 20 50 100] [--noise 1 3] [--gust 0 0.5]
[estimates|quiet]`: lateral flights of 26 s, beliefs 20 % off. `estimates`: rms error and coverage of the main derivatives at
the end; `quiet`: alarms of `watch` with the true model. Nothing of it was used to choose a number of the program. The last result
is kept in docs/validation/live.md.
"""

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from daq.identification.airframe import Airframe
from daq.identification.live import LiveEstimator
from estimation.aircraft import Aircraft
from estimation.aircraft.aircraft import PriorDerivative, Servos
from estimation.errors import EstimationError
from estimation.estimators.recursive import airframe_of, samples_of
from estimation.models import load_model
from estimation.watch.over_file import watch
from groundstation.flight import Flight
from tests.studies.random_aeroplanes import DEG, MAIN, Aeroplane, Situation, fly

OFF = 0.2  # of what is believed of each derivative
EXACT = 0.01  # of each derivative: what the model of quiet flights states of itself


def aircraft_of(craft: Aeroplane, rng: np.random.Generator, off: float, lag: float | None) -> Aircraft:
    """The aircraft file of an aeroplane, beliefs `off` of their values wrong."""
    beliefs = {
        n: PriorDerivative(v * (1.0 + off * rng.standard_normal()), max(off, EXACT) * abs(v), "study")
        for n, v in craft.derivatives.items()
        if v
    }
    Ixx, Iyy, Izz, Ixz = craft.inertia
    aircraft = Aircraft("random", craft.span, craft.area, craft.chord, craft.mass, Ixx, Iyy, Izz, Ixz)
    return replace(aircraft, derivatives=beliefs, servos=None if lag is None else Servos(lag, 10.0, 0.5, 0.5))


def drawn(
    options: argparse.Namespace, rate: float, noise: float, gust: float
) -> Iterator[tuple[Aeroplane, list[Flight], np.random.Generator]]:
    """Aeroplanes with a flight each. gust: rms sideslip [deg]."""
    for seed in range(options.first, options.first + options.aeroplanes):
        rng = np.random.default_rng([47, seed])
        craft = Aeroplane.drawn(rng)
        situation = Situation("", rate=rate, noise=noise, gust=gust * DEG)
        yield craft, fly(craft, situation, rng, flights=1), rng


def errors(airframe: Airframe, flight: Flight, truth: dict[str, float]) -> tuple[list[float], list[float]]:
    """Of the main derivatives at the end: relative errors, and errors over bounds, of those that are told."""
    estimator = LiveEstimator(airframe)
    for sample in samples_of(flight, slice(None)):
        estimator.add(sample)
    known = estimator.estimates().derivatives
    told = [(known[n], truth[n]) for n in MAIN if known[n].told]
    return [d.estimate / true - 1.0 for d, true in told], [(d.estimate - true) / d.std for d, true in told]


def estimates(options: argparse.Namespace, lag: float | None) -> None:
    print(
        "| scans a second | noise | gust deg | servo lag | told % | rms % | in 95 % bound % | in 3 bounds % |\n|"
        + "---|" * 8
    )
    for rate in options.rates:
        for noise in options.noise:
            for gust in options.gust:
                relative, z = list[float](), list[float]()
                for craft, flights, rng in drawn(options, rate, noise, gust):
                    aircraft = aircraft_of(craft, rng, OFF, lag)
                    airframe = airframe_of(load_model("lateral", aircraft), aircraft)
                    parts = errors(airframe, flights[0], dict(craft.derivatives))
                    relative += parts[0]
                    z += parts[1]
                size = np.abs(z)
                print(
                    f"| {rate:g} | {noise:g} | {gust:g} | {'known' if lag else 'not known'} "
                    f"| {100 * len(z) / (8 * options.aeroplanes):.0f} | {100 * np.sqrt(np.mean(np.square(relative))):.1f} "
                    f"| {100 * np.mean(size < 1.96):.0f} | {100 * np.mean(size < 3):.0f} |",
                    flush=True,
                )


def quiet(options: argparse.Namespace, lag: float | None) -> None:
    print(
        "| scans a second | noise | gust deg | servo lag | flights | with an alarm | largest score | alarms |\n|"
        + "---|" * 8
    )
    for rate in options.rates:
        for noise in options.noise:
            for gust in options.gust:
                alarms, scores, flown = list[str](), list[float](), 0
                for craft, flights, rng in drawn(options, rate, noise, gust):
                    aircraft = aircraft_of(craft, rng, 0.0, lag)
                    try:
                        answer = watch(load_model("lateral", aircraft), flights[0], aircraft, hours=options.hours)
                    except EstimationError as error:
                        print("refused:", error)
                        continue
                    flown += 1
                    scores.append(max(w.score for w in answer.history))
                    alarms += [a.leading[0].effect if a.leading else a.channels[0] + "?" for a in answer.alarms[:1]]
                print(
                    f"| {rate:g} | {noise:g} | {gust:g} | {'known' if lag else 'not known'} | {flown} | {len(alarms)} "
                    f"| {max(scores):.2f} | {', '.join(alarms)} |",
                    flush=True,
                )


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", nargs="?", choices=("estimates", "quiet"), default="estimates")
    parser.add_argument("--aeroplanes", type=int, default=8)
    parser.add_argument("--first", type=int, default=0, help="number of the first of them")
    parser.add_argument("--rates", type=float, nargs="+", default=[10.0, 12.0, 20.0, 50.0, 100.0])
    parser.add_argument("--noise", type=float, nargs="+", default=[1.0, 3.0])
    parser.add_argument("--gust", type=float, nargs="+", default=[0.0, 0.5])
    parser.add_argument(
        "--hours", type=float, default=0.8, help="of simulated manoeuvring behind the thresholds of `quiet`"
    )
    parser.add_argument("--lag", choices=("known", "unknown", "both"), default="both")
    options = parser.parse_args(arguments)
    for lag in {"known": (0.035,), "unknown": (None,), "both": (0.035, None)}[options.lag]:
        (estimates if options.what == "estimates" else quiet)(options, lag)


if __name__ == "__main__":
    main()
