"""`sideslip aircraft`: writes and checks an aircraft file."""

from pathlib import Path

import click

from daq.utilities.options import json_option, path_option


@click.group(
    epilog="Example: sideslip aircraft new glider, then fill in glider.toml and: sideslip aircraft check glider.toml"
)
def aircraft() -> None:
    """Describe your aircraft in one file (docs/aircraft.md)."""


@aircraft.command(epilog="Example: sideslip aircraft new glider -o aircraft/glider.toml")
@click.argument("name")
@path_option("-o", "--output", "--out", text="File to write [default: NAME.toml].")
def new(name: str, output: Path | None) -> None:
    """Write a commented file for aircraft NAME, every key explained; replaces no file."""
    from sideslip.aircraft_files import new_aircraft

    target = new_aircraft(name, output)
    click.echo(f"{target} written; fill it in, then: sideslip aircraft check {target}")


@aircraft.command(epilog="Example: sideslip aircraft check glider.toml --json glider.json")
@click.argument("file")
@json_option()
def check(file: str, json_path: Path | None) -> int:
    """Say what in FILE (or a built-in aircraft) is missing, doubtful, or enough for which method.

    Exit status 1 where a value is impossible, or the file is not enough for any model.
    """
    from sideslip.aircraft_files import check_aircraft
    from sideslip.verbs.delivery import deliver

    return deliver(check_aircraft(file), json_path)
