"""One model's fit to the training flights with its noise, its nulls and its screen: one round of the workflow."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from estimation.engine.kernel import Array
from estimation.engine.simulate import Simulator
from estimation.gap.bench import Bench, Record
from estimation.gap.confirm import linear_gains
from estimation.gap.effects.base import Effect
from estimation.gap.errors import GapError
from estimation.gap.fitting import Fit, Local, Problem, fit
from estimation.gap.nulls import InputErrors, NullFlyer, columns_of, fly_nulls
from estimation.gap.screen import Screen, build_screen, hypotheses_for
from estimation.gap.whitening import NoiseModel, Whitener, estimate_noise, force_states, shapes_of, whitener
from estimation.models.base import Model
from estimation.preprocess import noise_level

LEAST_NOISE = 0.25  # of the variance that the sample-to-sample scatter of a channel shows
PASSES = 3
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


def bank_error(records: Sequence[Record], outputs: Sequence[str], scatter: Array) -> Array:
    """`scatter` with the noise of the bank angle replaced by its slow error where the bank angle is a filter's.

    An attitude filter integrates the gyro and corrects slowly: from sample to sample its angle is smoother than one
    step of the gyro's own noise, which no independent measurement can be. What is wrong with it is then not seen in
    that smoothness but in how it parts from the integrated rates (without a constant and a drift) over the record.
    """
    if not {"p", "r", "phi"} <= set(outputs):
        return scatter
    p, r, phi = (outputs.index(n) for n in ("p", "r", "phi"))
    step = float(np.median(np.concatenate([np.diff(record.time) for record in records])))
    if scatter[phi] > scatter[p] * step:
        return scatter
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
) -> tuple[NoiseModel, tuple[Whitener, ...]]:
    """Noise model from `residuals` (or `noise` where given) and the whitener of every record."""
    simulator = Simulator.build(problem_model, (), substeps=1, hold="linear")
    shapes = [
        shapes_of(problem_model, simulator, r.segment(problem_model, base), values, force_states(base)) for r in records
    ]
    if noise is None:
        noise = estimate_noise(residuals, shapes, scatter**2, LEAST_NOISE * scatter**2)
    return noise, tuple(whitener(noise, s) for s in shapes)


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
    for turn in range(passes + 1):
        at = {**model.starts(), **values}
        if turn == 0:
            _, whiteners = whiteners_for(model, bench.base, records, at, level, (), scatter)
        else:
            assert found is not None
            level, whiteners = whiteners_for(model, bench.base, records, at, None, found.residuals, scatter)
        problem = Problem(model, bench.base, records, whiteners, WORK)
        found = fit(problem, values, own)
        if found.diverged:
            raise GapError(
                f"model {model.name} runs away on {_culprit(problem, found, bench)}: the baseline itself is wrong for these "
                "flights; check the aircraft file and the signs of the controls, or cut the flights into shorter segments"
            )
        values, own = dict(found.values), list(found.locals)
    assert found is not None
    return Baseline(problem, found, level, scatter, clean)


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
    null_gains = np.array([linear_gains(screen, problem, 1 + c) for c in range(nulls)])
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
