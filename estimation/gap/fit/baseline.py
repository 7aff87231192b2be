"""A model fitted to the training flights, with the noise estimated from its residuals.

The fit starts at the model's own values, or at a regression of the measured motion where that costs less. An aircraft without
known derivatives states none, or only those estimated from its shape; from there the motion may run away, or the fit may end in
another minimum.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from types import MappingProxyType

import numpy as np

from estimation.engine.kernel import Array
from estimation.engine.simulate import Simulator
from estimation.errors import GapError
from estimation.estimators.equation_error import start_values
from estimation.gap.criteria import Criteria
from estimation.gap.fit.fitting import ENOUGH, cost_at, fit
from estimation.gap.fit.linear_motion import GROWS, fastest_growth, growth, linear_motion, linear_motions
from estimation.gap.fit.noise import (
    NoiseModel,
    NoisePart,
    NoiseSource,
    Shapes,
    as_seen,
    channel_noise,
    estimate_noise,
    filtered_attitudes,
    shapes_of,
    whitener,
)
from estimation.gap.fit.problem import LikelihoodProblem, ModelFit, carried_local, integration_steps
from estimation.gap.fit.surface_steps import (
    SurfaceSteps,
    displaced,
    find_surface_steps,
    freedom_of,
    loosened,
    slow_errors,
    without_slow,
)
from estimation.gap.fit.whitener import Whitener
from estimation.gap.records.candidate_model import RATE_OF
from estimation.gap.records.flight_records import FlightRecord, FlightRecords
from estimation.models.base import Model
from estimation.models.dependence import force_states
from estimation.prepare.flight_data import FlightData

PASSES = 3  # of noise and parameters in turn; a third changes both by less than their scatter on the nulls
SPARE_PASSES = 3  # more of them where the fit has not converged
ROUGH = 0.5  # of the log-likelihood: accuracy of a fit whose noise is not yet known
STEP_TURNS = 2  # of stationary noise and freedom of the surfaces in turn, the first time; one where a fit goes on
FOLDS = 3.0  # by which power of e the motion may grow in a stretch: 20 times the noise of its beginning
SHORTEST = 4.0  # s, of a stretch
CALMER = 0.5  # times the growth: so much slower another fit has to grow to be preferred
AS_GOOD = 3.0  # of the log-likelihood: which of two fits so close is better is chance
ALIKE = 0.005  # of the cost: what a change of the noise in the third digit makes where the base lacks an effect


def first_values(problem: LikelihoodProblem, known: Mapping[str, float] = MappingProxyType({})) -> dict[str, float]:
    """Shared values at which the first fit starts: of a regression, of `known` and of the model itself (an empty dict) those of
    the lowest cost. known: values of another model fitted to these flights."""
    carried_over = {n: known[n] for n in problem.parameters if n in known and not problem.nuisance(n)}
    candidates = [values for values in (by_regression(problem), carried_over) if values]
    return min([{}, *candidates], key=lambda values: cost_at(problem, values)) if candidates else {}


def by_regression(problem: LikelihoodProblem) -> dict[str, float]:
    """Derivatives of the model by equation error over all records, nuisance parameters at their starts; empty where a state is
    not measured, or where an effect has added states."""
    if len(problem.model.states) != len(problem.base.states):
        return {}
    unknowns = tuple(n for n in problem.parameters if not problem.nuisance(n))
    flights = [
        FlightData(f"record {i}", len(r), (replace(s, first=0),), r.states, {}, (), ())
        for i, (r, s) in enumerate(zip(problem.records, problem.coarse, strict=True))
        if r.states is not None
    ]
    if len(flights) < len(problem.records):
        return {}
    estimates = start_values(Simulator.build(problem.model, unknowns, substeps=1, hold="linear"), flights)
    return {} if estimates is None else {n: estimates[n] for n in unknowns}


@dataclass(frozen=True)
class Baseline:
    """A model fitted to the training flights, with the noise of its residuals. scatter: (ny,) standard deviations of the outputs'
    white noise. clean: the model without its dormant effects. prepared: all flights, also the held-out ones."""

    problem: LikelihoodProblem
    fit: ModelFit
    noise: NoiseModel
    scatter: Array
    clean: Model
    prepared: FlightRecords

    @property
    def criteria(self) -> Criteria:
        return self.problem.criteria

    @property
    def model(self) -> Model:
        return self.problem.model

    @cached_property
    def held_out(self) -> tuple[LikelihoodProblem, ModelFit] | None:
        """`on_holdout` with the noise of this baseline; cached, for it is needed often."""
        return self.on_holdout(self.noise)

    def noise_about(
        self, model_fit: ModelFit, noise: NoiseModel | None = None
    ) -> tuple[NoiseModel, tuple[Whitener, ...]]:
        """Noise about another fit to the training flights, and the whiteners of these flights with it. noise: used as it is; by
        default the noise is estimated from the residuals of `model_fit`."""
        values, records = {**model_fit.model.starts(), **model_fit.values}, self.problem.records
        residuals, scatter = model_fit.residuals, self.scatter
        return whiteners_for(model_fit.model, self.prepared, records, values, noise, residuals, scatter, self.noise)

    def on_holdout(self, noise: NoiseModel) -> tuple[LikelihoodProblem, ModelFit] | None:
        """The fitted model on the held-out flights with `noise`: parameters frozen, initial states and biases fitted.

        None where there is no held-out flight.
        """
        records = self.prepared.of(self.prepared.holdout)
        if not records:
            return None
        values = {**self.model.starts(), **self.fit.values}
        _, whiteners = whiteners_for(self.model, self.prepared, records, values, noise, (), self.scatter)
        problem = LikelihoodProblem(self.model, self.prepared.base, records, whiteners, self.prepared.criteria)
        return problem, fit(problem, values, frozen=True)


def whiteners_for(
    model: Model,
    prepared: FlightRecords,
    records: Sequence[FlightRecord],
    values: Mapping[str, float],
    noise: NoiseModel | None,
    residuals: Sequence[Array],
    scatter: Array,
    earlier: NoiseModel | None = None,
) -> tuple[NoiseModel, tuple[Whitener, ...]]:
    """`noise`, or where None the noise estimated from `residuals`; and with it the whitener of every record.

    values: of the model's parameters, about which its motion is linearised. earlier: a noise model to start the estimate from.
    """
    base, criteria = prepared.base, prepared.criteria
    # slow errors need no finer steps than those of the fits, for half a sample; the lag of an instrument does
    has_lags = len(model.states) > len(base.states)
    longest = records[0].interval if has_lags else 0.5 * records[0].interval
    simulator = Simulator.build(model, (), substeps=integration_steps(longest), hold="linear")
    segments = [r.segment(model, base) for r in records]
    shapes, steps = [], []
    for record, segment in zip(records, segments, strict=True):
        motion = linear_motion(model, simulator, segment, values)
        shape = shapes_of(model, motion, len(segment), criteria, force_states(base), record.error_spectra)
        shapes.append(as_seen(replace(shape, louder=record.louder), np.isfinite(segment.z)))
        steps.append(find_surface_steps(model, motion, segment, criteria, record.restless))
    if noise is None:
        parts = noise_parts(records, base.output_names, scatter, criteria)
        noise = estimated_noise(residuals, shapes, steps, *parts, earlier)
    whiteners = []
    for record, segment, shape in zip(records, segments, shapes, strict=True):
        slow = slow_errors(simulator, values, segment, record.error_spectra)
        strict = whitener(noise, without_slow(shape, slow.below))
        # the displacements of a record, large arrays, are dropped as soon as its whitener has what it needs of them
        whiteners.append(loosened(strict, steps.pop(0), noise.freedom, slow.response))
    return noise, tuple(whiteners)


def estimated_noise(
    residuals: Sequence[Array],
    shapes: Sequence[Shapes],
    steps: Sequence[SurfaceSteps],
    white: Array,
    without: Collection[NoisePart],
    known: Mapping[NoisePart, float],
    earlier: NoiseModel | None,
) -> NoiseModel:
    """Stationary noise and freedom of the surfaces (`surface_steps`), estimated in turn, each from the residuals less the other.

    white: (ny,) first standard deviations of the outputs' white noise. without: parts that these flights do not have. known:
    first strengths of some parts. earlier: a noise model to go on from.
    """
    floor = (steps[0].criteria.halfway * white) ** 2

    def estimate(unexplained: Sequence[Array], start: NoiseModel | None) -> NoiseModel:
        return estimate_noise(unexplained, shapes, white**2, floor, without, known, start)

    goes_on = earlier is not None and bool(earlier.freedom)
    noise = earlier if earlier is not None and goes_on else estimate(residuals, None)
    freedom = noise.freedom
    for _ in range(1 if goes_on else STEP_TURNS):
        displacements = [
            displaced(whitener(noise, s), e, freedom, np.nan_to_num(r))
            for s, e, r in zip(shapes, steps, residuals, strict=True)
        ]
        freedom = freedom_of(steps, displacements)
        displacing = zip(residuals, steps, displacements, strict=True)
        noise = estimate([r - e.response @ mean for r, e, (mean, _) in displacing], noise)
    return replace(noise, freedom=freedom)


def noise_parts(
    records: Sequence[FlightRecord], outputs: Sequence[str], scatter: Array, criteria: Criteria
) -> tuple[Array, tuple[NoisePart, ...], dict[NoisePart, float]]:
    """(ny,) first standard deviations of the outputs' white noise, the parts these flights do not have, and first strengths of
    some that they have.

    An attitude that is measured independently in every sample has no wandering error. One that comes from a filter has, and most
    of its gyro's noise. It keeps its slow error as white noise too: such an angle is smoother than it is accurate, and how the
    filter follows the motion between two samples is not known to a hundredth of a degree.
    """
    filtered = filtered_attitudes(records, outputs, channel_noise(records), criteria)
    step = records[0].interval
    white = scatter.copy()
    strengths: dict[NoisePart, float] = {}
    for n in filtered:
        variance = scatter[outputs.index(n)] ** 2
        strengths[NoisePart(NoiseSource.WANDERING, n)] = variance / (step * criteria.filter_memory)
        if RATE_OF[n] in outputs:
            rate, shared = outputs.index(RATE_OF[n]), 1.0 - criteria.halfway**2
            strengths[NoisePart(NoiseSource.GYRO, n)] = shared * scatter[rate] ** 2
            white[rate] *= criteria.halfway
    of_filters = (NoiseSource.WANDERING, NoiseSource.GYRO)
    return white, tuple(NoisePart(s, n) for n in RATE_OF if n not in filtered for s in of_filters), strengths


def fit_baseline(
    model: Model,
    clean: Model,
    prepared: FlightRecords,
    scatter: Array,
    earlier_fit: ModelFit | None = None,
    noise: NoiseModel | None = None,
    noise_is_current: bool = False,
) -> Baseline:
    """Fit `model` to the training flights, noise and parameters in turn.

    clean: `model` without its dormant effects. scatter: (ny,) standard deviations of the outputs' white noise. earlier_fit: a fit
    of this model with `noise`, from which to go on. noise_is_current: `noise` was estimated with this model, so that one pass
    fewer is needed. Raises GapError where the motion runs away.
    """
    records = prepared.of(prepared.training)
    noise, model_fit, problem = noise or NoiseModel(scatter**2, {}), earlier_fit, None
    for turn in range(0 if earlier_fit is None else 1 + noise_is_current, PASSES + 1 + SPARE_PASSES):
        if turn > PASSES and model_fit is not None and model_fit.converged:
            break
        if model_fit is None:
            _, whiteners = whiteners_for(model, prepared, records, model.starts(), noise, (), scatter)
        else:
            values, problem = {**model.starts(), **model_fit.values}, None  # whose whiteners are large
            noise, whiteners = whiteners_for(
                model, prepared, records, values, None, model_fit.residuals, scatter, noise
            )
        problem = LikelihoodProblem(model, prepared.base, records, whiteners, prepared.criteria)
        model_fit = _fit_in_stages(problem, model_fit, turn if earlier_fit is None else PASSES)
        if model_fit.diverged:
            where = _runaway_flights(problem, model_fit, prepared)
            raise GapError(
                f"model {model.name} runs away on {where}: the baseline itself is wrong for these flights; check the aircraft "
                "file and the signs of the controls, or cut the flights into shorter segments"
            )
    assert problem is not None
    assert model_fit is not None
    baseline = Baseline(problem, model_fit, noise, scatter, clean, prepared)
    calmer = _calmer_fit(baseline) if earlier_fit is None else None
    if calmer is None:
        return baseline
    try:
        return fit_baseline(model, clean, prepared, scatter, calmer, noise, noise_is_current=True)
    except GapError:  # the calmer fit was as good only with the noise of the first
        return baseline


def _calmer_fit(baseline: Baseline) -> ModelFit | None:
    """A fit as good as one whose motion grows, but with slower growth, started at the model's own values; None where there is
    none. A missing effect can bias the base either way, and nulls that run away calibrate nothing."""
    growing = fastest_growth(baseline.problem, baseline.fit)
    if growing < GROWS:
        return None
    alternative = fit(baseline.problem, baseline.problem.starts())
    close = not alternative.diverged and alternative.cost < baseline.fit.cost + max(AS_GOOD, ALIKE * baseline.fit.cost)
    return alternative if close and fastest_growth(baseline.problem, alternative) < CALMER * growing else None


def stretch_that_holds(baseline: Baseline) -> float | None:
    """Length [s] of records over which the motion of a fit grows little, by its own values and by a regression; None where it
    does not grow, or its records are no longer."""
    problem = baseline.problem
    growing = fastest_growth(problem, baseline.fit)
    if growing < GROWS:
        return None
    if values := by_regression(problem):
        growing = max(growing, *(growth(m) for m in linear_motions(problem, values)))
    longest = max(FOLDS / growing, SHORTEST)
    return longest if longest < max(float(np.ptp(r.time)) for r in problem.records) else None


def fit_afresh(baseline: Baseline, model: Model, clean: Model) -> Baseline | None:
    """Another model fitted to the same flights with the whiteners of a baseline, so that their costs can be compared; None where
    its motion runs away.

    The better of two fits, one from first values and one from the values of the baseline: a fit in a poorer minimum would make
    the effects that `model` lacks look better than they are.
    """
    problem = replace(baseline.problem, model=model)
    fits = (_fit_in_stages(problem, None, turn=1, known=baseline.fit.values), fit_from(problem, baseline.fit))
    finite = [f for f in fits if not f.diverged]
    if not finite:
        return None
    return replace(baseline, problem=problem, fit=min(finite, key=lambda f: f.cost), clean=clean)


def fit_from(problem: LikelihoodProblem, other: ModelFit, enough: float = ENOUGH, beyond: float = np.inf) -> ModelFit:
    """A fit started at the values of another model's fit to the same flights, as far as both have the same unknowns."""
    values = {n: other.values[n] for n in problem.free if n in other.values}
    locals_ = [carried_local(local, other.model, problem.model) for local in other.locals]
    return fit(problem, values, locals_, enough=enough, beyond=beyond)


