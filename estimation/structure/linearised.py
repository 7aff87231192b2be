"""A fit linearised in its parameters and in all candidates of its model: inner products of sensitivities and residuals.

Products use the metric in which the outputs' noise is white. Its spectrum comes from the residuals that remain after fitting
parameters *and* all candidates, flight by flight, because what a model lacks must not pass for noise. A flight's own unknowns
(initial states, local constants) are eliminated. The effect of errors in the inputs (`estimation.estimators.input_error`) is
represented by random draws, simulated nulls that calibrate the scores.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from estimation.engine.simulate import Simulator
from estimation.estimators.coloured import ResidualSegment, noise_spectrum, white_products, without_nuisance
from estimation.estimators.input_error import (
    LEAST_NOISE,
    Disturbed,
    InputErrorEvidence,
    common_error,
    disturbed_outputs,
    edge_size,
)
from estimation.estimators.input_path import at_paths_of
from estimation.estimators.likelihood import LikelihoodPoint, OutputErrorProblem
from estimation.estimators.normal_equations import projected_out, pseudo_inverse
from estimation.estimators.output_error import in_pieces_of
from estimation.estimators.result import Result
from estimation.estimators.uncertainty import input_lags, segments_in_noise, white_responses
from estimation.models.base import Model
from estimation.prepare.flight_data import FlightData, Segment
from estimation.structure.candidates import Candidate, CandidateKind, structure_candidates, with_candidates

Array = NDArray[np.float64]

INDEPENDENT = 1e-6
"""Share of a candidate's squared column that must remain after projecting out the parameters: with less it is a combination of
them, which no data can separate."""


@dataclass(frozen=True)
class FlightProducts:
    """Products of one flight, columns [shared parameters | candidates | residual], its own unknowns eliminated.

    gram: (columns, columns) weighed by the noise spectrum; output_error_gram: without the residual, weighed by the residual
    variances as output error does. noise, edges: (columns, draws), common: (columns, errors), products with the response to input
    errors.
    """

    name: str
    gram: Array
    output_error_gram: Array
    noise: Array
    edges: Array
    common: Array

    def in_order(self, index: NDArray[np.intp]) -> "FlightProducts":
        """The products for the columns `index`, whose last is the residual."""
        block, inner = np.ix_(index, index), np.ix_(index[:-1], index[:-1])
        return FlightProducts(
            self.name,
            self.gram[block],
            self.output_error_gram[inner],
            self.noise[index],
            self.edges[index],
            self.common[index],
        )


@dataclass(frozen=True)
class LinearisedFit:
    """All flights of a fit. shared: names of the parameters, values: their estimates, prior: (n, n) information of their priors;
    tested: candidates. edges: size of errors in the steps' times; common: (errors, errors) covariance of common input errors."""

    shared: tuple[str, ...]
    values: Array
    tested: tuple[Candidate, ...]
    flights: tuple[FlightProducts, ...]
    prior: Array
    edges: float
    common: Array

    @property
    def n(self) -> int:
        """Number of shared parameters."""
        return len(self.shared)

    def total(self, members: Sequence[int] | None = None) -> Array:
        """Gram matrix summed over some flights (default: all), with priors."""
        grams = [f.gram for i, f in enumerate(self.flights) if members is None or i in members]
        gram = np.sum(grams, axis=0)
        gram[: self.n, : self.n] += self.prior
        return np.asarray(gram)

    def output_error_gram(self) -> Array:
        """The same over all flights, weighed as output error does, without the residual."""
        gram = np.sum([f.output_error_gram for f in self.flights], axis=0)
        gram[: self.n, : self.n] += self.prior
        return np.asarray(gram)

    def without(self, kind: CandidateKind) -> "LinearisedFit":
        """The fit without candidates of a kind."""
        n, remaining = self.n, [k for k, c in enumerate(self.tested) if c.kind is not kind]
        order = np.array([*range(n), *(n + k for k in remaining), n + len(self.tested)], np.intp)
        flights = tuple(f.in_order(order) for f in self.flights)
        return replace(self, tested=tuple(self.tested[k] for k in remaining), flights=flights)

    def absorbing(self, names: Collection[str]) -> "LinearisedFit":
        """The fit with some candidates moved to the parameters, with the value zero."""
        n = self.n
        absorbed = [k for k, c in enumerate(self.tested) if c.name in names]
        remaining = [k for k in range(len(self.tested)) if k not in absorbed]
        columns = len(self.tested) + n
        order = np.array([*range(n), *(n + k for k in absorbed), *(n + k for k in remaining), columns], int)
        prior = np.zeros((n + len(absorbed), n + len(absorbed)))
        prior[:n, :n] = self.prior
        return replace(
            self,
            shared=(*self.shared, *(self.tested[k].name for k in absorbed)),
            values=np.concatenate([self.values, np.zeros(len(absorbed))]),
            tested=tuple(self.tested[k] for k in remaining),
            flights=tuple(f.in_order(order) for f in self.flights),
            prior=prior,
        )

    def input_error_covariance(self, combine: Array) -> Array:
        """(rows, rows) covariance of scores due to input errors. combine: (rows, columns), the scores' linear combinations."""
        total = np.zeros((len(combine), len(combine)))
        projection = np.zeros((len(combine), self.common.shape[0]))
        for f in self.flights:
            for draws, size in ((f.noise, 1.0), (f.edges, self.edges)):
                if draws.shape[1]:
                    combined = combine @ draws
                    total += size / draws.shape[1] * (combined @ combined.T)
            projection += combine @ f.common
        return total + projection @ self.common @ projection.T


