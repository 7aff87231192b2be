"""Designed inputs flown many times: the scatter of the estimates against the bounds that the design predicted.

`python -m tests.studies.designed_flights [--flights 200] [--gust 0.0] [--exact] [--chain 20]`
Flights of the project's simulator through its direct sensor model; with --chain, so many through bus, onboard
sequencer, recorder and calibration as well. Two predictions: from the beliefs that the input was designed with, and from
the means of the estimates and the noise that their residuals show (what `design --from` would be given). --exact leaves
out the noise of what the model takes as exact. The last result is kept in docs/design.md.
"""

import argparse
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from daq.contract.manoeuvre import Manoeuvre
from estimation.aircraft import load_aircraft
from estimation.answers.designs import write_manoeuvre
from estimation.design.design import DesignTask, InputDesign, design
from estimation.design.predict import fly, information
from estimation.estimators.output_error import OutputErrorOptions, output_error
from estimation.models import load_model
from estimation.prepare.pipeline import prepare_all
from firmware_sim.runs.direct import ORDINARY_NOISE, DirectNoise, direct_flights
from firmware_sim.world.scenario import load_scenario
from groundstation.flight import Flight
from tests.studies.injected import Injected

SPEED, DURATION, START = 16.0, 20.0, 2.0
AIRCRAFT = load_aircraft("cdfp")
MODEL = load_model("lateral", AIRCRAFT)
AT_REST = ("CY_0", "Cl_0", "Cn_0")
NOISE = {name: getattr(ORDINARY_NOISE, name) for name in MODEL.output_names}
EXACT_INPUTS = DirectNoise(surfaces=0.0, V=0.0, alpha=0.0, theta=0.0)
"""Noise on the model's outputs only, which is what a Cramer-Rao bound supposes."""
CROWD = 50


def designed() -> InputDesign:
    return design(MODEL, AIRCRAFT, DesignTask("multisine", DURATION, SPEED, noise=NOISE))


def direct(manoeuvre: Manoeuvre, flights: int, gust_deg: float, noise: DirectNoise) -> Iterator[Flight]:
    """The part of each flight in which the manoeuvre is flown."""
    scenario = load_scenario("quiet").altered(
        flight={"speed_m_s": SPEED, "manoeuvres": "none", "duration_s": START + DURATION + 1.0},
        wind={"gust_deg": gust_deg},
    )
    for first in range(1, flights + 1, CROWD):
        seeds = list(range(first, min(first + CROWD, flights + 1)))
        for columns in direct_flights([scenario] * len(seeds), seeds, noise=noise, wiring=Injected(manoeuvre, START)):
            yield _part(columns["time"], {k: v for k, v in columns.items() if k != "time"}, START)


def chained(first: InputDesign, flights: int, gust_deg: float) -> Iterator[Flight]:
    """The same through the simulated bus and the onboard sequencer, calibrated from the recording."""
    from firmware_sim.runs.flight import prepare_flight
    from groundstation.calibration.calibration_set import NOMINAL_DIRECTORY
    from groundstation.calibration.recording import calibrate_recording

    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "manoeuvre.toml"
        write_manoeuvre(first, file)
        scenario = load_scenario("sequencer").altered(
            flight={"speed_m_s": SPEED, "duration_s": 6.5 + DURATION + 2.0},
            wind={"gust_deg": gust_deg},
            sequencer={"switch": [[0.0, "off"], [3.0, "arm"], [6.0, "go"]]},
            logger={"sequencer": {"manoeuvre": str(file)}},
        )
        for seed in range(1, flights + 1):
            place = Path(folder) / str(seed)
            with prepare_flight(scenario, place, seed=seed, calibration=NOMINAL_DIRECTORY / "cdfp") as flight:
                flight.run()
            flown = calibrate_recording(place / "onboard")
            yield _part(flown.time, flown.columns, 6.1)


def _part(time: np.ndarray, columns: Mapping[str, np.ndarray], start: float) -> Flight:
    keep = (time >= time[0] + start - 1e-6) & (time <= time[0] + start + DURATION + 1e-6)
    return Flight.build("flight", time[keep], {name: values[keep] for name, values in columns.items()})


