"""A second look at an answer: channels the model does not explain, controls of the wrong sign or unit."""

from dataclasses import dataclass
from enum import Enum

import numpy as np

from estimation.estimators.result import Result
from estimation.estimators.uncertainty import companions
from estimation.models.base import ParameterRole
from estimation.signals.preprocess import noise_level

UNEXPLAINED = 0.5  # r2 below which a channel is not explained
AUDIBLE = 3.0  # residual in units of the channel's white noise from which that is no matter of noise
FAR = 8.0  # times what was believed
SURE = 2.0  # bounds by which a constant must lie beyond what is possible
TRIM = 0.26  # rad (15 deg) of sideslip or surface that a lateral constant may stand for: no aircraft is flown further out of trim
SYMMETRIC = ("CY", "Cl", "Cn")  # coefficients that vanish in symmetric flight: their constants are offsets

LARGEST_BIAS = {"m/s2": 1.0, "rad/s": 0.05, "rad": 0.1, "m/s": 5.0}
"""Unit -> bias beyond what an instrument can have: an accelerometer a tenth of g, a gyro 3 deg/s (an uncalibrated MEMS sensor),
an angle 6 deg (a vane in the airframe's upwash), an airspeed 5 m/s (position error of a light aircraft)."""


class DoubtKind(Enum):
    """What an answer is doubted for."""

    UNEXPLAINED = "unexplained channel"
    SIGN = "sign of a control"
    UNIT = "unit of a control"
    FAILED = "failed"
    PROCESS_NOISE = "process noise"
    COLOURED = "coloured innovations"
    DISAGREEMENT = "methods disagree"
    INSTRUMENT = "impossible instrument"
    JOINT = "joint outside its members"
    SCATTER = "scatter beyond bounds"
    EXTRAPOLATION = "beyond what was flown"
    RECONSTRUCTED = "reconstructed angles"


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
        if e.identifiable
        and e.reference
        and control in companions(result.model, e.name)
        and abs(e.estimate) > 5.0 * e.std_coloured
    }
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


def impossible(result: Result) -> list[str]:
    """Biases and constants that no instrument and no trim can have, by more than their bounds; one sentence each."""
    said = []
    for e in (*result.parameters.values(), *(o for f in result.flights for o in f.local.values())):
        parameter = result.model.parameter(e.name)
        beyond = abs(e.estimate) - SURE * e.std_coloured
        if parameter.role is ParameterRole.INSTRUMENT and e.name.startswith("bias_"):
            most = LARGEST_BIAS.get(parameter.unit, np.inf)
            if beyond > most:
                said.append(
                    f"{e.name} = {e.estimate:.3g} {parameter.unit} is no bias of an instrument (at most {most:g})"
                )
        elif parameter.role is ParameterRole.CONSTANT and e.name.partition("_")[0] in SYMMETRIC:
            angle = beyond / _strongest(result, e.name.partition("_")[0])
            if angle > TRIM:
                said.append(
                    f"{e.name} = {e.estimate:.3g} stands for {np.degrees(angle):.0f} deg of sideslip or surface out of trim"
                )
    return list(dict.fromkeys(said))


def _strongest(result: Result, coefficient: str) -> float:
    """Largest derivative [1/rad] of a coefficient by sideslip or a surface; infinite where none can be told."""
    told = [
        abs(e.estimate)
        for n, e in result.parameters.items()
        if e.identifiable and n.partition("_")[0] == coefficient and n.partition("_")[2] in ("beta", "da", "dr")
    ]
    return max(told, default=0.0) or np.inf
