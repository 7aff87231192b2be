"""The gap monitor in a notebook: what `sideslip watch` does, with the same numbers."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sideslip.api import model_of, read_flights
from sideslip.notebook import Figures, plot_watched, table

if TYPE_CHECKING:
    import pandas as pd

    from daq.identification.monitor.monitor import Alarm
    from estimation.watch.over_file import Watched
    from groundstation.flight import Flight
    from sideslip.api import AnyAircraft, AnyModel


def watch(
    flight: "Flight | str | Path",
    model: "AnyModel" = "lateral",
    *,
    aircraft: "AnyAircraft" = None,
    rate: float = 1.0,
    hours: float = 2.5,
    seed: int = 1,
) -> "Watching":
    """When a model of the lateral derivatives stopped describing the aircraft, as it would have been said in flight.

    rate: false alarms allowed in an hour of manoeuvring; hours: of simulated manoeuvring that thresholds come from. Raises a
    UserError for another model, a missing column, or less than ten seconds of manoeuvring.
    """
    from estimation.watch import over_file

    (read,) = read_flights(flight)
    chosen, craft = model_of(model, [read], aircraft)
    return Watching(over_file.watch(chosen, read, craft, seed=seed, hours=hours, rate=rate))


@dataclass(frozen=True, repr=False)
class Watching:
    """What the monitor said of a flight. `result` is the whole of it."""

    result: "Watched"

    @property
    def alarms(self) -> "tuple[Alarm, ...]":
        """Alarms in the order in which they were told; none where the model held."""
        return self.result.alarms

    def stretch(self) -> "Flight | None":
        """The part of the flight about its first alarm, for `gap`; None where there was no alarm."""
        from estimation.watch.answer import stretch

        return stretch(self.result) if self.alarms else None

    def to_pandas(self) -> "pd.DataFrame":
        """A row for each half second of manoeuvring: time [s], and the score in units of its threshold."""
        import pandas as pd

        seen = self.result.history
        return pd.DataFrame({"time": [w.time for w in seen], "score": [w.score for w in seen]})

    def summary(self) -> str:
        """What `sideslip watch` prints."""
        from estimation.watch.answer import lines

        return "\n".join(lines(self.result))

    def plot(self, ax: Any = None) -> Any:
        """The score over the flight, its threshold and the alarms; gives the axes."""
        return plot_watched(self.result, ax)

    def figures(self) -> Figures:
        """The figure of the page."""
        from functools import partial

        from estimation.watch.answer import history_picture

        return Figures({"watch_history": partial(history_picture, self.result)})

    def report(self, folder: str | Path) -> Path:
        """Write the HTML page; gives its path."""
        from estimation.watch.answer import write_watch_report

        return write_watch_report(self.result, Path(folder), "ss.gap(model, watching.stretch())")

    def save(self, path: str | Path) -> Path:
        """Write .json, as `watch --json` does. Raises UserError for another ending."""
        from daq.contract.errors import UserError
        from daq.contract.outputs import write_json

        path = Path(path)
        if path.suffix.lower() != ".json":
            raise UserError(f"{path}: no known format of what the monitor said; end the name in .json")
        write_json(self.result.to_json(), path)
        return path

    def __repr__(self) -> str:
        alarms = f"{len(self.alarms)} alarm{'s' if len(self.alarms) > 1 else ''}" if self.alarms else "no alarm"
        return f"<Watching of {self.result.flight.name} with {self.result.model}: {alarms}>"

    def _repr_html_(self) -> str:
        rows = [
            (f"{a.time:.1f}", f"{a.since:.1f}", a.equation, f"{a.score:.1f}", f"{a.threshold:.1f}",
             ", ".join(n.effect for n in a.leading))
            for a in self.alarms
        ]  # fmt: skip
        return table(repr(self), ("noticed [s]", "since [s]", "equation", "score", "threshold", "leading"), rows)
