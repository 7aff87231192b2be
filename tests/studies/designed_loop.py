"""Fly, estimate, design the next, fly: three designed flights against flights of plain doublets.

`python -m tests.studies.designed_loop [--seeds 6] [--doublets 12] [--gust 0.1]`
Each seed is a campaign of its own on the project's simulator through the direct sensor model. The designed series begins with
the input that beliefs give; each further one is designed from the joint estimate so far (values and noise of the residuals, as
`design --from`). The other series flies the same set of doublets again and again under the same limits. Compared are
corrected bounds of the joint estimates over the size of each derivative. The last result is kept in docs/design.md.
"""

import argparse
from collections.abc import Sequence

import numpy as np

from daq.contract.manoeuvre import Manoeuvre
from estimation.design.design import DesignTask, InputDesign, design
from estimation.estimators.output_error import OutputErrorOptions, output_error
from estimation.estimators.result import Result
from estimation.prepare.pipeline import prepare_all
from firmware_sim.runs.direct import ORDINARY_NOISE, direct_flights
from firmware_sim.world.scenario import load_scenario
from groundstation.flight import Flight
from tests.studies.designed_flights import AIRCRAFT, DURATION, MODEL, NOISE, SPEED, START, _part
from tests.studies.injected import Injected

DESIGNED = 3


def flown(manoeuvre: Manoeuvre, seed: int, gust_deg: float) -> Flight:
    """The part of a flight in which the manoeuvre is flown."""
    scenario = load_scenario("quiet").altered(
        flight={"speed_m_s": SPEED, "manoeuvres": "none", "duration_s": START + DURATION + 1.0},
        wind={"gust_deg": gust_deg},
    )
    columns = direct_flights([scenario], [seed], noise=ORDINARY_NOISE, wiring=Injected(manoeuvre, START))[0]
    return _part(columns["time"], {k: v for k, v in columns.items() if k != "time"}, START)


def joint(flights: Sequence[Flight]) -> Result:
    """Maximum likelihood of all flights together."""
    return output_error(MODEL, prepare_all(MODEL, list(flights)), options=OutputErrorOptions())


def next_design(result: Result, seed: int) -> InputDesign:
    """The optimal input at what has been estimated."""
    noise = {s.name: float(np.sqrt(result.R[i, i])) for i, s in enumerate(MODEL.outputs)}
    values = {n: p.estimate for n, p in result.parameters.items()}
    task = DesignTask("optimal", DURATION, SPEED, values=values, noise=noise, noise_of_residuals=True, seed=seed)
    return design(MODEL, AIRCRAFT, task)


def relative(result: Result, sizes: dict[str, float]) -> np.ndarray:
    """Corrected bounds over sizes."""
    return np.array([result.parameters[n].std_coloured / abs(s) for n, s in sizes.items()])


def designed_series(seed: int, gust_deg: float) -> tuple[list[np.ndarray], dict[str, float]]:
    """Relative bounds after each designed flight."""
    plan = design(MODEL, AIRCRAFT, DesignTask("optimal", DURATION, SPEED, noise=NOISE, seed=seed))
    sizes = dict(plan.sizes)
    flights: list[Flight] = []
    bounds = []
    for turn in range(DESIGNED):
        flights.append(flown(plan.manoeuvre(), 1000 * seed + turn, gust_deg))
        result = joint(flights)
        bounds.append(relative(result, sizes))
        plan = next_design(result, seed + turn)
    return bounds, sizes


def doublet_series(seed: int, gust_deg: float, count: int, sizes: dict[str, float]) -> list[np.ndarray]:
    """Relative bounds after each flight of doublets."""
    manoeuvre = design(MODEL, AIRCRAFT, DesignTask("doublet", DURATION, SPEED, noise=NOISE)).manoeuvre()
    flights = [flown(manoeuvre, 1000 * seed + 500 + i, gust_deg) for i in range(count)]
    return [relative(joint(flights[: i + 1]), sizes) for i in range(count)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=6)
    parser.add_argument("--doublets", type=int, default=12)
    parser.add_argument("--gust", type=float, default=0.1, help="sideslip of the gusts, 1 sigma [deg]")
    options = parser.parse_args()
    designed, doublets = [], []
    for seed in range(1, options.seeds + 1):
        bounds, sizes = designed_series(seed, options.gust)
        designed.append(bounds)
        doublets.append(doublet_series(seed, options.gust, options.doublets, sizes))
        print(f"seed {seed} flown", flush=True)
    print(f"\n{options.seeds} campaigns, gusts {options.gust:g} deg; medians over the campaigns")
    print("| flights | designed: worst, mean relative bound [%] | doublets: worst, mean [%] |")
    print("|---|---|---|")
    for i in range(options.doublets):
        cells = []
        for series in (designed, doublets):
            rows = [s[i] for s in series if i < len(s)]
            cells.append(
                f"{100 * np.median([r.max() for r in rows]):.1f}, {100 * np.median([r.mean() for r in rows]):.2f}"
                if rows
                else ""
            )
        print(f"| {i + 1} | {cells[0]} | {cells[1]} |")


if __name__ == "__main__":
    main()
