"""What the live estimator is told of an aircraft, and who says so.

The ground station knows no aircraft files; whoever assembles it passes an `AircraftSource` that reads them.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from daq.identification.airframe import Airframe


@dataclass(frozen=True)
class LiveAircraft:
    """An airframe with its beliefs. sources: derivative -> who believes it (wind tunnel, flight, engineering estimate)."""

    name: str
    airframe: Airframe
    sources: Mapping[str, str] = field(default_factory=dict)


AircraftSource = Callable[[str, str | None], LiveAircraft]
"""(name or file, text of the file that travelled with the recording or None) -> the aircraft.

Raises `daq.contract.errors.UserError` where there is none, or where it lacks what the estimator needs."""
