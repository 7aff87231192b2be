"""Command-line options that verbs share, each declared once. Output files and folders are checked before the verb runs."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click

from daq.utilities.outputs import tried_file, tried_folder, tried_picture

Decorated = TypeVar("Decorated", bound=Callable[..., Any] | click.Command)
Option = Callable[[Decorated], Decorated]

STRETCHES = (
    "Use only these stretches, each with initial states of its own: 2:12,15:25 [s], mode:MANUAL, "
    "'V > 12 and abs(phi) < 0.5'."
)
_PATH = click.Path(path_type=Path)


def flights_argument(name: str = "flights", metavar: str = "FLIGHT...") -> Option[Any]:
    """Files, one or more."""
    return click.argument(name, nargs=-1, required=True, type=_PATH, metavar=metavar)


def flag_option(*names: str, text: str, default: bool | None = False) -> Option[Any]:
    """An option without a value. default: None where the verb must know whether it was given."""
    return click.option(*names, is_flag=True, default=default, help=text)


def path_option(*names: str, text: str, tried: Callable[..., Any] | None = None, **more: Any) -> Option[Any]:
    """A file or folder. tried: callback that checks whether it can be written (`daq.utilities.outputs`); more: arguments of
    `click.option`."""
    return click.option(*names, type=_PATH, callback=tried, help=text, **more)


def json_option(text: str = "Write the answer as JSON.", name: str = "json_path") -> Option[Any]:
    """`--json PATH`. name: the argument of the verb's function."""
    return click.option("--json", name, type=_PATH, callback=tried_file, help=text)


def report_option(text: str = "Write an HTML page with tables and figures.") -> Option[Any]:
    """`--report FOLDER` as `report_folder`."""
    return click.option("--report", "report_folder", type=_PATH, callback=tried_folder, help=text)


def figure_option(text: str, *more: str) -> Option[Any]:
    """`--figure PATH` as `figure_path`. more: further names of the option."""
    return click.option(*more, "--figure", "figure_path", type=_PATH, callback=tried_picture, help=text)


def aircraft_option(
    text: str = "Built-in aircraft or an AIRCRAFT.toml", default: str = "the one the flights carry or name"
) -> Option[Any]:
    """`--aircraft NAME|FILE`. default: in words, what is used without the option."""
    return click.option("--aircraft", help=f"{text}  [default: {default}]." if default else f"{text}.")


def model_option(
    text: str = "lateral, lateral-simple, longitudinal, six-dof, a MODEL.toml, or module:Class.",
    default: str | None = "lateral",
    kind: click.ParamType | None = None,
) -> Option[Any]:
    """`--model NAME|FILE|CLASS`. kind: click type of the value, None for any text."""
    return click.option("--model", type=kind, default=default, show_default=True, help=text)


def simulation_option() -> Option[Any]:
    """`--simulation KIND:WHICH`."""
    text = (
        "A simulation of your own as base: jsbsim:AIRCRAFT (name or folder), ardupilot:FILE.json, gazebo:FILE.sdf,"
        " module:function or MODEL.toml."
    )
    return click.option("--simulation", help=text)


def seed_option(
    text: str = "Of every random draw: same seed, same answer.", default: int | None = 1, least: int | None = None
) -> Option[Any]:
    """`--seed N`. least: smallest allowed value, None for no limit."""
    kind = click.INT if least is None else click.IntRange(min=least)
    return click.option("--seed", type=kind, default=default, show_default=True, help=text)


def segments_option(text: str = STRETCHES) -> Option[Any]:
    """`--segments STRETCHES`."""
    return click.option("--segments", help=text)


def align_option(text: str) -> Option[Any]:
    """`--align [WAY]`. text: what is aligned with what."""
    ways = ("auto", "correlation", "input", "event", "start")
    text = f"{text}: by likeness, by the first input, by an event that both have, or by their starts."
    return click.option("--align", type=click.Choice(ways), is_flag=False, flag_value="auto", help=text)


def histories_option(what: str) -> Option[Any]:
    """`--histories FOLDER` as `histories_folder`. what: what the model computes beside each flight, as a verb."""
    text = f"Write each flight with what the model {what} beside it, for sideslip view."
    return click.option("--histories", "histories_folder", type=_PATH, callback=tried_folder, help=text)
