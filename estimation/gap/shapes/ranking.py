"""Which coefficient as a function of which variable would explain what is left, by linear theory, against simulated nulls."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

from estimation.engine.kernel import Array
from estimation.estimators.arrow import solved
from estimation.gap.criteria import Criteria
from estimation.gap.shapes.places import ModelMotion, Place, spread_of
from estimation.gap.significance.calibration import Round, upper_quantile
from estimation.gap.significance.screen import Projected, gram_of

NOTHING = 1e-300


Asked = TypeVar("Asked")  # what is ranked: places of a spline, of a lag, oscillators


@dataclass(frozen=True)
class Ranked(Generic[Asked]):
    """Places by what is gained there. gains: (places,) twice the log-likelihood with the penalty counted; scores: (places,)
    root of the gain over its median on the nulls; usual: (places,) that median; threshold: family-wise, from the largest score
    of every null."""

    places: tuple[Asked, ...]
    gains: Array
    scores: Array
    usual: Array
    threshold: float

    @property
    def order(self) -> list[int]:
        """Indices of the places whose score passes the threshold, largest gain first."""
        return [int(i) for i in np.argsort(-self.gains) if self.scores[i] > self.threshold]

    @property
    def best_gain(self) -> float:
        """Largest gain of a place that passes the threshold, less what so many unknowns gain there with nothing hidden; 0 where
        none passes."""
        return float((self.gains - self.usual)[self.order].max()) if self.order else 0.0


def rank(flown: ModelMotion, round_: Round, places: Sequence[Place]) -> Ranked[Place]:
    """Score every place on the residuals of a round's baseline and on its nulls."""
    problem, criteria = flown.problem, round_.criteria
    usable = [p for p in places if flown.moves(p.variable) and flown.scale[p.line] > 0.0]
    spans: list[range] = []
    asks: list[list[tuple[str, Array]]] = [[] for _ in problem.records]
    weights: list[Array] = []
    for place in usable:
        spread = spread_of(place, flown.scale[place.line], criteria)
        limits = flown.range_of(place.variable)
        begin = len(asks[0])
        for i, record_asks in enumerate(asks):
            record_asks += [(place.line, course) for course in flown.columns(place, i, limits).T]
        spans.append(range(begin, len(asks[0])))
        weights.append(1.0 / spread**2)
    gram = gram_of(round_.tangent, lambda i: flown.changes(i, asks[i]))
    projected = Projected.of(gram, len(problem.free), len(asks[0]))
    gains = np.array([penalised(projected, span, w) for span, w in zip(spans, weights, strict=True)])
    return ranked(usable, gains, criteria)


def penalised(projected: Projected, span: Sequence[int], weight: Array) -> Array:
    """(residual columns,) twice the log-likelihood that columns gain under a Gaussian prior of precision `weight`."""
    index = list(span)
    b = projected.b[index]
    return np.asarray(np.sum(b * solved(projected.B[np.ix_(index, index)] + np.diag(weight), b), axis=0))


def ranked(places: Sequence[Asked], gains: Array, criteria: Criteria) -> Ranked[Asked]:
    """gains: (places, 1 + nulls). The threshold is raised like that of a name."""
    if not places:
        return Ranked((), np.zeros(0), np.zeros(0), np.zeros(0), 0.0)
    medians = np.maximum(np.median(gains[:, 1:], axis=1), NOTHING)  # a mean is made by the few nulls that run away
    scores = np.sqrt(gains / medians[:, None])
    limit = criteria.null_margin * upper_quantile(scores[:, 1:].max(axis=0), criteria.null_level)
    return Ranked(tuple(places), gains[:, 0], scores[:, 0], medians, limit)
