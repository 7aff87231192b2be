"""One model over the envelope against models of one condition: simulated campaigns with known truth, flights held out.

    python -m tests.studies.envelope_model [-n 8] [--flights 18] [--plain]

Flights at 13.5 to 19.5 m/s whose Cl_beta and Cn_beta change with angle of attack and whose Cn is cubic in sideslip (--plain:
aircraft whose derivatives are constants). Two thirds are fitted together, one third predicted: by the model over the envelope,
by the joint constant model, and by each flight's own. Bands are held against the truth at the conditions of the flights held out.
"""

import json
import tempfile
from collections.abc import Mapping
from pathlib import Path

import click
import numpy as np

from estimation.aircraft import load_aircraft
from estimation.campaign.aerodynamics.joint import GlobalModel, global_model, half_band
from estimation.campaign.aerodynamics.terms import derivatives_of
from estimation.estimators.output_error import output_error
from estimation.models import Model, load_model
from estimation.models.base import ParameterRole
from estimation.session.proof_of_match import predict
from estimation.session.runner import joint_model
from firmware_sim.physics.aerodynamics import true_derivatives
from firmware_sim.runs.direct import direct_flights, write_csv
from firmware_sim.world.scenario import load_scenario
from groundstation.flight import Flight, read_flight

HIDDEN = {"Cl_alpha_beta": ("Cl_beta", -0.75), "Cn_alpha_beta": ("Cn_beta", -0.15)}
ALPHA_THERE = 0.086  # rad, at which the simulator's derivatives are those of its aircraft
CUBIC = "Cn_beta3"
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
        proof = predict(model, flight, free=model.free_of(ParameterRole.CONSTANT))
        off = (proof.measured - proof.predicted) / np.array([noise[n] for n in proof.outputs])
        left.append(float(np.nanmean(off**2)))
    return float(np.mean(left))


def inside(found: GlobalModel, model: Model, flights: list[Flight], hidden: tuple[str, ...]) -> dict[str, list[bool]]:
    """For each derivative and flight held out: whether 95 % at its mean conditions hold the truth."""
    true = true_derivatives(load_aircraft("cdfp"), {})
    covered = {}
    for name in derivatives_of(model):
        slope = sum(size for effect, (of, size) in HIDDEN.items() if of == name and effect in hidden)
        at = [{"beta": 0.0, **{v: float(np.nanmean(f[v])) for v in ("alpha", "V", "delta_e")}} for f in flights]
        value, std = found.at(name, at)
        truth = np.array([true[name] + slope * (a["alpha"] - ALPHA_THERE) for a in at])
        covered[name] = (np.abs(value - truth) < half_band(std, len(found.result.flights))).tolist()
    return covered


def campaign(seed: int, count: int, hidden: tuple[str, ...]) -> dict[str, object]:
    """One campaign: what was chosen, and how everything predicts."""
    model = load_model("lateral", "cdfp")
    with tempfile.TemporaryDirectory() as folder:
        flights = made_flights(Path(folder), count, seed, hidden)
    kept, held = flights[: 2 * count // 3], flights[2 * count // 3 :]
    found = global_model(model, kept)
    constant = output_error(joint_model(model), kept)
    singles = [misfit(output_error(model, f).fitted_model, held, constant.noise) for f in kept]
    covered = inside(found, model, held, hidden)
    return {
        "seed": seed,
        "terms": {g.name: round(found.result.values[g.name], 4) for g in found.gains},
        "global": misfit(found.model, held, constant.noise),
        "constant": misfit(constant.fitted_model, held, constant.noise),
        "best single": min(singles),
        "covered": {n: sum(c) for n, c in covered.items()},
        "of": len(held),
    }


@click.command()
@click.option("-n", "campaigns", default=8)
@click.option("--flights", default=18)
@click.option("--plain", is_flag=True)
def main(campaigns: int, flights: int, plain: bool) -> None:
    """Fly, fit, predict."""
    hidden = () if plain else (*HIDDEN, CUBIC)
    covered: dict[str, int] = {}
    points, better = 0, 0
    for seed in range(1, campaigns + 1):
        row = campaign(seed, flights, hidden)
        print(json.dumps(row), flush=True)
        for name, n in row["covered"].items():  # type: ignore[attr-defined]
            covered[name] = covered.get(name, 0) + n
        points += row["of"]  # type: ignore[operator]
        better += row["global"] < min(row["constant"], row["best single"])  # type: ignore[type-var]
    print(f"better than every model of one condition: {better} of {campaigns}")
    print(
        "95 % bands hold the truth:",
        {n: f"{c / points:.0%}" for n, c in covered.items()},
        f"{sum(covered.values()) / points / len(covered):.1%}",
    )


if __name__ == "__main__":
    main()
