"""Refits of a maximum-likelihood fit: uncertainty where the log likelihood is no parabola.

Parametric bootstrap (B. Efron and R. J. Tibshirani, An Introduction to the Bootstrap, sections 6.5 and 13.3): simulate at the
estimate, add noise like the residuals, fit again, many times. It needs no linearisation and shows bias and skewness of the
estimates, which a bound cannot. The noise has the covariance between outputs and the colour of the residuals, from the spectrum
of the corrected bound (`estimators.coloured`); remaining noise of the inputs is drawn anew (`estimators.input_error`).

Profile likelihood: how fast the fit worsens as one parameter leaves its estimate while all others are fitted again. It shows
limits, curvature and one-sided knowledge. The 95 % interval contains the values whose deviance 2 (J - J_min) is below 3.84
(chi-square, one degree of freedom; Y. Pawitan, In All Likelihood, section 3.4), if residuals are white; where they are coloured,
the deviance is scaled by the squared ratio of Cramer-Rao to corrected bound (R. E. Chandler and S. Bate, Biometrika 94(1), 2007,
equation 8).
"""

import math
from dataclasses import replace

import numpy as np

from estimation.engine.kernel import Array
from estimation.errors import EstimationError
from estimation.estimators.coloured import Spectrum, coloured_noise, square_root
from estimation.estimators.gauss_newton import minimise
from estimation.estimators.input_error import Disturbed, disturbed_outputs
from estimation.estimators.likelihood import LikelihoodPoint, OutputErrorProblem
from estimation.estimators.output_error import STANDARD, Fit, OutputErrorOptions, build_problem, reopen_fit
from estimation.estimators.result import Bootstrap, Profile, Result, Spread
from estimation.estimators.uncertainty import noise_spectra
from estimation.models.base import Model
from estimation.prepare.flight_data import FlightData
from estimation.prepare.pipeline import FlightsToFit

FEWEST_REPLICATES = 10
PERCENTILES = (2.5, 97.5)  # ends of a 95 % interval
ROOT_95 = 1.959963984540054  # square root of the 95 % point of chi-square, one degree of freedom
BEYOND = 1.15  # of the expected half-width: how far the curve is drawn
FARTHEST = 4.0  # times that, where the interval is longer than expected
FEWEST_POINTS = 5
BETTER = -0.01  # deviance: a fit this much better than the estimate is no rounding


def parametric_bootstrap(
    model: Model | str,
    flights: FlightsToFit,
    result: Result,
    replicates: int,
    rng: np.random.Generator,
    options: OutputErrorOptions = STANDARD,
) -> Bootstrap:
    """Spread of every estimate over `replicates` simulated flights like the given ones; `result` and `options` are those of the
    fit.

    Raises EstimationError for too few replicates.
    """
    check_replicates(replicates)
    if not result.converged:
        return Bootstrap((), np.zeros((0, 0)), {}, 0, f"no bootstrap: {result.text}")
    problem, fit = reopen_fit(model, flights, result, options)
    point = fit.point
    options = replace(options, substeps=problem.simulator.substeps)
    roots = [square_root(s) for s in noise_spectra(problem, fit.unknowns, point)]
    inputs = [disturbed_outputs(problem, fit.unknowns, i) for i in range(len(problem.flights))]
    rows = []
    for _ in range(replicates):
        replicate = build_problem(
            _prior_redrawn(problem, fit, rng), _repeated(problem, point, roots, inputs, rng), options
        )
        outcome = minimise(replicate, fit.unknowns, options.loop)
        if outcome.status.usable:
            rows.append(_mean_over_flights(problem, outcome.unknowns))
    names = tuple(n for n in problem.free if n in result.parameters and np.isfinite(result.parameters[n].std))
    if len(rows) < FEWEST_REPLICATES:
        return Bootstrap(
            names, np.zeros((0, len(names))), {}, replicates - len(rows), "hardly any replicate could be fitted"
        )
    index = [problem.free.index(n) for n in names]
    estimates, center = np.array(rows)[:, index], _mean_over_flights(problem, fit.unknowns)[index]
    low, high = np.percentile(estimates, PERCENTILES, axis=0)
    std, bias = estimates.std(axis=0, ddof=1), estimates.mean(axis=0) - center
    spreads = {n: Spread(float(std[i]), float(bias[i]), (float(low[i]), float(high[i]))) for i, n in enumerate(names)}
    return Bootstrap(names, estimates, spreads, replicates - len(rows))


