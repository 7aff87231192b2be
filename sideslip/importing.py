"""The verb `import`: the ground station's, and with --recipe what estimation can do with the log."""

from collections.abc import Mapping
from copy import copy
from pathlib import Path
from typing import Any

import click

from groundstation.cli.data import import_ as import_alone


def _parameters() -> list[click.Parameter]:
    """Those of the ground station's verb; a recipe needs no output."""
    given = [copy(p) for p in import_alone.params]
    for parameter in given:
        if parameter.name == "output":
            parameter.required = False
    draft = "Write no flight, but a mapping file to OUTPUT: columns, units, signs and servos proposed, each with its evidence."
    words = "Write no flight: say which models and methods the log is good for, and what one more sensor would add."
    return [
        *given,
        click.Option(["--recipe"], is_flag=True, help=words),
        click.Option(["--draft-map"], is_flag=True, help=draft),
    ]


def _run(recipe: bool, draft_map: bool, **given: Any) -> None:
    if recipe and given["output"] is not None:
        raise click.UsageError("--recipe writes no flight: leave out one of --recipe and -o")
    if recipe:
        say_recipe(given["data"], given["mapping"], given["rate"], given["report"])
        return
    if draft_map:
        if recipe or given["output"] is None or given["output"].suffix.lower() != ".toml":
            raise click.UsageError("--draft-map writes a mapping: give -o MAP.toml, and no --recipe")
        _write_draft(given["data"], given["output"])
        return
    if given["output"] is None:
        raise click.UsageError("Missing option '-o' / '--output'")
    assert import_alone.callback is not None
    import_alone.callback(**given)


def say_recipe(data: tuple[Path, ...], mapping: Path | None, rate: float | None, report: Path | None) -> None:
    """Print what can be done with a log; report: a JSON to write."""
    from estimation.session.recipe import recipe
    from groundstation.cli.data import write_json
    from groundstation.importers.recipe import servo_outputs
    from groundstation.importers.run import import_data

    flight = import_data(data, mapping, rate_hz=rate, accept_implausible=True)
    found = recipe(flight)
    for line in found.lines():
        click.echo(line)
    outputs = [o for path in data for o in servo_outputs(path)]
    for output in outputs:
        click.echo(f"servo output {output.line()}")
    if outputs and not any(flight.measured(c) for c in ("delta_e", "delta_a", "delta_r")):
        click.echo(
            "which surface each servo moves, with trim and travel, goes into a mapping: see the example maps in docs/import.md"
        )
    content = found.to_json()
    servos = [{"name": o.name, "low": o.low, "high": o.high, "usual": o.usual, **_lower(o.stated)} for o in outputs]
    write_json(report, {**content, "servo_outputs": servos})


def _write_draft(data: tuple[Path, ...], output: Path) -> None:
    """Write a drafted mapping and say what in it is not known."""
    from daq.contract.durable import write_text
    from groundstation.importers.draft import draft_map

    text = draft_map(data)
    write_text(output, text)
    unknown = [line for line in text.splitlines() if "UNKNOWN" in line or "CHECK" in line][1:]
    click.echo(f"{output}: a drafted mapping; {len(unknown)} lines in it need a person (UNKNOWN, CHECK)")


def _lower(stated: Mapping[str, float]) -> dict[str, float]:
    return {ending.lower(): value for ending, value in stated.items()}


import_ = click.Command("import", params=_parameters(), callback=_run, help=import_alone.help)
