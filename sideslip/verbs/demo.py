"""The verb `demo`: the whole chain in one go, with explanations."""

import os
import shutil
import subprocess
import sys
import time
from concurrent.futures import Future, ProcessPoolExecutor, ThreadPoolExecutor, as_completed
from multiprocessing import get_context
from pathlib import Path
from typing import TYPE_CHECKING

import click

from daq.utilities.durable import whole, write_text
from daq.utilities.errors import UserError
from daq.utilities.options import path_option
from daq.utilities.outputs import tried_folder
from sideslip.chain import ChainFlight, fly_onboard, fly_scenario

if TYPE_CHECKING:
    from collections.abc import Sequence

DEMO_FLIGHTS = ("cdfp_ld1", "cdfp_ld2", "cdfp_ld3", "cdfp_ld4")
DEMO_HIDDEN = ("Cn_da", 1.0)  # hidden effect, and its size as a share of the default
DEMO_SEED = 20
DEMO_SPEEDS = (14.5, 19.0)  # [m/s] of the flights on which the gap workflow is trained; one more is held out
WORKERS = 2  # processes that fly: the demo is timed on two cores
DEMO_RADIO = {"drop": 0.05}  # share of frames that the radio loses


@click.command(epilog="Example: sideslip demo --out demo")
@path_option(
    "-o",
    "--out",
    "--output",
    text="Folder for the flights and the report  [default: demo].",
    tried=tried_folder,
    default=Path("demo"),
)
def demo(out: Path) -> int:
    """Fly, record, downlink, calibrate, check, estimate, match, and close a gap: the whole chain on a simulated aircraft."""
    start_time = time.monotonic()
    if out.exists() and any(out.iterdir()) and not (out / "demo.txt").is_file():
        raise UserError(f"{out} is not empty and not of an earlier demo; give --out another folder")
    shutil.rmtree(out, ignore_errors=True)
    report = out / "report"
    report.mkdir(parents=True)
    write_text(out / "demo.txt", "Written by sideslip demo; replaced by the next one.\n")

    click.echo(
        "1  Four flights of the simulated aircraft: sensor bus, 20 Hz MCAP on board, 11.5 Hz MAVLink over a lossy radio\n"
    )
    with ProcessPoolExecutor(min(WORKERS, os.cpu_count() or 1), mp_context=get_context("spawn")) as workers:
        ordinary, hidden = _start_flights(out, workers)
        with ThreadPoolExecutor(1) as gap_thread:
            gap_output = gap_thread.submit(_gap, hidden, out)
            flights = _finished_flights(ordinary, out)
            _estimates(flights, out)
            click.echo("\n5  Three flights with something hidden in the aircraft; the gap workflow is not told what\n")
            click.echo(gap_output.result())

    from estimation.report.front import write_front_page

    click.echo("\n6  The truth beside the answers: what the simulator flew with, and what it hid\n")
    write_truth(report / "truth.json")
    for line in truth_lines(report):
        click.echo(line)
    page = write_front_page(report)
    click.echo(f"\n{time.monotonic() - start_time:.0f} s. Report: {page}")
    return 0


def write_truth(path: Path) -> None:
    """Write the simulator's truth: derivatives of the demo's flights, and the hidden effect with its size and unit."""
    from daq.utilities.outputs import write_json
    from firmware_sim.physics.effects.registry import EFFECTS
    from firmware_sim.world.scenario import load_scenario
    from firmware_sim.world.simulation import derivatives_of

    name, scale = DEMO_HIDDEN
    effect = EFFECTS[name](scale)
    hidden = {"name": name, "title": effect.title, "parameters": {name: [float(effect.size), effect.unit]}}
    write_json({"derivatives": derivatives_of(load_scenario(DEMO_FLIGHTS[0])), "hidden": hidden}, path)


def truth_lines(report: Path) -> list[str]:
    """The truth in `report`/truth.json beside the joint estimates in estimate.json and the answer in gap.json."""
    import json

    from estimation.report.tables import rounded

    truth, estimate, gap = (
        json.loads((report / f"{n}.json").read_text(encoding="utf-8")) for n in ("truth", "estimate", "gap")
    )
    method, joint_result = next(iter(estimate["joint"].items()))
    lines = [f"  {'derivative':<12}{'truth':>10}{method:>12}{'corrected':>10}"]
    for name, e in joint_result["parameters"].items():
        if not e["identifiable"] or name not in truth["derivatives"] or name.endswith("_0"):
            continue  # constants absorb the sensors' offsets
        value, bound = rounded(e["estimate"], e["std_coloured"])
        lines.append(f"  {name:<12}{truth['derivatives'][name]:10.4g}{value:>12}{bound:>10}")
    hidden = truth["hidden"]
    size, unit = hidden["parameters"][hidden["name"]]
    lines.append(f"  hidden: {hidden['name']} ({hidden['title']}) of {size:.4g} {unit}; answer: {gap['verdict']}")
    for step in gap["steps"]:
        parameter_texts = "; ".join(
            f"{n} = {' ± '.join(t for t in rounded(e['estimate'], e['std']) if t)}"
            for n, e in step["parameters"].items()
        )
        lines.append(f"  found:  {step['effect']} ({step['title']}){': ' + parameter_texts if parameter_texts else ''}")
    return lines


