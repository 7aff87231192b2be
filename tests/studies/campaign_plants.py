"""What a whole campaign tells of what was planted: flights flown by the simulator, estimated, pooled, compared.

    python -m tests.studies.campaign_plants [-n 4] [--flights 40]

A flight a day at 14 to 19 m/s, two configurations in turn. Planted: Cn_dr 5 % larger in the new configuration; a sideslip vane
that slips by 2 degrees half-way; three bad flights (rudder potentiometer 25 % off, a roll gyro 20 % off, an airspeed 12 % off).
Beside it the same campaign with nothing planted.
"""

import csv
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click
import numpy as np

from estimation.aircraft import load_aircraft
from estimation.campaign.plan import plan_from
from estimation.campaign.pooling import LEVEL
from estimation.campaign.run import Campaign
from estimation.campaign.sources import entries_of
from estimation.campaign.store import Store
from estimation.campaign.work_list import work_list
from estimation.campaign.workers.in_process import SerialEngine
from firmware_sim.physics.aerodynamics import true_derivatives
from firmware_sim.runs.direct import direct_flights, write_csv
from firmware_sim.world.scenario import load_scenario

CHANGE = 1.05
SLIP = np.radians(2.0)
BAD: tuple[tuple[str, float], ...] = (("delta_r", 1.25), ("p", 1.2), ("V", 1.12))
CLAIMS = ("outlier", "outlying flight", "step")


def fly(folder: Path, flights: int, seed: int, planted: bool) -> None:
    """Flights and the table of the plan."""
    base, rng = load_scenario("quiet"), np.random.default_rng(seed)
    speeds = rng.uniform(14.0, 19.0, flights)
    rudder = true_derivatives(load_aircraft("cdfp"), {})["Cn_dr"]
    plans = []
    for i, speed in enumerate(speeds):
        other = {"Cn_dr": CHANGE * rudder} if planted and i % 2 else {}
        flight = {"speed_m_s": float(speed), "duration_s": 20.0, "manoeuvres": "rich"}
        plans.append(base.altered(flight=flight, derivatives=other))
    bad = bad_flights(flights)
    with (folder / "flights.csv").open("w", encoding="utf-8") as file:
        table = csv.writer(file)
        table.writerow(["path", "configuration", "date"])
        for i, columns in enumerate(direct_flights(plans, [1000 * seed + i for i in range(flights)])):
            if planted and i >= flights // 2:
                columns["beta"] = columns["beta"] + SLIP
            if planted and i in bad:
                name, factor = BAD[bad.index(i)]
                columns[name] = factor * columns[name]
            write_csv(folder / f"f{i:03d}.csv", columns)
            table.writerow([f"f{i:03d}.csv", "new" if i % 2 else "old", f"2026-{3 + i // 28:02d}-{1 + i % 28:02d}"])


def bad_flights(flights: int) -> list[int]:
    """Numbers of the three."""
    return [flights // 5, flights // 2 + 3, 4 * flights // 5]


def told(folder: Path, method: str) -> list[dict[str, Any]]:
    """Rows of the groups that claim something."""
    plan = plan_from(
        {"table": "flights.csv", "aircraft": "cdfp", "methods": [method], "groups": ["configuration"]}, "study"
    )
    with Store(folder / "out", time.monotonic) as store:
        work = work_list(plan, entries_of(plan, folder), folder)
        engine = SerialEngine()
        outcome = Campaign(plan, work, store, lambda _: engine, lambda *words: None).run()
    return [
        dict(r)
        for r in outcome.groups
        if r["kind"] in CLAIMS or (r["kind"] == "difference" and r["probability"] <= LEVEL)
    ]


def judged(claims: list[dict[str, Any]], flights: int) -> Mapping[str, Any]:
    """Which of the plants were told, and what else was."""
    bad = {f"f{i:03d}" for i in bad_flights(flights)}
    changes = [r for r in claims if r["kind"] == "difference"]
    rudder = next((r for r in changes if r["parameter"] == "Cn_dr"), None)
    steps = [r for r in claims if r["kind"] == "step"]
    day = f"2026-{3 + flights // 2 // 28:02d}-{1 + flights // 2 % 28:02d}"
    out = {r["flight"] for r in claims if "flight" in r and r["kind"] != "step"}
    return {
        "Cn_dr told": rudder is not None,
        "change": None if rudder is None else round(rudder["estimate"], 5),
        "other differences": [r["parameter"] for r in changes if r is not rudder],
        "slip told": bool(steps),
        "days off": [abs(int((np.datetime64(r["at"]) - np.datetime64(day)).astype(int))) for r in steps],
        "moved": sorted({r.get("parameter") or "together" for r in steps}),
        "bad told": len(out & bad),
        "good told": len(out - bad),
    }


@click.command()
@click.option("-n", "campaigns", default=4)
@click.option("--flights", default=40)
@click.option("--method", default="ls")
@click.option("--words", is_flag=True, help="Print every sentence.")
def main(campaigns: int, flights: int, method: str, words: bool) -> None:
    """With the plants and without."""
    for seed in range(1, campaigns + 1):
        for planted in (True, False):
            with tempfile.TemporaryDirectory() as folder:
                fly(Path(folder), flights, seed, planted)
                claims = told(Path(folder), method)
            print({"seed": seed, "planted": planted, **judged(claims, flights)}, flush=True)
            for row in claims if words else ():
                print("   ", row["text"], flush=True)


if __name__ == "__main__":
    main()
