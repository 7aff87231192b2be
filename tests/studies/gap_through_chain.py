"""The gap workflow on flights that went the whole way: sensors, bus, logger, attitude filter and calibration.

`python -m tests.studies.gap_through_chain [--nulls-from 400 --nulls 8] [--effects NAME ...] [--gust DEG] [--budget SECONDS]
[--model lateral|longitudinal|six-dof] [--direct]`:
for each set three training flights and one held out of one aircraft are flown and given to the workflow, which is told
nothing; with `--direct` the truth with white noise of sensors, sampled at once, in place of the chain. A line a set, then
the counts. The last result is kept in docs/gap.md.
"""

import argparse
import tempfile
import time
from pathlib import Path

from estimation.gap.effects import catalogue
from estimation.gap.workflow import run_gap
from estimation.models.load import load_model
from firmware_sim.runs.campaign import CampaignFlights
from groundstation.flight import Flight, read_flight
from sideslip import fly_scenario
from tests.studies.gap_benchmark import flights as from_columns
from tests.unit.firmware_sim.campaigns import fly_campaigns

EFFECTS = (
    "Cn_da", "beta_lag", "Cl_alpha_beta", "rudder_delay", "Cl_beta3", "aileron_delay", "CY_da", "beta_scale",
    "Cn_beta3", "aileron_lag", "imu_lever_arm", "Cl_p_abs_p",
)  # fmt: skip
PITCH_EFFECTS = (
    "alpha_scale",
    "Cm_alphadot",
    "propwash_elevator",
    "elevator_lag",
    "CL_alpha2",
    "thrust_scale",
    "imu_x",
    "theta_lag",
)
CROSS_EFFECTS = ("Cm_beta2", "Cn_alpha_p", "Cm_da2", "prop_gyroscopic")
SUBJECTS = {
    "lateral": (EFFECTS, "rich"),
    "longitudinal": (PITCH_EFFECTS, "longitudinal"),
    "six-dof": (CROSS_EFFECTS, "all_axes"),
}
"""Model -> effects, plan of the flights."""


def flown(hidden: tuple[tuple[str, float], ...], seed: int, gust_deg: float, plan: str = "rich") -> list[Flight]:
    """Four calibrated flights of one aircraft."""
    flights = []
    with tempfile.TemporaryDirectory() as folder:
        campaign = CampaignFlights(hidden=hidden, seed=seed, gust_deg=gust_deg, manoeuvres=plan)
        for number, (scenario, own) in enumerate(campaign.scenarios()):
            done = fly_scenario(scenario, Path(folder) / str(number), seed=own, backfill=False)
            flights.append(read_flight(done.onboard))
    return flights


def direct(hidden: tuple[tuple[str, float], ...], seed: int, gust_deg: float, plan: str = "rich") -> list[Flight]:
    """The same flights as the sensors alone would show them."""
    (done,) = fly_campaigns([CampaignFlights(hidden=hidden, seed=seed, gust_deg=gust_deg, manoeuvres=plan)])
    return from_columns([*done.training, *done.holdout])


def main() -> None:
    """Fly, ask, count."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--nulls-from", type=int, default=400)
    parser.add_argument("--nulls", type=int, default=8)
    parser.add_argument("--effects", nargs="*", help="default: what suits the model")
    parser.add_argument("--model", default="lateral", choices=SUBJECTS)
    parser.add_argument("--gust", type=float, default=0.15)
    parser.add_argument("--direct", action="store_true", help="the truth with sensor noise in place of the chain")
    parser.add_argument("--budget", type=float, default=float("inf"), help="begin no further set after so many seconds")
    given = parser.parse_args()
    plan: list[tuple[str, ...]] = []
    usual, manoeuvres = SUBJECTS[given.model]
    model = load_model(given.model, "cdfp")
    effects = [(name,) for name in (usual if given.effects is None else given.effects)]
    nulls: list[tuple[str, ...]] = [() for _ in range(given.nulls)]
    while effects or nulls:  # by turns, so that a study cut short has some of both
        plan += [part.pop(0) for part in (nulls, effects) if part]
    counts = {"nulls": 0, "false": 0, "effects": 0, "exact": 0, "closed": 0, "rest": 0}
    begun = time.monotonic()
    for number, names in enumerate(plan):
        if time.monotonic() - begun > given.budget:
            break
        hidden = tuple((name, 1.0) for name in names)
        flights = (direct if given.direct else flown)(hidden, given.nulls_from + number, given.gust, manoeuvres)
        result = run_gap(model, flights[:3], flights[3:], catalogue(model=model))
        said = [step.effect for step in result.steps]
        print(f"{'+'.join(names) or 'nothing':<16} {result.verdict:<15} {' '.join(said)}", flush=True)
        if names:
            counts["effects"] += 1
            counts["exact"] += said[:1] == list(names)
            counts["closed"] += result.verdict == "gap_closed"
            counts["rest"] += "unknown" in said
        else:
            counts["nulls"] += 1
            counts["false"] += bool(said)
    print(", ".join(f"{name} {count}" for name, count in counts.items()))


if __name__ == "__main__":
    main()
