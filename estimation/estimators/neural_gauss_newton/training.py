"""Training of the network: Levenberg-Marquardt (default), L-BFGS or Adam, validated on held-out stretches, restarted.

Everything is seeded and in float64; on CPU the same seed gives the same weights bit for bit.
"""

from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor

from estimation.estimators.neural_gauss_newton.network import Shape, forward, initial_weights, weight_jacobian

Optimiser = Literal["lm", "lbfgs", "adam"]


@dataclass(frozen=True, slots=True)
class TrainingOptions:
    """How to train. decay: weight of the sum of squared weights in the cost (standardised data, summed residuals)."""

    optimiser: Optimiser = "lm"
    iterations: int = 60
    restarts: int = 2
    decay: float = 1e-4
    learning_rate: float = 0.02


@dataclass(frozen=True, slots=True)
class Trained:
    """A trained network: weights (n_weights,), mean squared standardised error on training and held-out rows."""

    weights: Tensor
    training_error: float
    validation_error: float
    iterations: int


def train(
    shape: Shape,
    u: Tensor,
    z: Tensor,
    held_out: Tensor,
    options: TrainingOptions,
    generator: torch.Generator,
    *,
    multiplicity: Tensor | None = None,
    start: Tensor | None = None,
) -> Trained:
    """Train `restarts` networks and keep the one that is best on the held-out rows.

    u: (M, in), z: (M, out) standardised; held_out: (M,) bool; multiplicity: (M,) weight of each row (block bootstrap);
    start: weights to start from, instead of restarts.
    """
    weight = torch.ones(len(u), dtype=u.dtype, device=u.device) if multiplicity is None else multiplicity
    fit = weight * (~held_out)
    best: Trained | None = None
    starts = initial_weights(shape, generator, options.restarts).to(u.device) if start is None else start.unsqueeze(0)
    for w in starts:
        w, iterations = OPTIMISERS[options.optimiser](shape, u, z, fit, w, options)
        result = Trained(w, _error(shape, w, u, z, fit), _error(shape, w, u, z, weight * held_out), iterations)
        score = result.validation_error if held_out.any() else result.training_error
        if best is None or score < (best.validation_error if held_out.any() else best.training_error):
            best = result
    assert best is not None
    return best


def _error(shape: Shape, w: Tensor, u: Tensor, z: Tensor, weight: Tensor) -> float:
    total = float(weight.sum())
    if total == 0:
        return float("nan")
    return float((weight[:, None] * (z - forward(shape, w, u)) ** 2).sum() / (total * z.shape[1]))


def _cost(shape: Shape, w: Tensor, u: Tensor, z: Tensor, weight: Tensor, decay: float) -> Tensor:
    return (weight[:, None] * (z - forward(shape, w, u)) ** 2).sum() + decay * (w**2).sum()


def _levenberg_marquardt(
    shape: Shape, u: Tensor, z: Tensor, weight: Tensor, w: Tensor, options: TrainingOptions
) -> tuple[Tensor, int]:
    """Gauss-Newton on the weights with damping that falls on success and rises on failure."""
    damping = 1e-2
    cost = _cost(shape, w, u, z, weight, options.decay)
    root = torch.sqrt(weight)
    for iteration in range(options.iterations):
        out, jacobian = weight_jacobian(shape, w, u)
        J = (root[:, None, None] * jacobian).reshape(-1, shape.weights)
        r = (root[:, None] * (z - out)).reshape(-1)
        H = J.T @ J
        H.diagonal().add_(options.decay)
        g = J.T @ r - options.decay * w
        for _ in range(8):
            M = H.clone()
            M.diagonal().add_(damping * H.diagonal().mean())
            trial = w + torch.linalg.solve(M, g)
            new = _cost(shape, trial, u, z, weight, options.decay)
            if new < cost:
                break
            damping *= 4.0
        else:
            return w, iteration
        gain = float((cost - new) / cost)
        w, cost, damping = trial, new, max(damping / 3.0, 1e-10)
        if gain < 1e-7:
            return w, iteration + 1
    return w, options.iterations


def _lbfgs(
    shape: Shape, u: Tensor, z: Tensor, weight: Tensor, w: Tensor, options: TrainingOptions
) -> tuple[Tensor, int]:
    w = w.clone().requires_grad_(True)
    optimiser = torch.optim.LBFGS([w], max_iter=10 * options.iterations, history_size=30, line_search_fn="strong_wolfe")

    def closure() -> float:
        optimiser.zero_grad()
        cost = _cost(shape, w, u, z, weight, options.decay)
        cost.backward()  # type: ignore[no-untyped-call]
        return float(cost.detach())

    optimiser.step(closure)
    return w.detach(), int(optimiser.state[w].get("n_iter", 0))


def _adam(
    shape: Shape, u: Tensor, z: Tensor, weight: Tensor, w: Tensor, options: TrainingOptions
) -> tuple[Tensor, int]:
    trained = train_ensemble(shape, u, z, weight.unsqueeze(0), w.unsqueeze(0), options)
    return trained[0], 20 * options.iterations


def train_ensemble(
    shape: Shape, u: Tensor, z: Tensor, weights: Tensor, starts: Tensor, options: TrainingOptions
) -> Tensor:
    """Train many networks at once by Adam, as one batched computation. weights: (nets, M) row multiplicities.

    The nets do not see each other: each has its own cost, the batch only shares the arithmetic (and the GPU).
    """
    w = starts.clone().requires_grad_(True)
    steps = 20 * options.iterations
    optimiser = torch.optim.Adam([w], lr=options.learning_rate)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, steps, eta_min=options.learning_rate * 1e-2)
    for _ in range(steps):
        optimiser.zero_grad()
        error = (weights[:, :, None] * (z - forward(shape, w, u)) ** 2).sum(dim=(1, 2))
        cost = (error + options.decay * (w**2).sum(dim=1)).sum()
        cost.backward()  # type: ignore[no-untyped-call]
        optimiser.step()
        schedule.step()
    return w.detach()


OPTIMISERS = {"lm": _levenberg_marquardt, "lbfgs": _lbfgs, "adam": _adam}
