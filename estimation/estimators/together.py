"""Controls that only move together with others, or with the motion: no data can tell their derivatives apart, however many
flights."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from estimation.models.base import Model
from estimation.prepare.flight_data import FlightData

Array = NDArray[np.float64]

ALONE = 0.02
"""Share of a control's movement that other controls and the motion must leave unexplained: less is a gearing, an interconnect
or a damper, and its derivatives would be told by the noise of two recordings of one movement."""
HEARD = 1.0  # times its noise, which de-noising halves: what is left over of a control must be more
NAMED = 0.05  # of the explained movement from which a companion is named


def moving_together(model: Model, flights: list[FlightData]) -> dict[str, tuple[str, ...]]:
    """Control -> the controls and states that it follows exactly, over all flights together; only those that do."""
    controls = [i for i, s in enumerate(model.inputs) if s.control]
    blocks = [_block(f, controls) for f in flights]
    if len(controls) < 1 or not any(len(b) for b in blocks):
        return {}
    rows = np.concatenate([b for b in blocks if len(b)])
    names = (*(model.inputs[i].name for i in controls), *model.state_names)
    usable = np.flatnonzero(np.isfinite(rows).all(axis=0) & (rows.std(axis=0) > 0.0))
    partners_of = {}
    for k in (k for k in usable if k < len(controls)):
        rest = np.array([j for j in usable if j != k], int)
        noise = max((f.noise.get(names[k], (0.0, 0.0))[0] for f in flights), default=0.0)
        if partners := _followed(rows[:, k], rows[:, rest], noise):
            partners_of[names[k]] = tuple(names[rest[j]] for j in partners)
    return partners_of


def _block(flight: FlightData, controls: list[int]) -> Array:
    """(N, controls + states) of a flight, each segment about its mean."""
    parts = []
    for s in flight.segments:
        rows = np.concatenate([s.u[:, controls], flight.states[s.rows]], axis=1)
        parts.append(rows - rows.mean(axis=0))
    return np.concatenate(parts) if parts else np.zeros((0, 0))


def _followed(control: Array, rest: Array, noise: float) -> list[int]:
    """Columns of `rest` that a control is made of, the main ones; empty where it moves by itself."""
    if not rest.shape[1]:
        return []
    scaled = rest / rest.std(axis=0)
    weights = np.linalg.lstsq(scaled, control, rcond=1e-9)[0]
    unexplained, movement = float(np.std(control - scaled @ weights)), float(np.std(control))
    if unexplained > max(ALONE * movement, HEARD * noise):
        return []
    if unexplained > ALONE * movement and movement <= 3.0 * noise:  # it hardly moves at all, which is said elsewhere
        return []
    size = np.abs(weights)
    return [int(j) for j in np.flatnonzero(size > NAMED * size.max())]


def text_of(control: str, partners_of: Mapping[str, tuple[str, ...]]) -> str:
    """Why derivatives by a control cannot be told; empty where it moves by itself."""
    if control not in partners_of:
        return ""
    partners = " and ".join(partners_of[control])
    return (
        f"{control} moves only together with {partners} (a combination of them to within its noise or {ALONE:.0%}): these flights"
        " cannot tell their effects apart; move it by itself"
    )
