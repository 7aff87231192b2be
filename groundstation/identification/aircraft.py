"""What the live estimator is told of an aircraft, and who says so.

The ground station knows no aircraft files; whoever assembles it passes an `AircraftSource` that reads them.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from daq.identification.airframe import Airframe


@dataclass(frozen=True)
class LiveAircraft:
    """An airframe with its beliefs. sources: derivative -> who believes it (wind tunnel, flight, engineering estimate).

    modelled: what the gap monitor holds against flight, as beliefs of a model, with a standard deviation of zero where it states
    none; None: what the aircraft file believes.
    """

    name: str
    airframe: Airframe
    sources: Mapping[str, str] = field(default_factory=dict)
    modelled: Airframe | None = None


AircraftSource = Callable[[str, str | None, str], LiveAircraft]
"""(name or file, text of the file that travelled with the recording or None, model file or "") -> the aircraft.

Raises `daq.contract.errors.UserError` where there is none, or where it lacks what the estimator needs."""
