"""Which joint of a Gazebo model is which surface, by where its trailing edge goes and what it does."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from estimation.simulation.autopilot.gazebo_equations import Hinged
from estimation.simulation.oracle import Array, SimulationError

UPRIGHT = 0.5  # share of an axis across from which a surface counts as lying flat, or standing up
CENTRE = 1e-3  # m beside the plane of symmetry
Read = tuple[str, dict[str, float], tuple[Array, float]]
"""Joint, numbers per degree, axis and place to the left [m]."""


def hinged(read: Sequence[Read], path: Path) -> tuple[tuple[Hinged, ...], list[str]]:
    """Surfaces with what our deflections turn each joint by, and notes of those that stand still.

    A trailing edge lies behind its hinge: turning by the axis a moves it up by a_y and to port by -a_z. Flat surfaces in the
    plane of symmetry are elevators; beside it those that roll more than they pitch are ailerons, the others elevators, or, where
    none is left to be one, all are both.
    """
    surfaces, notes = [], []
    flat = [(name, values, axis, left) for name, values, (axis, left) in read if abs(axis[1]) > UPRIGHT]
    elevators = [name for name, values, _, left in flat if abs(left) < CENTRE or not _rolls(values)]
    for name, values, (axis, left) in read:
        up, port = float(axis[1]), float(-axis[2])
        if abs(up) > UPRIGHT:
            side = -np.sign(left) if abs(left) >= CENTRE else 0.0  # +1 on the right, whose edge goes down with delta_a
            both = not elevators and side != 0.0
            moves = {"delta_e": -1.0 / up} if name in elevators or both else {}
            if side != 0.0 and (name not in elevators or both):
                moves["delta_a"] = -float(side) / up
        elif abs(port) > UPRIGHT:
            moves = {"delta_r": 1.0 / port}
        else:
            moves = {}
            notes.append(f"{path.name}: joint {name} turns about neither y nor z: held at zero")
        surfaces.append(Hinged(name, values, moves))
    if not any(s.moves for s in surfaces) and surfaces:
        raise SimulationError(f"{path}: none of its control surfaces turns about y or z, so none is known")
    told = [f"{s.joint} by {', '.join(s.moves)}" for s in surfaces if s.moves]
    if told:
        notes.append(f"{path.name}: surfaces move {'; '.join(told)}")
    return tuple(surfaces), notes


def _rolls(values: dict[str, float]) -> bool:
    return abs(values["Cell_ctrl"]) > abs(values["Cem_ctrl"])
