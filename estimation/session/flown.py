"""What was flown, variable by variable: kept with a model, and held against the flights that it is asked to predict."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from estimation.models.base import Model
from estimation.models.driven import force_states
from groundstation.flight import Flight

MARGIN = 0.15
"""Of the range flown, by which a flight may pass it: a linear model reaches that far, and noise passes it too."""
LONELY = 0.005
"""Share of samples at either end that do not count: single wild values and noise."""


def flown(model: Model, flights: Sequence[Flight]) -> dict[str, tuple[float, float]]:
    """Least and greatest value of what forces depend on: driven states, controls, and the motion that is measured as an input."""
    motion = ("V", "alpha", "beta", "p", "q", "r")
    wanted = dict.fromkeys([*force_states(model), *(s.name for s in model.inputs if s.control or s.name in motion)])
    sources = {s.name: s.source for s in (*model.states, *model.inputs)}
    found = {}
    for name in wanted:
        column = sources[name]
        parts = [f[column][np.isfinite(f[column])] for f in flights if column in f.columns]
        values = np.concatenate(parts) if parts else np.zeros(0)
        if values.size:
            low, high = np.quantile(values, [LONELY, 1.0 - LONELY])
            found[name] = (float(low), float(high))
    return found


@dataclass(frozen=True)
class Beyond:
    """One variable in which a flight leaves what a model was estimated from; in its unit."""

    name: str
    unit: str
    flown: tuple[float, float]
    here: tuple[float, float]

    @property
    def text(self) -> str:
        """For a person, angles in degrees."""
        scale, unit = (math.degrees(1.0), "deg" + self.unit[3:]) if self.unit.startswith("rad") else (1.0, self.unit)
        (low, high), (least, most) = (tuple(scale * v for v in ends) for ends in (self.here, self.flown))
        return f"{self.name} from {low:.3g} to {high:.3g} {unit}, estimated from {least:.3g} to {most:.3g}"

    def to_json(self) -> dict[str, Any]:
        """An entry of `beyond` in `match --json`."""
        return {"flown": list(self.flown), "here": list(self.here)}


def beyond(model: Model, flight: Flight) -> tuple[Beyond, ...]:
    """The variables in which a flight passes the ranges of a model by more than MARGIN of them."""
    units = {s.name: s.unit for s in (*model.states, *model.inputs)}
    here = flown(model, [flight])
    out = []
    for name, (low, high) in model.flown.items():
        if name not in here:
            continue
        room = MARGIN * (high - low)
        if here[name][0] < low - room or here[name][1] > high + room:
            out.append(Beyond(name, units.get(name, ""), (low, high), here[name]))
    return tuple(out)
