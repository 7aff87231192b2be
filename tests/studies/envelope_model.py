"""One model over the envelope against models of one condition: simulated campaigns with known truth, flights held out.

    python -m tests.studies.envelope_model [-n 24] [--against 6] [--first 301] [--flights 18] [--plain]

Flights at 13.5 to 19.5 m/s whose Cl_beta and Cn_beta change with angle of attack and whose Cn is cubic in sideslip (--plain:
aircraft whose derivatives are constants). Two thirds are fitted together, one third predicted: by the model over the envelope,
by the joint constant model, and (in the first `against` campaigns) by each flight's own. Bands are held against the truth at the
mean conditions of the flights held out, without sideslip, and Cn_beta also at their largest sideslip. Seeds up to 210 were
looked at when the method was made.
"""

import json
import tempfile
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click
import numpy as np

from estimation.aircraft import load_aircraft
from estimation.campaign.aerodynamics.joint import GlobalModel, global_model, half_band
from estimation.campaign.aerodynamics.terms import derivatives_of
from estimation.estimators.output_error import output_error
from estimation.models import Model, load_model
from estimation.models.base import ParameterRole, joint_model
from estimation.session.proof_of_match import predict_flight
from firmware_sim.physics.aerodynamics import true_derivatives
from firmware_sim.runs.direct import direct_flights, write_csv
from firmware_sim.world.scenario import load_scenario
from groundstation.flight import Flight, read_flight

HIDDEN = {"Cl_alpha_beta": ("Cl_beta", -0.75), "Cn_alpha_beta": ("Cn_beta", -0.15)}
ALPHA_THERE = 0.086  # rad, at which the simulator's derivatives are those of its aircraft
CUBIC, CUBE = "Cn_beta3", 0.25
SLOW, FAST = 13.5, 19.5


def made_flights(folder: Path, count: int, seed: int, hidden: tuple[str, ...]) -> list[Flight]:
    """Flights of 20 s at speeds drawn evenly."""
    base = load_scenario("quiet")
    speeds = np.random.default_rng(seed).uniform(SLOW, FAST, count)
    effects = [{"name": name, "size": 1.0} for name in hidden]
    plans = [
        base.altered(flight={"speed_m_s": float(s), "duration_s": 20.0, "manoeuvres": "rich"}, hidden=effects)
        for s in speeds
    ]
    flights = []
    for i, columns in enumerate(direct_flights(plans, [1000 * seed + i for i in range(count)])):
        path = folder / f"flight{i:03d}.csv"
        write_csv(path, columns)
        flights.append(read_flight(path))
    return flights


def misfit(model: Model, flights: list[Flight], noise: Mapping[str, float]) -> float:
    """Mean square of what is left of flights predicted with frozen derivatives, in units of `noise`."""
    left = []
    for flight in flights:
        proof = predict_flight(model, flight, free=model.free_of(ParameterRole.CONSTANT))
        off = (proof.measured - proof.predicted) / np.array([noise[n] for n in proof.outputs])
        left.append(float(np.nanmean(off**2)))
    return float(np.mean(left))


LARGE = "Cn_beta at large sideslip"


def inside(found: GlobalModel, model: Model, flights: list[Flight], hidden: tuple[str, ...]) -> dict[str, list[bool]]:
    """For each derivative and flight held out: whether 95 % at its mean conditions hold the truth."""
    true = true_derivatives(load_aircraft("cdfp"), {})
    quiet = [{"beta": 0.0, **{v: float(np.nanmean(f[v])) for v in ("alpha", "V", "delta_e")}} for f in flights]
    swung = [{**a, "beta": float(np.nanmax(np.abs(f["beta"])))} for a, f in zip(quiet, flights, strict=True)]
    covered = {}
    for label in (*derivatives_of(model), LARGE):
        name = label.partition(" ")[0]
        at = swung if label == LARGE else quiet
        slope = sum(size for effect, (of, size) in HIDDEN.items() if of == name and effect in hidden)
        cubic = CUBE if CUBIC in hidden and name == "Cn_beta" else 0.0
        value, std = found.at(name, at)
        truth = np.array([true[name] + slope * (a["alpha"] - ALPHA_THERE) + cubic * a["beta"] ** 2 for a in at])
        covered[label] = (np.abs(value - truth) < half_band(std, len(found.result.flights))).tolist()
    return covered


def campaign(seed: int, count: int, hidden: tuple[str, ...], *, singles: bool) -> dict[str, Any]:
    """One campaign: what was chosen, and how everything predicts. singles: also the model of each flight by itself."""
    model = load_model("lateral", "cdfp")
    with tempfile.TemporaryDirectory() as folder:
        flights = made_flights(Path(folder), count, seed, hidden)
    kept, held = flights[: 2 * count // 3], flights[2 * count // 3 :]
    found = global_model(model, kept)
    constant = output_error(joint_model(model), kept)
    rivals = [output_error(model, f).fitted_model for f in kept] if singles else []
    return {
        "seed": seed,
        "terms": {g.name: round(found.result.values[g.name], 4) for g in found.gains},
        "global": misfit(found.model, held, constant.noise),
        "constant": misfit(constant.fitted_model, held, constant.noise),
        "best single": min((misfit(m, held, constant.noise) for m in rivals), default=None),
        "covered": {n: sum(c) for n, c in inside(found, model, held, hidden).items()},
        "of": len(held),
    }


@click.command()
@click.option("-n", "campaigns", default=24)
@click.option("--against", default=6, help="Campaigns in which each flight's own model predicts the others, too.")
@click.option("--first", default=301)
@click.option("--flights", default=18)
@click.option("--plain", is_flag=True)
def main(campaigns: int, against: int, first: int, flights: int, plain: bool) -> None:
    """Fly, fit, predict."""
    hidden = () if plain else (*HIDDEN, CUBIC)
    covered: Counter[str] = Counter()
    points, better = 0, 0
    for seed in range(first, first + campaigns):
        row = campaign(seed, flights, hidden, singles=seed < first + against)
        print(json.dumps(row), flush=True)
        covered += Counter(row["covered"])
        points += row["of"]
        better += row["global"] < min(x for x in (row["constant"], row["best single"]) if x is not None)
    print(f"better than every model of one condition that was asked: {better} of {campaigns}")
    print(
        "95 % bands hold the truth:",
        {n: f"{c / points:.0%}" for n, c in covered.items()},
        f"{sum(covered.values()) / points / len(covered):.1%}",
    )


if __name__ == "__main__":
    main()
