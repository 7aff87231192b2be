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

SHORTEST = 8  # samples of a stretch, as the engine has it
EXAMPLE = "Example: sideslip estimate ld1.mcap ld2.mcap --method ml,ngn --joint --report out/"


@click.command(epilog=EXAMPLE)
@click.argument("flights", nargs=-1, required=True, type=click.Path(path_type=Path), metavar="FLIGHT...")
@click.option(
    "--method", "methods", default="ml", show_default=True, help="Comma-separated: ml, fem, ngn, ngn-improved, ls."
)
@click.option("--model", default="lateral", show_default=True,
              help="lateral, lateral-simple, longitudinal, six-dof, a MODEL.toml, or module:Class.")  # fmt: skip
@click.option(
    "--aircraft", help="Built-in aircraft or an AIRCRAFT.toml  [default: cdfp, where the model asks for one]."
)
@click.option("--joint", is_flag=True, help="Also one estimate over all flights together.")
@click.option("--device", default="cpu", show_default=True, help="Where ngn trains its networks: cpu, cuda or auto.")
@click.option("--segments", help="Use only these stretches, each with its own initial states: 2:12,15:25 [s].")
@click.option("--each-segment", is_flag=True,
              help="Take each segment as a flight of its own: estimates each, their scatter, --joint all of them.")  # fmt: skip
@click.option("--raw-inputs", is_flag=True, help="Take measured inputs with their noise, as a plain output error does.")
@click.option("--stepwise", is_flag=True, help="Method ls keeps only the terms that a partial F ratio finds.")
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
@click.option("--histories", "histories_folder", type=click.Path(path_type=Path),
              help="Write each flight with what the model shows beside it, for sideslip view.")  # fmt: skip
@click.option("--save-model", "model_path", type=click.Path(path_type=Path),
              help="Write the model with its estimates: joint if asked for, else of the first flight.")  # fmt: skip
@click.option("--truth", "truth_path", type=click.Path(path_type=Path),
              help="True derivatives of simulated flights (JSON), shown beside the means.")  # fmt: skip
@click.option("--profile", default="", metavar="NAMES",
              help="Comma-separated parameters: 95 % interval by profile likelihood (method ml).")  # fmt: skip
@click.option("--bootstrap", default=0, metavar="N",
              help="Spread by N refits: of simulated repetitions (ml), or with N networks on resampled stretches (ngn, "
              "ngn-improved; 64 where not given).")  # fmt: skip
@click.option("--seed", default=0, show_default=True, help="Of the bootstrap, and of the networks.")
@click.option(
    "--brief", is_flag=True, help="Print each flight in one line; tables for the mean and the joint estimate only."
)
def estimate(
    flights: tuple[Path, ...],
    methods: str,
    model: str,
    aircraft: str | None,
    joint: bool,
    device: str,
    segments: str | None,
    each_segment: bool,
    raw_inputs: bool,
    stepwise: bool,
    json_path: Path | None,
    report_folder: Path | None,
    figure_path: Path | None,
    histories_folder: Path | None,
    model_path: Path | None,
    truth_path: Path | None,
    profile: str,
    bootstrap: int,
    seed: int,
    brief: bool,
) -> int:
    """Estimate aerodynamic parameters of each FLIGHT (.mcap, .csv or .parquet), with bounds."""
    import os
    from dataclasses import replace

    for library in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ.setdefault(library, "1")  # matrices of a fit are small: threads only wait for one another
    from estimation import laboratory
    from estimation.aircraft import load_aircraft
    from estimation.commands.outputs import check_outputs
    from estimation.commands.truth import read_truth
    from estimation.models import load_model
    from estimation.models.load import asks_for_aircraft
    from groundstation.flight import read_flight

    check_outputs(
        json=json_path, figure=figure_path, report=report_folder, save_model=model_path, histories=histories_folder
    )
    craft = load_aircraft(aircraft or "cdfp")
    chosen = load_model(model, craft)
    read = [select_segments(read_flight(path), segments) for path in flights]
    if each_segment:
        read = [part for flight in read for part in separated(flight)]
    if aircraft is None and not asks_for_aircraft(model):
        craft = replace(craft, name=read[0].provenance.aircraft or "not stated")
    names = tuple(dict.fromkeys(m.strip() for m in methods.split(",") if m.strip()))
    truth = {} if truth_path is None else read_truth(truth_path, [f.name for f in read])
    profiled = tuple(dict.fromkeys(n.strip() for n in profile.split(",") if n.strip()))
    extras = laboratory.Extras(profiled, bootstrap, seed, raw_inputs, stepwise)
    session = laboratory.estimate(
        chosen, read, craft, names, joint=joint, device=device, progress=_progress(), extras=extras
    )
    session = replace(session, truth=truth)
    # files first: a reader that closes the pipe early (| head) must not cost a result
    written = list(write_files(session, json_path, model_path, figure_path, histories_folder, report_folder))
    for line in (*session_lines(session, brief=brief), *written):
        click.echo(line)
    return 0 if session.converged else 1


