"""Estimates with their spread from training rows, for one problem or for many side by side.

A problem is a flight, or several flights with shared parameters. There are three rounds of training, each over all problems at
once so that a batch fills the machine: candidate networks, judged by held-out blocks; the best of them, trained further on all
rows; the networks of the block bootstrap. In between the parameters are fitted problem by problem. Results of a problem depend
on its rows and the seed alone, not on the other problems (but for rounding).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import torch
from numpy.typing import NDArray

from estimation.estimators.neural_gauss_newton.formulation import FlightUnknowns, TrainingRows
from estimation.estimators.neural_gauss_newton.frozen import (
    Frozen,
    FrozenFit,
    Predict,
    Regressors,
    fit_parameters,
    fit_with_instruments,
)
from estimation.estimators.neural_gauss_newton.network import NetworkShape, initial_weights
from estimation.estimators.neural_gauss_newton.training import Job, NgnOptions, Trained, mean_square, train_jobs

Array = NDArray[np.float64]

SEEDS = 2**63  # torch takes smaller seeds; that of a campaign is a digest
BOOTSTRAP_STREAM = 64  # of random numbers, beside the seed
FEW_STEPS = 3  # of the parameters in a bootstrap, which starts at the solution


@dataclass(frozen=True)
class NeuralSolution:
    """theta: (n,) estimates; bound, spread: (n, n) covariances, Cramer-Rao, and of bootstrap and ensemble; members: (ensemble, n)
    estimates; bootstrap: (bootstraps, n) estimates minus those of the network from which each started."""

    theta: Array
    bound: Array
    spread: Array
    members: Array
    bootstrap: Array
    fits: tuple[FrozenFit, ...]
    trained: tuple[Trained, ...]


class NeuralProblem:
    """One set of rows with its unknowns, to be fitted with any network."""

    def __init__(self, rows: TrainingRows, unknowns: FlightUnknowns, options: NgnOptions) -> None:
        self.rows, self.unknowns, self.options = rows, unknowns, options
        self.shape = NetworkShape(rows.u.shape[1], options.hidden, rows.z.shape[1], skip=options.improved)
        self.counts = [len(s.u) for s in rows.stretches]
        self.smooth = [Regressors(rows.axis, s, s.smooth) for s in rows.stretches]
        self.measured: list[Regressors] = []
        self.instruments: list[Regressors] = []
        if options.instruments:
            self.measured = [Regressors(rows.axis, s, s.signals) for s in rows.stretches]
            predicted = zip(rows.stretches, rows.instruments(), strict=True)
            self.instruments = [Regressors(rows.axis, s, i) for s, i in predicted]

    def job(self, weight: torch.Tensor, start: torch.Tensor) -> Job:
        """Training of one network on all rows, weighted."""
        return Job(self.shape, self.rows.u, self.rows.z, weight, start)

    def predict(self, frozen: Frozen, regressors: Sequence[Regressors]) -> Predict:
        """Function of the unknowns that gives residuals and slopes of all stretches."""

        def predict(theta: Array) -> tuple[list[Array], list[Array]]:
            residuals, slopes = [], []
            for stretch, flight, stretch_regressors in zip(
                self.rows.stretches, self.rows.flight, regressors, strict=True
            ):
                r, s = frozen.residual_and_slope(stretch, stretch_regressors, self.unknowns.of_flight(flight, theta))
                residuals.append(r)
                slopes.append(self.unknowns.scatter(flight, s))
            return residuals, slopes

        return predict

    @cached_property
    def regression(self) -> Array:
        """(n,) parameters with which the model's coefficients are nearest to the measured ones.

        A network was not trained on coefficients unlike those of the flight, so a fit from beliefs of another aircraft would not
        find these.
        """

        def coefficients(theta: Array) -> tuple[list[Array], list[Array]]:
            residuals, slopes = [], []
            for stretch, flight, stretch_regressors in zip(
                self.rows.stretches, self.rows.flight, self.smooth, strict=True
            ):
                model, d_theta = stretch_regressors(self.unknowns.of_flight(flight, theta))
                residuals.append(stretch.u[:, -model.shape[1] :] - model)
                slopes.append(self.unknowns.scatter(flight, d_theta))
            return residuals, slopes

        return fit_parameters(coefficients, self.counts, [self.unknowns.start]).theta

    def fit(self, weights: torch.Tensor) -> FrozenFit:
        """Gauss-Newton with one frozen network; in the improved form then the root with instruments."""
        frozen = Frozen(self.shape, weights, self.rows.standard)
        smooth = self.predict(frozen, self.smooth)
        fitted = fit_parameters(smooth, self.counts, [self.unknowns.start, self.regression])
        if not self.instruments:
            return fitted
        return fit_with_instruments(
            self.predict(frozen, self.measured), self.predict(frozen, self.instruments), self.counts, fitted.theta
        )

    def refit(self, weights: torch.Tensor, start: Array, multiplicity_of_rows: Array) -> Array:
        """(n,) parameters with another network on resampled rows, by a few steps from a solution."""
        frozen = Frozen(self.shape, weights, self.rows.standard)
        multiplicity = self.rows.split(multiplicity_of_rows)
        if not self.instruments:
            return fit_parameters(
                self.predict(frozen, self.smooth), self.counts, [start], multiplicity=multiplicity, iterations=FEW_STEPS
            ).theta
        return fit_with_instruments(
            self.predict(frozen, self.measured),
            self.predict(frozen, self.instruments),
            self.counts,
            start,
            multiplicity=multiplicity,
            iterations=FEW_STEPS,
        ).theta


def solve_problems(problems: Sequence[NeuralProblem], options: NgnOptions) -> list[NeuralSolution]:
    """Train, freeze, estimate; then again for the bootstrap."""
    trained = _trained(problems, options)
    fitted = [[p.fit(t.weights) for t in nets] for p, nets in zip(problems, trained, strict=True)]
    multiplicities = [_bootstrap_weights(p, options) for p in problems]
    jobs = [
        p.job(torch.as_tensor(row), nets[k % len(nets)].weights)
        for p, nets, rows in zip(problems, trained, multiplicities, strict=True)
        for k, row in enumerate(rows)
    ]
    short = replace(options.training, iterations=options.bootstrap_iterations)
    retrained = iter(train_jobs(jobs, short, options.device))
    solutions = []
    for problem, nets, fits, rows in zip(problems, trained, fitted, multiplicities, strict=True):
        deviations = [
            problem.refit(next(retrained)[0], fits[k % len(fits)].theta, row) - fits[k % len(fits)].theta
            for k, row in enumerate(rows)
        ]
        bootstrap = np.array(deviations).reshape(-1, problem.unknowns.size)
        solutions.append(_solution(fits, nets, bootstrap))
    return solutions


def generator_of(seed: int, member: int) -> torch.Generator:
    """Random numbers of one network of an ensemble; seed: any integer from 0."""
    return torch.Generator().manual_seed((1000 * seed + member) % SEEDS)


def _trained(problems: Sequence[NeuralProblem], options: NgnOptions) -> list[list[Trained]]:
    """The ensemble of every problem: the best restarts by the held-out blocks, trained further on all rows."""
    training, members = options.training, max(1, options.ensemble)
    tries = members * training.restarts
    jobs = []
    for problem in problems:
        training_rows = (~problem.rows.held_out).double()
        for member in range(members):
            starts = initial_weights(problem.shape, generator_of(options.seed, member), training.restarts)
            jobs += [problem.job(training_rows, start) for start in starts]
    candidates = train_jobs(jobs, training, options.device)
    best_nets: list[tuple[torch.Tensor, int, float]] = []
    for i, problem in enumerate(problems):
        for member in range(members):
            first = i * tries + member * training.restarts
            best_nets.append(_best(problem, candidates[first : first + training.restarts]))
    final_jobs = [
        problem.job(torch.ones(len(problem.rows.u), dtype=torch.float64), best_nets[i * members + k][0])
        for i, problem in enumerate(problems)
        for k in range(members)
    ]
    finished = train_jobs(final_jobs, training, options.device)
    return [
        [
            Trained(
                w, mean_square(p.shape, w, p.rows.u, p.rows.z, torch.ones(len(p.rows.u))), selected[2], selected[1] + n
            )
            for (w, n), selected in zip(
                finished[i * members : (i + 1) * members], best_nets[i * members : (i + 1) * members], strict=True
            )
        ]
        for i, p in enumerate(problems)
    ]


def _best(problem: NeuralProblem, candidates: Sequence[tuple[torch.Tensor, int]]) -> tuple[torch.Tensor, int, float]:
    """Weights, iterations and held-out error of the network that predicts held-out rows best."""
    rows = problem.rows
    validation = rows.held_out.double() if rows.held_out.any() else torch.ones(len(rows.u), dtype=torch.float64)
    errors = [mean_square(problem.shape, w, rows.u, rows.z, validation) for w, _ in candidates]
    lowest = int(np.nanargmin(errors))
    return *candidates[lowest], errors[lowest]


def _bootstrap_weights(problem: NeuralProblem, options: NgnOptions) -> Array:
    """(bootstraps, M) how often each row is drawn."""
    rng = np.random.default_rng([options.seed, BOOTSTRAP_STREAM])
    multiplicities = [problem.rows.resampled(rng) for _ in range(options.bootstraps)]
    return np.array(multiplicities).reshape(options.bootstraps, len(problem.rows.u))


def _solution(fits: Sequence[FrozenFit], trained: Sequence[Trained], bootstrap: Array) -> NeuralSolution:
    members = np.stack([f.theta for f in fits])
    bound = np.mean([np.linalg.pinv(f.information, hermitian=True) for f in fits], axis=0)
    spread = np.atleast_2d(np.cov(bootstrap, rowvar=False)) if len(bootstrap) > 1 else bound
    if len(members) > 1:
        spread = spread + np.atleast_2d(np.cov(members, rowvar=False)) / len(members)
    return NeuralSolution(members.mean(axis=0), bound, spread, members, bootstrap, tuple(fits), tuple(trained))
