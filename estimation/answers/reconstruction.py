"""`reconstruct`: air data of an aircraft without vanes, with stated uncertainty."""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from estimation.answers.answer import Answer, Rows, panels
from estimation.threads import single_threaded

if TYPE_CHECKING:
    from estimation.compatibility.air_data import AirData
    from groundstation.flight import Flight


@single_threaded
def reconstruct(
    flight: "Flight | str | Path",
    output: str | Path | None = None,
    *,
    trim_sideslip: float = 1.7,
    attitude_error: float = 0.17,
) -> "Reconstruction":
    """Reconstruct airspeed, angle of attack, sideslip and wind of a flight without vanes, from GNSS velocity, IMU and pitot.

    Args:
        flight: a Flight or a file.
        output: file for the flight with its air data: .mcap, .csv or .parquet.
        trim_sideslip: uncertainty of the mean sideslip about zero [deg, 1 sigma].
        attitude_error: smallest slow error of the attitude, mounting included [deg, 1 sigma].

    Raises:
        UserError: one sentence, for a column that is missing.

    Example::

        ss.reconstruct("log.mcap", "flight.mcap")
    """
    from estimation.compatibility.air_data import reconstruct_air, with_air
    from estimation.compatibility.air_filter import Assumptions
    from estimation.resolve import read_flights
    from groundstation.flight import write_flight

    assumed = Assumptions(trim_sideslip=math.radians(trim_sideslip), attitude=math.radians(attitude_error))
    (given,) = read_flights(flight)
    air = reconstruct_air(given, assumed)
    with_air_data = with_air(given, air)
    if output is not None:
        write_flight(with_air_data, Path(output))
    measured = tuple(n for n in ("alpha", "beta") if given.measured(n))
    return Reconstruction(air, with_air_data, str(output or given.name), measured)


@dataclass(frozen=True, repr=False)
class Reconstruction(Answer):
    """The answer of `reconstruct`. flight: with the air data as columns; name: of the written file, else of the flight; measured:
    angles that a vane measured, which stay as measured."""

    air: "AirData"
    flight: "Flight"
    name: str
    measured: tuple[str, ...]

    def to_json(self) -> dict[str, Any]:
        """The content of `reconstruct --json`: the reconstructed columns, their uncertainty and the wind, in SI and radians."""
        from groundstation.flight import RECONSTRUCTED

        air = self.air
        return {
            "version": 1,
            "flight": self.name,
            "columns": self.flight.provenance.detail[RECONSTRUCTED]["columns"],
            "airspeed_from": air.airspeed,
            "std": {n: air.typical(n) for n in air.std},
            "wind": {"ned": air.wind.tolist(), "std": air.wind_std.tolist(), "gust": air.gust},
            "scatter": dict(air.scatter),
            "notes": list(air.notes),
        }

    def lines(self) -> Iterator[str]:
        from estimation.compatibility.air_data import air_data_sentence

        yield f"{self.name}: {air_data_sentence(self.air)}"
        north, east = self.air.wind[:2]
        speed, from_deg = math.hypot(north, east), math.degrees(math.atan2(-east, -north)) % 360.0
        std = float(max(self.air.wind_std[:2]))
        yield (
            f"  wind {speed:.1f} m/s from {from_deg:.0f} deg (+- {std:.1f} m/s), gusts {self.air.gust:.2g} m/s; "
            f"airspeed from {self.air.airspeed}"
        )
        yield from (f"  note: {note}" for note in self.air.notes)
        if self.measured:
            yield f"  note: {' and '.join(self.measured)} measured by a vane: kept as measured"

    def plot(self, ax: Any = None) -> Any:
        """Draw air data over time, one axes a quantity; angles in degrees; returns the axes."""
        from estimation.report.names import face

        axes = panels(ax, len(self.air.values))
        for panel, (name, values) in zip(axes, self.air.values.items(), strict=True):
            factor, unit = face(name, "m/s" if name == "V" else "rad")
            panel.plot(self.flight.time, factor * values)
            panel.set_ylabel(f"{name} [{unit}]")
        axes[-1].set_xlabel("time [s]")
        return axes

    def writers(self) -> Mapping[str, Callable[[Path], Any]]:
        """The flight with its air data as .mcap, .csv or .parquet, wind and uncertainties as .json."""
        from groundstation.flight import write_flight

        flights = dict.fromkeys((".mcap", ".csv", ".parquet"), lambda path: write_flight(self.flight, path))
        return {**super().writers(), **flights}

    def headline(self) -> str:
        return next(self.lines())

    def rows(self) -> Rows:
        """A row for each quantity."""
        return ("quantity", "1 sigma [SI]"), [(n, f"{self.air.typical(n):.3g}") for n in self.air.std]
