"""Which hypotheses get a full fit: those whose predicted gain is near what a name needs, and near the best prediction.

For a hypothesis that is linear in its unknowns, linear theory predicts the gain of the full fit. For a delay, a lag or a play it
does not: the effect of a small step says little about that of the usual size. Their changes of the outputs are computed at
several sizes and interpolated linearly; as in linear theory, the part that the base parameters can absorb is projected out.
"""

from collections.abc import Collection
from dataclasses import replace

import numpy as np

from estimation.engine.kernel import Array
from estimation.gap.criteria import Criteria
from estimation.gap.effects.base import Form
from estimation.gap.fit.problem import LikelihoodProblem, ModelFit, changes_by
from estimation.gap.records.candidate_model import awakened
from estimation.gap.significance.calibration import Round
from estimation.gap.significance.screen import Hypothesis, Projected, Screen, gram_of

SIZES = (0.3, 1.0, 3.0)
"""Multiples of the usual size: from what the screen takes for a small step to the farthest from which a fit starts."""
BEYOND = 4.0  # times the last size, up to which its change is extrapolated linearly
HOPELESS = 0.5  # of the gain that a name needs: below this promise a hypothesis is not fitted, a fit given up


def leading(
    screen: Screen, promised: Array, threshold: float, criteria: Criteria, further: Collection[int] = ()
) -> list[int]:
    """Indices of the hypotheses worth a full fit, best first.

    promised: (hypotheses,) from `promise`. threshold: score that a name needs. further: indices to be included in any case.

    Worth a fit is what promises a good part of the gain that a name needs and of the best promise, and what has nearly the
    signature of the best (`Screen.tied`). Unsteady lags of the aerodynamics always are: where the base has taken one up as
    damping, adding it at any size makes the motion oscillate, and its promise says nothing.
    """
    order = [int(h) for h in np.argsort(-promised)]
    first = order[0]
    limit = max(HOPELESS * threshold**2, criteria.in_sight * float(promised[first]))
    tied = screen.tied(first, criteria) if promised[first] >= limit else [False] * len(order)
    worth = [promised[h] >= limit or tied[h] or x.form.lagging or h in further for h, x in enumerate(screen.hypotheses)]
    return [h for h in order if worth[h]]


def promise(round_: Round) -> Array:
    """(hypotheses,) predicted gains of full fits, over inflation. For delays, lags and plays the inflation is at most the median
    of all: theirs is that of a small step, which says little about them."""
    nonlinear = np.array([h.form.nonlinear for h in round_.screen.hypotheses])
    usual = float(np.median(round_.inflation))
    inflation = np.where(nonlinear, np.minimum(round_.inflation, usual), round_.inflation)
    return np.asarray(np.maximum(round_.gains, gains_at_sizes(round_)) / inflation)


def gains_at_sizes(round_: Round) -> Array:
    """(hypotheses,) largest predicted gain over all sizes, of hypotheses that are strongly nonlinear; 0 of the others."""
    problem, model_fit = round_.baseline.problem, round_.baseline.fit
    owner: list[int] = []  # index of the hypothesis to which each change belongs
    changes: list[tuple[Array, ...]] = []
    for h, hypothesis in enumerate(round_.screen.hypotheses):
        at_sizes = changes_at_sizes(problem, model_fit, hypothesis) if strongly_nonlinear(hypothesis.form) else []
        owner += [h] * len(at_sizes)
        changes += at_sizes
    gram = gram_of(round_.tangent, lambda i: [change[i] for change in changes])
    projected, gains = Projected.of(gram, len(problem.free), len(owner)), np.zeros(len(round_.screen.hypotheses))
    for h in set(owner):
        span = [k for k, other in enumerate(owner) if other == h]
        gains[h] = gain_along(projected.B[np.ix_(span, span)], projected.b[span, 0])
    return gains


def strongly_nonlinear(form: Form) -> bool:
    """Whether a form's effect on the outputs departs from that of a small step already below the usual size: of a control that is
    late or has play, and of a form with states of its own. An output that is merely late does not."""
    return bool(form.transforms or form.states)


def changes_at_sizes(
    problem: LikelihoodProblem, model_fit: ModelFit, hypothesis: Hypothesis
) -> list[tuple[Array, ...]]:
    """Per size, per record: (N, ny) what a hypothesis of that size adds to the outputs of the fitted base. Sizes at which the
    motion runs away are left out."""
    trial = replace(problem, model=awakened(problem.model, hypothesis.form))
    changes = []
    for size in SIZES:
        unknowns = {
            p.name: float(np.clip(p.null_value(problem.model) + size * p.typical, p.lower, p.upper))
            for p in hypothesis.form.parameters
        }
        values = {**trial.model.starts(), **model_fit.values, **unknowns}
        if (change := changes_by(trial, model_fit, values)) is not None:
            changes.append(change)
    return changes


def gain_along(information: Array, gradient: Array) -> float:
    """The largest gain on straight lines from no change to that of the first size, to the next, and so on beyond the last.

    information: (sizes, sizes) products of the changes; gradient: (sizes,) their products with the residuals."""
    count, best = len(gradient), 0.0
    corners = np.vstack([np.zeros(count), np.eye(count), BEYOND * np.eye(count)[-1:]])
    for corner, next_corner in zip(corners[:-1], corners[1:], strict=True):
        direction = next_corner - corner
        slope, curvature = direction @ (gradient - information @ corner), direction @ information @ direction
        point = corner + direction * (np.clip(slope / curvature, 0.0, 1.0) if curvature > 0.0 else 0.0)
        best = max(best, float(2.0 * gradient @ point - point @ information @ point))
    return best