def deeper_fit(baseline: Baseline, other: ModelFit) -> ModelFit | None:
    """A better fit of a baseline's own model, started at the fit of another model (`other`); None where there is none.

    Part of the gain of `other` is then not due to its effect but to a better minimum. A fit whose motion grows, such as
    `_calmer_fit` replaces, counts only if it is better by more than `_calmer_fit` was allowed to lose.
    """
    cost = baseline.fit.cost
    model_fit = fit_from(baseline.problem, other, ROUGH, cost - AS_GOOD)
    if model_fit.diverged or not model_fit.cost < cost - AS_GOOD:
        return None
    growing = fastest_growth(baseline.problem, model_fit)
    was_avoided = growing >= GROWS and fastest_growth(baseline.problem, baseline.fit) < CALMER * growing
    return None if was_avoided and model_fit.cost > cost - ALIKE * cost else model_fit


def _fit_in_stages(
    problem: LikelihoodProblem,
    earlier_fit: ModelFit | None,
    turn: int,
    known: Mapping[str, float] = MappingProxyType({}),
) -> ModelFit:
    """The fit of one turn of noise and parameters. Turn 0 (white noise) holds the nuisance parameters, turn 1 (first estimated
    noise) frees them after a first fit, later turns fit all at once.

    Far from the optimum a timing offset would take on errors of the derivatives, and stay there. known: as in `first_values`.
    """
    values = first_values(problem, known) if earlier_fit is None else earlier_fit.values
    locals_ = None if earlier_fit is None else earlier_fit.locals
    if turn > 1:
        return fit(problem, values, locals_)
    first = fit(problem, values, locals_, enough=ROUGH, held=[n for n in problem.free if problem.nuisance(n)])
    return first if first.diverged or turn == 0 else fit(problem, first.values, first.locals)


def _runaway_flights(problem: LikelihoodProblem, model_fit: ModelFit, prepared: FlightRecords) -> str:
    """Name of the first flight on which the motion runs away; of all training flights where it stays finite."""
    for i, local in enumerate(model_fit.locals):
        if problem.residual(i, model_fit.values, local) is None:
            return prepared.names[problem.records[i].flight]
    return ", ".join(prepared.names[i] for i in prepared.training)
