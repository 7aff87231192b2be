"""One model's fit to the training flights with the noise of its residuals.

It begins at what the model states, or at a regression of the measured motion where that is nearer: an aircraft that was never
written down has no beliefs, or those of its shape alone. From there the motion runs away, or the search ends in a valley that is
not the one of these flights.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from types import MappingProxyType

import numpy as np

from estimation.engine.kernel import Array
from estimation.engine.simulate import Simulator
from estimation.estimators.equation_error import start_values
from estimation.gap.criteria import Criteria
from estimation.gap.errors import GapError
from estimation.gap.fit.channel_noise import channel_noise, filtered_attitudes
from estimation.gap.fit.fitting import ENOUGH, cost_at, fit
from estimation.gap.fit.problem import LikelihoodProblem, ModelFit, carried_local
from estimation.gap.fit.spectra import (
    NoiseModel,
    NoisePart,
    NoiseSource,
    Shapes,
    as_seen,
    estimate_noise,
    linear_motion,
    shapes_of,
    whitener,
)
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

PASSES = 3  # of noise and parameters in turn: the third changes neither by more than the nulls know them
SPARE_PASSES = 3  # more of them where the fit has not come to rest
ROUGH = 0.5  # of the log-likelihood: what a fit may leave before its noise is known
STEP_TURNS = 2  # of stationary noise and freedom of the surfaces
GROWS = 0.15  # 1/s: doubles in less than five seconds, which no pilot flies through a record
CALMER = 0.5  # times the growth
AS_GOOD = 3.0  # of the log-likelihood: which of two fits so close is better is chance
ALIKE = 0.005  # of the cost: so far two fits of a base that lacks something move with the third digit of the noise


def first_values(problem: LikelihoodProblem, known: Mapping[str, float] = MappingProxyType({})) -> dict[str, float]:
    """Shared values at which the first fit begins, the nearest of three: none (the model's own starts), a regression, and what
    another model of these flights has of the same derivatives (`known`)."""
    carried_over = {n: known[n] for n in problem.parameters if n in known and not problem.nuisance(n)}
    candidates = [values for values in (by_regression(problem), carried_over) if values]
    return min([{}, *candidates], key=lambda values: cost_at(problem, values)) if candidates else {}


def by_regression(problem: LikelihoodProblem) -> dict[str, float]:
    """Derivatives of the model by equation error over the records, what is only nuisance at rest; none where a state is not
    measured, as those that an effect brings with it."""
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
    """A fitted model with the noise of its residuals. scatter: (ny,) standard deviations of the channels' white noise.
    clean: the model as a person reads it, without what is dormant in it. prepared: all flights, held-out ones among them."""

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
        """`on_holdout` with its own noise, which is asked for again and again."""
        return self.on_holdout(self.noise)

    def on_holdout(self, noise: NoiseModel) -> tuple[LikelihoodProblem, ModelFit] | None:
        """The fitted model on the held-out flights, weighed by `noise`: parameters frozen, initial states and biases fitted.

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
    problem_model: Model,
    prepared: FlightRecords,
    records: Sequence[FlightRecord],
    values: Mapping[str, float],
    noise: NoiseModel | None,
    residuals: Sequence[Array],
    scatter: Array,
    begin: NoiseModel | None = None,
) -> tuple[NoiseModel, tuple[Whitener, ...]]:
    """Noise model from `residuals` (or `noise` where given) and the whitener of every record. begin: an earlier estimate."""
    base, criteria = prepared.base, prepared.criteria
    simulator = Simulator.build(problem_model, (), substeps=1, hold="linear")
    segments = [r.segment(problem_model, base) for r in records]
    linear = [linear_motion(problem_model, simulator, s, values) for s in segments]
    shapes = [
        as_seen(
            replace(
                shapes_of(problem_model, m, len(s), criteria, force_states(base), r.error_spectra), louder=r.louder
            ),
            np.isfinite(s.z),
        )
        for m, s, r in zip(linear, segments, records, strict=True)
    ]
    steps = [find_surface_steps(problem_model, m, s, criteria) for m, s in zip(linear, segments, strict=True)]
    if noise is None:
        noise = estimated_noise(
            residuals, shapes, steps, *noise_parts(records, base.output_names, scatter, criteria), begin
        )
    slow = [slow_errors(simulator, values, s, r.error_spectra) for r, s in zip(records, segments, strict=True)]
    return noise, tuple(
        loosened(whitener(noise, without_slow(s, w.below)), e, noise.freedom, w.response)
        for s, e, w in zip(shapes, steps, slow, strict=True)
    )


