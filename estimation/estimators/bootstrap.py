"""Parametric bootstrap: simulate at the estimate, add noise like the residuals, fit again, many times.

It needs no linearisation: bias and skewness of the estimates show, which a bound cannot. The noise has the covariance
between outputs and the colour of the residuals, from the same autoregressive spectrum as the corrected bound, raised by
what the fit took away (`estimators.coloured`), and the noise that de-noising left in the inputs is drawn anew
(`estimators.input_error`). (B. Efron and R. J.
Tibshirani, An Introduction to the Bootstrap, sections 6.5 and 13.3.)
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from estimation.engine.kernel import Array
from estimation.errors import EstimationError
from estimation.estimators.coloured import Spectrum, coloured_noise, square_root
from estimation.estimators.gauss_newton import minimise
from estimation.estimators.input_error import Disturbed, disturbed
from estimation.estimators.likelihood import LikelihoodPoint, OutputErrorProblem
from estimation.estimators.output_error import STANDARD, Fit, OutputErrorOptions, build_problem, reopened
from estimation.estimators.result import Bootstrap, Result, Spread
from estimation.estimators.uncertainty import noise_spectra
from estimation.models.base import Model
from estimation.prepare.flight_data import FlightData
from groundstation.flight import Flight

FEWEST = 10  # replicates
PERCENTILES = (2.5, 97.5)


def parametric_bootstrap(
    model: Model | str,
    flights: Flight | FlightData | Sequence[Flight | FlightData],
    result: Result,
    replicates: int,
    rng: np.random.Generator,
    options: OutputErrorOptions = STANDARD,
) -> Bootstrap:
    """Spread of every estimate over `replicates` simulated repetitions; `result` and `options` are those of the fit.

    Raises EstimationError for too few replicates.
    """
    check_replicates(replicates)
    if not result.converged:
        return Bootstrap((), np.zeros((0, 0)), {}, 0, f"no bootstrap: {result.text}")
    problem, best = reopened(model, flights, result, options)
    point = best.point
    options = replace(options, substeps=problem.simulator.substeps)
    roots = [square_root(s) for s in noise_spectra(problem, best.unknowns, point)]
    inputs = [disturbed(problem, best.unknowns, i) for i in range(len(problem.flights))]
    rows = []
    for _ in range(replicates):
        again = build_problem(
            _prior_redrawn(problem, best, rng), _repeated(problem, point, roots, inputs, rng), options
        )
        outcome = minimise(again, best.unknowns, options.loop)
        if outcome.status.usable:
            rows.append(_mean_over_flights(problem, outcome.unknowns))
    names = tuple(n for n in problem.free if np.isfinite(result.parameters[n].std))
    if len(rows) < FEWEST:
        return Bootstrap(
            names, np.zeros((0, len(names))), {}, replicates - len(rows), "hardly any replicate could be fitted"
        )
    seen = [problem.free.index(n) for n in names]
    found, center = np.array(rows)[:, seen], _mean_over_flights(problem, best.unknowns)[seen]
    low, high = np.percentile(found, PERCENTILES, axis=0)
    std, bias = found.std(axis=0, ddof=1), found.mean(axis=0) - center
    spreads = {n: Spread(float(std[i]), float(bias[i]), (float(low[i]), float(high[i]))) for i, n in enumerate(names)}
    return Bootstrap(names, found, spreads, replicates - len(rows))


def check_replicates(replicates: int) -> None:
    """EstimationError where there are too few."""
    if replicates < FEWEST:
        raise EstimationError(
            f"{replicates} replicates make no bootstrap: at least {FEWEST} are needed, 100 or more of use"
        )


def _mean_over_flights(problem: OutputErrorProblem, unknowns: Array) -> Array:
    """(free parameters,): shared ones as they are, local ones as their mean."""
    return np.mean([problem.parameters(unknowns, i) for i in range(len(problem.flights))], axis=0)


def _repeated(
    problem: OutputErrorProblem,
    point: LikelihoodPoint,
    roots: list[Spectrum],
    inputs: list[list[Disturbed]],
    rng: np.random.Generator,
) -> list[FlightData]:
    """The flights as they might be measured another time, with the same samples missing."""
    factor = np.linalg.cholesky(point.R)
    repeated = []
    for flight, motions, root, responses in zip(problem.flights, point.motions, roots, inputs, strict=True):
        segments = []
        draws = responses[0].noise
        weight = rng.standard_normal(draws) / np.sqrt(max(draws, 1))
        for segment, motion, response in zip(flight.segments, motions, responses, strict=True):
            noise = coloured_noise(root, len(segment), 1, rng)[:, :, 0] @ factor.T
            noise += response.values[:, :, :draws] @ weight
            segments.append(replace(segment, z=np.where(np.isfinite(segment.z), motion.y + noise, np.nan)))
        repeated.append(replace(flight, segments=tuple(segments)))
    return repeated


def _prior_redrawn(problem: OutputErrorProblem, best: Fit, rng: np.random.Generator) -> Model:
    """A prior is a measurement made earlier: repeated, it falls elsewhere too."""
    values = problem.values(best.unknowns, 0)
    return problem.model.with_prior(
        **{
            p.name: (values[p.name] + p.prior_std * float(rng.standard_normal()), p.prior_std)
            for p in problem.model.parameters
            if p.prior_std is not None and not p.fixed
        }
    )
