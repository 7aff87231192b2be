"""A second look at an answer: channels the model does not explain, controls of the wrong sign or unit."""

from dataclasses import dataclass
from enum import Enum

import numpy as np

from estimation.estimators.result import Result
from estimation.estimators.uncertainty import companions
from estimation.signals.preprocess import noise_level

UNEXPLAINED = 0.5  # r2 below which a channel is not explained
AUDIBLE = 3.0  # residual in units of the channel's white noise from which that is no matter of noise
FAR = 8.0  # times what was believed


class DoubtKind(Enum):
    """What an answer is doubted for."""

    UNEXPLAINED = "unexplained channel"
    SIGN = "sign of a control"
    UNIT = "unit of a control"


@dataclass(frozen=True, slots=True)
class Doubt:
    """What asks for a second look, and where to look."""

    kind: DoubtKind
    text: str

    def to_json(self) -> dict[str, str]:
        """One entry of `doubts` in `estimate --json`."""
        return {"kind": self.kind.value, "text": self.text}


def doubts_of(result: Result) -> list[Doubt]:
    """Channels that the model does not explain, and derivatives far from what was believed."""
    said = []
    fit = result.flights[0]
    for i, (name, f) in enumerate(fit.fit.items()):
        measured = fit.measured[np.isfinite(fit.measured[:, i]), i]
        if f.r2 < UNEXPLAINED and f.rms > AUDIBLE * noise_level(measured):
            text = (
                f"{name} is not explained by the model (r2 {f.r2:.2f}): check its unit, sign and sensor, and the model"
            )
            said.append(Doubt(DoubtKind.UNEXPLAINED, text))
    for signal in result.model.inputs:
        if signal.control:
            said += _doubts_of_control(result, signal.source, signal.name)
    return said


def _doubts_of_control(result: Result, column: str, control: str) -> list[Doubt]:
    """Where every derivative of a control has the wrong sign, or the wrong order of magnitude."""
    ratios = {
        e.name: e.estimate / e.reference
        for e in result.parameters.values()
        if e.identifiable and e.reference and control in companions(result.model, e.name)
        and abs(e.estimate) > 5.0 * e.std_coloured
    }  # fmt: skip
    names = " and ".join(ratios)
    if ratios and all(r < 0.0 for r in ratios.values()):
        return [
            Doubt(DoubtKind.SIGN, f"{names}: of the opposite sign of what was believed: check the sign of {column}")
        ]
    for far in (all(abs(r) > FAR for r in ratios.values()), all(abs(r) < 1.0 / FAR for r in ratios.values())):
        if ratios and far:
            times = ", ".join(f"{r:.2g}" for r in ratios.values())
            return [Doubt(DoubtKind.UNIT, f"{names}: {times} times what was believed: check the unit of {column}")]
    return []
