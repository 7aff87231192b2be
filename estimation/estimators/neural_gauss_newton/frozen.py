"""Gauss-Newton over the aerodynamic parameters with the network frozen.

The coefficients among the network's inputs are those of the aerodynamic model; the one-step prediction error, weighted by R^-1
with R from the residuals (relaxation), is minimised. The Jacobian is exact: network by its inputs (autograd) times coefficients
by parameters. This runs on the CPU: 64 fits of a flight take half a second.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from estimation.estimators.gauss_newton import halve_until
from estimation.estimators.neural_gauss_newton.axes import Axis
from estimation.estimators.neural_gauss_newton.network import NetworkShape, input_slopes
from estimation.estimators.neural_gauss_newton.samples import SampleStretch

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Standard:
    """Means and standard deviations with which inputs u and outputs z are standardised."""

    u_mean: Array
    u_std: Array
    z_mean: Array
    z_std: Array

    @classmethod
    def build(cls, stretches: Sequence[SampleStretch]) -> "Standard":
        """From all rows; a constant column keeps its unit."""
        u, z = np.vstack([s.u for s in stretches]), np.vstack([s.z for s in stretches])
        deviations = [np.where(v.std(axis=0) > 1e-12, v.std(axis=0), 1.0) for v in (u, z)]
        return cls(u.mean(axis=0), deviations[0], z.mean(axis=0), deviations[1])

    def u(self, values: Array) -> Array:
        """Standardised inputs."""
        return (values - self.u_mean) / self.u_std

    def z(self, values: Array) -> Array:
        """Standardised outputs."""
        return (values - self.z_mean) / self.z_std


@dataclass(frozen=True)
class FrozenFit:
    """theta: (n,); information: (n, n); R: (out,) variance of the standardised residuals; residuals: (M, out) of each stretch."""

    theta: Array
    information: Array
    R: Array
    residuals: tuple[Array, ...]
    iterations: int
    converged: bool


class Regressors:
    """The model's coefficients in one stretch, as functions of the parameters.

    Where they are linear, their slopes are computed once, for all networks and steps.
    """

    def __init__(self, axis: Axis, stretch: SampleStretch, signals: dict[str, Array]) -> None:
        self.axis, self.stretch, self.signals = axis, stretch, signals
        self.slopes = self._evaluate(np.zeros(len(axis.parameters)))[1] if axis.linear else None

    def _evaluate(self, theta: Array) -> tuple[Array, Array]:
        return self.stretch.model_coefficients(self.axis, theta, self.signals)

    def __call__(self, theta: Array) -> tuple[Array, Array]:
        """(M, 3) coefficients and their derivative (M, 3, axis parameters)."""
        return self._evaluate(theta) if self.slopes is None else (self.slopes @ theta, self.slopes)


@dataclass(frozen=True)
class Frozen:
    """A trained network with its scaling."""

    shape: NetworkShape
    weights: torch.Tensor
    standard: Standard

    def residual_and_slope(self, stretch: SampleStretch, regressors: Regressors, theta: Array) -> tuple[Array, Array]:
        """Standardised residuals (M, out) and prediction slopes (M, out, n) with the model's coefficients."""
        coefficients, d_theta = regressors(theta)
        m = stretch.u.shape[1] - coefficients.shape[1]  # inputs that are motion
        u = torch.as_tensor(self.standard.u(np.column_stack([stretch.u[:, :m], coefficients])))
        outputs, d_u = input_slopes(self.shape, self.weights, u)
        slopes = (d_u[:, :, m:].numpy() / self.standard.u_std[m:]) @ d_theta
        return self.standard.z(stretch.z) - outputs.numpy(), slopes


Predict = Callable[[Array], tuple[list[Array], list[Array]]]
"""theta -> standardised residuals (M, out) and prediction slopes (M, out, n) of every stretch."""
Evaluation = tuple[list[Array], list[Array], Array, float]
"""Residuals and slopes of every stretch at one theta, R (out,) and the cost."""
HALVINGS = 11  # of a step, down to a thousandth
ROUNDING = 1e-9  # of the cost: a step may raise it by so much
SETTLED = 1e-4  # squared length of a step in units of the Cramer-Rao bound: a hundredth of it
RCOND = 1e-13  # of normal equations: directions with smaller singular values are not moved along


