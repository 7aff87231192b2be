"""Statistics of the recursive estimator in the pitching plane: rms error and coverage after 30 s or more at several rates.

`python -m tests.studies.live_pitch_statistics [--flights 40] [--rates 10 12.5 20 50 100] [--seconds 30]`:
flights of the project's simulator,
elevator and throttle by hand, derivatives about those believed, flown at 100 Hz and thinned. The last
result is kept in docs/validation/live.md.
"""

import argparse
from collections.abc import Sequence

import numpy as np

from daq.identification.airframe import PITCH_SIGNALS, SIGNALS, Sample
from daq.identification.live import LiveEstimator
from daq.identification.regression import LONGITUDINAL
from estimation.aircraft.library import load_aircraft
from firmware_sim.runs.direct import direct_flights
from firmware_sim.world.scenario import load_scenario
from firmware_sim.world.simulation import derivatives_of
from sideslip.live_aircraft import airframe_of_file

SEVEN = ("CL_alpha", "CL_de", "CD_0", "CD_k", "Cm_alpha", "Cm_q", "Cm_de")
FASTEST = 100.0  # Hz


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--flights", type=int, default=40)
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--first", type=int, default=101, help="seed of the first of them")
    parser.add_argument("--rates", type=float, nargs="+", default=[10.0, 12.5, 20.0, 50.0, 100.0])
    options = parser.parse_args(arguments)
    scenario = load_scenario("longitudinal").altered(wind={"gust_deg": 0.1}, flight={"duration_s": options.seconds})
    seeds = list(range(options.first, options.first + options.flights))
    flights = direct_flights([scenario] * len(seeds), seeds, rate_hz=FASTEST)
    airframe = airframe_of_file(load_aircraft("cdfp"), (LONGITUDINAL,))
    print("| scans a second | rms error of the seven % | in 95 % bound % | within 3 bounds % | each rms % |")
    print("|---|---|---|---|---|")
    for rate in options.rates:
        relative, in_bounds = [], []
        for seed, columns in zip(seeds, flights, strict=True):
            truth, estimator = derivatives_of(scenario, seed), LiveEstimator(airframe, LONGITUDINAL)
            rows = np.stack([columns[n] for n in ("time", *SIGNALS, *PITCH_SIGNALS)], axis=1)
            for row in rows[:: round(FASTEST / rate)].tolist():
                estimator.add(Sample(*row))
            known = estimator.estimates().derivatives
            relative.append([known[n].estimate / truth[n] - 1.0 for n in SEVEN])
            in_bounds.append([abs(known[n].estimate - truth[n]) / known[n].std for n in SEVEN])
        rms = 100.0 * np.sqrt(np.mean(np.square(relative), axis=0))
        z = np.array(in_bounds)
        print(
            f"| {rate:g} | {np.sqrt(np.mean(rms**2)):.1f} | {100 * np.mean(z < 1.96):.0f} | {100 * np.mean(z < 3.0):.0f} "
            f"| {', '.join(f'{n} {x:.1f}' for n, x in zip(SEVEN, rms, strict=True))} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
