"""Proof of match: a frozen model predicts a flight with its measured controls.

Parameters identified on one flight predict another; only the initial states (and, where asked, instrument biases) are
refitted, and the match is judged per channel by `estimation.signals.goodness_of_fit`.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from estimation.estimators.output_error import OutputErrorOptions, output_error
from estimation.estimators.result import Array, Result
from estimation.models.base import Model
from estimation.prepare.flight_data import FlightData
from estimation.session.flown import Beyond, beyond
from estimation.signals.goodness_of_fit import ChannelFit, to_json
from groundstation.flight import Flight


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

    def to_json(self) -> dict[str, Any]:
        """One flight's entry of `match --json`."""
        data = {"name": self.name, "fit": to_json(self.fit), "converged": self.converged, "status": self.text}
        return {**data, "beyond": {b.name: b.to_json() for b in self.beyond}} if self.result.model.flown else data


def predict(model: Model, flight: Flight | FlightData, *, free: Sequence[str] = ()) -> ProofOfMatch:
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
    left = beyond(model, flight) if isinstance(flight, Flight) else ()
    return ProofOfMatch(
        fitted.name, result.converged, text, result.model.output_names, fitted.time, fitted.measured, fitted.outputs,
        dict(fitted.fit), result, left,
    )  # fmt: skip
