"""`sideslip estimate`: aerodynamic parameters with bounds, beside what was believed before flying."""

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from estimation.estimators.bootstrap import Bootstrap
    from estimation.estimators.result import Result
    from estimation.laboratory import Session
    from groundstation.flight import Flight

EXAMPLE = "Example: sideslip estimate ld1.mcap ld2.mcap --method ml,ngn --joint --report out/"


@click.command(epilog=EXAMPLE)
@click.argument("flights", nargs=-1, required=True, type=click.Path(path_type=Path), metavar="FLIGHT...")
@click.option(
    "--method", "methods", default="ml", show_default=True, help="Comma-separated: ml, fem, ngn, ngn-improved, ls."
)
@click.option("--model", default="lateral", show_default=True,
              help="lateral, lateral-simple, longitudinal, six-dof, a MODEL.toml, or module:Class.")  # fmt: skip
@click.option("--aircraft", default="cdfp", show_default=True, help="Built-in aircraft or an AIRCRAFT.toml.")
@click.option("--joint", is_flag=True, help="Also one estimate over all flights together.")
@click.option("--device", default="cpu", show_default=True, help="Where ngn trains its networks: cpu, cuda or auto.")
@click.option("--segments", help="Use only these stretches, each with its own initial states: 2:12,15:25 [s].")
@click.option("--json", "json_path", type=click.Path(path_type=Path), help="Write the results as JSON.")
@click.option(
    "--report", "report_folder", type=click.Path(path_type=Path), help="Write an HTML report with tables and figures."
)
@click.option(
    "--figure",
    "figure_path",
    type=click.Path(path_type=Path),
    help="Write a figure of measured and estimated histories.",
)
@click.option("--save-model", "model_path", type=click.Path(path_type=Path),
              help="Write the model with its estimates: joint if asked for, else of the first flight.")  # fmt: skip
@click.option("--profile", default="", metavar="NAMES",
              help="Comma-separated parameters: 95 % interval by profile likelihood (method ml).")  # fmt: skip
@click.option("--bootstrap", default=0, metavar="N", help="Spread by N refits of simulated repetitions (method ml).")
@click.option("--seed", default=0, show_default=True, help="Of the bootstrap's noise.")
@click.option(
    "--brief", is_flag=True, help="Print each flight in one line; tables for the mean and the joint estimate only."
)
def estimate(
    flights: tuple[Path, ...],
    methods: str,
    model: str,
    aircraft: str,
    joint: bool,
    device: str,
    segments: str | None,
    json_path: Path | None,
    report_folder: Path | None,
    figure_path: Path | None,
    model_path: Path | None,
    profile: str,
    bootstrap: int,
    seed: int,
    brief: bool,
) -> int:
    """Estimate aerodynamic parameters of each FLIGHT (.mcap, .csv or .parquet), with bounds."""
    import os

    for library in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ.setdefault(library, "1")  # matrices of a fit are small: threads only wait for one another
    from estimation import laboratory
    from estimation.aircraft import load_aircraft
    from estimation.models import load_model
    from groundstation.flight import read_flight

    craft = load_aircraft(aircraft)
    chosen = load_model(model, craft)
    read = [select_segments(read_flight(path), segments) for path in flights]
    names = tuple(m.strip() for m in methods.split(",") if m.strip())
    profiled = tuple(dict.fromkeys(n.strip() for n in profile.split(",") if n.strip()))
    extras = laboratory.Extras(profiled, bootstrap, seed)
    session = laboratory.estimate(
        chosen, read, craft, names, joint=joint, device=device, progress=_progress(), extras=extras
    )
    for line in session_lines(session, brief=brief):
        click.echo(line)
    if model_path is not None:
        from estimation.models import write_model

        best = next(iter(session.joint.values()), None) or next(iter(session.flights[0].results.values()))
        model_path.parent.mkdir(parents=True, exist_ok=True)
        write_model(best.fitted_model, model_path)
        click.echo(f"model: {model_path}")
    if json_path is not None:
        write_json(session.to_json(), json_path)
    if figure_path is not None:
        from estimation.histories import write_histories

        write_histories(session, figure_path)
    if report_folder is not None:
        from estimation.report.page import write_estimate_report

        click.echo(f"report: {write_estimate_report(session, report_folder)}")
    return 0 if session.converged else 1