def check_replicates(replicates: int) -> None:
    """EstimationError where they are too few."""
    if replicates < FEWEST_REPLICATES:
        raise EstimationError(
            f"{replicates} replicates make no bootstrap: at least {FEWEST_REPLICATES} are needed, 100 or more of use"
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
    """The flights as another measurement might show them, with the same samples missing."""
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


def _prior_redrawn(problem: OutputErrorProblem, fit: Fit, rng: np.random.Generator) -> Model:
    """The model with its prior means redrawn: a prior is an earlier measurement, and a repetition would differ."""
    values = problem.values(fit.unknowns, 0)
    return problem.model.with_prior(
        **{
            p.name: (values[p.name] + p.prior_std * float(rng.standard_normal()), p.prior_std)
            for p in problem.model.parameters
            if p.prior_std is not None and not p.fixed
        }
    )


def profile_likelihood(
    model: Model | str,
    flights: FlightsToFit,
    parameter: str,
    result: Result,
    points: int = 13,
    options: OutputErrorOptions = STANDARD,
) -> Profile:
    """Profile of one parameter at about `points` values; `result` and `options` are those of the fit.

    Raises EstimationError for too few points or a parameter that was not estimated, ModelError for an unknown one.
    """
    if points < FEWEST_POINTS:
        raise EstimationError(f"{points} points make no profile of {parameter}: at least {FEWEST_POINTS} are needed")
    if result.model.parameter(parameter).fixed:
        raise EstimationError(f"model {result.model.name}: {parameter} is fixed, so it has no profile; free it first")
    estimate = result.parameters[parameter]
    if no_curve := _no_curve(result, parameter):
        everything = (-math.inf, math.inf)
        return Profile(parameter, estimate.estimate, np.zeros(0), np.zeros(0), everything, everything, no_curve)
    problem, fit = reopen_fit(model, flights, result, options)
    line = _ProfileLine(problem, fit, parameter, replace(options, substeps=problem.simulator.substeps))
    ratio = estimate.std_coloured / estimate.std
    reach = BEYOND * ROOT_95 * ratio * estimate.std
    lower_side, upper_side = (line.side(s * reach / (points // 2), points // 2, ROOT_95 * ratio) for s in (-1.0, 1.0))
    knots = [*reversed(lower_side), (line.center, 0.0), *upper_side]
    values = np.array([k[0] for k in knots])
    deviance = np.maximum([k[1] for k in knots], 0.0)
    root = np.copysign(np.sqrt(deviance), values - line.center)
    ends = [_interval(values, root, level, line.limits) for level in (ROOT_95, ROOT_95 * ratio)]
    unbounded = any(not math.isfinite(v) for v in ends[1])
    text = f"the data sets {parameter} no end within {FARTHEST:g} times its bound" if unbounded else ""
    if line.better_fit_found:
        text = "a better fit was found beside the estimate: the fit had not reached the best; start it from elsewhere"
    return Profile(parameter, line.center, values, deviance, ends[0], ends[1], text)


def _no_curve(result: Result, parameter: str) -> str:
    """Why a parameter has no profile, empty where it has one."""
    if not result.converged:
        return f"no profile: {result.text}"
    if parameter not in result.names:
        return f"{parameter} is each flight's own in this fit: profile it flight by flight"
    estimate = result.parameters[parameter]
    return "" if math.isfinite(estimate.std) else estimate.why


class _ProfileLine:
    """Refits along one parameter, each from its neighbour. center: value at the optimum."""

    def __init__(self, problem: OutputErrorProblem, fit: Fit, name: str, options: OutputErrorOptions) -> None:
        self.problem, self.name, self.options = problem, name, options
        self.index = [problem.free[i] for i in problem.shared].index(name)
        self.best, self.center = fit.unknowns, float(fit.unknowns[self.index])
        self.lowest = fit.point.cost  # with the parameter's own prior
        parameter = problem.model.parameter(name)
        self.limits = (parameter.lower, parameter.upper)
        self.better_fit_found = False

    def _prior(self, value: float) -> float:
        """Cost of the parameter's prior, which a refit with the parameter fixed does not include."""
        parameter = self.problem.model.parameter(self.name)
        if parameter.prior_mean is None or parameter.prior_std is None:
            return 0.0
        return 0.5 * ((value - parameter.prior_mean) / parameter.prior_std) ** 2

    def side(self, step: float, count: int, level: float) -> list[tuple[float, float]]:
        """(value, deviance) outward from the estimate: `count` steps, and more until the root of deviance passes `level`."""
        curve: list[tuple[float, float]] = []
        unknowns = np.delete(self.best, self.index)
        for k in range(1, math.ceil(FARTHEST * count) + 1):
            if k > count and math.sqrt(max(curve[-1][1], 0.0)) >= level:
                break
            value = min(max(self.center + k * step, self.limits[0]), self.limits[1])
            if value == (curve[-1][0] if curve else self.center):  # at a limit
                break
            constrained = build_problem(
                self.problem.model.fixed(**{self.name: value}), self.problem.flights, self.options
            )
            outcome = minimise(constrained, unknowns, self.options.loop)
            if not outcome.status.usable:
                break
            unknowns = outcome.unknowns
            deviance = 2.0 * (outcome.point.cost + self._prior(value) - self.lowest)
            self.better_fit_found |= deviance < BETTER
            curve.append((value, deviance))
        return curve


def _interval(values: Array, root: Array, level: float, limits: tuple[float, float]) -> tuple[float, float]:
    """Where the signed root of deviance passes -level and level, by lines between points, because it is nearly straight."""
    ends = []
    center = int(np.flatnonzero(root == 0.0)[0])
    for side, limit in zip((-1, 1), limits, strict=True):
        x, r = values[center::side], np.abs(root[center::side])
        crossings = np.flatnonzero(r >= level)
        if crossings.size:
            k = int(crossings[0])
            ends.append(float(x[k - 1] + (level - r[k - 1]) / (r[k] - r[k - 1]) * (x[k] - x[k - 1])))
        else:
            ends.append(limit if x[-1] == limit else side * math.inf)
    return ends[0], ends[1]
