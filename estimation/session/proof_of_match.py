"""Proof of match: a frozen model predicts a flight with its measured controls; where the flight leaves what was flown before.

Parameters identified on one flight predict another; only the initial states (and, where asked, instrument biases) are
refitted, and the match is judged per channel by `estimation.signals.goodness_of_fit`.
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
"""Of the range flown, by which a flight may pass it: a linear model reaches that far, and noise passes it too."""
LONELY = 0.005
"""Share of samples at either end that do not count: single wild values and noise."""


def flown_ranges(model: Model, flights: Sequence[Flight]) -> dict[str, tuple[float, float]]:
    """Least and greatest value of what forces depend on: driven states, controls, and the motion that is measured as an input."""
    motion = ("V", "alpha", "beta", "p", "q", "r")
    names = dict.fromkeys([*force_states(model), *(s.name for s in model.inputs if s.control or s.name in motion)])
    sources = {s.name: s.source for s in (*model.states, *model.inputs)}
    ranges = {}
    for name in names:
        column = sources[name]
        parts = [f[column][np.isfinite(f[column])] for f in flights if column in f.columns]
        values = np.concatenate(parts) if parts else np.zeros(0)
        if values.size:
            low, high = np.quantile(values, [LONELY, 1.0 - LONELY])
            ranges[name] = (float(low), float(high))
    return ranges


def stretches_of_recordings(flights: Sequence[Flight]) -> tuple[EstimatedStretch, ...]:
    """The stretches of flights whose recording is known by its digest."""
    return tuple(
        EstimatedStretch(f.provenance.sha256, float(f.time[s.start]), float(f.time[s.stop - 1]))
        for f in flights
        if f.provenance.sha256
        for s in f.segments
    )


def was_estimated_from(model: Model, flight: Flight) -> bool:
    """Whether some of a flight is in what a model was estimated from, so that to predict it proves nothing."""
    return any(
        part.sha256 == used.sha256 and part.begin < used.end and used.begin < part.end
        for part in stretches_of_recordings([flight])
        for used in model.estimated_from
    )


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
        (low, high), (flown_low, flown_high) = (tuple(scale * v for v in ends) for ends in (self.here, self.flown))
        return f"{self.name} from {low:.3g} to {high:.3g} {unit}, estimated from {flown_low:.3g} to {flown_high:.3g}"

    def to_json(self) -> dict[str, Any]:
        """An entry of `beyond` in `match --json`."""
        return {"flown": list(self.flown), "here": list(self.here)}


def beyond_flown(model: Model, flight: Flight) -> tuple[Beyond, ...]:
    """The variables in which a flight passes the ranges of a model by more than MARGIN of them."""
    units = {s.name: s.unit for s in (*model.states, *model.inputs)}
    ranges = flown_ranges(model, [flight])
    exceeded = []
    for name, (low, high) in model.flown.items():
        if name not in ranges:
            continue
        room = MARGIN * (high - low)
        if ranges[name][0] < low - room or ranges[name][1] > high + room:
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
    """In what the flight leaves the ranges that the model was estimated from."""
    estimated_from: bool = False
    """Whether the model was estimated from some of this flight."""

    def to_json(self) -> dict[str, Any]:
        """One flight's entry of `match --json`."""
        data = {"name": self.name, "fit": to_json(self.fit), "converged": self.converged, "status": self.text}
        data |= {"estimated_from": self.estimated_from} if self.result.model.estimated_from else {}
        return {**data, "beyond": {b.name: b.to_json() for b in self.beyond}} if self.result.model.flown else data


def predict_flight(model: Model, flight: Flight | FlightData, *, free: Sequence[str] = ()) -> ProofOfMatch:
    """Predict one flight with every parameter frozen at the model's values but those named in `free`.

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
