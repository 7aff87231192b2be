"""Proof of match: a model with frozen parameters predicts a flight from its measured controls.

Parameters identified on one flight predict another. Only the initial states (on request also instrument biases) are refitted, and
`estimation.signals.goodness_of_fit` judges the match channel by channel. The answer says where the flight leaves the ranges that
the model was estimated from.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from estimation.estimators.output_error import OutputErrorOptions, output_error
from estimation.estimators.result import Array, Result
from estimation.models.base import Model
from estimation.models.dependence import force_states
from estimation.models.parts import EstimatedStretch
from estimation.prepare.flight_data import FlightData
from estimation.signals.goodness_of_fit import ChannelFit, to_json
from groundstation.flight import Flight

MARGIN = 0.15
"""Share of the flown range by which a flight may leave it: a linear model holds that far, and noise alone may leave it."""
OUTLIERS = 0.005
"""Share of samples that is dropped at either end of a range: single wild values and noise."""


def flown_ranges(model: Model, flights: Sequence[Flight]) -> dict[str, tuple[float, float]]:
    """Name -> least and greatest value of what forces depend on: driven states, controls, and motion measured as an input."""
    motion = ("V", "alpha", "beta", "p", "q", "r")
    names = dict.fromkeys([*force_states(model), *(s.name for s in model.inputs if s.control or s.name in motion)])
    sources = {s.name: s.source for s in (*model.states, *model.inputs)}
    ranges = {}
    for name in names:
        column = sources[name]
        parts = [f[column][np.isfinite(f[column])] for f in flights if column in f.columns]
        values = np.concatenate(parts) if parts else np.zeros(0)
        if values.size:
            low, high = np.quantile(values, [OUTLIERS, 1.0 - OUTLIERS])
            ranges[name] = (float(low), float(high))
    return ranges


def stretches_of_recordings(flights: Sequence[Flight]) -> tuple[EstimatedStretch, ...]:
    """The stretches (begin, end [s]) of flights whose recording has a digest."""
    return tuple(
        EstimatedStretch(f.provenance.sha256, float(f.time[s.start]), float(f.time[s.stop - 1]))
        for f in flights
        if f.provenance.sha256
        for s in f.segments
    )


def was_estimated_from(model: Model, flight: Flight) -> bool:
    """Whether the model was estimated from part of this flight, so that its prediction proves nothing."""
    return any(
        part.sha256 == used.sha256 and part.begin < used.end and used.begin < part.end
        for part in stretches_of_recordings([flight])
        for used in model.estimated_from
    )


@dataclass(frozen=True)
class Beyond:
    """One variable in which a flight leaves the range that a model was estimated from. flown, here: ranges in `unit`."""

    name: str
    unit: str
    flown: tuple[float, float]
    here: tuple[float, float]

    @property
    def text(self) -> str:
        """A sentence, with angles in degrees."""
        scale, unit = (math.degrees(1.0), "deg" + self.unit[3:]) if self.unit.startswith("rad") else (1.0, self.unit)
        (low, high), (flown_low, flown_high) = (tuple(scale * v for v in ends) for ends in (self.here, self.flown))
        return f"{self.name} from {low:.3g} to {high:.3g} {unit}, estimated from {flown_low:.3g} to {flown_high:.3g}"

    def to_json(self) -> dict[str, Any]:
        """An entry of `beyond` in `match --json`."""
        return {"flown": list(self.flown), "here": list(self.here)}


def beyond_flown(model: Model, flight: Flight) -> tuple[Beyond, ...]:
    """The variables in which a flight leaves the model's flown ranges by more than MARGIN of the range."""
    units = {s.name: s.unit for s in (*model.states, *model.inputs)}
    ranges = flown_ranges(model, [flight])
    exceeded = []
    for name, (low, high) in model.flown.items():
        if name not in ranges:
            continue
        margin = MARGIN * (high - low)
        if ranges[name][0] < low - margin or ranges[name][1] > high + margin:
            exceeded.append(Beyond(name, units.get(name, ""), (low, high), ranges[name]))
    return tuple(exceeded)


@dataclass(frozen=True)
class ProofOfMatch:
    """One flight predicted. time (N,), measured and predicted (N, ny), NaN outside the segments."""

    name: str
    converged: bool
    text: str
    outputs: tuple[str, ...]
    time: Array
    measured: Array
    predicted: Array
    fit: dict[str, ChannelFit]
    result: Result
    beyond: tuple[Beyond, ...] = ()
    """Variables in which the flight leaves the ranges that the model was estimated from."""
    estimated_from: bool = False
    """Whether the model was estimated from part of this flight."""

    def to_json(self) -> dict[str, Any]:
        """One flight's entry of `match --json`."""
        data = {"name": self.name, "fit": to_json(self.fit), "converged": self.converged, "status": self.text}
        data |= {"estimated_from": self.estimated_from} if self.result.model.estimated_from else {}
        return {**data, "beyond": {b.name: b.to_json() for b in self.beyond}} if self.result.model.flown else data


def predict_flight(model: Model, flight: Flight | FlightData, *, free: Sequence[str] = ()) -> ProofOfMatch:
    """Predict one flight with all parameters frozen at the model's values except those named in `free`.

    Raises ModelError for an unknown name, DataError or MissingColumnError for a flight that cannot feed the model.
    """
    for name in free:
        model.parameter(name)
    frozen = model.fixed(*(n for n in model.parameter_names if n not in free)).freed(*free)
    result = output_error(frozen, flight, options=OutputErrorOptions(improve_start=False))
    fitted = result.flights[0]
    refitted = "initial states" + (f" and {', '.join(free)}" if free else "")
    text = f"predicted with frozen parameters, {refitted} refitted" if result.converged else result.text
    exceeded = beyond_flown(model, flight) if isinstance(flight, Flight) else ()
    return ProofOfMatch(
        fitted.name, result.converged, text, result.model.output_names, fitted.time, fitted.measured, fitted.outputs,
        dict(fitted.fit), result, exceeded, isinstance(flight, Flight) and was_estimated_from(model, flight),
    )  # fmt: skip