def _run(verb: str, *arguments: object) -> None:
    """Print a verb's command line and run it in this process. A failed check (status 1) does not end the demo."""
    text = [verb, *(str(a) for a in arguments)]
    click.echo(f"$ sideslip {' '.join(text)}\n")
    from sideslip.cli import cli

    status = cli.main(args=text, prog_name="sideslip", standalone_mode=False)
    if status not in (0, 1, None):
        raise UserError(f"demo: sideslip {verb} ended with status {status}")


def _estimates(flights: list[Path], out: Path) -> None:
    """Stages 2 to 4: check, estimate and match of the four flights."""
    report, corrected = out / "report", out / "corrected"
    click.echo(
        "\n2  Do accelerations, rates, attitude and air data tell the same story? Instrument factors are found and taken out\n"
    )
    _run("check", *flights, "--json", report / "check.json", "--report", report / "check", "--write", corrected)
    flights = [corrected / path.name for path in flights]

    click.echo("\n3  Aerodynamic derivatives by maximum likelihood, joint over the four flights\n")
    saved = ("--json", report / "estimate.json", "--report", report / "estimate", "--save-model", out / "model.toml")
    _run("estimate", *flights, "--joint", "--brief", *saved)

    click.echo("\n4  Proof of match: the joint model predicts each flight, parameters frozen\n")
    proof = ("--json", report / "match.json", "--figure", report / "match.svg")
    _run("match", out / "model.toml", *flights, "--free", "CY_0,Cl_0,Cn_0", *proof)


def _gap(futures: "Sequence[Future[Path]]", out: Path) -> str:
    """Run the gap workflow in another process once its flights are finished, the last one held out; gives its output."""
    report = out / "report"
    *training, holdout = [_named_copy(f.result(), out, f"hidden_{i}") for i, f in enumerate(futures)]
    text = [
        str(word)
        for word in ("gap", *training, "--holdout", holdout, "--json", report / "gap.json", "--report", report / "gap")
    ]
    command = [sys.executable, "-m", "sideslip", "--quiet", *text]
    process = subprocess.run(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, encoding="utf-8", check=False
    )
    if process.returncode not in (0, 1):
        raise UserError(f"demo: sideslip gap ended with status {process.returncode}: {process.stdout.strip()}")
    return f"$ sideslip {' '.join(text)}\n\n{process.stdout.rstrip()}"


def _start_flights(out: Path, workers: ProcessPoolExecutor) -> "tuple[list[Future[ChainFlight]], list[Future[Path]]]":
    """Start the four flights, and those of an aircraft with a hidden effect, of which the last is held out."""
    from firmware_sim.runs.campaign import CampaignFlights
    from firmware_sim.world.scenario import load_scenario

    hidden_flights = CampaignFlights(hidden=(DEMO_HIDDEN,), seed=DEMO_SEED, training_speeds=DEMO_SPEEDS)
    ordinary = [
        workers.submit(fly_scenario, load_scenario(name).altered(radio=DEMO_RADIO), out / name) for name in DEMO_FLIGHTS
    ]
    hidden = [
        workers.submit(fly_onboard, scenario, out / f"hidden_{number}", seed=seed)
        for number, (scenario, seed) in enumerate(hidden_flights.scenarios())
    ]
    return ordinary, hidden


def _finished_flights(futures: "Sequence[Future[ChainFlight]]", out: Path) -> list[Path]:
    """Wait for the four flights and print what the radio delivered of each; gives their files."""
    from sideslip.verbs.delivery import Progress

    with Progress("flying") as bar:
        for finished, _ in enumerate(as_completed(futures), 1):
            bar(finished / len(futures))
    for name, flight in zip(DEMO_FLIGHTS, futures, strict=True):
        click.echo(_radio_line(name, flight.result()))
    return [_named_copy(f.result().onboard, out, name) for name, f in zip(DEMO_FLIGHTS, futures, strict=True)]


def _radio_line(name: str, flight: ChainFlight) -> str:
    s = flight.summary
    lost_scans = sum(b - a + 1 for a, b in s["scans_lost"])
    agree = "air and ground agree" if flight.agreed else "air and ground DO NOT agree"
    return f"{name}: {s['scans_received']} scans came down, {lost_scans} lost on the radio; after backfill {agree}"


def _named_copy(flight: Path, out: Path, name: str) -> Path:
    """A copy of a flight under its name in the folder `flights`."""
    target = out / "flights" / f"{name}.mcap"
    target.parent.mkdir(exist_ok=True)
    with whole(target) as new:
        shutil.copyfile(flight, new)
    return target
