"""Sanity checks of a result: channels the model does not explain, controls and channels of the wrong sign or unit.

`groundstation.flight.quality.plausibility` checks the data without a model.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from estimation.estimators.result import Estimate, Result
from estimation.estimators.uncertainty import inputs_beside
from estimation.models.base import Model, ParameterRole
from estimation.signals.denoise import noise_level

Array = NDArray[np.float64]

ANOTHER_UNIT = 8.0  # estimate over belief, or its inverse, from which a control has another unit
SURE_BOUNDS = 5.0  # bounds by which a derivative has to differ from zero
REVERSED = -0.7  # correlation of a channel with the model's output, below which its sign is wrong (then -0.9 to -1)


def turned_outputs(model: Model, fits: Iterable[tuple[Array, Array]]) -> list[str]:
    """One sentence for each output that moves against the model's.

    fits: measured and modelled outputs (N, ny) of each record, NaN where not measured.
    """
    pairs = [(_moving(measured, modelled), _moving(modelled, measured)) for measured, modelled in fits]
    products = sum(np.nansum(a * b, axis=0) for a, b in pairs)
    power = [sum(np.nansum(side**2, axis=0) for side in sides) for sides in zip(*pairs, strict=True)]
    with np.errstate(invalid="ignore", divide="ignore"):
        correlation = np.atleast_1d(products / np.sqrt(np.prod(power, axis=0)))
    return [
        f"{signal.source}: moves against what the other channels make of it (correlation {c:.2f} with the model): "
        "is its sign wrong (sign = -1)?"
        for signal, c in zip(model.outputs, correlation, strict=False)
        if c < REVERSED
    ]


def _moving(values: Array, reference: Array) -> Array:
    """Values (N, n) about their mean over the rows where both are finite; NaN elsewhere."""
    common = np.where(np.isfinite(values) & np.isfinite(reference), values, np.nan)
    counts = np.isfinite(common).sum(axis=0)
    return np.asarray(common - np.nansum(common, axis=0) / np.maximum(counts, 1))


def turned_side_force(model: Model, parameters: Mapping[str, Estimate]) -> list[str]:
    """A sentence where the side force has the wrong sign: `CY_beta` above 0, as no aircraft has."""
    side_force = parameters.get("CY_beta")
    measured = "ay" in {s.source for s in model.outputs}
    if (
        side_force is None
        or not measured
        or not side_force.identifiable
        or side_force.estimate < SURE_BOUNDS * side_force.std_coloured
    ):
        return []
    size = f"CY_beta = {side_force.estimate:.3g} +- {side_force.std_coloured:.2g}, and no aircraft's is above 0"
    return [f"ay: pushes the aircraft into the wind ({size}): is its sign wrong (sign = -1)?"]


def turned_controls(model: Model, parameters: Mapping[str, Estimate]) -> list[str]:
    """A sentence for each control all of whose derivatives have the opposite sign of their beliefs."""
    return [
        f"{' and '.join(ratios)}: of the opposite sign of what was believed: check the sign of {column}"
        for column, ratios in _ratios(model, parameters).items()
        if all(r < 0.0 for r in ratios.values())
    ]


def controls_of_another_unit(model: Model, parameters: Mapping[str, Estimate]) -> list[str]:
    """A sentence for each control all of whose derivatives are larger, or all smaller, than their beliefs by ANOTHER_UNIT."""
    sentences = []
    for column, ratios in _ratios(model, parameters).items():
        sizes = [abs(r) for r in ratios.values()]
        if max(ratios.values()) > 0.0 and (min(sizes) > ANOTHER_UNIT or max(sizes) < 1.0 / ANOTHER_UNIT):
            times = ", ".join(f"{r:.2g}" for r in ratios.values())
            sentences.append(f"{' and '.join(ratios)}: {times} times what was believed: check the unit of {column}")
    return sentences


def _ratios(model: Model, parameters: Mapping[str, Estimate]) -> Mapping[str, Mapping[str, float]]:
    """Column of each control -> its identifiable derivatives -> estimate over belief."""
    identifiable = {
        n: e for n, e in parameters.items() if e.identifiable and abs(e.estimate) > SURE_BOUNDS * e.std_coloured
    }
    by_control = {
        s.source: {
            n: e.estimate / e.reference
            for n, e in identifiable.items()
            if e.reference and s.name in inputs_beside(model, n)
        }
        for s in model.inputs
        if s.control
    }
    return {column: ratios for column, ratios in by_control.items() if ratios}


UNEXPLAINED = 0.5  # r2 below which a channel is not explained
ABOVE_NOISE = 3.0  # residual over the channel's white noise, above which noise alone does not explain a low r2
SURE = 2.0  # bounds by which a constant must lie beyond what is possible
LARGEST_TRIM = (
    0.26  # rad (15 deg) of sideslip or surface for which a lateral constant may stand: nobody flies so far off trim
)
SYMMETRIC = ("CY", "Cl", "Cn")  # coefficients that vanish in symmetric flight: their constants are offsets

LARGEST_BIAS = {"m/s2": 1.0, "rad/s": 0.05, "rad": 0.1, "m/s": 5.0}
"""Unit -> largest bias that an instrument can have: an accelerometer a tenth of g, a gyro 3 deg/s (an uncalibrated MEMS sensor),
an angle 6 deg (a vane in the airframe's upwash), an airspeed 5 m/s (position error of a light aircraft)."""


class DoubtKind(Enum):
    """Kinds of doubt about a result."""

    UNEXPLAINED = "unexplained channel"
    SIGN = "sign of a control"
    CHANNEL_SIGN = "sign of a channel"
    CHANNEL = "unit or sign of a channel"
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
    LACK = "what the model lacks"
    ODD_FLIGHT = "a flight that differs"
    AIRCRAFT = "aircraft file"
    STATED = "stated term not used"
    IMPLAUSIBLE = "no aeroplane's value"
    FAST = "too fast for the record"


@dataclass(frozen=True, slots=True)
class Doubt:
    """One reason to distrust a result, and what to check."""

    kind: DoubtKind
    text: str

    def to_json(self) -> dict[str, str]:
        """One entry of `doubts` in `estimate --json`."""
        return {"kind": self.kind.value, "text": self.text}


def doubts_of(result: Result) -> list[Doubt]:
    """Doubts about channels that the model does not explain, and about signs and units."""
    doubts = []
    fit = result.flights[0]
    for i, (name, f) in enumerate(fit.fit.items()):
        measured = fit.measured[np.isfinite(fit.measured[:, i]), i]
        if f.r2 < UNEXPLAINED and f.rms > ABOVE_NOISE * noise_level(measured):
            text = (
                f"{name} is not explained by the model (r2 {f.r2:.2f}): check its unit, sign and sensor, and the model"
            )
            doubts.append(Doubt(DoubtKind.UNEXPLAINED, text))
    model, parameters = result.model, result.parameters
    turned_channels = turned_outputs(model, [(f.measured, f.outputs) for f in result.flights])
    doubts += [
        Doubt(DoubtKind.CHANNEL_SIGN, text) for text in (*turned_channels, *turned_side_force(model, parameters))
    ]
    doubts += [Doubt(DoubtKind.SIGN, text) for text in turned_controls(model, parameters)]
    return doubts + [Doubt(DoubtKind.UNIT, t) for t in controls_of_another_unit(model, parameters)]


def impossible_values(result: Result) -> list[str]:
    """A sentence for each bias or constant that exceeds what an instrument or a trim can have by more than SURE bounds."""
    sentences = []
    for e in (*result.parameters.values(), *(o for f in result.flights for o in f.local.values())):
        parameter = result.model.parameter(e.name)
        excess = abs(e.estimate) - SURE * e.std_coloured
        if parameter.role is ParameterRole.INSTRUMENT and e.name.startswith("bias_"):
            largest = LARGEST_BIAS.get(parameter.unit, np.inf)
            if excess > largest:
                sentences.append(
                    f"{e.name} = {e.estimate:.3g} {parameter.unit} is too large for an instrument's bias (at most {largest:g})"
                )
        elif parameter.role is ParameterRole.CONSTANT and e.name.partition("_")[0] in SYMMETRIC:
            angle = excess / _largest_slope(result, e.name.partition("_")[0])
            if angle > LARGEST_TRIM:
                sentences.append(
                    f"{e.name} = {e.estimate:.3g} stands for {np.degrees(angle):.0f} deg of sideslip or surface out of trim"
                )
    return list(dict.fromkeys(sentences))


def _largest_slope(result: Result, coefficient: str) -> float:
    """Largest derivative [1/rad] of a coefficient by sideslip or a surface; infinite where none is identifiable."""
    sizes = [
        abs(e.estimate)
        for n, e in result.parameters.items()
        if e.identifiable and n.partition("_")[0] == coefficient and n.partition("_")[2] in ("beta", "da", "dr")
    ]
    return max(sizes, default=0.0) or np.inf