@dataclass
class Fits:
    """Of each flight by itself: estimates and corrected bounds by parameter, residuals (rms) by output; (flights,) each."""

    estimates: dict[str, np.ndarray]
    bounds: dict[str, np.ndarray]
    residuals: dict[str, float]
    rate_hz: float


def fitted(flights: Iterator[Flight]) -> Fits:
    """Maximum likelihood of each flight."""
    options = OutputErrorOptions()
    all_of_them = list(flights)
    results = [output_error(MODEL, [flight], options=options) for flight in prepare_all(MODEL, all_of_them)]
    good = [r for r in results if r.converged]
    names = good[0].parameters
    return Fits(
        {n: np.array([r.parameters[n].estimate for r in good]) for n in names},
        {n: np.array([r.parameters[n].std_coloured for r in good]) for n in names},
        {s: float(np.median([np.sqrt(r.R[i, i]) for r in good])) for i, s in enumerate(MODEL.output_names)},
        1.0 / float(np.median(np.diff(all_of_them[0].time))),
    )


def again(first: InputDesign, fits: Fits) -> InputDesign:
    """The same input as `design --from` would predict it: means of the estimates, noise as the residuals show it."""
    setting = first.setting
    means = {n: float(np.mean(v)) for n, v in fits.estimates.items() if n in setting.values}
    changed = replace(setting, values={**setting.values, **means}, noise=fits.residuals, noise_of_residuals=True)
    flown = fly(changed, first.best.commands)
    best = replace(first.best, motion=flown, information=information(changed, flown))
    return replace(first, setting=changed, best=best)


def table(title: str, first: InputDesign, flights: Iterator[Flight], exact: bool = False) -> None:
    fits = fitted(flights)
    count = len(next(iter(fits.estimates.values())))
    after = again(first, fits)
    predictions = (
        [first.best.information.std, after.best.information.std] if exact else [first.expected, after.expected]
    )
    known = 100 / np.sqrt(2 * (count - 1))
    print(f"\n{title}: {count} flights at {fits.rate_hz:.0f} Hz; each ratio is known to {known:.0f} % (1 sigma)")
    print("| | scatter | from beliefs | ratio | from the last flights | ratio | / corrected bound |")
    print("|---|---|---|---|---|---|---|")
    ratios = []
    for name, values in fits.estimates.items():
        if name in AT_REST or name not in predictions[0]:
            continue
        scatter = float(np.std(values, ddof=1))
        one, two = (prediction[name] for prediction in predictions)
        ratios.append((scatter / one, scatter / two, scatter / float(np.median(fits.bounds[name]))))
        shares = [f"{r:.2f}" for r in ratios[-1]]
        print(f"| {name} | {scatter:.2g} | {one:.2g} | {shares[0]} | {two:.2g} | {shares[1]} | {shares[2]} |")
    rms = np.sqrt(np.mean(np.square(ratios), axis=0))
    print(
        f"rms of the ratios: {rms[0]:.2f} from beliefs, {rms[1]:.2f} from the last flights, {rms[2]:.2f} to the corrected bound"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--flights", type=int, default=200)
    parser.add_argument("--chain", type=int, default=0)
    parser.add_argument("--gust", type=float, default=0.0, help="sideslip of the gusts, 1 sigma [deg]")
    parser.add_argument(
        "--exact", action="store_true", help="no noise on surfaces, airspeed, angle of attack and pitch"
    )
    options = parser.parse_args()
    first = designed()
    manoeuvre = first.manoeuvre()
    if options.flights:
        noise = EXACT_INPUTS if options.exact else ORDINARY_NOISE
        title = f"direct, gusts {options.gust:g} deg{', exact inputs' if options.exact else ''}"
        table(title, first, direct(manoeuvre, options.flights, options.gust, noise), options.exact)
    if options.chain:
        table(f"chain, gusts {options.gust:g} deg", first, chained(first, options.chain, options.gust))


if __name__ == "__main__":
    main()