def select_segments(flight: "Flight", text: str | None) -> "Flight":
    """The stretches `2:12,15:25` [s] of a flight, as segments; EstimationError where they make no sense."""
    if text is None:
        return flight
    import numpy as np

    from estimation.errors import EstimationError
    from groundstation.flight import Flight

    label = np.full(len(flight), -1)
    for i, part in enumerate(text.split(",")):
        begin, colon, end = part.partition(":")
        try:
            a, b = float(begin), float(end)
        except ValueError:
            raise EstimationError(
                f"--segments {text!r}: write stretches as begin:end in seconds, like 2:12,15:25"
            ) from None
        inside = (flight.time >= a) & (flight.time <= b)
        if not colon or b <= a or not inside.any():
            raise EstimationError(
                f"--segments {part}: no samples of {flight.name} there; it runs from {flight.time[0]:g} to {flight.time[-1]:g} s"
            )
        label[inside] = i
    keep = label >= 0
    chosen = flight.part(keep)
    return Flight.build(
        flight.name,
        chosen.time,
        dict(chosen.columns),
        segment=label[keep],
        provenance=flight.provenance,
        notes=flight.notes,
    )


def write_json(data: object, path: Path) -> None:
    """JSON to a file, in one step."""
    import json

    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(path.name + ".part")
    partial.write_text(json.dumps(data, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    partial.replace(path)


class _Progress:
    def __init__(self) -> None:
        self.live = sys.stderr.isatty()

    def __call__(self, text: str) -> None:
        if self.live:
            click.echo(f"  {text} ...", err=True)


def _progress() -> _Progress:
    return _Progress()


# ------------------------------------------------------------------------------------------------------ tables


def session_lines(session: "Session", *, brief: bool = False) -> Iterator[str]:
    """The printed answer: a table for each flight and method, mean and scatter, joint."""
    yield f"aircraft {session.aircraft.name}, model {session.model.name}"
    for f in session.flights:
        for method, result in f.results.items():
            if brief:
                yield f"{f.flight.name} ({len(f.flight)} samples), {method}: {result.text}"
                continue
            yield ""
            yield f"{f.flight.name} ({len(f.flight)} samples), {method}: {result.text}"
            yield from result_lines(result)
        for method, why in f.failures.items():
            yield f"{f.flight.name}, {method}: {why}"
        for note in next(iter(f.results.values())).flights[0].notes if f.results and not brief else ():
            yield f"  note: {note}"
    if len(session.flights) > 1:
        yield from _mean_lines(session)
    for method, result in session.joint.items():
        yield ""
        yield f"joint over {len(session.flights)} flights, {method}: {result.text}"
        yield from result_lines(result)


def result_lines(result: "Result") -> Iterator[str]:
    """Estimate, Cramer-Rao bound, corrected bound and prior belief, parameter by parameter; then the fit."""
    yield f"  {'parameter':<12}{'estimate':>11}{'bound':>10}{'corrected':>11}{'before':>10}"
    for name, e in result.parameters.items():
        before = "" if e.reference is None else f"{e.reference:10.4g} {e.reference_source}"
        if e.identifiable:
            yield f"  {name:<12}{e.estimate:11.4g}{e.std:10.2g}{e.std_coloured:11.2g}{before}"
        else:
            yield f"  {name:<12}{'cannot tell':>32}{before}: {e.why}"
    for flight in result.flights:
        line = "  ".join(f"{n} {f.r2:.3f}" for n, f in flight.fit.items())
        yield f"  fit r2{' ' + flight.name if len(result.flights) > 1 else ''}: {line}"
    for first, second, rho in result.collinear[:4]:
        yield f"  correlated: {first} and {second}, {rho:+.3f}"
    for name, p in result.profile.items():
        if p.values.size:
            (low, high), (wide_low, wide_high) = p.interval, p.interval_coloured
            yield f"  profile {name}: 95 % {low:.4g} .. {high:.4g}, corrected {wide_low:.4g} .. {wide_high:.4g}"
        if p.text:
            yield f"  profile {name}: {p.text}"
    if result.bootstrap is not None:
        yield from _bootstrap_lines(result.bootstrap)


def _bootstrap_lines(b: "Bootstrap") -> Iterator[str]:
    if b.text:
        yield f"  bootstrap: {b.text}"
        return
    yield f"  bootstrap, {len(b.estimates)} replicates" + (f", {b.failed} more could not be fitted" if b.failed else "")
    yield f"  {'parameter':<12}{'spread':>11}{'bias':>10}  95 % interval"
    for name, s in b.parameters.items():
        yield f"  {name:<12}{s.std:11.2g}{s.bias:10.1g}  {s.interval[0]:.4g} .. {s.interval[1]:.4g}"


def _mean_lines(session: "Session") -> Iterator[str]:
    for method, table in session.mean.items():
        yield ""
        yield f"mean over flights, {method}"
        yield f"  {'parameter':<12}{'mean':>11}{'scatter':>10}{'bound':>11}{'flights':>9}"
        for name, s in table.items():
            yield f"  {name:<12}{s.mean:11.4g}{s.std:10.2g}{s.bound:11.2g}{s.count:9d}  {s.text}".rstrip()
