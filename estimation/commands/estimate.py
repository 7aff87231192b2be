"""`sideslip estimate`: aerodynamic parameters with bounds, beside what was believed before flying."""

import math
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import click

from estimation.estimators.estimator import Extra, Extras
from estimation.estimators.registry import find, listed, names

if TYPE_CHECKING:
    from estimation.estimators.result import Bootstrap, Result
    from estimation.models.base import Model
    from estimation.session.session import Session
    from estimation.session.verdict import Verdict

EXAMPLE = "Example: sideslip estimate ld1.mcap ld2.mcap --method ml,ngn --joint --report out/"


def _able(extra: Extra) -> str:
    """The methods that heed an extra, as help says them."""
    return f"method{'s' if len(names(extra)) > 1 else ''} {listed(names(extra))}"


@click.command(epilog=EXAMPLE)
@click.argument("flights", nargs=-1, required=True, type=click.Path(path_type=Path), metavar="FLIGHT...")
@click.option(
    "--method",
    "methods",
    default=names()[0],
    show_default=True,
    metavar="NAMES",
    help=f"Comma-separated: {', '.join(names())}; module:NAME is an estimator of your own.",
)
@click.option(
    "--model",
    default="lateral",
    show_default=True,
    help="lateral, lateral-simple, longitudinal, six-dof, a MODEL.toml, or module:Class.",
)
@click.option("--aircraft", help="Built-in aircraft or an AIRCRAFT.toml  [default: the one the flights carry or name].")
@click.option(
    "--simulation",
    help="A simulation of your own as base: jsbsim:AIRCRAFT (name or folder), ardupilot:FILE.json, gazebo:FILE.sdf,"
    " module:function or MODEL.toml.",
)
@click.option("--joint", is_flag=True, help="Also one estimate over all flights together.")
@click.option("--device", default="cpu", show_default=True, help="Where ngn trains its networks: cpu, cuda or auto.")
@click.option("--segments", help="Use only these stretches, each with its own initial states: 2:12,15:25 [s].")
@click.option(
    "--each-segment",
    is_flag=True,
    help="Take each segment as a flight of its own: estimates each, their scatter, --joint all of them.",
)
@click.option(
    "--raw-inputs",
    is_flag=True,
    help=f"Take measured inputs with their noise, as a plain output error does ({_able(Extra.RAW_INPUTS)}).",
)
@click.option(
    "--keep-held",
    is_flag=True,
    help="Take the repeated values of slow and stuck sensors for measurements; without it they are left out, and said.",
)
@click.option(
    "--hold-initial",
    default="",
    metavar="NAMES",
    help="Comma-separated states whose initial values are held: as measured, or NAME=VALUE; all.",
)
@click.option(
    "--free-initial",
    default="",
    metavar="NAMES",
    help="Comma-separated states whose initial values are estimated though the model holds them; all.",
)
@click.option(
    "--stepwise", is_flag=True, help=f"Keep only the terms that a partial F ratio finds ({_able(Extra.STEPWISE)})."
)
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
@click.option(
    "--histories",
    "histories_folder",
    type=click.Path(path_type=Path),
    help="Write each flight with what the model shows beside it, for sideslip view.",
)
@click.option(
    "--save-model",
    "model_path",
    type=click.Path(path_type=Path),
    help="Write the model with its estimates: joint if asked for, else of the first flight.",
)
@click.option(
    "--truth",
    "truth_path",
    type=click.Path(path_type=Path),
    help="True derivatives of simulated flights (JSON), shown beside the means.",
)
@click.option(
    "--profile",
    default="",
    metavar="NAMES",
    help=f"Comma-separated parameters: 95 % interval by profile likelihood ({_able(Extra.PROFILE)}).",
)
@click.option(
    "--bootstrap",
    default=0,
    metavar="N",
    help=f"Spread by N refits ({_able(Extra.BOOTSTRAP)}): of simulated repetitions, or networks on resampled "
    "stretches (64 where not given).",
)
@click.option("--seed", default=0, show_default=True, help="Of the bootstrap, and of the networks.")
@click.option(
    "--brief",
    is_flag=True,
    help="Print each flight's estimates in one line; tables for the mean and the joint estimate only.",
)
def estimate(
    flights: tuple[Path, ...],
    methods: str,
    model: str,
    aircraft: str | None,
    simulation: str | None,
    joint: bool,
    device: str,
    segments: str | None,
    each_segment: bool,
    raw_inputs: bool,
    keep_held: bool,
    hold_initial: str,
    free_initial: str,
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
    from estimation.aircraft import unknown_aircraft
    from estimation.aircraft.of_flight import aircraft_of
    from estimation.commands.outputs import check_outputs
    from estimation.commands.progress import Progress
    from estimation.commands.simulation import attached_to
    from estimation.commands.truth import read_truth
    from estimation.models import load_model
    from estimation.models.load import asks_for_aircraft, check_model
    from estimation.session import runner
    from estimation.session.flights import select_segments, separated
    from groundstation.flight import read_flight

    check_outputs(
        json=json_path, figure=figure_path, report=report_folder, save_model=model_path, histories=histories_folder
    )
    chosen_methods = tuple(dict.fromkeys(m.strip() for m in methods.split(",") if m.strip()))
    found = [find(m) for m in chosen_methods]  # what is mistyped there or in the model is said before a flight is read
    check_model(model)
    read = [select_segments(read_flight(path), segments) for path in flights]
    if each_segment:
        read = [part for flight in read for part in separated(flight)]
    if simulation is not None:
        attached = attached_to(simulation, model, read, aircraft, estimating=True)
        craft, loaded, read = attached.aircraft, attached.model, list(attached.flights)
    elif aircraft is None and not asks_for_aircraft(model) and not any(m.needs_aircraft for m in found):
        craft = unknown_aircraft(read[0].provenance.aircraft or "not stated")
        loaded = load_model(model, craft)
    else:
        craft = aircraft_of(read, aircraft)
        loaded = load_model(model, craft)
    chosen = with_initial_states(loaded, hold_initial, free_initial)
    truth = {} if truth_path is None else read_truth(truth_path, [f.name for f in read])
    profiled = tuple(dict.fromkeys(n.strip() for n in profile.split(",") if n.strip()))
    extras = Extras(profiled, bootstrap, seed, raw_inputs, stepwise, keep_held)
    with Progress() as progress:
        session = runner.estimate(
            chosen, read, craft, chosen_methods, joint=joint, device=device, progress=progress, extras=extras
        )
    session = replace(session, truth=truth)
    # files first: a reader that closes the pipe early (| head) must not cost a result
    written = list(write_files(session, json_path, model_path, figure_path, histories_folder, report_folder))
    for line in (*session_lines(session, brief=brief), *written):
        click.echo(line)
    return 0 if session.converged else 1


def with_initial_states(model: "Model", hold: str, free: str) -> "Model":
    """The model with initial values held and freed as --hold-initial and --free-initial say; EstimationError for nonsense."""
    from estimation.errors import EstimationError

    values: dict[str, float] = {}
    names: dict[str, list[str]] = {}
    for option, text in (("--hold-initial", hold), ("--free-initial", free)):
        words = [w.strip() for w in text.split(",") if w.strip()]
        names[option] = list(model.state_names) if words == ["all"] else [w for w in words if "=" not in w]
        for name, _, number in (w.partition("=") for w in words if "=" in w):
            try:
                values[name.strip()] = float(number)
            except ValueError:
                raise EstimationError(f"{option} {name}={number}: not a number; write it like phi=0.02") from None
            if option == "--free-initial" or not math.isfinite(values[name.strip()]):
                raise EstimationError(f"{option} {name}={number}: a value is for --hold-initial, and finite")
    held, freed = names["--hold-initial"], names["--free-initial"]
    if both := sorted({*held, *values} & set(freed)):
        raise EstimationError(f"{both[0]} is named by --hold-initial and --free-initial: choose one")
    if held or values:
        model = model.with_initial(*held, held=True, values=values)
    return model.with_initial(*freed, held=False) if freed else model


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
        from estimation.commands.outputs import write_json

        write_json(session.to_json(), json_path)
    if model_path is not None:
        from dataclasses import replace

        from estimation.models import write_model
        from estimation.session.flown import flown

        best = next(iter(session.joint.values()), None) or next(iter(session.flights[0].results.values()))
        used = [f.flight for f in (session.flights if session.joint else session.flights[:1])]
        write_model(replace(best.fitted_model, flown=flown(best.model, used)), model_path)
        yield f"model: {model_path}"
    if figure_path is not None:
        from estimation.report.drawing.histories import write_histories

        write_histories(session, figure_path)
        yield f"figure: {figure_path}"
    if histories_folder is not None:
        from estimation.report.drawing.histories import write_flights

        for path in write_flights(session, histories_folder):
            yield f"histories: {path} (look at them with: sideslip view {path})"
    if report_folder is not None:
        from estimation.report.page import write_estimate_report

        yield f"report: {write_estimate_report(session, report_folder)}"


# ------------------------------------------------------------------------------------------------------ tables


def session_lines(session: "Session", *, brief: bool = False) -> Iterator[str]:
    """The printed answer: a table for each flight and method, mean and scatter, joint."""
    yield f"aircraft {session.aircraft.name}, model {session.model.name}"
    for f in session.flights:
        for method, result in f.results.items():
            if brief:
                yield f"{f.flight.name} ({len(f.flight)} samples), {method}: {result.text}"
                yield f"  {brief_numbers(result)}"
                continue
            yield ""
            yield f"{f.flight.name} ({len(f.flight)} samples), {method}: {result.text}"
            yield from result_lines(result)
        for method, why in f.failures.items():
            yield f"{f.flight.name}, {method}: {why}"
        for note in () if brief else f.notes:
            yield f"  note: {note}"
        yield from _verdict_lines(f.verdict, brief=brief)
    if len(session.flights) > 1:
        yield from _mean_lines(session)
    for method, result in session.joint.items():
        yield ""
        yield f"joint over {len(session.flights)} flights, {method}: {result.text}"
        yield from result_lines(result)
    for method, why in session.joint_failures.items():
        yield f"joint over {len(session.flights)} flights, {method}: {why}"
    yield from _verdict_lines(session.verdict, brief=False)


def _verdict_lines(verdict: "Verdict | None", *, brief: bool) -> Iterator[str]:
    """Doubts, and which method to believe."""
    if verdict is None:
        return
    for doubt in () if brief else verdict.doubts:
        yield f"  doubt ({doubt.kind.value}): {doubt.text}"
    yield f"  recommended: {verdict.recommended.text}"


def brief_numbers(result: "Result") -> str:
    """Every estimate that the data could tell with its corrected bound, both to the second figure of the bound, in one line."""
    from estimation.report.tables import rounded

    told = [(n, rounded(e.estimate, e.std_coloured)) for n, e in result.parameters.items() if e.identifiable]
    return "  ".join(f"{n} {value}" + (f" ({bound})" if bound else "") for n, (value, bound) in told)


def result_lines(result: "Result") -> Iterator[str]:
    """Estimate, Cramer-Rao bound, corrected bound and prior belief, parameter by parameter; then the fit."""
    yield f"  {'parameter':<12}{'estimate':>11}{'bound':>10}{'corrected':>11}{'before':>10}"
    for name, e in result.parameters.items():
        before = "" if e.reference is None else f"{e.reference:10.4g} {e.reference_source}"
        why = "" if e.identifiable else f"  cannot tell: {e.why}"
        yield f"  {name:<12}{e.estimate:11.4g}{e.std:10.2g}{e.std_coloured:11.2g}{before}{why}"
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
            scatter = f"{s.std:.2g}" if s.count > 1 else "-"  # of one flight there is none
            yield f"  {name:<12}{s.mean:11.4g}{scatter:>10}{s.bound:11.2g}{s.count:9d}{true}  {s.text}".rstrip()