def estimated_noise(
    residuals: Sequence[Array],
    shapes: Sequence[Shapes],
    steps: Sequence[SurfaceSteps],
    white: Array,
    without: Collection[NoisePart],
    known: Mapping[NoisePart, float],
    begin: NoiseModel | None,
) -> NoiseModel:
    """Stationary noise and the freedom of the surfaces in turn: each from what the other leaves of the residuals."""
    noise = begin if begin is not None and begin.freedom else None
    freedom = dict(noise.freedom) if noise is not None else {}
    unexplained = list(residuals)
    for turn in range(STEP_TURNS + 1):
        if turn > 0 or noise is None:
            noise = estimate_noise(
                unexplained, shapes, white**2, (steps[0].criteria.least_scatter * white) ** 2, without, known, noise
            )
        if turn == STEP_TURNS:
            break
        displacements = [
            displaced(whitener(noise, s), e, freedom, np.nan_to_num(r))
            for s, e, r in zip(shapes, steps, residuals, strict=True)
        ]
        freedom = freedom_of(steps, displacements)
        unexplained = [r - e.response @ mean for r, e, (mean, _) in zip(residuals, steps, displacements, strict=True)]
    assert noise is not None
    return replace(noise, freedom=freedom)


def noise_parts(
    records: Sequence[FlightRecord], outputs: Sequence[str], scatter: Array, criteria: Criteria
) -> tuple[Array, tuple[NoisePart, ...], dict[NoisePart, float]]:
    """(ny,) white noise of the outputs to begin with, the parts these flights do not have, first guesses of some they have.

    An attitude that is measured afresh in every sample does not wander; one that is a filter's shares most of its gyro's
    noise. It keeps its slow error as white noise too: a filter is smoother than it is right, and what it makes of the motion
    between two samples is not known to a hundredth of a degree.
    """
    white = channel_noise(records)
    wandering = filtered_attitudes(records, outputs, white, criteria)
    step = float(np.median(np.diff(records[0].time)))
    floor = scatter.copy()
    for n in wandering:
        if RATE_OF[n] in outputs:
            floor[outputs.index(RATE_OF[n])] *= criteria.least_scatter
    strengths: dict[NoisePart, float] = {}
    for n in wandering:
        strengths[NoisePart(NoiseSource.WANDERING, n)] = scatter[outputs.index(n)] ** 2 / (
            step * criteria.filter_memory
        )
        if RATE_OF[n] in outputs:
            shared = 1.0 - criteria.least_scatter**2
            strengths[NoisePart(NoiseSource.GYRO, n)] = shared * scatter[outputs.index(RATE_OF[n])] ** 2
    filters = (NoiseSource.WANDERING, NoiseSource.GYRO)
    return floor, tuple(NoisePart(f, n) for n in RATE_OF if n not in wandering for f in filters), strengths


def fit_baseline(
    model: Model,
    clean: Model,
    prepared: FlightRecords,
    scatter: Array,
    begun: ModelFit | None = None,
    noise: NoiseModel | None = None,
    known: bool = False,
) -> Baseline:
    """Fit `model` to the training flights, noise and parameters in turn.

    begun: a fit of this model with `noise`, from which to go on. known: this noise was estimated with this model, so that one
    pass is done. Raises GapError when the motion diverges at the start and no start helps.
    """
    records = prepared.of(prepared.training)
    level, model_fit, problem = noise or NoiseModel(scatter**2, {}), begun, None
    for turn in range(0 if begun is None else 1 + known, PASSES + 1 + SPARE_PASSES):
        if turn > PASSES and model_fit is not None and model_fit.converged:
            break
        if model_fit is None:
            _, whiteners = whiteners_for(model, prepared, records, model.starts(), level, (), scatter)
        else:
            current = {**model.starts(), **model_fit.values}
            level, whiteners = whiteners_for(
                model, prepared, records, current, None, model_fit.residuals, scatter, level
            )
        problem = LikelihoodProblem(model, prepared.base, records, whiteners, prepared.criteria)
        model_fit = _careful(problem, model_fit, afar=turn if begun is None else PASSES)
        if model_fit.diverged:
            raise GapError(
                f"model {model.name} runs away on {_culprit(problem, model_fit, prepared)}: the baseline itself is wrong for "
                "these flights; check the aircraft file and the signs of the controls, or cut the flights into shorter segments"
            )
    assert problem is not None
    assert model_fit is not None
    baseline = Baseline(problem, model_fit, level, scatter, clean, prepared)
    calmer = _calmer(baseline) if begun is None else None
    if calmer is None:
        return baseline
    try:
        return fit_baseline(model, clean, prepared, scatter, calmer, level)
    except GapError:  # it was as good with the noise of the first only
        return baseline