def fit_parameters(
    predict: Predict,
    rows: Sequence[int],
    starts: Sequence[Array],
    *,
    multiplicity: Sequence[Array] | None = None,
    iterations: int = 40,
) -> FrozenFit:
    """Minimise the prediction error over theta from the best of `starts`, with step halving, until a step has settled.

    predict: residuals and slopes of every stretch; rows: number in each stretch; multiplicity: weight of each row.
    """
    counts = [np.ones(n) for n in rows] if multiplicity is None else list(multiplicity)
    total = sum(float(c.sum()) for c in counts)

    def evaluate(theta: Array) -> Evaluation:
        residuals, slopes = predict(theta)
        R = residual_variance(residuals, counts)
        return residuals, slopes, R, 0.5 * total * float(np.log(R).sum())

    def evaluate_along(theta: Array, step: NDArray[np.floating[Any]], fraction: float) -> Evaluation:
        return evaluate(theta + fraction * step)

    def not_above(limit: float, evaluation: Evaluation) -> bool:
        return not evaluation[3] > limit

    theta, (residuals, slopes, R, cost) = min(((t, evaluate(t)) for t in starts), key=lambda candidate: candidate[1][3])
    converged, count = False, 0
    for _ in range(iterations):
        count += 1
        information, gradient = normal_equations(slopes, slopes, residuals, counts, R)
        step = np.linalg.lstsq(information, gradient, rcond=RCOND)[0]
        converged = step_settled(step, information)
        limit = cost + ROUNDING * abs(cost)
        accepted = halve_until(partial(evaluate_along, theta, step), partial(not_above, limit), HALVINGS)
        if accepted is None:
            break
        theta = theta + accepted[0] * step
        residuals, slopes, R, cost = accepted[1]
        if converged:
            break
    information, _ = normal_equations(slopes, slopes, residuals, counts, R)
    return FrozenFit(theta, information, R, tuple(residuals), count, converged)


def fit_with_instruments(
    predict: Predict,
    instrument: Predict,
    rows: Sequence[int],
    start: Array,
    *,
    multiplicity: Sequence[Array] | None = None,
    iterations: int = 40,
) -> FrozenFit:
    """Root of the sum of instrument' R^-1 residual, by Newton steps from `start` (instrumental variables).

    instrument: like `predict`, from signals that do not share the noise of the measured ones. rows, multiplicity: as in
    `fit_parameters`.
    """
    theta = start.copy()
    counts = [np.ones(n) for n in rows] if multiplicity is None else list(multiplicity)
    converged, count = False, 0
    for _ in range(iterations):
        count += 1
        residuals, slopes = predict(theta)
        _, instruments = instrument(theta)
        R = residual_variance(residuals, counts)
        matrix, right = normal_equations(instruments, slopes, residuals, counts, R)
        step = np.linalg.lstsq(matrix, right, rcond=RCOND)[0]
        theta = theta + step
        converged = step_settled(step, normal_equations(slopes, slopes, residuals, counts, R)[0])
        if converged:
            break
    residuals, slopes = predict(theta)
    R = residual_variance(residuals, counts)
    information, _ = normal_equations(slopes, slopes, residuals, counts, R)
    return FrozenFit(theta, information, R, tuple(residuals), count, converged)


def step_settled(step: NDArray[np.floating[Any]], information: Array) -> bool:
    """Whether a step is less than a hundredth of the Cramer-Rao bound in every direction.

    A test relative to the parameters would never pass for one that the data hardly sees.
    """
    return bool(step @ information @ step < SETTLED)


def residual_variance(residuals: Sequence[Array], counts: Sequence[Array]) -> Array:
    """(out,) mean squared residual over rows weighted by `counts`."""
    total = sum(float(c.sum()) for c in counts)
    summed = sum((c[:, None] * r**2).sum(axis=0) for c, r in zip(counts, residuals, strict=True))
    return np.maximum(np.asarray(summed) / total, 1e-16)


def normal_equations(
    instruments: Sequence[Array], slopes: Sequence[Array], residuals: Sequence[Array], counts: Sequence[Array], R: Array
) -> tuple[Array, Array]:
    """Sums over all rows of instrument' R^-1 slope (n, n) and instrument' R^-1 residual (n,); the slopes may be their own
    instruments."""
    n = slopes[0].shape[2]
    matrix, right = np.zeros((n, n)), np.zeros(n)
    for a, s, r, c in zip(instruments, slopes, residuals, counts, strict=True):
        weighted = (a * (c[:, None] / R)[:, :, None]).reshape(-1, n).T
        matrix += weighted @ s.reshape(-1, n)
        right += weighted @ r.reshape(-1)
    return matrix, right
