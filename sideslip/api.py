"""Sideslip in a notebook: five lines from a recording to derivatives with bounds.

    import sideslip as ss
    flight = ss.open("ld1.mcap")
    result = ss.estimate(flight, "lateral")
    result.to_pandas()
    result.plot()

Every function is what the verb of its name calls, so that the numbers are the same; what it returns prints shortly, shows a
table in a notebook, and gives JSON, pandas frames, figures and files when asked.
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
"""Arguments that are flights or files of them."""


def _asking(function: Callable[P, R]) -> Callable[P, R]:
    """The function, which asks for a package of an extra by a sentence where it is missing, and names the argument meant."""
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


@_asking
def open(path: str | Path) -> "Flight":
    """A flight of a file.

    Args:
        path: a flight (.mcap, .csv, .parquet), or a raw recording, calibrated with the set it carries.

    Raises:
        FlightError: one sentence, for a file that is none.

    Example::

        flight = ss.open("ld1.mcap")
        flight["p"]  # [rad/s]
    """
    from groundstation.calibration.recording import open_flight

    return open_flight(Path(path))


def _opening(function: Callable[P, R]) -> Callable[P, R]:
    """The function with every file of a flight opened as `open` does: raw recordings are calibrated."""
    signature = inspect.signature(function)

    @_asking
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


check = _opening(checks.check)
estimate = _opening(estimates.estimate)
match = _opening(matches.match)
gap = _opening(gaps.gap)
watch = _opening(watching.watch)
frequency = _opening(responses.frequency)
performance = _opening(performances.performance)
reconstruct = _opening(reconstruction.reconstruct)
design = _asking(designs.design)
analyse = _asking(analysis.analyse)
campaign = _asking(campaigns.campaign)
export = _asking(exports.export)
new_aircraft = _asking(aircraft_files.new_aircraft)
check_aircraft = _asking(aircraft_files.check_aircraft)


@_asking
def import_log(
    path: str | Path,
    mapping: str | Path | None = None,
    rate_hz: float | None = None,
    *,
    aircraft: str | Path | None = None,
) -> "Flight":
    """Somebody else's log as a flight.

    Args:
        path: CSV, Parquet, MATLAB, ULog, ArduPilot .bin, .tlog, MCAP, ROS bag.
        mapping: a file as for `import --map`, or the name of a built-in one.
        rate_hz: resample to this [Hz].
        aircraft: a built-in name or a file, which then travels with the flight.

    Raises:
        UserError: one sentence, for a log that cannot be read.

    Example::

        flight = ss.import_log("flight.bin", "surfaces.toml", aircraft="my.toml")
    """
    from groundstation.importers.records import with_aircraft
    from groundstation.importers.run import import_data

    flight = import_data(Path(path), None if mapping is None else Path(mapping), rate_hz=rate_hz)
    return flight if aircraft is None else with_aircraft(flight, str(aircraft))


@_asking
def simulate(model: "AnyModel", flight: "Flight | str | Path", *, aircraft: "AnyAircraft" = None) -> "Flight":
    """The flight with what the model shows on its measured inputs, as columns `<output>_model`.

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
    (read,) = problem.flights
    y = simulated(problem.model, read)
    return read.with_columns(**{f"{name}_model": y[:, i] for i, name in enumerate(problem.model.output_names)})
