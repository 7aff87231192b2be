"""Many networks at once: every bootstrap of every flight of a campaign, trained side by side.

Each network has its own rows and its own weights; stacking them only shares the arithmetic. On a GPU the batch fills
the machine, on a CPU it saves the overhead of many small operations. Results are those of training one by one, within
rounding.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import torch
from torch import Tensor

from estimation.errors import EstimationError
from estimation.estimators.neural_gauss_newton.formulation import Rows
from estimation.estimators.neural_gauss_newton.network import Shape, initial_weights
from estimation.estimators.neural_gauss_newton.training import TrainingOptions, train_ensemble

LARGEST_BATCH_ROWS = 400_000  # rows of all networks of a batch: about 0.4 GB while training


@dataclass(frozen=True, slots=True)
class CampaignOptions:
    """bootstraps: networks for each flight; training: Adam runs 20 steps for each of its iterations."""

    bootstraps: int = 64
    hidden: int = 6
    skip: bool = True
    training: TrainingOptions = field(default_factory=lambda: TrainingOptions(optimiser="adam"))
    seed: int = 0
    device: str = "cpu"


def usable_device(name: str) -> str:
    """`name` if torch can compute there, `auto` meaning a GPU where there is one; EstimationError otherwise."""
    if name == "auto":
        return "cuda" if torch.cuda.is_available() else "cpu"
    try:
        kind = torch.device(name).type
    except RuntimeError:
        raise EstimationError(f"device {name!r} is unknown; write cpu, cuda or auto") from None
    if kind not in ("cpu", "cuda"):
        raise EstimationError(f"device {name!r} is not supported; write cpu, cuda or auto")
    if kind == "cuda" and not torch.cuda.is_available():
        raise EstimationError(f"device {name!r}: torch finds no GPU here; write cpu or auto")
    return name


def train_campaign(flights: Sequence[Rows], options: CampaignOptions) -> list[Tensor]:
    """Weights (bootstraps, n_weights) of the networks of every flight, on the CPU.

    Network k of flight i depends on the seed, i and k alone, not on the other flights or the size of the batches.
    """
    device = usable_device(options.device)
    jobs = [_jobs(i, rows, options) for i, rows in enumerate(flights)]
    longest = max(len(rows.u) for rows in flights)
    batch = max(1, LARGEST_BATCH_ROWS // longest)
    flat = [(i, k) for i in range(len(flights)) for k in range(options.bootstraps)]
    trained: dict[tuple[int, int], Tensor] = {}
    for first in range(0, len(flat), batch):
        chosen = flat[first : first + batch]
        u = torch.stack([_padded(flights[i].u, longest) for i, _ in chosen]).to(device)
        z = torch.stack([_padded(flights[i].z, longest) for i, _ in chosen]).to(device)
        weights = torch.stack([_padded(jobs[i][0][k], longest) for i, k in chosen]).to(device)
        starts = torch.stack([jobs[i][1][k] for i, k in chosen]).to(device)
        shape = _shape(flights[0], options)
        done = train_ensemble(shape, u, z, weights, starts, options.training).cpu()
        trained.update(zip(chosen, done, strict=True))
    return [torch.stack([trained[i, k] for k in range(options.bootstraps)]) for i in range(len(flights))]


def _shape(rows: Rows, options: CampaignOptions) -> Shape:
    return Shape(rows.u.shape[1], options.hidden, rows.z.shape[1], options.skip)


def _jobs(index: int, rows: Rows, options: CampaignOptions) -> tuple[Tensor, Tensor]:
    """Row weights (bootstraps, M) and start weights (bootstraps, n_weights) of one flight."""
    rng = np.random.default_rng([options.seed, index, 65])
    drawn = np.stack([rows.resampled(rng) for _ in range(options.bootstraps)])
    generator = torch.Generator().manual_seed(100_003 * options.seed + index)
    return torch.as_tensor(drawn), initial_weights(_shape(rows, options), generator, options.bootstraps)


def _padded(values: Tensor, length: int) -> Tensor:
    """Zeros appended to `length` rows; rows of zero weight count for nothing."""
    missing = length - values.shape[0]
    return torch.cat([values, values.new_zeros(missing, *values.shape[1:])]) if missing else values
