"""A small feed-forward network as pure functions of one flat weight vector, so that ensembles train side by side.

One hidden layer of tanh, linear output, optionally a linear path beside it (`skip`). Callers standardise inputs and outputs.
Shapes: inputs (samples, n_in), outputs (samples, n_out), weights (n_weights,) or (nets, n_weights) for an ensemble.
"""

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import torch
from torch import Tensor

from estimation.errors import EstimationError


def usable_device(name: str) -> str:
    """The device of that name if torch can use it; `auto` is a GPU where there is one. EstimationError otherwise."""
    if name == "auto":
        return "cuda" if torch.cuda.is_available() else "cpu"
    try:
        device = torch.device(name)
    except RuntimeError:
        raise EstimationError(f"device {name!r} is unknown; write cpu, cuda or auto") from None
    if device.type not in ("cpu", "cuda"):
        raise EstimationError(f"device {name!r} is not supported; write cpu, cuda or auto")
    if device.type == "cuda":
        count = torch.cuda.device_count() if torch.cuda.is_available() else 0
        if not count:
            raise EstimationError(f"device {name!r}: torch finds no GPU here; write cpu or auto")
        if (device.index or 0) >= count:
            raise EstimationError(f"device {name!r}: torch finds {count} GPU here, counted from cuda:0")
    return name


