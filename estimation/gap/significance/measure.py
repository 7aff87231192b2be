"""The size of the gap: residual over measurement noise on training and held-out flights, against that of nulls; and whether the
training flights repeat each other, each by itself against all together."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.special import ndtri

from estimation.engine.kernel import Array
from estimation.errors import GapError
from estimation.estimators.normal_equations import eliminated, solved
from estimation.gap.answer.result import Gap
from estimation.gap.criteria import Criteria
from estimation.gap.fit.baseline import Baseline
from estimation.gap.fit.fitting import local_prior
from estimation.gap.fit.problem import LikelihoodProblem, ModelFit
from estimation.gap.significance.calibration import Round, significant_above
from estimation.gap.significance.nulls import InputErrors, NullFlyer, Stream
from estimation.gap.significance.tangent import Tangent

PAIR = 2  # flights: which of them is the odd one cannot be known


def rms_over_noise(problem: LikelihoodProblem, model_fit: ModelFit, scatter: Array) -> float:
    """Gap of a fitted model: rms over records, samples and outputs of residual / noise.

    The whitened fit tolerates slow drifts, which gusts cause. For this plain measure the initial states and biases of every
    record are fitted again with plain weights and fixed shared parameters. Nulls are measured in the same way.
    """
    squares, count = 0.0, 0.0
    for i, residual in enumerate(model_fit.residuals):
        finite = np.isfinite(residual)
        part = _plain_squares(problem, model_fit, i, np.nan_to_num(residual)[:, :, None], scatter)
        squares += float(part[0])
        count += float(finite.sum())
    return float(np.sqrt(squares / max(count, 1.0)))


def plain_residuals(problem: LikelihoodProblem, model_fit: ModelFit, index: int, scatter: Array) -> Array:
    """(N, ny) residuals of a record after its initial states and biases were fitted with plain weights."""
    residual = model_fit.residuals[index]
    rows = _plain_rows(problem, model_fit, index, np.nan_to_num(residual)[:, :, None], scatter)
    return np.where(np.isfinite(residual), rows.reshape(residual.shape) * scatter, np.nan)


def _plain_squares(
    problem: LikelihoodProblem, model_fit: ModelFit, index: int, residuals: Array, scatter: Array
) -> Array:
    """(m,) sums of squares over noise of residuals (N, ny, m) after the unknowns of the record alone were fitted to them."""
    return np.sum(_plain_rows(problem, model_fit, index, residuals, scatter) ** 2, axis=0)


def _plain_rows(problem: LikelihoodProblem, model_fit: ModelFit, index: int, residuals: Array, scatter: Array) -> Array:
    """(N ny, m) residuals over noise after the unknowns of the record alone were fitted to them."""
    finite = np.isfinite(problem.coarse[index].z)
    rows = (residuals / scatter[None, :, None] * finite[:, :, None]).reshape(-1, residuals.shape[2])
    linear = problem.linearised(index, {**problem.starts(), **model_fit.values}, model_fit.locals[index])
    if linear is None:  # a motion too sensitive for a better initial state
        return rows
    local_columns = linear[1][:, :, len(problem.free) :] / scatter[None, :, None] * finite[:, :, None]
    J = local_columns.reshape(rows.shape[0], -1)
    weights, _ = local_prior(problem, model_fit.locals[index], J.shape[1])
    return rows - J @ solved(J.T @ J + np.diag(weights), J.T @ rows)


@dataclass(frozen=True)
class HeldOutLikelihood:
    """What the held-out flights say of one model beside another.

    With r the whitened residual of the first and d the change of the prediction by the second: gain, of the likelihood (twice its
    logarithm), 2r'd - d'd where both have one covariance, infinite where one of the motions runs away; predicted: d'd, None where
    one does.
    """

    gain: float
    predicted: float | None

    def confirmed(self, chance: float, criteria: Criteria) -> float | None:
        """Share in 0..1 of the disagreement along d that the second model takes away. None where no more than chance was there.

        It is (r'd)^2/d'd before and ((r - d)'d)^2/d'd after. chance: what noise leaves of either on the average.
        """
        if not np.isfinite(self.gain):
            return 1.0 if self.gain > 0.0 else 0.0
        if self.predicted is None or not self.predicted > 0.0:
            return None
        gain, predicted = self.gain / chance, self.predicted / chance
        before, after = ((gain + sign * predicted) ** 2 / (4.0 * predicted) for sign in (1.0, -1.0))
        if before <= float(ndtri(criteria.null_level)) ** 2:
            return None
        return min(max(1.0 - max(after - 1.0, 0.0) / (before - 1.0), 0.0), 1.0)


def held_out_likelihood(before: Baseline, after: Baseline) -> HeldOutLikelihood | None:
    """Two fitted models on the held-out flights, both with the noise of the second; None without such flights."""
    held_before, held_after = before.on_holdout(after.noise), after.held_out
    if held_before is None or held_after is None:
        return None
    pairs = zip(held_before[1].residuals, held_after[1].residuals, strict=True)
    change = tuple(np.nan_to_num(r - s) for r, s in pairs)
    first, second = (
        _products_given_training(before, held_before, (change,)),
        _products_given_training(after, held_after),
    )
    if first is None or second is None:  # both run away: no gain
        return HeldOutLikelihood(0.0 if first is second else np.inf if first is None else -np.inf, None)
    # gusts act through the model: about each of the two, one noise has another covariance
    determinants = [sum(w.log_determinant for w in problem.whiteners) for problem, _ in (held_before, held_after)]
    gain = first[0, 0] + determinants[0] - second[0, 0] - determinants[1]
    return HeldOutLikelihood(float(gain), float(first[1, 1]))


def _products_given_training(
    baseline: Baseline, held_out: tuple[LikelihoodProblem, ModelFit], further: Sequence[tuple[Array, ...]] = ()
) -> Array | None:
    """Whitened products of the held-out residuals and `further` courses (N, ny) per record, given the training flights; None
    where the motion runs away.

    Parameters may move within their uncertainty from training: otherwise a barely stable motion, which amplifies small errors of
    the parameters, would reject every model.
    """
    problem, model_fit = held_out
    tangent, n = Tangent(problem, model_fit, tuple(further)), len(problem.free)
    try:
        gram = np.sum([tangent.record(i).gram for i in range(len(problem.records))], axis=0)
    except GapError:
        return None
    gram[:n, :n] += baseline.fit.hessian
    return eliminated(gram, n)


@dataclass(frozen=True)
class Floors:
    """The gap of simulated nulls: (nulls,) each; `holdout` is empty without held-out flights."""

    training: Array
    holdout: Array
    criteria: Criteria

    def covers(self, gap: float) -> bool:
        """Whether a training gap is one that nulls have too."""
        return gap <= self.training_highest

    @property
    def training_highest(self) -> float:
        """Upper end of the gap on the training flights with nothing hidden."""
        return float(np.quantile(self.training, self.criteria.null_level))

    @property
    def highest(self) -> float:
        """The same on the held-out flights, on the training flights where there are none."""
        if not self.holdout.size:
            return self.training_highest
        return float(np.quantile(self.holdout, self.criteria.null_level))

    @property
    def training_median(self) -> float:
        return float(np.median(self.training))

    @property
    def holdout_median(self) -> float | None:
        return float(np.median(self.holdout)) if self.holdout.size else None


def gaps(before: Baseline, after: Baseline, floor: Floors, chance: float = 1.0) -> tuple[Gap, Gap | None]:
    """Gap of two fitted models on the training flights, and on the held-out ones where there are any. chance: as in
    `HeldOutLikelihood`."""
    scatter, held, enough = after.scatter, held_out_gaps(before, after), before.criteria.closed_share
    training = Gap(
        rms_over_noise(before.problem, before.fit, scatter),
        rms_over_noise(after.problem, after.fit, scatter),
        floor.training_median,
        floor.training_highest,
        enough,
    )
    if held is None or floor.holdout_median is None:
        return training, None
    held_out = Gap(*held, floor.holdout_median, floor.highest, enough)
    asked = held_out.says_nothing or held_out.grows
    likelihood = held_out_likelihood(before, after) if asked else None
    if likelihood is None:
        return training, held_out
    confirmed = likelihood.confirmed(chance, before.criteria)
    return training, replace(held_out, confirmed=confirmed, gained=likelihood.gain > 0.0)


def held_out_gaps(before: Baseline, after: Baseline) -> tuple[float, float] | None:
    """Gap of two fitted models on the held-out flights; None where there are none."""
    held_before, held_after = before.held_out, after.held_out
    if held_before is None or held_after is None:
        return None
    return rms_over_noise(*held_before, after.scatter), rms_over_noise(*held_after, after.scatter)


def floors(
    round_: Round, held: tuple[LikelihoodProblem, ModelFit] | None, held_errors: Sequence[InputErrors], seed: int
) -> Floors:
    """Gap of the nulls of a round after the same refit, by linear theory about the fitted point."""
    baseline = round_.baseline
    problem, model_fit, scatter = baseline.problem, baseline.fit, baseline.scatter
    n = len(problem.free)
    screen = round_.screen
    G, first, m = screen.total(), n + screen.k + 1, len(round_.null_residuals)
    shift = solved(G[:n, :n], G[:n, first : first + m])  # (n, nulls)
    null_records = [np.stack(nulls, axis=2) for nulls in zip(*round_.null_residuals, strict=True)]
    training = _gaps(problem, model_fit, null_records, shift, scatter)
    if held is None:
        return Floors(training, np.zeros(0), round_.criteria)
    flyer = NullFlyer.build(*held, baseline.noise, held_errors)
    null_records = [
        np.stack(flyer.residuals(i, Stream.HELD_OUT_NULLS, seed, m), axis=2) for i in range(len(held[0].records))
    ]
    return Floors(training, _gaps(*held, null_records, shift, scatter), round_.criteria)


def _gaps(
    problem: LikelihoodProblem, model_fit: ModelFit, null_records: Sequence[Array], shift: Array, scatter: Array
) -> Array:
    """(nulls,) gap of null residuals, per record (N, ny, nulls), after the shared parameters moved by `shift` (n, nulls)."""
    squares = []
    for i, residuals in enumerate(null_records):
        refitted = np.nan_to_num(residuals)
        linear = problem.linearised(i, {**problem.starts(), **model_fit.values}, model_fit.locals[i])
        if linear is not None:
            refitted = refitted - linear[1][:, :, : len(problem.free)] @ shift
        squares.append(_plain_squares(problem, model_fit, i, refitted, scatter))
    count = sum(float(np.isfinite(segment.z).sum()) for segment in problem.coarse)
    return np.asarray(np.sqrt(np.sum(squares, axis=0) / max(count, 1.0)))


@dataclass(frozen=True)
class Repeatability:
    """How much better one flight is fitted by itself than together with the others. chi2: twice the log-likelihood; usual: its
    median on the nulls; limit: above it chi2 is significant (over all flights)."""

    flight: str
    chi2: float
    usual: float
    limit: float

    @property
    def odd(self) -> bool:
        return self.chi2 > self.limit

    def to_json(self) -> dict[str, Any]:
        return {
            "flight": self.flight,
            "chi2": round(self.chi2, 1),
            "usual": round(self.usual, 1),
            "limit": round(self.limit, 1),
            "odd": self.odd,
        }


def repeatability(round_: Round, names: Sequence[str]) -> tuple[Repeatability, ...]:
    """Every training flight against the others, by linear theory about the joint fit; empty for one flight alone.

    One wrong flight pulls the joint fit away from all others, and then no flight repeats it. Where the others repeat each other
    without one flight, they are measured without it, and it alone is odd.
    """
    flights = sorted(set(round_.screen.flights))
    if len(flights) < PAIR:
        return ()
    table = _against_each_other(round_, flights, names)
    if len(flights) > PAIR and all(r.odd for r in table.values()):
        without = {f: _against_each_other(round_, [o for o in flights if o != f], names) for f in flights}
        lone = [f for f, others in without.items() if not any(r.odd for r in others.values())]
        if len(lone) == 1:
            table |= without[lone[0]]
    return tuple(table[f] for f in flights)


def _against_each_other(round_: Round, flights: Sequence[int], names: Sequence[str]) -> dict[int, Repeatability]:
    """Each of these flights by itself against all of them together."""
    screen = round_.screen
    n, first = screen.n, screen.n + screen.k
    pooled = screen.total(flights)
    joint = solved(pooled[:n, :n], pooled[:n, first:])
    chi2 = []
    for flight in flights:
        G = screen.total([flight])  # with the priors: parameters that one flight does not show stay there
        difference = solved(G[:n, :n], G[:n, first:]) - joint
        chi2.append(np.sum(difference * (G[:n, :n] @ difference), axis=0))
    table = np.array(chi2)
    medians, limit = usual_and_limit(table[:, 1:], round_.criteria)
    rows = zip(flights, table[:, 0], medians, limit, strict=True)
    return {f: Repeatability(names[f], float(chi), float(u), float(upper)) for f, chi, u, upper in rows}


def odd_flights(repeats: Sequence[Repeatability]) -> list[str]:
    """The flights that do not repeat the others. Of two flights both: which of them is odd cannot be known."""
    odd = [r.flight for r in repeats if r.odd]
    return [r.flight for r in repeats] if odd and len(repeats) == PAIR else odd


def usual_and_limit(nulls: Array, criteria: Criteria) -> tuple[Array, Array]:
    """(flights,) median of the nulls' chi2 (flights, nulls), and the limit for flights that repeat each other."""
    medians = np.median(nulls, axis=1)
    return medians, medians * significant_above((nulls / medians[:, None]).max(axis=0), criteria)
