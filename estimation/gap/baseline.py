"""One model's fit to the training flights with its noise, its nulls and its screen: one round of the workflow."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from estimation.engine.kernel import Array
from estimation.engine.simulate import Simulator
from estimation.gap.bench import Bench, Record
from estimation.gap.confirm import linear_gains
from estimation.gap.edges import Edges, displaced, find_edges, freedom_of, loosened
from estimation.gap.effects.base import Effect
from estimation.gap.errors import GapError
from estimation.gap.fitting import Fit, Local, Problem, fit
from estimation.gap.nuisance import is_nuisance
from estimation.gap.nulls import InputErrors, NullFlyer, columns_of, fly_nulls
from estimation.gap.screen import Screen, build_screen, hypotheses_for
from estimation.gap.whitening import (
    GYRO,
    RATE_OF,
    WANDERING,
    WANDERING_S,
    NoiseModel,
    Shapes,
    Whitener,
    estimate_noise,
    force_states,
    linear_motion,
    shapes_of,
    whitener,
)  # fmt: skip
from estimation.models.base import Model
from estimation.signals.preprocess import noise_level

LEAST_NOISE = 0.25  # of the variance that the sample-to-sample scatter of a channel shows
PASSES = 3
SPARE_PASSES = 3  # more of them where the fit has not come to rest
EDGE_TURNS = 2
OWN_NOISE = 0.5  # of a rate's scatter: to begin with, half of its standard deviation is not shared with the attitude
SAFETY = 1.25  # on the null threshold: nulls know nothing of what the baseline's own equations and sampling get a little wrong
WORK = 1e7  # the same right-hand side serves every fit and null: compiling it repays


def channel_noise(records: Sequence[Record]) -> Array:
    """(ny,) standard deviation of the white part of every output, median over the records."""
    ny = records[0].z.shape[1]
    levels = np.zeros((len(records), ny))
    span = np.zeros(ny)
    for k, record in enumerate(records):
        for i in range(ny):
            seen = record.z[np.isfinite(record.z[:, i]), i]
            if seen.size:
                levels[k, i] = noise_level(seen)
                span[i] = max(span[i], float(np.ptp(seen)))
    return np.maximum(np.median(levels, axis=0), 1e-4 * np.maximum(span, 1e-9))


def filtered_attitudes(records: Sequence[Record], outputs: Sequence[str], white: Array) -> tuple[str, ...]:
    """Those attitudes among the outputs, of white noise `white` (ny,), that come from a filter which integrates the gyro.

    From sample to sample they are smoother than one step of the gyro's own noise, which no independent measurement can be.
    """
    step = float(np.median(np.concatenate([np.diff(record.time) for record in records])))
    found = []
    for attitude, rate in RATE_OF.items():
        if attitude in outputs:
            given = [record.input_noise.get(rate, 0.0) for record in records]
            noise = white[outputs.index(rate)] if rate in outputs else float(np.median(given))
            if white[outputs.index(attitude)] <= noise * step:
                found.append(attitude)
    return tuple(found)


def bank_error(records: Sequence[Record], outputs: Sequence[str], scatter: Array) -> Array:
    """`scatter` with the noise of the bank angle replaced by its slow error where the bank angle is a filter's.

    An attitude filter integrates the gyro and corrects slowly: from sample to sample its angle is smoother than one
    step of the gyro's own noise, which no independent measurement can be. What is wrong with it is then not seen in
    that smoothness but in how it parts from the integrated rates (without a constant and a drift) over the record.
    """
    if not {"p", "r"} <= set(outputs) or "phi" not in filtered_attitudes(records, outputs, scatter):
        return scatter
    p, r, phi = (outputs.index(n) for n in ("p", "r", "phi"))
    errors = []
    for record in records:
        if not {"q", "theta"} <= set(record.inputs) or not np.isfinite(record.z[:, [p, r, phi]]).all():
            continue
        bank = record.z[:, phi]
        turn = record.inputs["q"] * np.sin(bank) + record.z[:, r] * np.cos(bank)
        rate = record.z[:, p] + np.tan(record.inputs["theta"]) * turn
        dt = np.diff(record.time)
        integrated = np.concatenate([[0.0], np.cumsum(0.5 * dt * (rate[1:] + rate[:-1]))])
        line = np.polyfit(record.time, bank - integrated, 1)
        errors.append(float(np.std(bank - integrated - np.polyval(line, record.time))))
    if not errors:
        return scatter
    wider = scatter.copy()
    wider[phi] = max(scatter[phi], float(np.median(errors)))
    return wider


@dataclass(frozen=True)
class Baseline:
    """A fitted model with the noise of its residuals. scatter: (ny,) standard deviations of the channels' white noise.
    clean: the model as a person reads it, without what sleeps in it."""

    problem: Problem
    fit: Fit
    noise: NoiseModel
    scatter: Array
    clean: Model

    @property
    def model(self) -> Model:
        return self.problem.model


def whiteners_for(
    problem_model: Model,
    base: Model,
    records: Sequence[Record],
    values: Mapping[str, float],
    noise: NoiseModel | None,
    residuals: Sequence[Array],
    scatter: Array,
    begin: NoiseModel | None = None,
) -> tuple[NoiseModel, tuple[Whitener, ...]]:
    """Noise model from `residuals` (or `noise` where given) and the whitener of every record. begin: an earlier estimate."""
    simulator = Simulator.build(problem_model, (), substeps=1, hold="linear")
    segments = [r.segment(problem_model, base) for r in records]
    linear = [linear_motion(problem_model, simulator, s, values) for s in segments]
    shapes = [
        replace(shapes_of(problem_model, m, len(s), force_states(base)), louder=r.louder)
        for m, s, r in zip(linear, segments, records, strict=True)
    ]
    edges = [find_edges(problem_model, m, s) for m, s in zip(linear, segments, strict=True)]
    if noise is None:
        noise = _estimated(residuals, shapes, edges, *_noise_parts(records, base.output_names, scatter), begin)
    return noise, tuple(loosened(whitener(noise, s), e, noise.freedom) for s, e in zip(shapes, edges, strict=True))


def _estimated(
    residuals: Sequence[Array],
    shapes: Sequence[Shapes],
    edges: Sequence[Edges],
    white: Array,
    without: Collection[str],
    known: Mapping[str, float],
    begin: NoiseModel | None,
) -> NoiseModel:
    """Stationary noise and the freedom of the edges in turn: each from what the other leaves of the residuals."""
    noise = begin if begin is not None and begin.freedom else None
    freedom = dict(noise.freedom) if noise is not None else {}
    left = list(residuals)
    for turn in range(EDGE_TURNS + 1):
        if turn > 0 or noise is None:
            noise = estimate_noise(left, shapes, white**2, LEAST_NOISE * white**2, without, known, noise)
        if turn == EDGE_TURNS:
            break
        told = [
            displaced(whitener(noise, s), e, freedom, np.nan_to_num(r))
            for s, e, r in zip(shapes, edges, residuals, strict=True)
        ]
        freedom = freedom_of(edges, told)
        left = [r - e.response @ mean for r, e, (mean, _) in zip(residuals, edges, told, strict=True)]
    assert noise is not None
    return replace(noise, freedom=freedom)


def _noise_parts(
    records: Sequence[Record], outputs: Sequence[str], scatter: Array
) -> tuple[Array, tuple[str, ...], dict[str, float]]:
    """(ny,) white noise of the outputs to begin with, the parts these flights do not have, first guesses of some they have.

    An attitude that is measured afresh in every sample does not wander; one that is a filter's shares most of its gyro's
    noise. It keeps its slow error as white noise too: a filter is smoother than it is right, and what it makes of the motion
    between two samples is not known to a hundredth of a degree.
    """
    white = channel_noise(records)
    wandering = filtered_attitudes(records, outputs, white)
    step = float(np.median(np.diff(records[0].time)))
    own = scatter.copy()
    for n in wandering:
        if RATE_OF[n] in outputs:
            own[outputs.index(RATE_OF[n])] *= OWN_NOISE
    known = {}
    for n in wandering:
        known[WANDERING.format(n)] = scatter[outputs.index(n)] ** 2 / (step * WANDERING_S)
        if RATE_OF[n] in outputs:
            known[GYRO.format(n)] = (1.0 - OWN_NOISE**2) * scatter[outputs.index(RATE_OF[n])] ** 2
    return own, tuple(part.format(n) for n in RATE_OF if n not in wandering for part in (WANDERING, GYRO)), known


def fit_baseline(
    model: Model,
    clean: Model,
    bench: Bench,
    scatter: Array,
    start: Mapping[str, float] | None = None,
    locals_: Sequence[Local] | None = None,
    noise: NoiseModel | None = None,
    passes: int = PASSES,
) -> Baseline:
    """Fit `model` to the training flights, noise and parameters in turn.

    start, locals_, noise: from a parent model, to save work. Raises GapError when the motion diverges at the start and
    no start helps.
    """
    records = bench.of(bench.training)
    values = dict(start or {})
    own = None if locals_ is None else list(locals_)
    found: Fit | None = None
    level = noise or NoiseModel(scatter**2, {})
    for turn in range(passes + 1 + SPARE_PASSES):
        if turn > passes and (found is None or found.converged):
            break
        at = {**model.starts(), **values}
        if turn == 0:
            _, whiteners = whiteners_for(model, bench.base, records, at, level, (), scatter)
        else:
            assert found is not None
            level, whiteners = whiteners_for(model, bench.base, records, at, None, found.residuals, scatter, level)
        problem = Problem(model, bench.base, records, whiteners, WORK)
        found = _careful(problem, values, own, afar=turn if start is None else passes)
        if found.diverged:
            raise GapError(
                f"model {model.name} runs away on {_culprit(problem, found, bench)}: the baseline itself is wrong for these "
                "flights; check the aircraft file and the signs of the controls, or cut the flights into shorter segments"
            )
        values, own = dict(found.values), list(found.locals)
    assert found is not None
    return Baseline(problem, found, level, scatter, clean)


def _careful(problem: Problem, values: Mapping[str, float], own: Sequence[Local] | None, afar: int) -> Fit:
    """A fit from afar (pass 0: white noise; pass 1: its own noise for the first time) without, then with what is only
    nuisance: far from the optimum a displacement in time is bent to serve for everything else, and does not come back."""
    if afar > 1:
        return fit(problem, values, own)
    first = fit(problem, values, own, held=[n for n in problem.free if is_nuisance(n)])
    return first if first.diverged or afar == 0 else fit(problem, first.values, first.locals)


def _culprit(problem: Problem, found: Fit, bench: Bench) -> str:
    for i, local in enumerate(found.locals):
        if problem.residual(i, found.values, local) is None:
            return bench.names[problem.records[i].flight]
    return ", ".join(bench.names[i] for i in bench.training)


@dataclass(frozen=True)
class Round:
    """A baseline with its screen and its nulls.

    gains: (hypotheses,) twice the log-likelihood by linear theory; null_gains: (nulls, hypotheses) the same on the nulls.
    inflation: (hypotheses,) variance of the score on the nulls, at least 1. threshold: family-wise quantile of the
    largest standardised score on the nulls, with a safety factor.
    """

    baseline: Baseline
    screen: Screen
    gains: Array
    null_gains: Array
    inflation: Array
    threshold: float
    null_residuals: tuple[tuple[Array, ...], ...]

    def standardised(self) -> Array:
        """(hypotheses,) scores of the data in units of their scatter on the nulls."""
        return np.sqrt(self.gains / self.inflation)


def screen_round(
    baseline: Baseline,
    bench: Bench,
    effects: Sequence[Effect],
    errors: Sequence[InputErrors],
    nulls: int,
    seed: int,
    level: float = 0.95,
    tell: Callable[[int], None] = lambda done: None,
) -> Round:
    """Screen every applicable hypothesis and calibrate the scores on simulated nulls."""
    problem = baseline.problem
    flyer = NullFlyer.build(problem, baseline.fit, baseline.noise, errors)
    flown = fly_nulls(flyer, nulls, seed, tell)
    if len(flown) < nulls:
        raise GapError(
            f"only {len(flown)} of {nulls} simulated nulls stay finite: the fitted baseline is barely stable"
        )
    hypotheses = hypotheses_for(baseline.clean, effects, bench.available)
    screen = build_screen(problem, baseline.fit, hypotheses, columns_of(flown))
    gains = linear_gains(screen, problem, 0)
    null_gains = linear_gains(screen, problem, slice(1, 1 + nulls))
    inflation = null_inflation(screen, nulls)
    largest = np.sqrt(null_gains / inflation).max(axis=1) if screen.hypotheses else np.zeros(nulls)
    return Round(baseline, screen, gains, null_gains, inflation, SAFETY * upper_quantile(largest, level), tuple(flown))


def null_inflation(screen: Screen, nulls: int) -> Array:
    """(hypotheses,) variance of the signed scores on the nulls, at least 1."""
    projected = screen.projected()
    result = np.ones(len(screen.hypotheses))
    for h in range(len(screen.hypotheses)):
        span = screen.span(h)
        z = projected.b[span, 1 : 1 + nulls] / np.sqrt(np.maximum(np.diag(projected.B)[span], 1e-300))[:, None]
        result[h] = max(1.0, float(np.mean(z**2)))
    return result


def upper_quantile(values: Array, level: float) -> float:
    """Upper quantile of the largest of many scores, by a Gumbel law fitted to its moments and the sample's own quantile,
    whichever is larger: two hundred nulls alone know a 95 % point only to some 3 %."""
    spread = float(np.std(values)) * np.sqrt(6.0) / np.pi
    gumbel = float(np.mean(values)) - 0.57721566 * spread - spread * float(np.log(-np.log(level)))
    return max(gumbel, float(np.quantile(values, level)))
