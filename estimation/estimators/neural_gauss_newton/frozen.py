"""Gauss-Newton over the aerodynamic parameters with the network frozen.

The coefficients among the network's inputs are replaced by the aerodynamic model's; what is minimised is the one-step
prediction error weighted by R^-1, R from the residuals (relaxation). The Jacobian is exact: network by its inputs
(autograd) times coefficients by parameters.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from estimation.estimators.neural_gauss_newton.axes import Axis
from estimation.estimators.neural_gauss_newton.network import Shape, input_jacobian
from estimation.estimators.neural_gauss_newton.samples import Stretch

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Standard:
    """Means and standard deviations that inputs u and outputs z are standardised with."""

    u_mean: Array
    u_std: Array
    z_mean: Array
    z_std: Array

    @classmethod
    def of(cls, stretches: Sequence[Stretch]) -> "Standard":
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


def fit_parameters(
    axis: Axis,
    stretches: Sequence[Stretch],
    shape: Shape,
    weights: torch.Tensor,
    standard: Standard,
    *,
    start: Array | None = None,
    multiplicity: Sequence[Array] | None = None,
    iterations: int = 40,
) -> FrozenFit:
    """Minimise the prediction error over theta with step halving; converged when no step is above 1e-6 of its size."""
    theta = np.zeros(len(axis.parameters)) if start is None else start.copy()
    m = stretches[0].u.shape[1] - 3
    counts = [np.ones(len(s.u)) for s in stretches] if multiplicity is None else list(multiplicity)
    total = sum(float(c.sum()) for c in counts)

    def residual_and_slope(t: Array) -> tuple[list[Array], list[Array]]:
        residuals, slopes = [], []
        for stretch in stretches:
            coefficients, d_theta = stretch.model_coefficients(axis, t)
            u = standard.u(np.column_stack([stretch.u[:, :m], coefficients]))
            out, d_u = input_jacobian(shape, weights, torch.as_tensor(u, device=weights.device))
            residuals.append(standard.z(stretch.z) - out.cpu().numpy())
            d_c = d_u[:, :, m:].cpu().numpy() / standard.u_std[m:]
            slopes.append(np.einsum("koc,kcp->kop", d_c, d_theta))
        return residuals, slopes

    def variance(residuals: list[Array]) -> Array:
        summed = sum((c[:, None] * r**2).sum(axis=0) for c, r in zip(counts, residuals, strict=True))
        return np.maximum(np.asarray(summed) / total, 1e-16)

    residuals, slopes = residual_and_slope(theta)
    R = variance(residuals)
    cost = 0.5 * total * float(np.log(R).sum())
    converged, used = False, 0
    information = np.zeros((theta.size, theta.size))
    for used in range(1, iterations + 1):
        information, gradient = _normal(residuals, slopes, counts, R)
        step = np.linalg.lstsq(information, gradient, rcond=1e-13)[0]
        scale = 1.0
        while True:
            trial = theta + scale * step
            new_residuals, new_slopes = residual_and_slope(trial)
            new_R = variance(new_residuals)
            new_cost = 0.5 * total * float(np.log(new_R).sum())
            if new_cost <= cost + 1e-9 * abs(cost) or scale < 1e-3:
                break
            scale *= 0.5
        if new_cost > cost + 1e-9 * abs(cost):
            break
        small = bool(np.all(np.abs(scale * step) < 1e-6 * (np.abs(theta) + 1e-3)))
        theta, residuals, slopes, R, cost = trial, new_residuals, new_slopes, new_R, new_cost
        if small:
            converged = True
            break
    information, _ = _normal(residuals, slopes, counts, R)
    return FrozenFit(theta, information, R, tuple(residuals), used, converged)


def _normal(residuals: list[Array], slopes: list[Array], counts: list[Array], R: Array) -> tuple[Array, Array]:
    n = slopes[0].shape[2]
    information, gradient = np.zeros((n, n)), np.zeros(n)
    for r, s, c in zip(residuals, slopes, counts, strict=True):
        weighted = s * (c[:, None] / R)[:, :, None]
        information += np.einsum("kop,koq->pq", weighted, s)
        gradient += np.einsum("kop,ko->p", weighted, r)
    return information, gradient
