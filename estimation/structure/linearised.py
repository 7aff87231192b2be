"""One fit with everything that its model may lack beside it, linearised: inner products of sensitivities and residuals.

Products are in the metric in which the outputs' noise is white. That noise is found of what is left once parameters *and*
everything that may be lacking have been fitted, flight by flight: what a model lacks must not pass for noise. A flight's own
unknowns (initial states, constants of the day) are eliminated. What the inputs' errors put in
(`estimation.estimators.input_error`) is kept as draws: simulated nulls, by which scores are calibrated.
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

SEEN = 1e-6
"""Share of a column that parameters must leave over: less is a combination of them, which no data can tell from the model."""


@dataclass(frozen=True)
class FlightProducts:
    """One flight, columns [shared parameters | candidates | residual], its own unknowns eliminated. gram: as weighed by the
    noise; plain: weighed by the variances of the residuals, as output error does (without the residual). noise, edges:
    (columns, draws) and common: (columns, errors) products with what the inputs' errors do to the outputs."""

    name: str
    gram: Array
    plain: Array
    noise: Array
    edges: Array
    common: Array

    def in_order(self, index: NDArray[np.intp]) -> "FlightProducts":
        """Some columns, in another order; the residual last."""
        pick, inner = np.ix_(index, index), np.ix_(index[:-1], index[:-1])
        return FlightProducts(
            self.name, self.gram[pick], self.plain[inner], self.noise[index], self.edges[index], self.common[index]
        )


@dataclass(frozen=True)
class LinearisedFit:
    """All flights of a fit. shared: parameters; values: theirs; tested: candidates. prior: information of priors on the
    shared ones."""

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
        """Gram matrix over some flights (all), priors included."""
        grams = [f.gram for i, f in enumerate(self.flights) if members is None or i in members]
        gram = np.sum(grams, axis=0)
        gram[: self.n, : self.n] += self.prior
        return np.asarray(gram)

    def plain(self) -> Array:
        """The same as output error weighs it."""
        gram = np.sum([f.plain for f in self.flights], axis=0)
        gram[: self.n, : self.n] += self.prior
        return np.asarray(gram)

    def without(self, kind: CandidateKind) -> "LinearisedFit":
        """The same without candidates of a kind."""
        n, remaining = self.n, [k for k, c in enumerate(self.tested) if c.kind is not kind]
        order = np.array([*range(n), *(n + k for k in remaining), n + len(self.tested)], np.intp)
        flights = tuple(f.in_order(order) for f in self.flights)
        return replace(self, tested=tuple(self.tested[k] for k in remaining), flights=flights)

    def absorbing(self, names: Collection[str]) -> "LinearisedFit":
        """The same with some candidates counted among the parameters, at nothing."""
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

    def by_inputs(self, combine: Array) -> Array:
        """(rows, rows) covariance of scores from the inputs' errors. combine: (rows, columns) of what is scored."""
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
    """A fit with what its model may lack beside it; None where its motion cannot be simulated.

    result: by any method; data: its flights, prepared for its model.
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
    return _visible(linear)


def _with_states(flights: list[FlightData], model: Model) -> list[FlightData]:
    """Flights whose segments begin with the states that candidates have put behind the model's: each at the one it follows."""
    names = model.state_names
    follows = [names.index(s.start) for s in model.states if isinstance(s.start, str) and s.start in names]

    def begun(s: Segment) -> Segment:
        behind = len(names) - len(s.x0)
        return replace(s, x0=np.append(s.x0, s.x0[follows[-behind:]])) if behind else s

    return [replace(f, segments=tuple(begun(s) for s in f.segments)) for f in flights]


def _visible(linear: LinearisedFit) -> LinearisedFit:
    """Without candidates that these flights do not excite, or that are combinations of the parameters."""
    gram, n = linear.total(), linear.n
    rest = projected_out(gram, n)
    raw = np.diag(gram)[n:-1]
    keep = np.flatnonzero(np.diag(rest)[:-1] > SEEN * np.maximum(raw, 1e-300))
    index = np.concatenate([np.arange(n), n + keep, [len(gram) - 1]]).astype(np.intp)
    flights = tuple(f.in_order(index) for f in linear.flights)
    tested = tuple(linear.tested[k] for k in keep)
    return replace(linear, tested=tested, flights=flights)


def _products(
    problem: OutputErrorProblem, unknowns: Array, point: LikelihoodPoint, index: int
) -> tuple[FlightProducts, InputErrorEvidence]:
    """Inner products of one flight, and what its residuals show of edges and timing."""
    pieces = segments_in_noise(problem, point, index)
    state_covariances = [pseudo_inverse(p.nuisance.T @ p.nuisance)[0] for p in pieces]
    responses = disturbed_outputs(problem, unknowns, index)
    white = white_responses(pieces, state_covariances, responses, point)
    inverse, residuals = _without_everything(pieces, state_covariances)
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
    return _sorted(problem.flights[index].name, gram, unweighted, responses[0]), InputErrorEvidence(
        rest, responses[0].noise, responses[0].edges
    )


def _sorted(name: str, gram: Array, unweighted: Array, kinds: Disturbed) -> FlightProducts:
    """Products with the columns in their places: gram has [shared and candidates | noise, edges, common | residual]."""
    n = len(unweighted)
    rows = np.concatenate([np.arange(n), [len(gram) - 1]])
    noise, edges, common = np.split(gram[rows][:, n:-1], [kinds.noise, kinds.noise + kinds.edges], axis=1)
    return FlightProducts(name, gram[np.ix_(rows, rows)], unweighted, noise, edges, common)


def _without_everything(
    pieces: list[ResidualSegment], state_covariances: list[Array]
) -> tuple[Array, list[ResidualSegment]]:
    """(covariance of parameters and candidates, pieces with the residual that a fit of all of them leaves)."""
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
