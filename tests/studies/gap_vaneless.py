"""Study: the gap workflow on logs of an ArduPilot aircraft without vanes, nothing or one effect hidden.

    python -m tests.studies.gap_vaneless MODEL SEED [EFFECT...]

Four flights of the simulated aircraft in 4 m/s of wind become dataflash logs (IMU at 50 Hz, attitude at 25, stamped 3 ms late,
pitot at 10, GNSS at 5, servo outputs in whole microseconds), are imported with the mapping of docs/import.md and reconstructed;
three train and one is held out. What flies in pitch is given the thrust, which no autopilot logs. Last results: docs/gap.md.
"""

import argparse
import contextlib
import os
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

import sideslip
from estimation.gap.workflow import Options, run_gap
from estimation.models.load import load_model
from firmware_sim.runs.campaign import CampaignFlights
from firmware_sim.world.world import simulate_many
from groundstation.flight import Flight, read_flight
from tests.chain.autopilot_logs import BOOT, dataflash
from tests.cli.docs.blocks import files_of, write_files
from tests.support.paths import ROOT

PLANS = {"lateral": "rich", "longitudinal": "longitudinal", "six-dof": "all_axes"}
WIND = {"gust_deg": 0.15, "speed_m_s": 4.0, "from_deg": 70.0}
PAGE = ROOT / "docs" / "import.md"


def reconstructed(folder: Path, model: str, effects: Sequence[str], seed: int) -> list[Flight]:
    """Four flights, from their logs."""
    write_files(files_of(PAGE), folder)
    campaign = CampaignFlights(
        hidden=tuple((e, 1.0) for e in effects), seed=seed, gust_deg=0.15, manoeuvres=PLANS[model]
    )
    made = []
    for n, (scenario, own) in enumerate(campaign.scenarios()):
        truth = simulate_many([scenario.altered(wind=WIND)], [own], 50.0)[0]
        (folder / f"l{n}.bin").write_bytes(dataflash(truth, np.random.default_rng([seed, n])))
        with contextlib.chdir(folder):
            command(f"import l{n}.bin --map surfaces.toml --aircraft cdfp -o l{n}.mcap")
            command(f"reconstruct l{n}.mcap -o f{n}.mcap")
        flight = read_flight(folder / f"f{n}.mcap")
        if model != "lateral":
            flight = flight.with_columns(thrust=np.interp(flight.time - BOOT, truth["time"], truth["thrust"]))
        made.append(flight)
    return made


def command(line: str) -> None:
    """A command of sideslip that has to succeed, without its words."""
    with Path(os.devnull).open("w") as nothing, contextlib.redirect_stdout(nothing):
        try:
            sideslip.main(line.split())
        except SystemExit as end:
            if end.code:
                raise RuntimeError(f"sideslip {line}: exit status {end.code}") from end


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("model", choices=PLANS)
    parser.add_argument("seed", type=int)
    parser.add_argument("effects", nargs="*")
    parser.add_argument("--nulls", type=int, default=60)
    a = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        flights = reconstructed(Path(folder), a.model, a.effects, a.seed)
    result = run_gap(load_model(a.model, "cdfp"), flights[:3], flights[3:], options=Options(seed=1, nulls=a.nulls))
    steps = ", ".join(f"{s.effect} {s.score:.1f} of {s.threshold:.1f}" for s in result.steps)
    print(f"{a.model} {a.seed} {' '.join(a.effects) or 'nothing'}: {result.verdict.value} {steps}\n  {result.text}")


if __name__ == "__main__":
    main()
