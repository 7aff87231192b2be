"""`watch`: the gap monitor over a flight: when a model stopped describing the aircraft."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from daq.identification.monitor import FALSE_ALARMS
from daq.utilities.packages import optional
from estimation.answers.answer import Answer, Figures, Rows, plot_watched
from estimation.threads import single_threaded

if TYPE_CHECKING:
    import pandas as pd

    from daq.identification.monitor.monitor import Alarm
    from estimation.resolve import AnyAircraft, AnyModel
    from estimation.watch.over_file import Watched
    from groundstation.flight import Flight


@single_threaded
def watch(
    flight: "Flight | str | Path",
    model: "AnyModel" = "lateral",
    *,
    aircraft: "AnyAircraft" = None,
    segments: str | None = None,
    rate: float = FALSE_ALARMS,
    hours: float = 2.5,
    seed: int = 1,
) -> "Watching":
    """Find when a linear model of rolling and yawing, of pitching, or of both stopped describing the aircraft.

    Args:
        flight: a Flight or a file.
        model: "lateral", "lateral-simple", "longitudinal", "six-dof", a model file, "module:Class" or a Model.
        aircraft: a built-in name or a file; by default what the flight carries.
        segments: use only these stretches: "1:9,12:20" [s], "mode:FBWA", "V > 12".
        rate: false alarms allowed in an hour of manoeuvring.
        hours: length of the simulated manoeuvring that sets the thresholds [h].
        seed: of every random draw.

    Raises:
        UserError: another model, a missing column, or less than ten seconds of manoeuvring.

    Example::

        answer = ss.watch("flight.mcap", "ld4.toml")
        print(answer.passed)
    """
    from estimation.resolve import resolve
    from estimation.watch import answer, over_file

    problem = resolve(flight, model, aircraft, segments=segments, needs_aircraft=True)
    (selected,) = problem.flights
    watched = over_file.watch(problem.model, selected, problem.aircraft, seed=seed, hours=hours, rate=rate)
    aircraft_name = None if aircraft is None else str(getattr(aircraft, "name", aircraft))
    model_name = str(model) if isinstance(model, str | Path) else problem.model.name
    command = answer.gap_command(Path(selected.provenance.path or selected.name), model_name, aircraft_name)
    return Watching(watched, command, problem.notes)


@dataclass(frozen=True, repr=False)
class Watching(Answer):
    """The answer of `watch`. result: history and alarms; command: for after an alarm; notes: which mass was used."""

    result: "Watched"
    command: str
    notes: tuple[str, ...] = ()

    @property
    def alarms(self) -> "tuple[Alarm, ...]":
        """Alarms in their order of time; none where the model held."""
        return self.result.alarms

    @property
    def passed(self) -> bool:
        """Whether there was no alarm."""
        return not self.alarms

    def to_json(self) -> dict[str, Any]:
        return {**self.result.to_json(), "next": self.command if self.alarms else None}

    def stretch(self) -> "Flight | None":
        """The part of the flight about its first alarm, for `gap`; None where there was no alarm."""
        from estimation.watch.answer import stretch

        return stretch(self.result) if self.alarms else None

    def to_pandas(self) -> "pd.DataFrame":
        """A row for each half second of manoeuvring: time [s], and the score over its threshold."""
        pd = optional("pandas", "a table of pandas")

        history = self.result.history
        return pd.DataFrame({"time": [w.time for w in history], "score": [w.score for w in history]})

    def lines(self) -> Iterator[str]:
        from estimation.watch.answer import lines

        yield from self.notes
        yield from lines(self.result)
        if self.alarms:
            yield f"next: {self.command}"

    def cut(self, path: Path) -> "Watching":
        """Write the stretch about the first alarm, if any; returns the answer whose command reads that file."""
        from groundstation.flight import write_flight

        stretch = self.stretch()
        if stretch is None:
            return self
        write_flight(stretch, path)
        _, _, model_and_options = self.command.partition(" --model ")
        return replace(self, command=f"sideslip gap {path} --model {model_and_options}")

    def plot(self, ax: Any = None) -> Any:
        """Draw the score over the flight, its threshold and the alarms; returns the axes."""
        return plot_watched(self.result, ax)

    def figures(self) -> Figures:
        from functools import partial

        from estimation.watch.answer import history_picture

        return Figures({"watch_history": partial(history_picture, self.result)})

    def report(self, folder: str | Path) -> Path:
        from estimation.watch.answer import write_watch_report

        return write_watch_report(self.result, Path(folder), self.command)

    def headline(self) -> str:
        alarms = f"{len(self.alarms)} alarm{'s' if len(self.alarms) > 1 else ''}" if self.alarms else "no alarm"
        return f"Watching of {self.result.flight.name} with {self.result.model}: {alarms}"

    def rows(self) -> Rows:
        """A row for each alarm."""
        rows = [
            (f"{a.time:.1f}", f"{a.since:.1f}", a.equation, f"{a.score:.1f}", f"{a.threshold:.1f}",
             ", ".join(n.effect for n in a.leading))
            for a in self.alarms
        ]  # fmt: skip
        return ("noticed [s]", "since [s]", "equation", "score", "threshold", "leading"), rows