def _calmer(baseline: Baseline) -> ModelFit | None:
    """Another fit as good as one whose motion grows, with calmer motion, begun at what the model states; None where there is
    none. What is missing can bend the base either way, and the nulls of an aircraft that runs away show nothing."""
    growing = growth(baseline.problem, baseline.fit)
    if growing < GROWS:
        return None
    alternative = fit(baseline.problem, baseline.problem.starts())
    close = not alternative.diverged and alternative.cost < baseline.fit.cost + max(AS_GOOD, ALIKE * baseline.fit.cost)
    return alternative if close and growth(baseline.problem, alternative) < CALMER * growing else None


def growth(problem: LikelihoodProblem, found: ModelFit) -> float:
    """Rate [1/s] of the fastest growing small motion about any record; negative where all die away."""
    motions = (linear_motion(problem.model, problem.simulator, s, found.values) for s in problem.coarse)
    return max(float(np.linalg.eigvals(motion.A).real.max()) for motion in motions)


def fit_afresh(baseline: Baseline, model: Model, clean: Model) -> Baseline | None:
    """Another model of the same flights, fitted afresh with the noise and the whiteners of a baseline, so that the two can be
    compared; None where its motion runs away. Begun from afar and where the baseline is: what a fit that rests in a poorer
    valley lacks would be counted for whatever the other model has not."""
    problem = replace(baseline.problem, model=model)
    ends = (_careful(problem, None, afar=1, known=baseline.fit.values), fit_from(problem, baseline.fit))
    finite = [found for found in ends if not found.diverged]
    if not finite:
        return None
    return replace(baseline, problem=problem, fit=min(finite, key=lambda found: found.cost), clean=clean)


def fit_from(problem: LikelihoodProblem, other: ModelFit, enough: float = ENOUGH, beyond: float = np.inf) -> ModelFit:
    """A problem's fit begun where another model of the same flights ended, with all that both have."""
    values = {n: other.values[n] for n in problem.free if n in other.values}
    locals_ = [carried_local(local, other.model, problem.model) for local in other.locals]
    return fit(problem, values, locals_, enough=enough, beyond=beyond)


def deeper_fit(baseline: Baseline, other: ModelFit) -> ModelFit | None:
    """A better fit of a baseline's own model, begun where another model of the same flights ended; None where there is none.

    A gain over a fit that rests in a poorer valley is not the other model's. A base whose motion grows was left for one as good
    (`_calmer`), and is not taken back for less than it was left for.
    """
    cost = baseline.fit.cost
    model_fit = fit_from(baseline.problem, other, ROUGH, cost - AS_GOOD)
    if model_fit.diverged or not model_fit.cost < cost - AS_GOOD:
        return None
    growing = growth(baseline.problem, model_fit)
    was_avoided = growing >= GROWS and growth(baseline.problem, baseline.fit) < CALMER * growing
    return None if was_avoided and model_fit.cost > cost - ALIKE * cost else model_fit


def _careful(
    problem: LikelihoodProblem, begun: ModelFit | None, afar: int, known: Mapping[str, float] = MappingProxyType({})
) -> ModelFit:
    """A fit from afar (pass 0: white noise; pass 1: its own noise for the first time) without, then with what is only
    nuisance: far from the optimum a displacement in time is bent to serve for everything else, and does not come back."""
    values, local_values = (first_values(problem, known), None) if begun is None else (begun.values, begun.locals)
    if afar > 1:
        return fit(problem, values, local_values)
    first = fit(problem, values, local_values, enough=ROUGH, held=[n for n in problem.free if problem.nuisance(n)])
    return first if first.diverged or afar == 0 else fit(problem, first.values, first.locals)


def _culprit(problem: LikelihoodProblem, found: ModelFit, prepared: FlightRecords) -> str:
    for i, local in enumerate(found.locals):
        if problem.residual(i, found.values, local) is None:
            return prepared.names[problem.records[i].flight]
    return ", ".join(prepared.names[i] for i in prepared.training)
