"""Full fits of the leading hypotheses and what they weigh against each other.

A screen is linear; a delay of 60 ms or a backlash is not. Each leading hypothesis is fitted together with all base
parameters on the training flights. Weights follow from the evidence (Laplace approximation): gain in log-likelihood,
divided by the inflation found on the nulls, the price of an estimate far from its usual size, and the width of the prior
against the bound.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from estimation.engine.kernel import Array
from estimation.gap.dormant import awakened
from estimation.gap.fitting import Fit, Problem, fit
from estimation.gap.screen import Hypothesis, Screen, equivalent_z, extended
from estimation.models.base import Model

IN_SIGHT = 0.15  # of the best gain by linear theory
FIRST_STEPS = 5  # from every start; the better end goes on
ENOUGH = 0.02  # of the log-likelihood: rivals are weighed by whole units of it
PRIOR_WIDTH = 1.5  # typical sizes: standard deviation of the prior of an effect's size


@dataclass(frozen=True)
class Candidate:
    """One fitted hypothesis. gain: twice the log-likelihood gained over the base fit with the same whitening.
    evidence: log evidence relative to the base. why_not: reason for rejection, or empty."""

    hypothesis: Hypothesis
    fit: Fit
    gain: float
    score: float
    evidence: float
    estimates: Mapping[str, tuple[float, float]]
    size: float  # largest distance from no effect, in usual sizes
    why_not: str = ""


def fit_hypothesis(
    problem: Problem, base_fit: Fit, hypothesis: Hypothesis, guess: Mapping[str, float], iterations: int = 12
) -> tuple[Problem, Fit]:
    """Fit base and hypothesis together from `guess`; (problem, fit).

    Delays, lags and plays are also started at their usual size, and the better end is kept: far from no effect the base
    parameters sit elsewhere, and a small step does not find the way.
    """
    starts = [_inside(hypothesis, problem.model, guess)]
    if hypothesis.form.nonlinear:
        usual = {p.name: p.null_value(problem.model) + p.typical for p in hypothesis.form.parameters}
        starts.append(_inside(hypothesis, problem.model, usual))
    done = []
    for start in starts:
        model = awakened(problem.model, hypothesis.form, start)
        trial = replace(problem, model=model)
        locals_ = [extended(local, base_fit.model, model) for local in base_fit.locals]
        first = {**model.starts(), **base_fit.values, **start}
        done.append((trial, fit(trial, first, locals_, iterations=FIRST_STEPS, enough=ENOUGH)))
    trial, best = min(done, key=lambda pair: pair[1].cost if not pair[1].diverged else np.inf)
    if best.converged or best.diverged:
        return trial, best
    return trial, fit(trial, best.values, best.locals, iterations=iterations - FIRST_STEPS, enough=ENOUGH)


def _inside(hypothesis: Hypothesis, model: Model, guess: Mapping[str, float]) -> dict[str, float]:
    """Start values inside the physical range and not exactly at no effect, where one-sided effects have no slope."""
    start = {}
    for p in hypothesis.form.parameters:
        none = p.null_value(model)
        value = guess.get(p.name, none)
        one_sided = p.lower >= none - 0.25 * p.typical
        least = none + 0.3 * p.typical if one_sided else -np.inf
        width = 3.0 * p.typical
        start[p.name] = float(np.clip(max(value, least), max(p.lower, none - width), min(p.upper, none + width)))
    return start


def assess(
    problem: Problem, base_fit: Fit, hypothesis: Hypothesis, found: Fit, inflation: float, own: float | None = None
) -> Candidate:
    """Gain, score, evidence and admissibility of a fitted hypothesis.

    inflation: by which rivals' gains are divided alike for the evidence; own: the hypothesis' own, for its score.
    """
    gain = 2.0 * (base_fit.cost - found.cost) if not found.diverged else 0.0
    std = found.std() if not found.diverged else {}
    evidence = 0.5 * gain / inflation - float(np.log(len(hypothesis.effect.forms)))  # forms share their effect's prior
    estimates: dict[str, tuple[float, float]] = {}
    why_not = "the fit diverges" if found.diverged else ""
    size = 0.0
    for p in hypothesis.form.parameters:
        none = p.null_value(problem.model)
        value, bound = float(found.values[p.name]), float(std.get(p.name, np.inf)) * np.sqrt(inflation)
        estimates[p.name] = (value, bound)
        size = max(size, abs(value - none) / p.typical)
        width = PRIOR_WIDTH * p.typical
        evidence -= (
            0.5 * ((value - none) / width) ** 2 + max(np.log(width / max(bound, 1e-12)), 0.0)
            if np.isfinite(bound)
            else 0.0
        )
        span = p.upper - p.lower
        if not p.lower + 1e-6 * span < value < p.upper - 1e-6 * span:
            at_none = abs(value - none) < 1e-3 * p.typical
            why_not = why_not or (
                f"{p.name} shrinks to nothing" if at_none
                else f"{p.name} = {value:.3g} {p.unit} is outside what is physically possible ({p.lower:g} to {p.upper:g})"
            )  # fmt: skip
    return Candidate(
        hypothesis,
        found,
        gain,
        equivalent_z(gain / (inflation if own is None else own), len(hypothesis.form.parameters)),
        evidence,
        estimates,
        size,
        why_not,
    )


def leading(screen: Screen, gains: Array, count: int, near: float = 0.9) -> list[int]:
    """Indices of the hypotheses worth a full fit: the `count` best by linear score and what is tied to the very best.

    Of those linear in their unknowns, which a full fit hardly changes, only the ones within sight of the best. Plays always: a
    play smaller than the noise of a surface changes nothing, so that a small step says nothing of one of usual size.
    """
    order = [int(h) for h in np.argsort(-gains)]
    least = IN_SIGHT * float(gains[order[0]])
    chosen = [
        h for i, h in enumerate(order[:count]) if i < 4 or screen.hypotheses[h].form.nonlinear or gains[h] > least
    ]
    cosines = np.abs(screen.projected().cosines())
    best = screen.span(order[0])
    for h in order[len(chosen) :]:
        if h not in chosen and cosines[np.ix_(best, screen.span(h))].max() > near:
            chosen.append(h)
    plays = [h for h, hypothesis in enumerate(screen.hypotheses) if hypothesis.form.play and h not in chosen]
    return [*chosen, *plays]


def linear_gains(
    screen: Screen, problem: Problem, column: int | slice = 0, flights: Sequence[int] | None = None
) -> Array:
    """Gains in twice the log-likelihood by linear theory, (hypotheses,) for one residual column, (columns, hypotheses)
    for a slice of them; zero where the sign is physically impossible."""
    projected = screen.projected(flights)
    chosen = column if isinstance(column, slice) else slice(column, column + 1)
    gains = np.zeros((projected.b[:, chosen].shape[1], len(screen.hypotheses)))
    for h in range(len(screen.hypotheses)):
        span = screen.span(h)
        gains[:, h] = projected.gains(span, chosen)
        if len(span) == 1:
            p = screen.columns[span[0]].parameter
            none = p.null_value(problem.model)
            if p.lower >= none - 0.25 * p.typical:
                gains[projected.b[span[0], chosen] < 0, h] = 0.0
    return gains if isinstance(column, slice) else gains[0]


def linear_guess(screen: Screen, problem: Problem, hypothesis: int) -> dict[str, float]:
    """Parameter values of a hypothesis by linear theory."""
    projected = screen.projected()
    span = screen.span(hypothesis)
    B = projected.B[np.ix_(span, span)]
    eta = np.linalg.lstsq(B, projected.b[span, 0], rcond=None)[0]
    return {
        screen.columns[c].parameter.name: screen.columns[c].parameter.null_value(problem.model) + float(e)
        for c, e in zip(span, eta, strict=True)
    }
