"""Normal equations of many flights: shared parameters, parameters local to a flight, initial states of a segment.

The information matrix has an arrow shape; initial states, then local parameters are eliminated (Schur complements), so cost and
memory are linear in flights and segments, and no dense Jacobian of all flights exists. `step_within` solves them inside limits.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.intp]

SINGULAR = 1e-11
"""Eigenvalues of the scaled information matrix below this fraction of the largest are directions the data does not see.

A Gram matrix of some hundred columns and 10^4 rows has rounding errors of about 10^-13 of its largest eigenvalue. A hundred times
that is certainly noise, and a direction so much weaker than another (square root: 3e-6) is of no use.
"""


def _eliminated(
    information: Array, coupling: Array, inverse: Array, gradient: Array, gradient_beside: Array
) -> tuple[Array, Array]:
    """Information (n, n) and gradient (n,) of the remaining unknowns with k others eliminated.

    coupling: (n, k); inverse, gradient_beside: inverse information (k, k) and gradient (k,) of the others.
    """
    lever = coupling @ inverse
    return information - lever @ coupling.T, gradient - lever @ gradient_beside


@dataclass
class SegmentBlocks:
    """Information of one segment about parameters t (n) and its initial states x (free ones): blocks and gradients."""

    tt: Array
    tx: Array
    xx: Array
    gt: Array
    gx: Array
    xx_inverse: Array = field(init=False)

    def __post_init__(self) -> None:
        self.xx_inverse = pseudo_inverse(self.xx)[0] if self.xx.size else self.xx

    def reduced(self) -> tuple[Array, Array]:
        """Information and gradient about the parameters with the initial states eliminated."""
        if not self.xx.size:
            return self.tt, self.gt
        return _eliminated(self.tt, self.tx, self.xx_inverse, self.gt, self.gx)

    def states(self, change: Array) -> Array:
        """Step of the initial states for a step of the parameters."""
        return self.xx_inverse @ (self.gx - self.tx.T @ change)


@dataclass
class FlightBlocks:
    """Information of one flight about the parameters, initial states eliminated, split into shared s and local l."""

    ss: Array
    sl: Array
    ll: Array
    gs: Array
    gl: Array
    ll_inverse: Array = field(init=False)

    def __post_init__(self) -> None:
        self.ll_inverse = pseudo_inverse(self.ll)[0] if self.ll.size else self.ll

    @classmethod
    def split(cls, information: Array, gradient: Array, shared: Index, local: Index) -> "FlightBlocks":
        """From the information and gradient about all parameters, and the places of the shared and local ones."""
        pick = np.ix_
        return cls(
            information[pick(shared, shared)],
            information[pick(shared, local)],
            information[pick(local, local)],
            gradient[shared],
            gradient[local],
        )

    def reduced(self) -> tuple[Array, Array]:
        """Information and gradient about the shared parameters with the local ones eliminated."""
        if not self.ll.size:
            return self.ss, self.gs
        return _eliminated(self.ss, self.sl, self.ll_inverse, self.gs, self.gl)

    def local(self, change: Array) -> Array:
        """Step of the local parameters for a step of the shared ones."""
        return self.ll_inverse @ (self.gl - self.sl.T @ change)


def pseudo_inverse(matrix: Array) -> tuple[Array, Array]:
    """Inverse (n, n) of an information matrix on the directions the data sees, and the others (n, k) in scaled coordinates.

    The matrix is scaled to unit diagonal first, so that units do not matter.
    """
    if matrix.shape[0] == 0:  # all parameters fixed, as in a proof of match
        return np.zeros((0, 0)), np.zeros((0, 0))
    diagonal = np.diag(matrix).copy()
    alive = diagonal > 0.0
    scale = np.where(alive, 1.0 / np.sqrt(np.where(alive, diagonal, 1.0)), 0.0)
    scaled = matrix * scale[:, None] * scale[None, :]
    scaled = 0.5 * (scaled + scaled.T)
    values, vectors = np.linalg.eigh(scaled)
    determined = values > SINGULAR * max(float(values[-1]), 0.0)
    if not determined.any():
        return np.zeros_like(matrix), np.eye(matrix.shape[0])
    inverse = (vectors[:, determined] / values[determined]) @ vectors[:, determined].T
    return inverse * scale[:, None] * scale[None, :], vectors[:, ~determined]


def eliminated(gram: Array, first: int) -> Array:
    """A Gram matrix (n + m, n + m) with its first n columns projected out of the rest: (m, m), the Schur complement."""
    cross = gram[:first, first:]
    return np.asarray(gram[first:, first:] - cross.T @ solved(gram[:first, :first], cross))


def projected_out(gram: Array, first: int) -> Array:
    """`eliminated` with the products grouped the other way, which leaves `gram` as it is for first = 0. Terms tested beside a
    fit are so weakly determined that the grouping changes their eighth figure."""
    if not first:
        return gram
    lever = gram[first:, :first] @ pseudo_inverse(gram[:first, :first])[0]
    return np.asarray(gram[first:, first:] - lever @ gram[:first, first:])


def solved(information: Array, right: Array) -> Array:
    """Solution (n,) or (n, m) of information @ x = right, zero along directions the data does not see."""
    return np.asarray(pseudo_inverse(information)[0] @ right)


INWARD = 1e-9  # of the largest scaled slope: a smaller one is rounding, and frees no unknown from its limit
TURNS = 10  # per unknown; each puts one unknown at its limit or frees one


def step_within(information: Array, gradient: Array, low: Array, high: Array) -> Array:
    """Step (n,) in low <= step <= high at which gradient @ step - 0.5 step @ information @ step is largest.

    information: (n, n) positive semidefinite; the step has no part along directions it does not see. low <= 0 <= high: (n,).
    Primal active set (Nocedal and Wright, Numerical Optimization, 2nd ed., algorithm 16.3), from a step of zero.
    """
    step = np.zeros(gradient.size)
    at_limit = np.zeros(gradient.size, bool)
    size = np.sqrt(np.maximum(np.diag(information), 0.0))
    scale = np.where(size > 0.0, 1.0 / np.where(size > 0.0, size, 1.0), 0.0)
    for _ in range(TURNS * gradient.size):
        free = ~at_limit
        target = step.copy()
        right = gradient[free] - information[np.ix_(free, at_limit)] @ step[at_limit]
        target[free] = solved(information[np.ix_(free, free)], right)
        move = target - step
        with np.errstate(divide="ignore", invalid="ignore"):
            room = np.where(move > 0.0, (high - step) / move, np.where(move < 0.0, (low - step) / move, np.inf))
        room[at_limit] = np.inf
        first = int(np.argmin(room))
        if room[first] < 1.0:
            step = step + max(room[first], 0.0) * move
            step[first] = high[first] if move[first] > 0.0 else low[first]
            at_limit[first] = True
            continue
        step = target
        slope = (gradient - information @ step) * scale  # uphill; a limit is right where this points out of the box
        inward = np.where(at_limit, np.where(step >= high, -slope, slope), -np.inf)
        inward[at_limit & (low == high)] = -np.inf
        steepest = int(np.argmax(inward))
        if inward[steepest] <= INWARD * max(float(np.abs(gradient * scale).max()), 1e-300):
            break
        at_limit[steepest] = False
    return np.clip(step, low, high)
