"""`sideslip design`: an input designed from what is known, with what it will do to the aircraft and what it will tell."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from daq.contract.input_files import read_json
from daq.contract.outputs import write_text

if TYPE_CHECKING:
    from estimation.design.design import Design, Task
    from estimation.models.base import Model

EXAMPLE = "Example: sideslip design --model lateral --aircraft cdfp --kind multisine --time 20 -o multisine.toml"
CRUISE_LIFT = 0.3
"""Lift coefficient at which an aircraft is taken to fly where no --speed is given."""


@click.command(epilog=EXAMPLE)
@click.option("--model", default="lateral", show_default=True, help="Built-in name, MODEL.toml or module:Class.")
@click.option(
    "--from",
    "estimate_path",
    type=click.Path(path_type=Path),
    help="What estimate --json wrote: its model, aircraft, values and noise.",
)
@click.option("--aircraft", help="Built-in aircraft or an AIRCRAFT.toml.")
@click.option("--kind", default="optimal", show_default=True, help="doublet, 121, 3211, chirp, multisine or optimal.")
@click.option("--time", "duration", type=float, required=True, help="How long it takes [s].")
@click.option("--limits", "limits_path", type=click.Path(path_type=Path), help="What it may do (LIMITS.toml).")
@click.option("--separate", default="", help="Two effects of the gap catalogue, or parameters, to be told apart: A,B.")
@click.option(
    "--criterion", default="worst", show_default=True, help="Of kind optimal: worst, D, A, or the name of a parameter."
)
@click.option("--controls", default="", help="Comma-separated controls to move  [default: all of the model].")
@click.option("--band", default="0.1,1.5", show_default=True, help="Frequencies of chirps and multisines [Hz].")
@click.option("--speed", type=float, help="True airspeed [m/s]  [default: that of a lift coefficient of 0.3].")
@click.option("--density", default=1.17, show_default=True, help="Air density [kg/m3].")
@click.option("--rate", "rate_hz", default=20.0, show_default=True, help="Samples a second of the recording [Hz].")
@click.option("--pilot-holds", "held", is_flag=True, help="A pilot holds bank and pitch gently meanwhile.")
@click.option("--seed", default=1, show_default=True, help="Of the search for phases.")
@click.option("-o", "--output", type=click.Path(path_type=Path), required=True, help="Manoeuvre file to write (.toml).")
@click.option("--json", "json_path", type=click.Path(path_type=Path), help="Write everything as JSON.")
@click.option("--figure", "figure_path", type=click.Path(path_type=Path), help="Draw inputs, spectra, motion, bounds.")
def design(
    model: str,
    estimate_path: Path | None,
    aircraft: str | None,
    kind: str,
    duration: float,
    limits_path: Path | None,
    separate: str,
    criterion: str,
    controls: str,
    band: str,
    speed: float | None,
    density: float,
    rate_hz: float,
    held: bool,
    seed: int,
    output: Path,
    json_path: Path | None,
    figure_path: Path | None,
) -> int:
    """Design the inputs of a manoeuvre of --time seconds, under limits, and say what it will tell."""
    from dataclasses import replace

    from estimation.aircraft import load_aircraft
    from estimation.commands.outputs import check_outputs
    from estimation.design.design import Task
    from estimation.design.design import design as designed
    from estimation.design.limits import load_limits
    from estimation.errors import EstimationError
    from estimation.models import load_model

    check_outputs(json=json_path, figure=figure_path, save_model=output)
    known = _estimate(estimate_path) if estimate_path else {}
    named = aircraft or known.get("aircraft")
    if not named:
        raise EstimationError(
            "design: name the aircraft with --aircraft (a built-in one or an AIRCRAFT.toml), or --from an estimate"
        )
    craft = load_aircraft(named)
    chosen = load_model(known.get("model", model), craft)
    task = Task(
        kind=kind,
        duration=duration,
        speed=speed or math.sqrt(2 * craft.mass * 9.80665 / (density * craft.area * CRUISE_LIFT)),
        density=density,
        controls=_names(controls),
        band=_band(band),
        criterion=criterion,
        values=known.get("values", {}),
        noise=known.get("noise", {}),
        noise_of_residuals=bool(known),
        rate_hz=rate_hz,
        held=held,
        seed=seed,
    )
    if separate:
        if kind != "optimal":
            raise EstimationError("--separate designs an optimal input: leave --kind out")
        chosen, sizes = with_effects(chosen, _names(separate))
        task = replace(task, separate=tuple(sizes), sizes=sizes)
    found = designed(chosen, craft, task, load_limits(limits_path) if limits_path else None)
    write_manoeuvre(found, output)
    if json_path is not None:
        from estimation.commands.outputs import write_json

        write_json(found.to_json(), json_path)
    for line in lines(found, task):
        click.echo(line)
    click.echo(f"manoeuvre: {output}")
    if figure_path is not None:
        from estimation.design.figure import write_figure

        write_figure(found, figure_path)
        click.echo(f"figure: {figure_path}")
    return 0


def lines(found: "Design", task: "Task") -> list[str]:
    """What a person reads on the terminal."""
    out = [
        f"{found.best.kind} of {task.duration:g} s at {task.speed:.1f} m/s on {', '.join(found.bench.controls)}: "
        f"worst relative error {found.gain:.2f} times smaller than of doublets of equal length under the same limits"
    ]
    out += [f"note: {note}" for note in found.notes]
    peaks = found.peak_factors()
    out += ["", f"  {'control':<10}{'peak [deg]':>12}{'peak factor':>13}"]
    for i, control in enumerate(found.bench.controls):
        peak = math.degrees(abs(found.best.commands[:, i]).max())
        out.append(f"  {control:<10}{peak:>12.2f}{peaks[control]:>13.3f}")
    out += ["", f"  {'limit':<14}{'used':>10}{'allowed':>10}"]
    for use in found.best.used:
        factor = 1.0 if use.name in ("load_factor", "V", "ax", "ay", "az") else math.degrees(1.0)
        unit = "" if factor == 1.0 else " deg"
        out.append(f"  {use.name:<14}{factor * use.used:>10.2f}{factor * use.allowed:>10.2f}{unit}")
    out += ["", f"  {'parameter':<12}{'size':>10}{'std':>10}{'relative':>10}{'doublets':>10}"]
    plain, std = found.expected_of_doublets, found.expected
    for name, relative in found.relative.items():
        size = found.sizes[name]
        mark = "  cannot be told" if name in found.untold else ""
        doublets = 100 * plain[name] / abs(size)
        out.append(f"  {name:<12}{size:>10.4g}{std[name]:>10.2g}{100 * relative:>9.1f}%{doublets:>9.1f}%{mark}")
    return out


def write_manoeuvre(found: "Design", path: Path) -> None:
    """The file that `fly --manoeuvre` and the sequencer on board read."""
    import tomli_w

    write_text(tomli_w.dumps(found.manoeuvre().to_dict()), path)


def with_effects(model: "Model", names: tuple[str, ...]) -> tuple["Model", dict[str, float]]:
    """The model with effects of the catalogue added, and the size of each of their parameters; a name that is already a
    parameter stays as it is. Raises EstimationError for fewer than two names, or one that the model cannot take."""
    from estimation.errors import EstimationError
    from estimation.gap.effects import catalogue

    if len(names) < 2:
        raise EstimationError("--separate needs two names or more, like Cn_da,Ixz_error")
    effects = {e.name: e for e in catalogue(model=model)}
    sizes: dict[str, float] = {}
    for name in names:
        if name in model.parameter_names:
            parameter = model.parameter(name)
            sizes[name] = abs(parameter.reference or parameter.start) or 1.0
            continue
        if name not in effects:
            raise EstimationError(
                f"--separate {name}: neither a parameter of model {model.name} nor an effect; see docs/effects.md"
            )
        form = next((f for f in effects[name].forms if f.obstacle(model) is None), None)
        if form is None:
            raise EstimationError(f"--separate {name}: {effects[name].forms[0].obstacle(model)}")
        # a delay or a play of zero has no slope: such effects are looked at where they have their usual size
        at = {p.name: p.typical for p in form.parameters} if form.nonlinear else None
        model = form.added_to(model, at)
        sizes |= {p.name: p.typical for p in form.parameters}
    return model, sizes


def _names(text: str) -> tuple[str, ...]:
    return tuple(dict.fromkeys(n.strip() for n in text.split(",") if n.strip()))


def _band(text: str) -> tuple[float, float]:
    from estimation.errors import EstimationError

    try:
        low, high = (float(part) for part in text.split(","))
    except ValueError:
        low, high = math.nan, math.nan
    if not 0.0 < low < high < 25.0:
        raise EstimationError(f"--band {text}: give two frequencies in Hz, like 0.1,1.5 (at most 25)")
    return low, high


def _estimate(path: Path) -> dict[str, Any]:
    """Model, aircraft, values and noise of what `estimate --json` wrote: joint where there is one, else the first flight."""
    from estimation.errors import EstimationError

    try:
        content = read_json(path, "estimate", EstimationError)
        methods = content["joint"] or content["flights"][0]["methods"]
        found = next(m for m in methods.values() if m["parameters"])
        values = {n: float(p["estimate"]) for n, p in found["parameters"].items() if p["estimate"] is not None}
        noise = {n: math.sqrt(v) for n, v in found["R"].items() if v}
        return {"model": content["model"], "aircraft": content["aircraft"], "values": values, "noise": noise}
    except OSError as error:
        raise EstimationError(f"{path}: cannot be read ({error.strerror}); name what estimate --json wrote") from error
    except (ValueError, KeyError, TypeError, IndexError, StopIteration, AttributeError, RecursionError) as error:
        raise EstimationError(f"{path}: not what 'sideslip estimate --json' writes, or without an estimate") from error
