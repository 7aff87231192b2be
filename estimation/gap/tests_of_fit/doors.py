"""What a small disturbance let in through a door of the model (an input of a force or moment equation) does to the outputs."""

from collections.abc import Iterator, Sequence

import numpy as np

from estimation.engine.kernel import Array
from estimation.gap.likelihood.fitting import Fit, Problem
from estimation.gap.records.candidate_model import DISTURBANCE

AT_ONCE = 60  # disturbances in one run: the arrays of some hundred would fill a small machine
RUNAWAY = 1e9  # a change that grows so far is no small one any more


def is_door(name: str) -> bool:
    """Whether an input is one through which a force equation can be disturbed."""
    return name.startswith(DISTURBANCE.format(""))


def through_doors(problem: Problem, found: Fit, index: int, asks: Sequence[tuple[str, Array]]) -> Iterator[Array]:
    """(N, ny) changes of the outputs of one record, by unit of each of `asks`: a door and the course (N,) through it.

    Nothing where they run away or nothing was measured.
    """
    inputs, unmeasured = problem.model.input_names, ~np.isfinite(found.residuals[index])
    for first in range(0, len(asks), AT_ONCE):
        some = asks[first : first + AT_ONCE]
        du = np.zeros((len(unmeasured), len(inputs), len(some)))
        for k, (door, course) in enumerate(some):
            du[:, inputs.index(door), k] = course
        changes = problem.disturbed(index, found.values, found.locals[index], du)
        if changes is None:
            changes = np.zeros((*unmeasured.shape, len(some)))
        changes[unmeasured] = 0.0
        for k in range(len(some)):
            alive = np.abs(changes[:, :, k]).max() < RUNAWAY
            yield changes[:, :, k] if alive else np.zeros(unmeasured.shape)