def linearise_fit(result: Result, data: Sequence[FlightData], substeps: int = 2) -> LinearisedFit | None:
    """The fit linearised with all candidates of its model; None where its motion cannot be simulated.

    result: of any method; data: its flights, prepared for its model.
    """
    tested = structure_candidates(result.model)
    model = at_paths_of(with_candidates(result.model.with_starts(result.fitted_model.starts()), tested), result)
    flights = _with_states(in_pieces_of(list(data), result), model)
    problem = OutputErrorProblem(model, flights, Simulator.build(model, substeps=substeps))
    unknowns = problem.pack(model.starts(), [list(f.initial_states) for f in result.flights])
    for i, flight in enumerate(result.flights):
        problem.set_local(unknowns, i, {n: e.estimate for n, e in flight.local.items()})
    point = problem.evaluate(unknowns, derivatives=True)
    if not np.isfinite(point.cost):
        return None
    products = [_products(problem, unknowns, point, i) for i in range(len(flights))]
    evidence = [e for _, e in products]
    edges = edge_size(evidence)
    shared = tuple(problem.free[i] for i in problem.shared)
    n = len(shared) - len(tested)
    linear = LinearisedFit(
        shared[:n],
        unknowns[:n].copy(),
        tested,
        tuple(p for p, _ in products),
        np.diag(problem.prior_weight[problem.shared[:n]]),
        edges,
        common_error(evidence, edges),
    )
    return _without_dependent(linear)


def _with_states(flights: list[FlightData], model: Model) -> list[FlightData]:
    """Flights whose initial states include the states that candidates append to the model's: each starts at its source state."""
    names = model.state_names
    sources = [names.index(s.start) for s in model.states if isinstance(s.start, str) and s.start in names]

    def extended(s: Segment) -> Segment:
        appended = len(names) - len(s.x0)
        return replace(s, x0=np.append(s.x0, s.x0[sources[-appended:]])) if appended else s

    return [replace(f, segments=tuple(extended(s) for s in f.segments)) for f in flights]


