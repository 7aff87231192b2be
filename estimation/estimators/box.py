"""A Gauss-Newton step inside limits: the least of its quadratic model in a box, not the free step cut off at it.

Cutting off moves along a direction that was right only together with what was cut: the step promises what it cannot give, and
a fit with one unknown at its limit creeps or stops short of the optimum of all the others.
"""

import numpy as np
from numpy.typing import NDArray

from estimation.estimators.arrow import solved

Array = NDArray[np.float64]

INWARD = 1e-9  # of the largest scaled slope: what is less than rounding sends no unknown back from its limit
TURNS = 10  # per unknown; each puts one at its limit or takes one off it


def step_within(information: Array, gradient: Array, low: Array, high: Array) -> Array:
    """Step (n,) in low <= step <= high at which gradient @ step - 0.5 step @ information @ step is largest.

    information: (n, n) symmetric, not negative; directions it does not see are not moved along. low <= 0 <= high: (n,).
    Primal active set (Nocedal and Wright, Numerical Optimization, 2nd ed., algorithm 16.3), started at no step.
    """
    step = np.zeros(gradient.size)
    limit = np.zeros(gradient.size, bool)
    size = np.sqrt(np.maximum(np.diag(information), 0.0))
    scale = np.where(size > 0.0, 1.0 / np.where(size > 0.0, size, 1.0), 0.0)
    for _ in range(TURNS * gradient.size):
        free = ~limit
        target = step.copy()
        right = gradient[free] - information[np.ix_(free, limit)] @ step[limit]
        target[free] = solved(information[np.ix_(free, free)], right)
        move = target - step
        with np.errstate(divide="ignore", invalid="ignore"):
            room = np.where(move > 0.0, (high - step) / move, np.where(move < 0.0, (low - step) / move, np.inf))
        room[limit] = np.inf
        first = int(np.argmin(room))
        if room[first] < 1.0:
            step = step + max(room[first], 0.0) * move
            step[first] = high[first] if move[first] > 0.0 else low[first]
            limit[first] = True
            continue
        step = target
        slope = (gradient - information @ step) * scale  # uphill; a limit is right where this points out of the box
        inward = np.where(limit, np.where(step >= high, -slope, slope), -np.inf)
        inward[limit & (low == high)] = -np.inf
        worst = int(np.argmax(inward))
        if inward[worst] <= INWARD * max(float(np.abs(gradient * scale).max()), 1e-300):
            break
        limit[worst] = False
    return np.clip(step, low, high)
