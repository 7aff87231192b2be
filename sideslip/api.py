"""Sideslip in a notebook: five lines from a recording to derivatives with bounds.

    import sideslip as ss
    flight = ss.open("ld1.mcap")
    result = ss.estimate(flight, "lateral")
    result.to_pandas()
    result.plot()

The verb of the same name calls the same function, so the numbers are the same. A result prints briefly, shows a table in a
notebook, and has methods for JSON, pandas frames, figures and files.
"""

import functools
import inspect
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, ParamSpec, TypeVar

from daq.utilities.packages import missing
from daq.utilities.plain_words import did_you_mean
from estimation.answers import (
    checks,
    designs,
    estimates,
    gaps,
    matches,
    performances,
    reconstruction,
    responses,
    watching,
)
from estimation.answers.answer import Answer, Figures
from estimation.answers.checks import Check
from estimation.answers.designs import DesignAnswer
from estimation.answers.estimates import Estimates
from estimation.answers.gaps import GapAnswer
from estimation.answers.matches import Match
from estimation.answers.performances import Performance
from estimation.answers.reconstruction import Reconstruction
from estimation.answers.responses import Response
from estimation.answers.watching import Watching
from sideslip import aircraft_files, analysis, campaigns, exports
from sideslip.campaigns import CampaignAnswer

if TYPE_CHECKING:
    from estimation.resolve import AnyAircraft, AnyModel
    from groundstation.flight import Flight

__all__ = [
    "Answer", "CampaignAnswer", "Check", "DesignAnswer", "Estimates", "Figures", "GapAnswer", "Match", "Performance",
    "Reconstruction", "Response", "Watching", "analyse", "campaign", "check", "check_aircraft", "design", "estimate",
    "export", "frequency", "gap", "import_log", "match", "new_aircraft", "open", "performance", "reconstruct",
    "simulate", "watch",
]  # fmt: skip

P = ParamSpec("P")
R = TypeVar("R")
FLIGHTS = ("flight", "flights", "holdout")
"""Names of arguments that take flights or their files."""


def _with_clear_errors(function: Callable[P, R]) -> Callable[P, R]:
    """The function with an error in one sentence for a missing package, and a similar name for an unknown argument."""
    known = inspect.signature(function).parameters

    @functools.wraps(function)
    def called(*args: P.args, **kwargs: P.kwargs) -> R:
        for name in kwargs:
            if name not in known:
                near = did_you_mean(name, known) or f"; it takes {', '.join(known)}"
                raise TypeError(f"{function.__name__}() has no argument {name!r}{near}")
        try:
            return function(*args, **kwargs)
        except ModuleNotFoundError as error:
            raise missing(error, f"sideslip.{function.__name__}") from error

    return called


@_with_clear_errors
def open(path: str | Path) -> "Flight":
    """Open a flight.

    Args:
        path: a flight (.mcap, .csv, .parquet), or a raw recording, which is calibrated with its embedded set.

    Raises:
        FlightError: one sentence, for a file that is not a flight.

    Example::

        flight = ss.open("ld1.mcap")
        flight["p"]  # [rad/s]
    """
    from groundstation.calibration.recording import open_flight

    return open_flight(Path(path))


def _with_opened_flights(function: Callable[P, R]) -> Callable[P, R]:
    """The function with files of flights opened by `open`, so that raw recordings are calibrated."""
    signature = inspect.signature(function)

    @_with_clear_errors
    @functools.wraps(function)
    def called(*args: P.args, **kwargs: P.kwargs) -> R:
        bound = signature.bind(*args, **kwargs)
        for name in FLIGHTS:
            argument = bound.arguments.get(name)
            if isinstance(argument, str | Path):
                bound.arguments[name] = open(argument)
            elif isinstance(argument, list | tuple):
                bound.arguments[name] = [open(f) if isinstance(f, str | Path) else f for f in argument]
        return function(*bound.args, **bound.kwargs)

    return called


check = _with_opened_flights(checks.check)
estimate = _with_opened_flights(estimates.estimate)
match = _with_opened_flights(matches.match)
gap = _with_opened_flights(gaps.gap)
watch = _with_opened_flights(watching.watch)
frequency = _with_opened_flights(responses.frequency)
performance = _with_opened_flights(performances.performance)
reconstruct = _with_opened_flights(reconstruction.reconstruct)
design = _with_clear_errors(designs.design)
analyse = _with_clear_errors(analysis.analyse)
campaign = _with_clear_errors(campaigns.campaign)
export = _with_clear_errors(exports.export)
new_aircraft = _with_clear_errors(aircraft_files.new_aircraft)
check_aircraft = _with_clear_errors(aircraft_files.check_aircraft)


@_with_clear_errors
def import_log(
    path: str | Path,
    mapping: str | Path | None = None,
    rate_hz: float | None = None,
    *,
    aircraft: str | Path | None = None,
) -> "Flight":
    """Import a log of another program as a flight.

    Args:
        path: CSV, Parquet, MATLAB, ULog, ArduPilot .bin, .tlog, MCAP, ROS bag.
        mapping: a file as for `import --map`, or the name of a built-in one.
        rate_hz: resample to this [Hz].
        aircraft: a built-in name or a file, which is stored with the flight.

    Raises:
        UserError: one sentence, for a log that cannot be read.

    Example::

        flight = ss.import_log("flight.bin", "surfaces.toml", aircraft="my.toml")
    """
    from groundstation.importers.records import with_aircraft
    from groundstation.importers.run import import_data

    flight = import_data(Path(path), None if mapping is None else Path(mapping), rate_hz=rate_hz)
    return flight if aircraft is None else with_aircraft(flight, str(aircraft))


@_with_clear_errors
def simulate(model: "AnyModel", flight: "Flight | str | Path", *, aircraft: "AnyAircraft" = None) -> "Flight":
    """The flight with the outputs of a model on its measured inputs, as columns `<output>_model`.

    Args:
        model: "lateral", "lateral-simple", "longitudinal", "six-dof", a model file, "module:Class" or a Model.
        flight: a Flight or a file.
        aircraft: a built-in name or a file; by default what the flight carries.

    Example::

        both = ss.simulate("model.toml", "ld2.mcap")
        both.plot("p", "p_model")
    """
    from estimation.engine.simulate import simulate as simulated
    from estimation.resolve import resolve

    problem = resolve(open(flight) if isinstance(flight, str | Path) else flight, model, aircraft)
    (prepared,) = problem.flights
    y = simulated(problem.model, prepared)
    return prepared.with_columns(**{f"{name}_model": y[:, i] for i, name in enumerate(problem.model.output_names)})