@contextmanager
def one_thread() -> Iterator[None]:
    """One thread of torch within: sums in the same order on every machine, so that the same seed gives the same bits."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)


@dataclass(frozen=True, slots=True)
class NetworkShape:
    """Sizes of the network."""

    inputs: int
    hidden: int
    outputs: int
    skip: bool = False

    @property
    def weights(self) -> int:
        """Number of weights and biases."""
        linear = self.inputs * self.outputs if self.skip else 0
        return (self.inputs + 1) * self.hidden + (self.hidden + 1) * self.outputs + linear

    def split(self, w: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor | None]:
        """Weight matrices and biases W1 (hidden, in), b1, W2 (out, hidden), b2, and the linear path (out, in)."""
        sizes = [self.hidden * self.inputs, self.hidden, self.outputs * self.hidden, self.outputs]
        if self.skip:
            sizes.append(self.outputs * self.inputs)
        parts = torch.split(w, sizes, dim=-1)
        networks = w.shape[:-1]  # none, or the networks of an ensemble
        linear = parts[4].reshape(*networks, self.outputs, self.inputs) if self.skip else None
        first = parts[0].reshape(*networks, self.hidden, self.inputs)
        return first, parts[1], parts[2].reshape(*networks, self.outputs, self.hidden), parts[3], linear


def initial_weights(shape: NetworkShape, generator: torch.Generator, nets: int = 1) -> Tensor:
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


def forward(shape: NetworkShape, w: Tensor, u: Tensor) -> Tensor:
    """Network output. w: (n_weights,) or (nets, n_weights); u: (samples, in) or (nets, samples, in)."""
    first, b1, second, b2, linear = shape.split(w)
    hidden = torch.tanh(u @ first.mT + b1.unsqueeze(-2))
    output = hidden @ second.mT + b2.unsqueeze(-2)
    return output if linear is None else output + u @ linear.mT


def weight_normal_equations(
    shape: NetworkShape, w: Tensor, u: Tensor, z: Tensor, weight: Tensor
) -> tuple[Tensor, Tensor]:
    """J'WJ (nets, n_weights, n_weights) and J'W(z - output) (nets, n_weights), J being the output's derivative by weights.

    w: (nets, n_weights); u: (samples, in) or (nets, samples, in); z alike; weight: (nets, samples). J itself, of samples
    times outputs rows, is never formed. With one hidden layer its row for output o is [W2[o, h] F, phi in the place of o], with F
    the tanh slopes times the inputs and phi the inputs of the output layer, so that all sums over samples are F'F, F'phi and
    phi'phi. Autograd gives the same (tested).
    """
    first, b1, second, b2, linear = shape.split(w)
    nets, ones = w.shape[0], torch.ones_like(u[..., :1])
    activation = torch.tanh(u @ first.mT + b1.unsqueeze(-2))  # (nets, samples, hidden)
    inputs = torch.cat([u, ones], dim=-1).expand(nets, -1, -1)
    layers = [activation, ones.expand(nets, -1, -1)]
    output = torch.cat([second, b2.unsqueeze(-1)], dim=-1)
    if linear is not None:
        layers.append(u.expand(nets, -1, -1))
        output = torch.cat([output, linear], dim=-1)
    phi = torch.cat(layers, dim=-1)
    F = ((1 - activation**2).unsqueeze(-1) * inputs.unsqueeze(-2)).flatten(-2)  # (nets, samples, hidden * (in + 1))
    residual = (z - phi @ output.mT) * weight.unsqueeze(-1)
    weighted = F * weight.unsqueeze(-1)
    outer = second.mT @ second  # (nets, hidden, hidden)
    across, wide = shape.inputs + 1, phi.shape[-1]
    first_block = (F.mT @ weighted).reshape(nets, shape.hidden, across, shape.hidden, across)
    first_block = (first_block * outer[:, :, None, :, None]).reshape(nets, F.shape[-1], F.shape[-1])
    cross_block = (weighted.mT @ phi).reshape(nets, shape.hidden, across, 1, wide)
    cross_block = (cross_block * second.mT[:, :, None, :, None]).reshape(nets, F.shape[-1], shape.outputs * wide)
    gram = phi.mT @ (phi * weight.unsqueeze(-1))
    eye = torch.eye(shape.outputs, dtype=w.dtype, device=w.device)
    last_block = (eye[None, :, None, :, None] * gram[:, None, :, None, :]).reshape(
        nets, cross_block.shape[-1], cross_block.shape[-1]
    )
    matrix = torch.cat(
        [torch.cat([first_block, cross_block], dim=-1), torch.cat([cross_block.mT, last_block], dim=-1)], dim=-2
    )
    backpropagated = (residual @ second).unsqueeze(-1)  # (nets, samples, hidden, 1)
    right_first = (F.reshape(*backpropagated.shape[:-1], across) * backpropagated).sum(dim=1).flatten(1)
    right = torch.cat([right_first, (residual.mT @ phi).flatten(1)], dim=-1)
    order = _flat_order(shape).to(w.device)
    return matrix[:, order][:, :, order], right[:, order]


def _flat_order(shape: NetworkShape) -> Tensor:
    """Place of each flat weight among [(hidden, in + 1), (out, inputs of the output layer)] of the normal equations."""
    across = shape.inputs + 1
    wide = shape.hidden + 1 + (shape.inputs if shape.skip else 0)
    first = torch.arange(shape.hidden * across).reshape(shape.hidden, across)
    last = shape.hidden * across + torch.arange(shape.outputs * wide).reshape(shape.outputs, wide)
    parts = [first[:, :-1], first[:, -1], last[:, : shape.hidden], last[:, shape.hidden]]
    if shape.skip:
        parts.append(last[:, shape.hidden + 1 :])
    return torch.cat([p.reshape(-1) for p in parts])


def input_slopes(shape: NetworkShape, w: Tensor, u: Tensor) -> tuple[Tensor, Tensor]:
    """Output (samples, out) of one network and its exact derivative by the inputs (samples, out, in), by autograd.

    Samples are independent, so one backward pass over one copy of them for each output gives all rows.
    """
    copies = u.expand(shape.outputs, -1, -1).clone().requires_grad_(True)
    outputs = forward(shape, w, copies)
    own_output = outputs.diagonal(dim1=0, dim2=2)  # output o of copy o
    (slopes,) = torch.autograd.grad(own_output.sum(), copies)
    return outputs[0].detach(), slopes.transpose(0, 1)