def write_files(
    session: "Session",
    json_path: Path | None,
    model_path: Path | None,
    figure_path: Path | None,
    histories_folder: Path | None,
    report_folder: Path | None,
) -> Iterator[str]:
    """Write what was asked for; a line on each file that a person opens."""
    if json_path is not None:
        write_json(session.to_json(), json_path)
    if model_path is not None:
        from estimation.models import write_model

        best = next(iter(session.joint.values()), None) or next(iter(session.flights[0].results.values()))
        write_model(best.fitted_model, model_path)
        yield f"model: {model_path}"
    if figure_path is not None:
        from estimation.histories import write_histories

        write_histories(session, figure_path)
        yield f"figure: {figure_path}"
    if histories_folder is not None:
        from estimation.histories import write_flights

        for path in write_flights(session, histories_folder):
            yield f"histories: {path} (look at them with: sideslip view {path})"
    if report_folder is not None:
        from estimation.report.page import write_estimate_report

        yield f"report: {write_estimate_report(session, report_folder)}"


def select_segments(flight: "Flight", text: str | None) -> "Flight":
    """The stretches `2:12,15:25` [s] of a flight, as segments; EstimationError where they make no sense."""
    if text is None:
        return flight
    import numpy as np

    from estimation.errors import EstimationError
    from groundstation.flight import Flight

    label = np.full(len(flight), -1)
    spans: list[tuple[float, float]] = []
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
        if inside.sum() < SHORTEST:
            raise EstimationError(
                f"--segments {part}: only {int(inside.sum())} samples of {flight.name} lie there, one each "
                f"{flight.sample_interval:.3g} s; a stretch needs at least {SHORTEST}"
            )
        if any(a < end_ and b > begin_ for begin_, end_ in spans):
            raise EstimationError(f"--segments {text}: {part} overlaps another stretch; give each sample once")
        spans.append((a, b))
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


def separated(flight: "Flight") -> list["Flight"]:
    """Every segment as a flight of its own, named <flight>.1, <flight>.2 ..."""
    parts = flight.segments
    if len(parts) == 1:
        return [flight]
    return [flight.part(part, f"{flight.name}.{i}") for i, part in enumerate(parts, start=1)]


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
        for note in () if brief else f.notes:
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
        told = f"{'truth':>11}" if session.truth else ""
        yield f"  {'parameter':<12}{'mean':>11}{'scatter':>10}{'bound':>11}{'flights':>9}{told}"
        for name, s in table.items():
            true = f"{session.truth[name]:11.4g}" if name in session.truth else " " * len(told)
            yield f"  {name:<12}{s.mean:11.4g}{s.std:10.2g}{s.bound:11.2g}{s.count:9d}{true}  {s.text}".rstrip()