def _without_dependent(linear: LinearisedFit) -> LinearisedFit:
    """The fit without candidates that these flights do not excite, or that are combinations of the parameters."""
    gram, n = linear.total(), linear.n
    rest = projected_out(gram, n)
    raw = np.diag(gram)[n:-1]
    keep = np.flatnonzero(np.diag(rest)[:-1] > INDEPENDENT * np.maximum(raw, 1e-300))
    index = np.concatenate([np.arange(n), n + keep, [len(gram) - 1]]).astype(np.intp)
    flights = tuple(f.in_order(index) for f in linear.flights)
    tested = tuple(linear.tested[k] for k in keep)
    return replace(linear, tested=tested, flights=flights)


def _products(
    problem: OutputErrorProblem, unknowns: Array, point: LikelihoodPoint, index: int
) -> tuple[FlightProducts, InputErrorEvidence]:
    """Inner products of one flight, and the evidence in its residuals of errors in the inputs."""
    pieces = segments_in_noise(problem, point, index)
    state_covariances = [pseudo_inverse(p.nuisance.T @ p.nuisance)[0] for p in pieces]
    responses = disturbed_outputs(problem, unknowns, index)
    white = white_responses(pieces, state_covariances, responses, point)
    inverse, residuals = _after_full_fit(pieces, state_covariances)
    projected = without_nuisance(pieces, state_covariances)
    quiet = [w[:, : responses[0].noise] for w in white]
    change = inverse @ np.sum([J.T @ w for J, w in zip(projected, quiet, strict=True)], axis=0)
    lags = input_lags(residuals, projected, quiet, change)
    spectrum = noise_spectrum(residuals, projected, inverse, state_covariances, lags)
    metric = np.linalg.inv(spectrum + LEAST_NOISE * np.eye(problem.ny)).astype(np.complex128)
    order = np.concatenate([problem.local, problem.shared])
    grams = [
        projected_out(white_products(p, w, metric), p.nuisance.shape[1]) for p, w in zip(pieces, white, strict=True)
    ]
    gram = np.asarray(np.sum(grams, axis=0))
    rest = projected_out(gram, len(problem.free))
    columns = np.concatenate([order, np.arange(len(problem.free), len(gram))])
    gram = projected_out(gram[np.ix_(columns, columns)], len(problem.local))
    stacked = np.concatenate(projected)[:, order]
    unweighted = projected_out(stacked.T @ stacked, len(problem.local))
    evidence = InputErrorEvidence(rest, responses[0].noise, responses[0].edges)
    return _split_products(problem.flights[index].name, gram, unweighted, responses[0]), evidence


def _split_products(name: str, gram: Array, unweighted: Array, kinds: Disturbed) -> FlightProducts:
    """The products from a gram matrix with the columns [shared and candidates | noise, edges, common | residual]."""
    n = len(unweighted)
    rows = np.concatenate([np.arange(n), [len(gram) - 1]])
    noise, edges, common = np.split(gram[rows][:, n:-1], [kinds.noise, kinds.noise + kinds.edges], axis=1)
    return FlightProducts(name, gram[np.ix_(rows, rows)], unweighted, noise, edges, common)


def _after_full_fit(
    pieces: list[ResidualSegment], state_covariances: list[Array]
) -> tuple[Array, list[ResidualSegment]]:
    """(covariance of parameters and candidates, pieces with the residual after fitting all of them)."""
    projected = without_nuisance(pieces, state_covariances)
    stacked = np.concatenate(projected)
    inverse = pseudo_inverse(stacked.T @ stacked)[0]
    flat = [p.residual.ravel() for p in pieces]
    change = inverse @ (stacked.T @ np.concatenate(flat))
    fitted = []
    for p, J, r, covariance in zip(pieces, projected, flat, state_covariances, strict=True):
        rest = r - J @ change
        if p.nuisance.shape[1]:
            rest = rest - p.nuisance @ (covariance @ (p.nuisance.T @ rest))
        fitted.append(ResidualSegment(rest.reshape(p.residual.shape) * p.known, p.jacobian, p.nuisance, p.known))
    return inverse, fitted
