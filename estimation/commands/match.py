"""`sideslip match`: proof of match, a model's prediction of flights it was not estimated from."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from estimation.signals.goodness_of_fit import THEIL_LIMIT

if TYPE_CHECKING:
    from estimation.session.proof_of_match import Proof

EXAMPLE = "Example: sideslip match ld4.toml ld2.mcap --json match.json"


@click.command(epilog=EXAMPLE)
@click.argument("model", type=click.Path(path_type=Path), metavar="MODEL.toml")
@click.argument("flights", nargs=-1, required=True, type=click.Path(path_type=Path), metavar="FLIGHT...")
@click.option(
    "--free", default="", help="Comma-separated parameters refitted on each flight (biases); all others are frozen."
)
@click.option(
    "--limit",
    type=float,
    default=THEIL_LIMIT,
    show_default=True,
    help="Theil's coefficient above which a channel does not match (exit status 1).",
)
@click.option("--segments", help="Use only these stretches, each with its own initial states: 2:12,15:25 [s].")
@click.option(
    "--histories",
    "histories_folder",
    type=click.Path(path_type=Path),
    help="Write each flight with what the model predicts beside it, for sideslip view.",
)
@click.option(
    "--aircraft", help="For a built-in model or a class of one's own  [default: the one the flights carry or name]."
)
@click.option(
    "--simulation",
    help="A simulation of your own as base: jsbsim:AIRCRAFT (name or folder), ardupilot:FILE.json, gazebo:FILE.sdf,"
    " module:function or MODEL.toml.",
)
@click.option("--json", "json_path", type=click.Path(path_type=Path), help="Write the fit as JSON.")
@click.option(
    "--figure",
    "figure_path",
    type=click.Path(path_type=Path),
    help="Write a figure of measured and predicted histories.",
)
def match(
    model: Path,
    flights: tuple[Path, ...],
    free: str,
    limit: float,
    segments: str | None,
    histories_folder: Path | None,
    aircraft: str | None,
    simulation: str | None,
    json_path: Path | None,
    figure_path: Path | None,
) -> int:
    """Predict each FLIGHT with MODEL.toml, parameters frozen and only initial states refitted, and judge the match."""
    from estimation.aircraft.of_flight import aircraft_of
    from estimation.commands.outputs import check_outputs, write_json
    from estimation.commands.simulation import attached_to
    from estimation.models import load_model
    from estimation.models.load import asks_for_aircraft, check_model
    from estimation.session.flights import select_segments, unique_names
    from estimation.session.proof_of_match import predict
    from groundstation.flight import read_flight

    check_outputs(json=json_path, figure=figure_path, histories=histories_folder)
    wanted = tuple(n.strip() for n in free.split(",") if n.strip())
    check_model(str(model))
    read = unique_names([select_segments(read_flight(path), segments) for path in flights])
    if simulation is None:
        chosen = load_model(model, aircraft_of(read, aircraft) if asks_for_aircraft(str(model)) else None)
    else:
        attached = attached_to(simulation, str(model), read, aircraft, predicting=True)
        chosen, read = attached.model, list(attached.flights)
    proofs = [predict(chosen, flight, free=wanted) for flight in read]
    good = True
    click.echo(f"limit: Theil's coefficient {limit:g} in every channel")
    for proof in proofs:
        for line in proof_lines(proof, limit):
            click.echo(line)
        good = good and all(f.theil <= limit for f in proof.fit.values())
        good = good and proof.converged
    if json_path is not None:
        write_json({"model": str(chosen.name), "limit": limit, "flights": [p.to_json() for p in proofs]}, json_path)
    if figure_path is not None:
        from estimation.report.drawing.histories import write_proof

        write_proof(proofs, figure_path)
        click.echo(f"figure: {figure_path}")
    if histories_folder is not None:
        from estimation.report.drawing.histories import write_beside

        for flight, proof in zip(read, proofs, strict=True):
            path = write_beside(flight, proof.result, histories_folder)
            click.echo(f"histories: {path} (look at them with: sideslip view {path})")
    return 0 if good else 1


def proof_lines(proof: "Proof", limit: float) -> list[str]:
    """What a person reads on the terminal of one flight predicted."""
    head = f"  {'channel':<10}{'r2':>8}{'Theil':>8}{'bias':>7}{'var':>7}{'cov':>7}{'rms':>11}{'white':>7}  match"
    lines = [f"{proof.name}: {proof.text}", head]
    for name, f in proof.fit.items():
        judged = "pass" if f.theil <= limit else f"FAIL, above {limit:g}"
        lines.append(
            f"  {name:<10}{f.r2:8.3f}{f.theil:8.3f}{f.theil_bias:7.2f}{f.theil_variance:7.2f}"
            f"{f.theil_covariance:7.2f}{f.rms:11.4g}{f.whiteness:7.2f}  {judged}"
        )
    lines += [f"  beyond what the model was estimated from: {b.text}" for b in proof.beyond]
    return [*lines, *(f"  note: {note}" for note in proof.result.flights[0].notes)]
