"""Whether what a filter takes for gusts follows the controls: then it is something that the model lacks.

Innovations of a right filter have nothing in common with what the controls did before, however rough the air and whoever
steers: they are what could not be foretold. Where a term, a lag or a scale is missing, they repeat at every movement of a
control.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from estimation.estimators.result import Result
from estimation.models.driven import force_states
from estimation.prepare.flight_data import FlightData

Array = NDArray[np.float64]

STEPS = 8  # samples of the past that count: what lacks shows within half a second of a movement
FOLLOWS = 0.08
"""Share of the innovations of one output that past movements of the controls foretell: 0.03 at most in plain and gusty
flights, 0.13 to 0.35 with a late vane, a late rudder or another product of inertia (random aeroplanes, docs/validation.md)."""
CHANCE = 1e-6  # probability of so much by chance


def follows_controls(result: Result, data: Sequence[FlightData]) -> str:
    """A sentence on the output whose innovations follow the controls most; empty where none does beyond FOLLOWS.

    result: of a filter error; data: its flights, prepared for its model.
    """
    from scipy.stats import chi2

    controls = [i for i, s in enumerate(result.model.inputs) if s.control]
    kinematic = set(result.model.state_names) - set(force_states(result.model, result.model.free_names))
    worst, name = 0.0, ""
    for c, output in enumerate(result.model.output_names):
        if output in kinematic or not controls:
            continue
        past, rest = _rows(result, data, controls, c)
        if len(rest) < 4 * past.shape[1] or not rest.any():
            continue
        left = rest - past @ np.linalg.lstsq(past, rest, rcond=1e-9)[0]
        share = 1.0 - float(left @ left) / float(rest @ rest)
        if share > max(worst, FOLLOWS) and chi2.sf(len(rest) * share, past.shape[1]) < CHANCE:
            worst, name = share, output
    if not name:
        return ""
    return (
        f"its process noise is no gusts: what the controls did before foretells {worst:.0%} of its innovations of {name}, where"
        f" in rough air they foretell {FOLLOWS:.0%} at most; the model, a channel or the record of a control lacks something"
    )


def _rows(result: Result, data: Sequence[FlightData], controls: list[int], output: int) -> tuple[Array, Array]:
    """(N, controls STEPS) past movements and (N,) innovations of one output, over all flights."""
    past, rest = [np.zeros((0, len(controls) * STEPS))], [np.zeros(0)]
    for fit, flight in zip(result.flights, data, strict=True):
        for s in flight.segments:
            moved = np.diff(s.u[:, controls], axis=0, prepend=s.u[:1, controls])
            if len(s) <= 2 * STEPS:
                continue
            rows = np.concatenate([moved[STEPS - k : len(s) - k] for k in range(STEPS)], axis=1)
            e = fit.residuals[s.first + STEPS : s.first + len(s), output]
            known = np.isfinite(e)
            past.append(rows[known])
            rest.append(e[known] - e[known].mean() if known.any() else e[known])
    return np.concatenate(past), np.concatenate(rest)
