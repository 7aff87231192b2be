"""Controls that move only in proportion to other controls or to the motion, so that no number of such flights separates their
derivatives."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from estimation.models.base import Model
from estimation.prepare.flight_data import FlightData

Array = NDArray[np.float64]

LEAST_INDEPENDENT = 0.02
"""Share of a control's movement that a regression on other controls and the motion must leave unexplained. Less means a gearing,
an interconnect or a damper; only the noise of its record would then determine its derivatives."""
LEAST_OVER_NOISE = 1.0  # times the noise of the control, which de-noising halves: the unexplained part must be larger
LEAST_PARTNER = 0.05  # of the largest regression weight: smaller ones are not named
HARDLY_MOVES = 3.0  # times its noise: a control that moves less counts as not moved


def moving_together(model: Model, flights: list[FlightData]) -> dict[str, tuple[str, ...]]:
    """Control -> the controls and states of which it is a linear combination over all flights; independent controls are left
    out."""
    controls = [i for i, s in enumerate(model.inputs) if s.control]
    blocks = [_block(f, controls) for f in flights]
    if not controls or not any(len(b) for b in blocks):
        return {}
    rows = np.concatenate([b for b in blocks if len(b)])
    names = (*(model.inputs[i].name for i in controls), *model.state_names)
    usable = np.flatnonzero(np.isfinite(rows).all(axis=0) & (rows.std(axis=0) > 0.0))
    partners_of = {}
    for k in (k for k in usable if k < len(controls)):
        others = np.array([j for j in usable if j != k], int)
        noise = max((f.noise.get(names[k], (0.0, 0.0))[0] for f in flights), default=0.0)
        if partners := _partners(rows[:, k], rows[:, others], noise):
            partners_of[names[k]] = tuple(names[others[j]] for j in partners)
    return partners_of


def _block(flight: FlightData, controls: list[int]) -> Array:
    """(N, controls + states) of a flight, about the mean of each segment."""
    parts = []
    for s in flight.segments:
        rows = np.concatenate([s.u[:, controls], flight.states[s.rows]], axis=1)
        parts.append(rows - rows.mean(axis=0))
    return np.concatenate(parts) if parts else np.zeros((0, 0))


def _partners(control: Array, others: Array, noise: float) -> list[int]:
    """The main columns of `others` of which a control is a linear combination; empty where it moves independently."""
    if not others.shape[1]:
        return []
    scaled = others / others.std(axis=0)
    weights = np.linalg.lstsq(scaled, control, rcond=1e-9)[0]
    unexplained, movement = float(np.std(control - scaled @ weights)), float(np.std(control))
    if unexplained > max(LEAST_INDEPENDENT * movement, LEAST_OVER_NOISE * noise):
        return []
    if unexplained > LEAST_INDEPENDENT * movement and movement <= HARDLY_MOVES * noise:  # reported as not moved
        return []
    size = np.abs(weights)
    return [int(j) for j in np.flatnonzero(size > LEAST_PARTNER * size.max())]


def gearing_text(control: str, partners_of: Mapping[str, tuple[str, ...]]) -> str:
    """Why the derivatives of a control cannot be estimated; empty where it moves independently."""
    if control not in partners_of:
        return ""
    partners = " and ".join(partners_of[control])
    return (
        f"{control} moves only together with {partners} (a combination of them to within its noise or"
        f" {LEAST_INDEPENDENT:.0%}): these flights cannot tell their effects apart; move it by itself"
    )
