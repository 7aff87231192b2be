"""Training of networks side by side by Levenberg-Marquardt, in float64, on a CPU or a GPU; its settings.

On a CPU the same jobs give the same weights bit for bit.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import torch
from torch import Tensor

from estimation.estimators.neural_gauss_newton.network import NetworkShape, forward, weight_normal_equations

FIRST_DAMPING, LEAST_DAMPING = 1e-2, 1e-10  # times the mean diagonal of the normal equations
LESS, MORE = 3.0, 4.0  # divisor of the damping after a step that lowers the cost, and factor after one that does not
TRIES = 8  # dampings of one step before a network counts as trained
LARGEST_BATCH_ROWS = {"cpu": 40_000, "cuda": 1_000_000}  # of all networks of a batch: 0.1 and 2 GB while training
ENOUGH = 1e-7  # of the cost: a network is trained when a step gains less


@dataclass(frozen=True, slots=True)
class TrainingOptions:
    """How to train. decay: factor of the sum of squared weights in the cost (standardised data, summed squares)."""

    iterations: int = 60
    restarts: int = 2
    decay: float = 1e-4


@dataclass(frozen=True, slots=True)
class Trained:
    """A trained network: weights (n_weights,), mean squared standardised errors on training and held-out rows."""

    weights: Tensor
    training_error: float
    validation_error: float
    iterations: int


@dataclass(frozen=True, slots=True)
class Job:
    """One network to train. u: (M, in), z: (M, out) standardised rows, on the CPU; weight: (M,) how often each counts;
    start: (n_weights,)."""

    shape: NetworkShape
    u: Tensor
    z: Tensor
    weight: Tensor
    start: Tensor


def train_jobs(jobs: Sequence[Job], options: TrainingOptions, device: str = "cpu") -> list[tuple[Tensor, int]]:
    """Weights (n_weights,) of every network, on the CPU, and the iterations it took.

    Networks of one shape are trained side by side, in batches that fill the device. They are independent: each becomes what it
    would be alone, within rounding.
    """
    trained: list[tuple[Tensor, int]] = []
    for batch in _batches(jobs, LARGEST_BATCH_ROWS[torch.device(device).type]):
        longest = max(len(j.u) for j in batch)
        shared = all(j.u is batch[0].u and j.z is batch[0].z for j in batch)
        sources = batch[:1] if shared else batch
        u, z = (
            torch.stack([_padded(v, longest) for v in vs]) for vs in ([j.u for j in sources], [j.z for j in sources])
        )
        weights, iterations = levenberg_marquardt(
            batch[0].shape,
            (u[0] if shared else u).to(device),
            (z[0] if shared else z).to(device),
            torch.stack([_padded(j.weight, longest) for j in batch]).to(device),
            torch.stack([j.start for j in batch]).to(device),
            options,
        )
        trained += zip(weights.cpu(), iterations.tolist(), strict=True)
    return trained


def _batches(jobs: Sequence[Job], largest: int) -> Iterator[list[Job]]:
    """Consecutive jobs of one shape whose rows, padded to the longest, stay within `largest` (one job at least)."""
    batch: list[Job] = []
    longest = 0
    for job in jobs:
        longest = max(longest, len(job.u))
        if batch and (job.shape != batch[0].shape or (len(batch) + 1) * longest > largest):
            yield batch
            batch, longest = [], len(job.u)
        batch.append(job)
    if batch:
        yield batch


def _padded(values: Tensor, length: int) -> Tensor:
    """Values with zeros appended to `length` rows; their weight is zero too."""
    missing = length - values.shape[0]
    return torch.cat([values, values.new_zeros(missing, *values.shape[1:])]) if missing else values


def mean_square(shape: NetworkShape, w: Tensor, u: Tensor, z: Tensor, weight: Tensor) -> float:
    """Mean squared standardised error of one network over weighted rows; NaN without any."""
    total = float(weight.sum())
    if total == 0:
        return float("nan")
    return float((weight[:, None] * (z - forward(shape, w, u)) ** 2).sum() / (total * z.shape[1]))


def levenberg_marquardt(
    shape: NetworkShape, u: Tensor, z: Tensor, weights: Tensor, starts: Tensor, options: TrainingOptions
) -> tuple[Tensor, Tensor]:
    """Gauss-Newton on the weights of many networks side by side, each with a damping of its own.

    Damping falls on success and rises on failure; a network is trained when a step gains less than ENOUGH of its cost, or none
    helps. weights: (nets, M) row multiplicities; starts: (nets, n_weights); u, z: shared (M, ...) or each net's own
    (nets, M, ...). Returns weights (nets, n_weights) and iterations (nets,).
    """
    w = starts.clone()
    damping = torch.full((len(w),), FIRST_DAMPING, dtype=w.dtype, device=w.device)
    cost = _costs(shape, w, u, z, weights, options.decay)
    iterations = torch.zeros(len(w), dtype=torch.int64, device=w.device)
    active = torch.arange(len(w), device=w.device)
    for _ in range(options.iterations):
        if not len(active):
            break
        rows = _Batch.build(u, z, weights, active)
        matrix, right = weight_normal_equations(shape, w[active], rows.u, rows.z, rows.weights)
        matrix.diagonal(dim1=1, dim2=2).add_(options.decay)
        right -= options.decay * w[active]
        scale = matrix.diagonal(dim1=1, dim2=2).mean(dim=1)
        gain = torch.full_like(scale, -1.0)
        for _ in range(TRIES):
            pending = torch.nonzero(gain < 0).squeeze(1)
            if not len(pending):
                break
            nets = active[pending]
            step = _damped_step(matrix[pending], right[pending], damping[nets] * scale[pending])
            trial = w[nets] + step
            part = rows.only(pending)
            new = _costs(shape, trial, part.u, part.z, part.weights, options.decay)
            lowered = new < cost[nets]
            gain[pending[lowered]] = ((cost[nets] - new) / cost[nets])[lowered]
            w[nets[lowered]], cost[nets[lowered]] = trial[lowered], new[lowered]
            damping[nets] = torch.where(
                lowered, torch.clamp(damping[nets] / LESS, min=LEAST_DAMPING), damping[nets] * MORE
            )
        iterations[active[gain >= 0]] += 1
        active = active[gain >= ENOUGH]
    return w, iterations


@dataclass(frozen=True, slots=True)
class _Batch:
    """Rows of some of the networks; shared rows stay shared."""

    u: Tensor
    z: Tensor
    weights: Tensor

    @classmethod
    def build(cls, u: Tensor, z: Tensor, weights: Tensor, nets: Tensor) -> "_Batch":
        return cls(u, z, weights).only(nets) if len(nets) < len(weights) else cls(u, z, weights)

    def only(self, nets: Tensor) -> "_Batch":
        if len(nets) == len(self.weights):
            return self
        u, z = (v[nets] if v.dim() == 3 else v for v in (self.u, self.z))
        return _Batch(u, z, self.weights[nets])


def _damped_step(matrix: Tensor, right: Tensor, damping: Tensor) -> Tensor:
    """(nets, n) solution of (matrix + damping I) step = right; NaN where the matrix is not positive definite."""
    damped = matrix.clone()
    damped.diagonal(dim1=1, dim2=2).add_(damping[:, None])
    factor, failed = torch.linalg.cholesky_ex(damped)
    step = torch.cholesky_solve(right.unsqueeze(-1), factor).squeeze(-1)
    return torch.where(failed[:, None] > 0, torch.full_like(step, torch.nan), step)


def _costs(shape: NetworkShape, w: Tensor, u: Tensor, z: Tensor, weights: Tensor, decay: float) -> Tensor:
    """(nets,) weighted sum of squared errors plus the decay term."""
    return (weights[:, :, None] * (z - forward(shape, w, u)) ** 2).sum(dim=(1, 2)) + decay * (w**2).sum(dim=1)


@dataclass(frozen=True, slots=True)
class NgnOptions:
    """improved: the interval form with a linear path; instruments: normal equations with instruments.

    hidden: neurons; ensemble: networks of different seeds whose estimates are averaged; bootstraps: networks of the
    block bootstrap (0: the spread is the Cramer-Rao bound); device: cpu, cuda or auto, for training.
    """

    improved: bool = False
    instruments: bool = False
    hidden: int = 6
    training: TrainingOptions = field(default_factory=lambda: TrainingOptions(restarts=1))
    ensemble: int = 2
    bootstraps: int = 64
    bootstrap_iterations: int = 4
    seed: int = 0
    device: str = "cpu"


def default_options(improved: bool, axis: str = "lateral") -> NgnOptions:
    """The best options of a study on simulated flights. Networks of the published form differ more, so it averages more of them.

    Longitudinal: lift follows angle of attack so closely that instruments have too little independent motion.
    """
    if improved and axis == "lateral":
        return NgnOptions(improved=True, instruments=True)
    strong_decay = TrainingOptions(restarts=1, decay=1e-2)
    if improved:
        return NgnOptions(improved=True, hidden=4, training=strong_decay)
    return NgnOptions(training=strong_decay, ensemble=4)
