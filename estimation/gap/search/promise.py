"""Which hypotheses get a full fit: those whose gain, by linear theory, can give a name or come near to that of the best.

A hypothesis that is linear in its unknowns gains in a full fit what its score says. A delay, a lag or a play does not: a small
step says nothing of a usual one. What it does to the outputs is worked out at several sizes and taken as straight between them;
the base absorbs of every one what it can.
"""

from collections.abc import Collection
from dataclasses import replace

import numpy as np

from estimation.engine.kernel import Array
from estimation.gap.criteria import Criteria
from estimation.gap.effects.base import Form
from estimation.gap.fit.problem import LikelihoodProblem, ModelFit, carried_local
from estimation.gap.records.candidate_model import awakened
from estimation.gap.significance.calibration import Round
from estimation.gap.significance.screen import Hypothesis, Projected, Screen, gram_of

SIZES = (0.3, 1.0, 3.0)
"""Usual sizes: from what the screen takes for a small step to the farthest from which a fit starts."""
BEYOND = 4.0  # times the last size, to where the way goes on straight
HOPELESS = 0.5  # of the gain that a name needs: a hypothesis that promises less gets no fit, a fit that does is not gone on with


def leading(
    screen: Screen, promised: Array, threshold: float, criteria: Criteria, further: Collection[int] = ()
) -> list[int]:
    """Indices of the hypotheses worth a full fit, best first: those that promise a good part of what a name needs and of what the
    best promises, and with them what is tied to the very best.

    Lags of the air always: about a base that has taken one up as damping, steps of any size set the aircraft swinging.
    promised: (hypotheses,) as of `promise`. threshold: score that a name needs. further: asked too.
    """
    order = [int(h) for h in np.argsort(-promised)]
    first = order[0]
    limit = max(HOPELESS * threshold**2, criteria.in_sight * float(promised[first]))
    tied = screen.tied(first, criteria) if promised[first] >= limit else [False] * len(order)
    asked = [promised[h] >= limit or tied[h] or x.form.lagging or h in further for h, x in enumerate(screen.hypotheses)]
    return [h for h in order if asked[h]]


def promise(round_: Round) -> Array:
    """(hypotheses,) gains, over what the nulls scatter, that full fits promise. The scatter of a small step on the nulls does not
    count against delays, lags and plays, which a small step cannot judge."""
    nonlinear = np.array([h.form.nonlinear for h in round_.screen.hypotheses])
    shared = float(np.median(round_.inflation))
    inflation = np.where(nonlinear, np.minimum(round_.inflation, shared), round_.inflation)
    return np.asarray(np.maximum(round_.gains, gains_at_sizes(round_)) / inflation)


def gains_at_sizes(round_: Round) -> Array:
    """(hypotheses,) twice the log-likelihood that hypotheses which a small step does not tell gain at the size at which they
    gain most; zero of the others."""
    problem, model_fit = round_.baseline.problem, round_.baseline.fit
    asked: list[int] = []
    changes: list[tuple[Array, ...]] = []
    for h, hypothesis in enumerate(round_.screen.hypotheses):
        courses = changes_at_sizes(problem, model_fit, hypothesis) if is_bent(hypothesis.form) else []
        asked += [h] * len(courses)
        changes += courses
    gram = gram_of(round_.tangent, lambda i: [course[i] for course in changes])
    projected, gains = Projected.of(gram, len(problem.free), len(asked)), np.zeros(len(round_.screen.hypotheses))
    for h in set(asked):
        span = [k for k, other in enumerate(asked) if other == h]
        gains[h] = gain_along(projected.B[np.ix_(span, span)], projected.b[span, 0])
    return gains


def is_bent(form: Form) -> bool:
    """Whether what a form does to the outputs bends away from a small step before the usual size: what makes a control late or
    gives it play, or has states of its own. An output that is late does not."""
    return bool(form.transforms or form.states)


def changes_at_sizes(
    problem: LikelihoodProblem, model_fit: ModelFit, hypothesis: Hypothesis
) -> list[tuple[Array, ...]]:
    """Per size, and there per record, (N, ny) what a hypothesis of that size adds to the outputs of the fitted base; sizes with
    which the motion runs away are left out."""
    trial = replace(problem, model=awakened(problem.model, hypothesis.form))
    locals_ = [carried_local(local, model_fit.model, trial.model) for local in model_fit.locals]
    courses = []
    for size in SIZES:
        unknowns = {
            p.name: float(np.clip(p.null_value(problem.model) + size * p.typical, p.lower, p.upper))
            for p in hypothesis.form.parameters
        }
        values = {**trial.model.starts(), **model_fit.values, **unknowns}
        residuals = [trial.residual(i, values, local) for i, local in enumerate(locals_)]
        finite = [r for r in residuals if r is not None]
        if len(finite) == len(residuals):
            courses.append(tuple(np.nan_to_num(a - b) for a, b in zip(model_fit.residuals, finite, strict=True)))
    return courses


def gain_along(information: Array, gradient: Array) -> float:
    """The most that is gained on straight lines from nothing to the first size, on to the next and so forth, and beyond the last.

    information: (sizes, sizes) products of the changes; gradient: (sizes,) their products with the residuals."""
    count, best = len(gradient), 0.0
    corners = np.vstack([np.zeros(count), np.eye(count), BEYOND * np.eye(count)[-1:]])
    for begin, end in zip(corners[:-1], corners[1:], strict=True):
        way = end - begin
        slope, bend = way @ (gradient - information @ begin), way @ information @ way
        point = begin + way * (np.clip(slope / bend, 0.0, 1.0) if bend > 0.0 else 0.0)
        best = max(best, float(2.0 * gradient @ point - point @ information @ point))
    return best
