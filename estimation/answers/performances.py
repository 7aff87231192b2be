"""`performance`: drag polar, glide, sink and power required, from flights whose thrust is known."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from daq.utilities.constants import NORMAL_95, RADIAN
from daq.utilities.packages import optional
from estimation.answers.answer import Answer, Figures, Rows, panels, picture_writers, table_writers
from estimation.threads import single_threaded

if TYPE_CHECKING:
    import pandas as pd

    from estimation.aircraft import Aircraft
    from estimation.performance.polar import Bounded, Polar, PolarPoint
    from estimation.performance.samples import Usable
    from estimation.resolve import AnyAircraft, Flights


@single_threaded
def performance(
    flights: "Flights", *, aircraft: "AnyAircraft" = None, segments: str | None = None, throttle_off: bool = False
) -> "Performance":
    """Fit the drag polar of an aircraft to all flights together, with glide, sink and power required.

    Args:
        flights: a Flight, a file, or a list of them; raw recordings are calibrated.
        aircraft: a built-in name or a file; by default what the flights carry.
        segments: use only these stretches: "1:9,12:20" [s], "mode:FBWA", "V > 12".
        throttle_off: the throttle was closed throughout; for flights without a column that shows it.

    Raises:
        UserError: thrust is unknown and not off, or the aircraft's mass or area is unknown.

    Example::

        answer = ss.performance("glides.mcap", aircraft="cdfp", throttle_off=True)
        print(answer.summary())
    """
    from estimation.performance.polar import fitted
    from estimation.performance.samples import all_stretches, usable
    from estimation.resolve import read_flights, which_aircraft

    selected = read_flights(flights, segments)
    airframe = which_aircraft(selected, aircraft, needed=True)
    airframe.need(("m", "S"), "performance")
    used = tuple(usable(flight, airframe, throttle_off=throttle_off) for flight in selected)
    return Performance(airframe, used, fitted(all_stretches(used)))


@dataclass(frozen=True, repr=False)
class Performance(Answer):
    """The answer of `performance`: a drag polar with the aircraft and the flights that it was fitted to."""

    aircraft: "Aircraft"
    flights: "tuple[Usable, ...]"
    polar: "Polar"

    @property
    def passed(self) -> bool:
        """Whether the polar is known: both coefficients above zero beyond their bounds."""
        return self.polar.known

    @property
    def status(self) -> str:
        """The answer in a sentence; where the polar is not known, what to fly instead."""
        low, high = self.polar.lift
        if self.passed:
            glide = self.best_glide
            beyond = [
                n for n, best in (("best glide", glide), ("least sink", self.least_sink)) if not self._flown(best)
            ]
            extrapolated = f"; {' and '.join(beyond)} beyond them, by the parabola alone" if beyond else ""
            return (
                f"best glide {glide['ratio'].estimate:.1f} at {glide['speed'].estimate:.1f} m/s (CL {glide['CL'].estimate:.2f}),"
                f" from lift coefficients {low:.2f} to {high:.2f}{extrapolated}"
            )
        weak = " and ".join(n for n in ("CD_0", "CD_k") if not self.polar[n].estimate > 2.0 * self.polar[n].std)
        return (
            f"{weak} cannot be told from these flights, whose lift coefficients are {low:.2f} to {high:.2f}; fly steady from near"
            " the slowest to near the fastest speed, and longer"
        )

    @property
    def best_glide(self) -> "dict[str, Bounded]":
        """Ratio, speed [m/s] and CL of the best glide; only where the polar is known."""
        from estimation.performance.polar import best_glide

        return best_glide(self.polar, self.aircraft)

    def _flown(self, best: "Mapping[str, Bounded]") -> bool:
        """Whether the lift coefficient of a best point was flown."""
        from estimation.performance.polar import flown

        return flown(self.polar, best["CL"].estimate)

    @property
    def least_sink(self) -> "dict[str, Bounded]":
        """Sink [m/s], power [W], speed [m/s] and CL of the least sink; only where the polar is known."""
        from estimation.performance.polar import least_sink

        return least_sink(self.polar, self.aircraft)

    @property
    def curve(self) -> "tuple[PolarPoint, ...]":
        """Drag, sink and power over the speeds whose lift was flown."""
        from estimation.performance.polar import curve

        return curve(self.polar, self.aircraft)

    def to_json(self) -> dict[str, Any]:
        polar_known = self.passed
        return {
            "version": 1, "aircraft": self.aircraft.name, "status": self.status, "known": polar_known,
            "mass": self.aircraft.mass, "density": self.polar.density, "rms_CD": self.polar.rms,
            "flights": [{"name": f.name, "samples": f.samples, "used": f.used, "thrust": f.thrust} for f in self.flights],
            "lift": list(self.polar.lift),
            "polar": {n: _json(self.polar[n]) for n in ("CD_0", "CD_k", "alpha_offset")},
            "best_glide": self._best_json(self.best_glide) if polar_known else None,
            "least_sink": self._best_json(self.least_sink) if polar_known else None,
            "curve": [
                {"V": p.V, "CL": p.CL, "drag": _json(p.drag), "sink": _json(p.sink), "power": _json(p.power)} for p in self.curve
            ] if polar_known else [],
        }  # fmt: skip

    def _best_json(self, best: "Mapping[str, Bounded]") -> dict[str, Any]:
        return {n: _json(b) for n, b in best.items()} | {"flown": self._flown(best)}

    def to_pandas(self) -> "pd.DataFrame":
        """A row for each speed of the curve: V [m/s], CL, drag [N], sink [m/s], power [W], each with std."""
        pd = optional("pandas", "a table of pandas")

        return pd.DataFrame([
            {"V": p.V, "CL": p.CL, "drag": p.drag.estimate, "drag_std": p.drag.std, "sink": p.sink.estimate,
             "sink_std": p.sink.std, "power": p.power.estimate, "power_std": p.power.std}
            for p in (self.curve if self.passed else ())
        ])  # fmt: skip

    def lines(self) -> Iterator[str]:
        for f in self.flights:
            yield f"{f.name}: {f.used} of {f.samples} samples, {f.thrust}"
        yield f"{self.aircraft.name}, {self.aircraft.mass:g} kg, density {self.polar.density:.3f} kg/m3: {self.status}"
        yield f"  {'':<14}{'estimate':>10}{'std':>10}   95 % bounds"
        for name, bounded, unit in self._numbers():
            low, high = bounded.ends
            yield f"  {name:<14}{bounded.estimate:>10.4g}{bounded.std:>10.2g}   {low:.4g} to {high:.4g} {unit}".rstrip()
        if self.passed:
            yield f"  {'V [m/s]':>8}{'CL':>8}{'drag [N]':>16}{'sink [m/s]':>18}{'power [W]':>18}"
            for p in self.curve:
                drag, sink, power = (f"{b.estimate:.3g} +- {NORMAL_95 * b.std:.2g}" for b in (p.drag, p.sink, p.power))
                yield f"  {p.V:>8.2f}{p.CL:>8.3f}{drag:>16}{sink:>18}{power:>18}"

    def _numbers(self) -> "list[tuple[str, Bounded, str]]":
        """Name, value and unit of each single number of the answer."""
        from estimation.performance.polar import Bounded

        offset = self.polar["alpha_offset"]
        rows = [("CD_0", self.polar["CD_0"], ""), ("CD_k", self.polar["CD_k"], ""),
                ("alpha offset", Bounded(RADIAN * offset.estimate, RADIAN * offset.std), "deg")]  # fmt: skip
        if self.passed:
            glide, sink = self.best_glide, self.least_sink
            rows += [("glide ratio", glide["ratio"], ""), ("  at speed", glide["speed"], "m/s"),
                     ("least sink", sink["sink"], "m/s"), ("least power", sink["power"], "W"),
                     ("  at speed", sink["speed"], "m/s")]  # fmt: skip
        return rows

    def plot(self, ax: Any = None) -> Any:
        """Draw polar, sink and power required over speed with 95 % bands; returns the three axes."""
        from estimation.performance.polar import draw_performance

        axes = panels(ax, 3, (6.0, 7.5))
        draw_performance(self.flights, self.polar, self.curve if self.passed else (), axes)
        return axes

    def figures(self) -> Figures:
        from functools import partial

        from estimation.performance.polar import performance_picture

        curve = self.curve if self.passed else ()
        return Figures({"performance": partial(performance_picture, self.flights, self.polar, curve)})

    def writers(self) -> Mapping[str, Callable[[Path], Any]]:
        """Everything as .json, the curve as .csv, the figure as a picture."""
        from estimation.performance.polar import write_performance

        curve = self.curve if self.passed else ()
        pictures = picture_writers(lambda path: write_performance(self.flights, self.polar, curve, path))
        return {**super().writers(), **table_writers(self), **pictures}

    def headline(self) -> str:
        return f"Performance of {self.aircraft.name}: {self.status}"

    def rows(self) -> Rows:
        """A row for each number."""
        rows = []
        for name, bounded, unit in self._numbers():
            low, high = bounded.ends
            rows.append(
                (name.strip(), f"{bounded.estimate:.4g}", f"{bounded.std:.2g}", f"{low:.4g} to {high:.4g}", unit)
            )
        return ("", "estimate", "std", "95 % bounds", "unit"), rows


def _json(bounded: "Bounded") -> dict[str, float]:
    low, high = bounded.ends
    return {"estimate": bounded.estimate, "std": bounded.std, "low": low, "high": high}
