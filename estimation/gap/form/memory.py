"""Where no function of the motion explains what is left: would a coefficient that follows its variable late?"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from estimation.engine.kernel import Array
from estimation.gap.form.places import ModelMotion, Place
from estimation.gap.form.screen import ranked
from estimation.gap.tests_of_fit.calibration import Round
from estimation.gap.tests_of_fit.screen import Projected, gram_of

TIMES = (0.05, 0.1, 0.2, 0.5, 1.0)  # s, each twice the one before or so: signatures of neighbours are much alike


@dataclass(frozen=True)
class Memory:
    """A coefficient that follows a variable with a lag. gain: twice the log-likelihood by linear theory."""

    place: Place
    time: float
    gain: float
    score: float
    threshold: float

    @property
    def words(self) -> str:
        return f"{self.place.line} follows {self.place.variable} some {self.time:g} s late"


def late(course: Array, time: Array, memory: float) -> Array:
    """(N,) how far a first-order lag [s] of a course (N,) is behind it, begun at rest."""
    keep = float(np.exp(-np.median(np.diff(time)) / memory))
    follower, _ = lfilter([1.0 - keep], [1.0, -keep], course, zi=[keep * course[0]])
    return np.asarray(follower - course)


def find_memory(flown: ModelMotion, round_: Round, places: Sequence[Place]) -> Memory | None:
    """The place and time constant that gain most by linear theory, where they stand out of the nulls."""
    asked = [(p, t) for p in places if flown.moves(p.variable) and flown.scale[p.line] > 0.0 for t in TIMES]

    def changes(i: int) -> Iterator[Array]:
        courses, time = flown.courses[i], flown.segments[i].time
        lags = [(p.line, late(courses[p.variable], time, t) / flown.reach(p.variable)) for p, t in asked]
        return flown.changes(i, lags)

    gram = gram_of(round_.tangent, changes)
    gains = Projected.of(gram, len(flown.problem.free), len(asked)).scores() ** 2
    result = ranked([p for p, _ in asked], gains, round_.criteria)
    if not result.order:
        return None
    best = result.order[0]
    return Memory(*asked[best], float(result.gains[best]), float(result.scores[best]), result.threshold)
