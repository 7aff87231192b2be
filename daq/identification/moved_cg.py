"""Conversion of measured motion to a centre of gravity that has moved along the body.

Calibrated columns are those at the CG of the aircraft file. With the true CG d ahead of it, that point is at r = (-d, 0, 0) from
the CG; relative to the CG it moves with omega x r and accelerates with omega_dot x r + omega x (omega x r).
"""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def at_moved_cg(columns: Mapping[str, Array], time: Array, ahead: Array) -> dict[str, Array]:
    """The available ones of `ax ay az alpha beta` [m/s2, rad] at a CG that is `ahead` [m] of the stated one; arrays over `time`
    [s]. Rates that are not measured count as zero."""
    still = np.zeros(time.size)
    p, q, r = (np.nan_to_num(columns.get(name, still)) for name in ("p", "q", "r"))
    q_dot, r_dot = (np.gradient(rate, time) if time.size > 1 else still for rate in (q, r))
    with np.errstate(divide="ignore", invalid="ignore"):
        per_speed = np.where(columns.get("V", still) > 0.0, ahead / columns.get("V", still), 0.0)
    differences = {
        "ax": -ahead * (q**2 + r**2),
        "ay": ahead * (r_dot + p * q),
        "az": -ahead * (q_dot - p * r),
        "alpha": -per_speed * q,
        "beta": per_speed * r,
    }
    return {name: columns[name] + change for name, change in differences.items() if name in columns}
