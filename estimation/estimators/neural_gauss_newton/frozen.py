"""Gauss-Newton over the aerodynamic parameters with the network frozen.

The coefficients among the network's inputs are replaced by the aerodynamic model's; what is minimised is the one-step
prediction error weighted by R^-1, R from the residuals (relaxation). The Jacobian is exact: network by its inputs
(autograd) times coefficients by parameters. Everything here is on the CPU: 64 fits of a flight take half a second.
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
    """Means and standard deviations that inputs u and outputs z are standardised with."""

    u_mean: Array
    u_std: Array
    z_mean: Array
    z_std: Array

    @classmethod
    def of(cls, stretches: Sequence[SampleStretch]) -> "Standard":
        """From all rows; a constant column keeps its own unit."""
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
    """theta: (n,); information: (n, n); R: (n_out,) standardised residual variance; residuals: per stretch, standardised."""

    theta: Array
    information: Array
    R: Array
    residuals: tuple[Array, ...]
    iterations: int
    converged: bool


class Regressors:
    """The model's coefficients on one stretch, as functions of the parameters.

    Where they are linear their slopes are worked out once, for all networks and steps.
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
    """A trained network with its scaling, ready to predict rows of stretches."""

    shape: NetworkShape
    weights: torch.Tensor
    standard: Standard

    def residual_and_slope(self, stretch: SampleStretch, regressors: Regressors, theta: Array) -> tuple[Array, Array]:
        """Standardised residuals (M, out) and prediction slopes (M, out, n) with the model's coefficients."""
        m = stretch.u.shape[1] - 3
        coefficients, d_theta = regressors(theta)
        u = torch.as_tensor(self.standard.u(np.column_stack([stretch.u[:, :m], coefficients])))
        outputs, d_u = input_slopes(self.shape, self.weights, u)
        slopes = (d_u[:, :, m:].numpy() / self.standard.u_std[m:]) @ d_theta
        return self.standard.z(stretch.z) - outputs.numpy(), slopes


Predict = Callable[[Array], tuple[list[Array], list[Array]]]
"""theta -> standardised residuals (M, out) and prediction slopes (M, out, n) of every stretch."""
Look = tuple[list[Array], list[Array], Array, float]
"""The same at one theta, with R (out,) and the cost."""
HALVINGS = 11  # of a step, down to a thousandth


def fit_parameters(
    predict: Predict,
    rows: Sequence[int],
    starts: Sequence[Array],
    *,
    multiplicity: Sequence[Array] | None = None,
    iterations: int = 40,
) -> FrozenFit:
    """Minimise the prediction error over theta from the best of `starts`, with step halving; converged when a step is settled.

    predict: residuals and slopes of every stretch; rows: of each stretch; multiplicity: weight of each row of each stretch.
    """
    counts = [np.ones(n) for n in rows] if multiplicity is None else list(multiplicity)
    total = sum(float(c.sum()) for c in counts)

    def look(t: Array) -> Look:
        residuals, slopes = predict(t)
        R = residual_variance(residuals, counts)
        return residuals, slopes, R, 0.5 * total * float(np.log(R).sum())

    def along(theta: Array, step: NDArray[np.floating[Any]], fraction: float) -> Look:
        return look(theta + fraction * step)

    def not_above(limit: float, place: Look) -> bool:
        return not place[3] > limit

    theta, (residuals, slopes, R, cost) = min(((t, look(t)) for t in starts), key=lambda tried: tried[1][3])
    converged, count = False, 0
    for _ in range(iterations):
        count += 1
        information, gradient = normal_equations(slopes, slopes, residuals, counts, R)
        step = np.linalg.lstsq(information, gradient, rcond=1e-13)[0]
        converged = step_settled(step, information)
        lowered = halve_until(partial(along, theta, step), partial(not_above, cost + 1e-9 * abs(cost)), HALVINGS)
        if lowered is None:
            break
        theta = theta + lowered[0] * step
        residuals, slopes, R, cost = lowered[1]
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
    """Root of sum of instrument' R^-1 residual, by Newton steps from `start` (instrumental variables).

    instrument: predicted slopes computed from signals that do not share the noise of those in `predict`.
    """
    theta = start.copy()
    counts = [np.ones(n) for n in rows] if multiplicity is None else list(multiplicity)
    converged, count = False, 0
    for _ in range(iterations):
        count += 1
        residuals, slopes = predict(theta)
        _, instruments = instrument(theta)
        matrix, right = normal_equations(instruments, slopes, residuals, counts, residual_variance(residuals, counts))
        step = np.linalg.lstsq(matrix, right, rcond=1e-13)[0]
        theta = theta + step
        converged = step_settled(
            step, normal_equations(slopes, slopes, residuals, counts, residual_variance(residuals, counts))[0]
        )
        if converged:
            break
    residuals, slopes = predict(theta)
    R = residual_variance(residuals, counts)
    information, _ = normal_equations(slopes, slopes, residuals, counts, R)
    return FrozenFit(theta, information, R, tuple(residuals), count, converged)


def step_settled(step: NDArray[np.floating[Any]], information: Array) -> bool:
    """Whether a step is less than a hundredth of the Cramer-Rao bound, in every direction of parameter space.

    Relative to the parameters themselves it would never be, where the data hardly sees one.
    """
    return bool(step @ information @ step < 1e-4)


def residual_variance(residuals: Sequence[Array], counts: Sequence[Array]) -> Array:
    """(out,) mean squared residual over weighted rows."""
    total = sum(float(c.sum()) for c in counts)
    summed = sum((c[:, None] * r**2).sum(axis=0) for c, r in zip(counts, residuals, strict=True))
    return np.maximum(np.asarray(summed) / total, 1e-16)


def normal_equations(
    instruments: Sequence[Array], slopes: Sequence[Array], residuals: Sequence[Array], counts: Sequence[Array], R: Array
) -> tuple[Array, Array]:
    """Sum of left' R^-1 slope and left' R^-1 residual over all rows; left are the slopes, or instruments for them."""
    n = slopes[0].shape[2]
    matrix, right = np.zeros((n, n)), np.zeros(n)
    for a, s, r, c in zip(instruments, slopes, residuals, counts, strict=True):
        weighted = (a * (c[:, None] / R)[:, :, None]).reshape(-1, n).T
        matrix += weighted @ s.reshape(-1, n)
        right += weighted @ r.reshape(-1)
    return matrix, right
