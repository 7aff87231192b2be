"""How large the gap is: residual over measurement noise, on training and held-out flights, against the null floor."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from estimation.engine.kernel import Array
from estimation.gap.baseline import WORK, Baseline, Round, whiteners_for
from estimation.gap.bench import Bench
from estimation.gap.fitting import Fit, Problem, fit
from estimation.gap.nulls import InputErrors, NullFlyer
from estimation.gap.whitening import NoiseModel


def rms_over_noise(residuals: Sequence[Array], scatter: Array) -> float:
    """rms over records, samples and outputs of residual / noise. residuals: (N, ny) each, NaN not counted."""
    squares = np.concatenate([((r / scatter) ** 2).ravel() for r in residuals])
    return float(np.sqrt(np.nanmean(squares)))


def on_holdout(baseline: Baseline, bench: Bench, noise: NoiseModel | None = None) -> tuple[Problem, Fit] | None:
    """The fitted model on the held-out flights: parameters frozen, initial states and biases fitted.

    None where there is no held-out flight.
    """
    records = bench.of(bench.holdout)
    if not records:
        return None
    model = baseline.model
    values = {**model.starts(), **baseline.fit.values}
    _, whiteners = whiteners_for(model, bench.base, records, values, noise or baseline.noise, (), baseline.scatter)
    problem = Problem(model, bench.base, records, whiteners, WORK)
    return problem, fit(problem, values, frozen=True)


@dataclass(frozen=True)
class Floors:
    """What the gap measures on simulated nulls: (nulls,) each; `holdout` empty without held-out flights."""

    training: Array
    holdout: Array

    @property
    def training_median(self) -> float:
        return float(np.median(self.training))

    @property
    def holdout_median(self) -> float | None:
        return float(np.median(self.holdout)) if self.holdout.size else None


def floors(
    round_: Round, held: tuple[Problem, Fit] | None, held_errors: Sequence[InputErrors], seed: int
) -> Floors:
    """Gap of the nulls of a round after the same refit, by linear theory about the fitted point."""
    baseline = round_.baseline
    problem, found, scatter = baseline.problem, baseline.fit, baseline.scatter
    n = len(problem.free)
    screen = round_.screen
    G = screen.total()
    k, m = screen.k, len(round_.null_residuals)
    shift = np.linalg.pinv(G[:n, :n], hermitian=True, rcond=1e-12) @ G[:n, n + k + 1 : n + k + 1 + m]  # (n, nulls)
    squares, count = np.zeros(m), 0.0
    for i in range(len(problem.records)):
        residuals = np.stack([null[i] for null in round_.null_residuals], axis=2)
        part, used = _after_refit(problem, found, i, residuals, shift, scatter)
        squares += part
        count += used
    training = np.sqrt(squares / max(count, 1.0))
    if held is None:
        return Floors(training, np.zeros(0))
    held_problem, held_fit = held
    flyer = NullFlyer.build(held_problem, held_fit, baseline.noise, held_errors)
    squares, count = np.zeros(m), 0.0
    for i in range(len(held_problem.records)):
        flown = [flyer.fly(i, np.random.default_rng([seed, 32452843, i, number])) for number in range(m)]
        good = [j for j, r in enumerate(flown) if r is not None]
        residuals = np.full((*held_problem.coarse[i].z.shape, m), np.nan)
        for j in good:
            residuals[:, :, j] = flown[j]
        part, used = _after_refit(held_problem, held_fit, i, residuals, shift, scatter)
        squares += part
        count += used
    return Floors(training, np.sqrt(squares / max(count, 1.0)))


def _after_refit(
    problem: Problem, found: Fit, index: int, residuals: Array, shift: Array, scatter: Array
) -> tuple[Array, float]:
    """(nulls,) sums of squares over noise of null residuals (N, ny, nulls) after the shared parameters moved by `shift`
    (n, nulls) and the record's own unknowns were fitted; and the number of values in each sum."""
    values = {**problem.starts(), **found.values}
    linear = problem.linearised(index, values, found.locals[index])
    assert linear is not None, "a converged fit can be linearised"
    _, dy = linear
    n = len(problem.free)
    moved = np.nan_to_num(residuals) - np.einsum("tyn,nm->tym", dy[:, :, :n], shift)
    rows = problem.whiteners[index].rows(np.concatenate([dy[:, :, n:], moved], axis=2))
    own = dy.shape[2] - n
    weights = np.zeros(own)
    for j, name in enumerate(problem.local_names):
        believed = problem.prior(name)
        weights[j] = 0.0 if believed is None else 1.0 / believed[1] ** 2
    A = rows[:, :own].T @ rows[:, :own] + np.diag(weights)
    local = np.linalg.pinv(A, hermitian=True) @ (rows[:, :own].T @ rows[:, own:])
    left = moved - np.einsum("tyl,lm->tym", dy[:, :, n:], local)
    finite = np.isfinite(problem.coarse[index].z)
    left = (left / scatter[None, :, None]) ** 2
    return np.sum(left * finite[:, :, None], axis=(0, 1)), float(finite.sum())
