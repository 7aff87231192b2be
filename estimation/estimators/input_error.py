"""Effect of input errors on the outputs, and through them on the estimates.

Output error takes its inputs for exact. They have three kinds of errors, none of them a stationary noise that residuals would
show: an airspeed 1 % too high makes all forces 2 % too large, which matters just where the manoeuvres are.

- Noise that de-noising did not remove: draws from its posterior (`FlightData.errors`), of known size.
- The path of a surface between two samples, because an edge may lie anywhere within its interval. The middle of every interval
  next to an edge is displaced at random by `EDGE` of the bend there.
- Errors that all edges of a control share: it acts a little earlier or later than its samples say (`SHIFT`), or all its edges
  are bent alike (`BEND`). They belong to the aircraft and are the same in all its flights.

The residuals determine the sizes. The factor on the variance of edges is found by the method of moments: the products of
residuals and edge responses, less those of noise alone. Common errors have a prior of the size given here and count with their
posterior second moment, because the bound is that of estimates which took the inputs for exact.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from estimation.engine.kernel import Array
from estimation.estimators.coloured import ResidualSegment, Spectrum, white_products
from estimation.estimators.likelihood import OutputErrorProblem
from estimation.estimators.normal_equations import projected_out
from estimation.models.base import Model
from estimation.prepare.flight_data import Segment, draws_for

EDGE = 0.08  # of the bend (second difference): rms over servo lags of 0.4 to 2 samples and all phases of an edge
SHIFT = 0.035  # of the sample interval: 2 ms at 20 Hz, about as well as logs are synchronised
BEND = 0.0245  # of the bends at both ends of an interval: two thirds of the mean over lagging servos
MOST_EDGE = 2.0  # largest factor on the variance of edges
MOST_COMMON = 2.0  # largest size of a common error that is believed
LEAST_NOISE = 0.05  # of an output's variance, at every frequency, however smooth a filter made the output
SEED = 21


@dataclass(frozen=True)
class Disturbed:
    """Changes of the outputs of one segment by input errors. values: (N, ny, columns), in the order noise, edges, common errors;
    noise, edges: number of their columns."""

    values: Array
    noise: int
    edges: int


@dataclass(frozen=True)
class InputErrorEvidence:
    """Inner products of the responses of one flight, from which the sizes of input errors follow.

    products: (columns, columns) of noise, edges, common errors and, last, the residual, weighted by the inverse spectrum of the
    noise, with parameters and initial states projected out: so it is also the covariance of the residual's products by chance.
    noise, edges: number of their columns.
    """

    products: Array
    noise: int
    edges: int

    def edge_excess(self) -> tuple[float, float]:
        """(excess, scale): squared products of residual and edges beyond chance, and the same expected at the size EDGE."""
        noise, edges = slice(0, self.noise), slice(self.noise, self.noise + self.edges)
        if self.edges < 2:
            return 0.0, 0.0
        gram = self.products[edges, edges]
        chance = float(np.trace(gram)) + float(np.sum(self.products[edges, noise] ** 2)) / max(self.noise, 1)
        scale = float(np.sum(gram**2) - np.sum(np.diag(gram) ** 2)) / (self.edges - 1)
        return float(np.sum(self.products[edges, -1] ** 2)) - chance, scale

    def common(self, edges: float) -> tuple[Array, Array, Array]:
        """(information on the common errors, their products with the residual, covariance of these by chance). edges: factor on
        the variance of edges."""
        k, m = self.noise, self.edges
        rows = slice(k + m, -1)
        information = self.products[rows, rows]
        by_noise, by_edges = self.products[rows, :k], self.products[rows, k : k + m]
        chance = information + by_noise @ by_noise.T / max(k, 1) + edges / max(m, 1) * by_edges @ by_edges.T
        return information, self.products[rows, -1], chance


def input_error_evidence(
    pieces: list[ResidualSegment], responses: list[Array], spectrum: Spectrum, kinds: Disturbed
) -> InputErrorEvidence:
    """Evidence of one flight. responses: (N ny, columns) of each piece in units of the noise; kinds: numbers of their columns."""
    floor = LEAST_NOISE * np.eye(spectrum.shape[1])
    inverse: Spectrum = np.asarray(np.linalg.inv(spectrum + floor), np.complex128)
    total: Array | None = None
    for piece, columns in zip(pieces, responses, strict=True):
        gram = projected_out(white_products(piece, columns, inverse), piece.nuisance.shape[1])
        total = gram if total is None else total + gram
    assert total is not None
    return InputErrorEvidence(projected_out(total, pieces[0].jacobian.shape[1]), kinds.noise, kinds.edges)


def disturbed_outputs(problem: OutputErrorProblem, unknowns: Array, index: int) -> list[Disturbed]:
    """Responses of one flight to its input errors, segment by segment."""
    flight = problem.flights[index]
    rng = np.random.default_rng([SEED, index])
    result = []
    for j, segment in enumerate(flight.segments):
        noise = np.zeros((len(segment), segment.u.shape[1], 0))
        if flight.errors is not None:
            noise = flight.errors[segment.rows].astype(float)
        edges = _edge_displacements(problem.model, segment, draws_for(flight.samples), rng)
        common, common_mid = _common_errors(problem.model, segment)
        du = np.concatenate([noise, np.zeros_like(edges), common], axis=2)
        du_mid = np.concatenate([_midway(noise), edges, common_mid], axis=2)
        values = problem.response(unknowns, index, j, du, du_mid)
        result.append(Disturbed(values, noise.shape[2], edges.shape[2]))
    return result


def _midway(values: Array) -> Array:
    """(N, ...) values half-way to the next sample."""
    middle = values.copy()
    middle[:-1] = 0.5 * (values[:-1] + values[1:])
    return middle


def _controls(model: Model) -> list[int]:
    """Indices of the inputs that are controls."""
    return [i for i, s in enumerate(model.inputs) if s.control]


def _second_differences(u: Array) -> Array:
    """(N,) second difference of a control at its samples."""
    result = np.zeros(u.size)
    result[1:-1] = np.diff(u, 2)
    return result


def _edge_displacements(model: Model, segment: Segment, draws: int, rng: np.random.Generator) -> Array:
    """(N, nu, draws) displacements half-way through every interval; its area errs by half of that."""
    result = np.zeros((*segment.u.shape, draws))
    for i in _controls(model):
        bend = np.append(np.abs(_second_differences(segment.u[:, i])), 0.0)
        size = 2.0 * EDGE * np.maximum(bend[:-1], bend[1:])
        result[:, i] = size[:, None] * rng.standard_normal((len(segment), draws))
    return result


def _common_errors(model: Model, segment: Segment) -> tuple[Array, Array]:
    """(N, nu, 2 controls) changes of the inputs, at the samples and half-way: each control SHIFT later, each bent by BEND."""
    controls = _controls(model)
    samples = np.zeros((*segment.u.shape, 2 * len(controls)))
    middle = np.zeros_like(samples)
    for k, i in enumerate(controls):
        step = np.append(np.diff(segment.u[:, i]), 0.0)
        bend = np.append(_second_differences(segment.u[:, i]), 0.0)
        samples[1:, i, 2 * k] = -0.5 * SHIFT * (step[1:] + step[:-1])
        middle[:, i, 2 * k] = -SHIFT * step
        middle[:, i, 2 * k + 1] = -2.0 * BEND * (bend[:-1] + bend[1:])
    return samples, middle


def edge_size(evidence: Sequence[InputErrorEvidence]) -> float:
    """Factor on the variance of edges, from all flights of a fit; 0 where residuals show no such errors."""
    excess, scale = np.sum([e.edge_excess() for e in evidence], axis=0)
    return float(np.clip(excess / scale, 0.0, MOST_EDGE)) if scale > 0.0 else 0.0


def common_error(evidence: Sequence[InputErrorEvidence], edges: float) -> Array:
    """(common, common) posterior second moment of the common errors, with a prior of size one. edges: as from `edge_size`."""
    by_flight = [e.common(edges) for e in evidence]
    information, product, chance = (np.sum(parts, axis=0) for parts in zip(*by_flight, strict=True))
    prior = np.eye(product.size)
    weight = information @ np.linalg.pinv(chance, hermitian=True)
    spread = np.linalg.inv(weight @ information + prior)
    mean = spread @ weight @ product
    if np.any(np.abs(mean) > MOST_COMMON):  # no timing error is that large: the residuals have another cause
        return prior
    return np.asarray(np.outer(mean, mean) + 0.5 * (spread + spread.T))
