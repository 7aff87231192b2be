"""`watch`: the gap monitor over a flight, when did a model stop describing the aircraft."""

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
    """When a linear model of rolling and yawing, of pitching, or of both stopped describing the aircraft.

    Args:
        flight: a Flight or a file.
        model: "lateral", "lateral-simple", "longitudinal", "six-dof", a model file, "module:Class" or a Model.
        aircraft: a built-in name or a file; by default what the flights carry.
        segments: use only these stretches: "1:9,12:20" [s], "mode:FBWA", "V > 12".
        rate: false alarms allowed in an hour of manoeuvring.
        hours: of simulated manoeuvring that thresholds come from.
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
    (read,) = problem.flights
    watched = over_file.watch(problem.model, read, problem.aircraft, seed=seed, hours=hours, rate=rate)
    craft = None if aircraft is None else str(getattr(aircraft, "name", aircraft))
    words = str(model) if isinstance(model, str | Path) else problem.model.name
    command = answer.gap_command(Path(read.provenance.path or read.name), words, craft)
    return Watching(watched, command, problem.notes)


@dataclass(frozen=True, repr=False)
class Watching(Answer):
    """What the monitor said of a flight. result: the whole of it; command: what to type where there was an alarm; notes: whose
    mass is taken."""

    result: "Watched"
    command: str
    notes: tuple[str, ...] = ()

    @property
    def alarms(self) -> "tuple[Alarm, ...]":
        """Alarms in the order in which they were told; none where the model held."""
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
        """A row for each half second of manoeuvring: time [s], and the score in units of its threshold."""
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
        """Write the stretch about the first alarm, where there is one; the answer whose next command reads that file."""
        from groundstation.flight import write_flight

        stretch = self.stretch()
        if stretch is None:
            return self
        write_flight(stretch, path)
        _, _, words = self.command.partition(" --model ")
        return replace(self, command=f"sideslip gap {path} --model {words}")

    def plot(self, ax: Any = None) -> Any:
        """The score over the flight, its threshold and the alarms; gives the axes."""
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
