"""A small feed-forward network as pure functions of one flat weight vector, so that ensembles train side by side.

One hidden layer of tanh, linear output, optionally a linear path beside it (`skip`). Everything is standardised outside.
Shapes: inputs (samples, n_in), outputs (samples, n_out), weights (n_weights,) or (nets, n_weights) for an ensemble.
"""

import math
from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass(frozen=True, slots=True)
class Shape:
    """Sizes of the network."""

    inputs: int
    hidden: int
    outputs: int
    skip: bool = False

    @property
    def weights(self) -> int:
        """Number of weights and biases."""
        through = self.inputs * self.outputs if self.skip else 0
        return (self.inputs + 1) * self.hidden + (self.hidden + 1) * self.outputs + through

    def split(self, w: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor | None]:
        """Weight matrices and biases W1 (hidden, in), b1, W2 (out, hidden), b2, and the linear path (out, in)."""
        sizes = [self.hidden * self.inputs, self.hidden, self.outputs * self.hidden, self.outputs]
        if self.skip:
            sizes.append(self.outputs * self.inputs)
        parts = torch.split(w, sizes, dim=-1)
        lead = w.shape[:-1]
        linear = parts[4].reshape(*lead, self.outputs, self.inputs) if self.skip else None
        first = parts[0].reshape(*lead, self.hidden, self.inputs)
        return first, parts[1], parts[2].reshape(*lead, self.outputs, self.hidden), parts[3], linear


def initial_weights(shape: Shape, generator: torch.Generator, nets: int = 1) -> Tensor:
    """Random start, (nets, n_weights): Glorot-uniform matrices, zero biases and zero linear path."""

    def uniform(rows: int, columns: int) -> Tensor:
        bound = math.sqrt(6.0 / (rows + columns))
        return (2 * torch.rand(nets, rows * columns, generator=generator, dtype=torch.float64) - 1) * bound

    parts = [
        uniform(shape.hidden, shape.inputs),
        torch.zeros(nets, shape.hidden, dtype=torch.float64),
        uniform(shape.outputs, shape.hidden),
        torch.zeros(nets, shape.outputs, dtype=torch.float64),
    ]
    if shape.skip:
        parts.append(torch.zeros(nets, shape.outputs * shape.inputs, dtype=torch.float64))
    return torch.cat(parts, dim=1)


def forward(shape: Shape, w: Tensor, u: Tensor) -> Tensor:
    """Network output. w: (n_weights,) or (nets, n_weights); u: (samples, in) or (nets, samples, in)."""
    first, b1, second, b2, linear = shape.split(w)
    hidden = torch.tanh(u @ first.mT + b1.unsqueeze(-2))
    out = hidden @ second.mT + b2.unsqueeze(-2)
    return out if linear is None else out + u @ linear.mT


def weight_jacobian(shape: Shape, w: Tensor, u: Tensor) -> tuple[Tensor, Tensor]:
    """Output (samples, out) and its exact derivative by the weights (samples, out, n_weights), one net.

    Written out because for one hidden layer it is four products; autograd gives the same (tested).
    """
    first, b1, second, b2, linear = shape.split(w)
    samples = u.shape[0]
    hidden = torch.tanh(u @ first.mT + b1)
    slope = 1 - hidden**2
    eye = torch.eye(shape.outputs, dtype=u.dtype, device=u.device)
    d_hidden = second.unsqueeze(0) * slope.unsqueeze(1)  # (samples, out, hidden)
    d_first = (d_hidden.unsqueeze(-1) * u[:, None, None, :]).reshape(samples, shape.outputs, -1)
    d_second = (eye[None, :, :, None] * hidden[:, None, None, :]).reshape(samples, shape.outputs, -1)
    parts = [d_first, d_hidden, d_second, eye.expand(samples, -1, -1)]
    out = hidden @ second.mT + b2
    if linear is not None:
        out = out + u @ linear.mT
        parts.append((eye[None, :, :, None] * u[:, None, None, :]).reshape(samples, shape.outputs, -1))
    return out, torch.cat(parts, dim=-1)


def input_jacobian(shape: Shape, w: Tensor, u: Tensor) -> tuple[Tensor, Tensor]:
    """Output (samples, out) and its exact derivative by the inputs (samples, out, in), by autograd."""

    def one(row: Tensor) -> Tensor:
        return forward(shape, w, row.unsqueeze(0)).squeeze(0)

    return forward(shape, w, u), torch.func.vmap(torch.func.jacrev(one))(u)
