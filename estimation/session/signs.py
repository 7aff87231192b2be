"""Signs and units that a fit gives away: what a model makes of all channels, against each of them and against what was believed.

What the data show by themselves is told by `groundstation.flight.quality.plausibility`.
"""

from collections.abc import Iterable, Mapping

import numpy as np
from numpy.typing import NDArray

from estimation.estimators.result import Estimate
from estimation.estimators.uncertainty import companions
from estimation.models.base import Model

Array = NDArray[np.float64]

FAR = 8.0  # times what was believed
SURE = 5.0  # bounds by which a derivative has to differ from zero
TURNED = -0.7  # correlation of a channel with what the model makes of it: -0.9 to -1 where its sign is turned


def turned_outputs(model: Model, fits: Iterable[tuple[Array, Array]]) -> list[str]:
    """One sentence for each output that moves against the model's.

    fits: measured and modelled outputs (N, ny) of each record, NaN where not measured.
    """
    pairs = [(_moving(measured, modelled), _moving(modelled, measured)) for measured, modelled in fits]
    together = sum(np.nansum(a * b, axis=0) for a, b in pairs)
    power = [sum(np.nansum(side**2, axis=0) for side in sides) for sides in zip(*pairs, strict=True)]
    with np.errstate(invalid="ignore", divide="ignore"):
        correlation = np.atleast_1d(together / np.sqrt(np.prod(power, axis=0)))
    return [
        f"{signal.source}: moves against what the other channels make of it (correlation {c:.2f} with the model): "
        "is its sign wrong (sign = -1)?"
        for signal, c in zip(model.outputs, correlation, strict=False)
        if c < TURNED
    ]


def _moving(values: Array, other: Array) -> Array:
    """Values (N, n) about their mean over the rows where the other is known too."""
    both = np.where(np.isfinite(values) & np.isfinite(other), values, np.nan)
    known = np.isfinite(both).sum(axis=0)
    return np.asarray(both - np.nansum(both, axis=0) / np.maximum(known, 1))


def turned_side_force(model: Model, parameters: Mapping[str, Estimate]) -> list[str]:
    """A sentence where air from the side pulls the aircraft towards it, as no aircraft's does: `CY_beta` above 0."""
    found = parameters.get("CY_beta")
    measured = "ay" in {s.source for s in model.outputs}
    if found is None or not measured or not found.identifiable or found.estimate < SURE * found.std_coloured:
        return []
    size = f"CY_beta = {found.estimate:.3g} +- {found.std_coloured:.2g}, and no aircraft's is above 0"
    return [f"ay: pushes the aircraft into the wind ({size}): is its sign wrong (sign = -1)?"]


def turned_controls(model: Model, parameters: Mapping[str, Estimate]) -> list[str]:
    """A sentence for each control all of whose derivatives have the sign that was not believed."""
    return [
        f"{' and '.join(ratios)}: of the opposite sign of what was believed: check the sign of {column}"
        for column, ratios in _ratios(model, parameters).items()
        if all(r < 0.0 for r in ratios.values())
    ]


def controls_of_another_unit(model: Model, parameters: Mapping[str, Estimate]) -> list[str]:
    """A sentence for each control all of whose derivatives are of another order of magnitude than was believed."""
    said = []
    for column, ratios in _ratios(model, parameters).items():
        sizes = [abs(r) for r in ratios.values()]
        if max(ratios.values()) > 0.0 and (min(sizes) > FAR or max(sizes) < 1.0 / FAR):
            times = ", ".join(f"{r:.2g}" for r in ratios.values())
            said.append(f"{' and '.join(ratios)}: {times} times what was believed: check the unit of {column}")
    return said


def _ratios(model: Model, parameters: Mapping[str, Estimate]) -> Mapping[str, Mapping[str, float]]:
    """Column of each control -> its derivatives that can be told -> estimate over what was believed."""
    told = {n: e for n, e in parameters.items() if e.identifiable and abs(e.estimate) > SURE * e.std_coloured}
    found = {
        s.source: {
            n: e.estimate / e.reference for n, e in told.items() if e.reference and s.name in companions(model, n)
        }
        for s in model.inputs
        if s.control
    }
    return {column: ratios for column, ratios in found.items() if ratios}
