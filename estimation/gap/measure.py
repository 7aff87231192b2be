"""How large the gap is: residual over measurement noise, on training and held-out flights, against the null floor."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from estimation.engine.kernel import Array
from estimation.gap.baseline import WORK, Baseline, Round, whiteners_for
from estimation.gap.bench import Bench
from estimation.gap.fitting import Fit, Problem, fit
from estimation.gap.nulls import InputErrors, NullFlyer
from estimation.gap.screen import reduce_record
from estimation.gap.whitening import NoiseModel


def rms_over_noise(problem: Problem, found: Fit, scatter: Array) -> float:
    """Gap of a fitted model: rms over records, samples and outputs of residual / noise.

    The whitened fit forgives slow drifts (gusts make them); for this plain measure every record's initial states and
    biases are fitted once more with plain weights, the shared parameters held. Nulls are measured the same way.
    """
    squares, count = 0.0, 0.0
    for i, residual in enumerate(found.residuals):
        finite = np.isfinite(residual)
        part = _plainly(problem, found, i, np.nan_to_num(residual)[:, :, None], scatter)
        squares += float(part[0])
        count += float(finite.sum())
    return float(np.sqrt(squares / max(count, 1.0)))


def plain_residuals(problem: Problem, found: Fit, index: int, scatter: Array) -> Array:
    """(N, ny) residuals of a record after its initial states and biases were fitted with plain weights."""
    residual = found.residuals[index]
    rows = _plain_rows(problem, found, index, np.nan_to_num(residual)[:, :, None], scatter)
    return np.where(np.isfinite(residual), rows.reshape(residual.shape) * scatter, np.nan)


def _plainly(problem: Problem, found: Fit, index: int, residuals: Array, scatter: Array) -> Array:
    """(m,) sums of squares over noise of residuals (N, ny, m) after the record's own unknowns were fitted to them."""
    return np.sum(_plain_rows(problem, found, index, residuals, scatter) ** 2, axis=0)


def _plain_rows(problem: Problem, found: Fit, index: int, residuals: Array, scatter: Array) -> Array:
    """(N ny, m) residuals over noise after the record's own unknowns were fitted to them."""
    linear = problem.linearised(index, {**problem.starts(), **found.values}, found.locals[index])
    assert linear is not None, "a converged fit can be linearised"
    finite = np.isfinite(problem.coarse[index].z)
    own = linear[1][:, :, len(problem.free) :] / scatter[None, :, None] * finite[:, :, None]
    rows = (residuals / scatter[None, :, None] * finite[:, :, None]).reshape(-1, residuals.shape[2])
    J = own.reshape(rows.shape[0], -1)
    weights = np.zeros(J.shape[1])
    for j, name in enumerate(problem.local_names):
        believed = problem.prior(name)
        weights[j] = 0.0 if believed is None else 1.0 / believed[1] ** 2
    scale = 1.0 / np.sqrt(np.maximum(np.sum(J**2, axis=0) + weights, 1e-300))
    A = (J.T @ J + np.diag(weights)) * scale[:, None] * scale[None, :] + 1e-10 * np.eye(J.shape[1])
    step = scale[:, None] * np.linalg.solve(A, scale[:, None] * (J.T @ rows))
    return rows - J @ step


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


def predictive_cost(baseline: Baseline, bench: Bench, noise: NoiseModel) -> float | None:
    """Whitened cost of the held-out flights given the training flights.

    Parameters may move within what training left uncertain: without that a barely stable motion, which multiplies small
    errors of the parameters, would condemn every model. None where there is no held-out flight.
    """
    held = on_holdout(baseline, bench, noise)
    if held is None:
        return None
    problem, found = held
    grams = [reduce_record(problem, found, i, (), ()).gram for i in range(len(problem.records))]
    gram = np.sum(grams, axis=0)
    n = len(problem.free)
    information = gram[:n, :n] + baseline.fit.hessian
    step = np.linalg.pinv(information, hermitian=True, rcond=1e-13) @ gram[:n, n]
    return 0.5 * float(gram[n, n] - gram[n, :n] @ step)


@dataclass(frozen=True)
class Floors:
    """What the gap measures on simulated nulls: (nulls,) each; `holdout` empty without held-out flights."""

    training: Array
    holdout: Array

    def covers(self, gap: float) -> bool:
        """Whether a training gap is one that nothing hidden would leave, 19 times in 20."""
        return gap <= float(np.quantile(self.training, 0.975))

    @property
    def training_median(self) -> float:
        return float(np.median(self.training))

    @property
    def holdout_median(self) -> float | None:
        return float(np.median(self.holdout)) if self.holdout.size else None


def floors(round_: Round, held: tuple[Problem, Fit] | None, held_errors: Sequence[InputErrors], seed: int) -> Floors:
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
    linear = problem.linearised(index, {**problem.starts(), **found.values}, found.locals[index])
    assert linear is not None, "a converged fit can be linearised"
    moved = np.nan_to_num(residuals) - np.einsum("tyn,nm->tym", linear[1][:, :, : len(problem.free)], shift)
    return _plainly(problem, found, index, moved, scatter), float(np.isfinite(problem.coarse[index].z).sum())
