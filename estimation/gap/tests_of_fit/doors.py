"""What a small disturbance let in through a door of the model (an input of a force or moment equation) does to the outputs."""

from collections.abc import Callable, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from estimation.engine.kernel import Array
from estimation.gap.likelihood.fitting import LikelihoodProblem, ModelFit
from estimation.gap.records.candidate_model import DISTURBANCE

AT_ONCE = 60  # disturbances in one run: the arrays of some hundred would fill a small machine
RUNAWAY = 1e9  # a change that grows so far is no small one any more


def is_door(name: str) -> bool:
    """Whether an input is one through which a force equation can be disturbed."""
    return name.startswith(DISTURBANCE.format(""))


def through_doors(
    problem: LikelihoodProblem, found: ModelFit, index: int, asks: Sequence[tuple[str, Array]]
) -> Iterator[Array]:
    """(N, ny) changes of the outputs of one record, by unit of each of `asks`: a door and the course (N,) through it.

    Nothing where they run away or nothing was measured.
    """
    return responses(
        lambda du: problem.disturbed(index, found.values, found.locals[index], du),
        problem.model.input_names,
        asks,
        ~np.isfinite(found.residuals[index]),
    )


def responses(
    respond: Callable[[Array], Array | None],
    inputs: Sequence[str],
    asks: Sequence[tuple[str, Array]],
    unmeasured: NDArray[np.bool_],
) -> Iterator[Array]:
    """(N, ny) changes of the outputs by each of `asks`: an input and its course (M,), so many at once as a small machine holds.

    respond: small changes (M, inputs, k) of the inputs -> (N, ny, k) of the outputs, None where the motion runs away. Nothing
    where a change runs away, or where `unmeasured` (N, ny).
    """
    for first in range(0, len(asks), AT_ONCE):
        some = asks[first : first + AT_ONCE]
        du = np.zeros((len(some[0][1]), len(inputs), len(some)))
        for k, (name, course) in enumerate(some):
            du[:, inputs.index(name), k] = course
        changes = respond(du)
        if changes is None:
            changes = np.zeros((*unmeasured.shape, len(some)))
        changes[unmeasured] = 0.0
        for k in range(len(some)):
            alive = np.abs(changes[:, :, k]).max() < RUNAWAY
            yield changes[:, :, k] if alive else np.zeros(unmeasured.shape)
