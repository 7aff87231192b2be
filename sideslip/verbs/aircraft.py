"""`sideslip aircraft`: a file for one's own aircraft, and what it is good for."""

from pathlib import Path

import click

from daq.utilities.options import json_option, path_option
from daq.utilities.outputs import check_file, write_json, write_text


@click.group(
    epilog="Example: sideslip aircraft new glider, then fill in glider.toml and: sideslip aircraft check glider.toml"
)
def aircraft() -> None:
    """Describe an aircraft of one's own in one file (docs/aircraft.md)."""


@aircraft.command(epilog="Example: sideslip aircraft new glider -o aircraft/glider.toml")
@click.argument("name")
@path_option("-o", "--output", text="File to write [default: NAME.toml].")
def new(name: str, output: Path | None) -> None:
    """Write a commented file for aircraft NAME, every key explained; asks nothing, replaces nothing."""
    from estimation.aircraft.template import template
    from estimation.errors import AircraftError

    if not name.strip() or not name.isprintable() or any(c in name for c in "/\\"):
        raise AircraftError(f"aircraft name {name!r}: give one word, like glider")
    target = output or Path(f"{name}.toml")
    if target.suffix != ".toml":
        raise AircraftError(f"--output {target}: an aircraft is written as TOML; end the name in .toml")
    if target.exists():
        raise AircraftError(f"{target} is there already; remove it, or give -o another name")
    check_file("--output", target)
    write_text(template(name, str(target)), target)
    click.echo(f"{target} written; fill it in, then: sideslip aircraft check {target}")


@aircraft.command(epilog="Example: sideslip aircraft check glider.toml --json glider.json")
@click.argument("file")
@json_option("Write the same as JSON.")
def check(file: str, json_path: Path | None) -> int:
    """Say what in FILE (or a built-in aircraft) is missing, doubtful, or enough for which method.

    Exit status 1 where it says something impossible, or is not enough for any model.
    """
    from estimation.aircraft import load_aircraft
    from estimation.session.aircraft_review import review_aircraft

    loaded_aircraft = load_aircraft(file)
    notes = review_aircraft(loaded_aircraft)
    click.echo(f"aircraft {loaded_aircraft.name}{': ' + loaded_aircraft.title if loaded_aircraft.title else ''}")
    for note in notes:
        click.echo(f"  {note.verdict:<5}{note.check}: {note.text}")
    impossible = any(n.verdict == "fail" and not n.check.startswith("model ") for n in notes)
    usable = any(n.verdict != "fail" for n in notes if n.check.startswith("model "))
    if json_path is not None:
        data = {
            "version": 1,
            "aircraft": loaded_aircraft.name,
            "ok": usable and not impossible,
            "notes": [n.to_json() for n in notes],
        }
        write_json(data, json_path)
    return 0 if usable and not impossible else 1
