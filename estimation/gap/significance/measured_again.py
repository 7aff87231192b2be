"""The gain of an effect on simulated flights without it, with controls that are measured and prepared again.

A control is recorded with noise. A hypothesis that smooths it a little (a lag, a delay, a play) removes noise from the modelled
motion and gains although the effect is absent: an elevator with 0.2 deg of noise looks like one that is 12 ms late, at a score of
6. Nulls with simulated residuals only do not show this, because there the recorded control drives both flight and base.

So the fitted base is flown through courses that the controls may have taken, and the controls are measured with new noise and
prepared like those of the flights. Base and hypothesis are compared on these flights with the values found on the real ones,
without a fit. With a correct likelihood the hypothesis loses there what it gained on the real flights (to second order both are
the same quadratic form, seen from either end); a gain by preparation is a gain on both. Half the difference is the gain of the
effect itself: the centred likelihood ratio of D. R. Cox, "Further results on tests of separate families of hypotheses", Journal
of the Royal Statistical Society B 24 (1962), 406-424, eq. 8.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from estimation.engine.kernel import Array
from estimation.gap.criteria import Criteria
from estimation.gap.fit.baseline import Baseline
from estimation.gap.fit.problem import LikelihoodProblem, ModelFit, freed_by
from estimation.gap.records.flight_records import FlightRecord
from estimation.gap.significance.nulls import InputErrors, NullFlyer, Stream
from estimation.models.base import Model
from estimation.signals.controls import with_raw_steps
from estimation.signals.denoise import denoise_many, wiener
from estimation.signals.rounding import near_edges, without_stairs

NOT_ITS_OWN = "gains nearly as much without it, where controls are measured again"  # why a candidate is rejected
NOTHING = 1e-12  # smallest score
REPEATS = 16  # simulated sets: their mean gain is known to a quarter of its scatter, some 4 of a gain of 40


@dataclass(frozen=True)
class SimulatedRecord:
    """One simulated record. outputs: (N, ny), NaN where not measured; inputs: (N, nu) with the controls prepared again; energy:
    of the whitened residual of the base."""

    outputs: Array
    inputs: Array
    energy: float


@dataclass(frozen=True)
class MeasuredAgain:
    """The training flights of a baseline simulated with controls measured again, `REPEATS` times."""

    baseline: Baseline
    seed: int

    @cached_property
    def sets(self) -> tuple[tuple[SimulatedRecord, ...], ...]:
        """The records of every repeat, without repeats whose motion runs away or leaves the base by more than the noise, as nulls
        may not either: gains on such flights do not come from controls."""
        indices = range(len(self.baseline.problem.records))
        streams = (Stream.MEASURED_AGAIN.generator(self.seed, number) for number in range(REPEATS))
        flown = [[self._flown(index, rng) for index in indices] for rng in streams]
        by_record = (self._simulated(index, [flights[index] for flights in flown]) for index in indices)
        return self._near_the_base(list(zip(*by_record, strict=True)))

    @cached_property
    def _flyer(self) -> NullFlyer:
        problem = self.baseline.problem
        exact = [InputErrors({}) for _ in problem.records]
        return NullFlyer.build(problem, self.baseline.fit, self.baseline.noise, exact)

    def _near_the_base(
        self, sets: Sequence[Sequence[SimulatedRecord | None]]
    ) -> tuple[tuple[SimulatedRecord, ...], ...]:
        """The sets in which no motion runs away or leaves the base by more than the noise."""
        pairs = zip(self.baseline.problem.whiteners, self.baseline.fit.residuals, strict=True)
        limit = self.baseline.criteria.null_energy * sum(w.energy(residual) for w, residual in pairs)
        finite = (tuple(r for r in records if r is not None) for records in sets if None not in records)
        return tuple(f for f in finite if sum(r.energy for r in f) < limit)

    def _simulated_record(self, index: int, outputs: Array | None, inputs: Array) -> SimulatedRecord | None:
        """One record with these outputs and inputs; None where it or the base runs away."""
        problem, fit = self.baseline.problem, self.baseline.fit
        modelled = problem.modelled(index, fit.values, fit.locals[index], inputs=inputs)
        if outputs is None or modelled is None:
            return None
        return SimulatedRecord(outputs, inputs, problem.whiteners[index].energy(outputs - modelled))

    def share(self, gain: float, model_fit: ModelFit) -> float:
        """The share of a fitted hypothesis' gain on the flights (twice a log-likelihood) that is its own, within 0 to 1.

        From its mean gain on simulated flights without the effect, as in `own_share`. Gains by priors, such as those of times
        that the base need not shift any more, are the hypothesis' own: simulated flights are compared by their residuals alone.
        1 where these flights cannot be flown.
        """
        if gain <= 0.0:
            return 1.0
        trial = replace(self.baseline.problem, model=model_fit.model)  # one for all repeats: it caches results
        gains = [g for simulated in self.sets if (g := _gain(trial, simulated, model_fit)) is not None]
        if not gains:
            return 1.0
        freed = freed_by(self.baseline.problem, self.baseline.fit, model_fit)
        return own_share(gain, float(np.mean(gains)), freed, self.baseline.criteria)

    def problems(self) -> Iterator[tuple[LikelihoodProblem, ModelFit]]:
        """Every simulated set as flights: the base with the values found on the real flights, and its residuals."""
        problem, model_fit = self.baseline.problem, self.baseline.fit
        for simulated in self.sets:
            pairs = list(zip(problem.records, simulated, strict=True))
            again = replace(problem, records=tuple(_recorded(problem.model, record, r) for record, r in pairs))
            modelled = [again.modelled(i, model_fit.values, local) for i, local in enumerate(model_fit.locals)]
            residuals = tuple(r.outputs - y for (_, r), y in zip(pairs, modelled, strict=True) if y is not None)
            if len(residuals) == len(pairs):
                yield again, replace(model_fit, residuals=residuals)

    def _flown(self, index: int, rng: np.random.Generator) -> tuple[Array | None, Array]:
        """Outputs of the base flown through a course that the controls of a record may have taken, None where it runs away; and
        inputs (N, nu) with these controls as measured."""
        problem, record = self.baseline.problem, self.baseline.problem.records[index]
        true_inputs, measured = problem.coarse[index].u.copy(), problem.coarse[index].u.copy()
        for column, name, noise in self._noisy_controls(index):
            true_inputs[:, column] = course(record, name, self._smooth_controls[index][name], rng)
            measured[:, column] = measured_control(record, name, true_inputs[:, column], noise, rng)
        driven = problem.driven(problem.grids[index].with_inputs(true_inputs), self.baseline.fit.values)
        return self._flyer.observed(index, rng, driven), measured

    def _simulated(self, index: int, flown: Sequence[tuple[Array | None, Array]]) -> list[SimulatedRecord | None]:
        """One record of every repeat with its controls prepared again; None where the motion runs away."""
        record = self.baseline.problem.records[index]
        prepared = [measured.copy() for _, measured in flown]
        for column, name, noise in self._noisy_controls(index):
            courses = [measured[:, column] for _, measured in flown]
            again = prepared_again(record, name, courses, noise, self.baseline)
            for inputs, values in zip(prepared, again, strict=True):
                inputs[:, column] = values
        pairs = zip(flown, prepared, strict=True)
        return [self._simulated_record(index, outputs, inputs) for (outputs, _), inputs in pairs]

    @cached_property
    def _smooth_controls(self) -> tuple[dict[str, Array], ...]:
        """Per record the noisy controls without noise, alike in every repeat."""
        records, segments = self.baseline.problem.records, self.baseline.problem.coarse
        return tuple(
            {name: smooth_control(r, name, s.u[:, column], noise) for column, name, noise in self._noisy_controls(i)}
            for i, (r, s) in enumerate(zip(records, segments, strict=True))
        )

    def _noisy_controls(self, index: int) -> list[tuple[int, str, float]]:
        """Column, name and noise of every control of a record that has noise."""
        problem, known = self.baseline.problem, self.baseline.problem.records[index].input_noise
        controls = [(i, s.name, known.get(s.name, 0.0)) for i, s in enumerate(problem.model.inputs) if s.control]
        return [(i, name, noise) for i, name, noise in controls if noise > 0.0]


def _recorded(model: Model, record: FlightRecord, simulated: SimulatedRecord) -> FlightRecord:
    """A record with the outputs and the controls of a simulated one."""
    controls = {
        s.name: simulated.inputs[:, i] for i, s in enumerate(model.inputs) if s.control and s.name in record.inputs
    }
    return replace(record, inputs={**record.inputs, **controls}, z=simulated.outputs)


def _gain(problem: LikelihoodProblem, simulated: Sequence[SimulatedRecord], model_fit: ModelFit) -> float | None:
    """Gain of a fitted hypothesis on one simulated set (twice a log-likelihood); None where its motion runs away."""
    total = 0.0
    for index, record in enumerate(simulated):
        outputs = problem.modelled(index, model_fit.values, model_fit.locals[index], inputs=record.inputs)
        if outputs is None:
            return None
        total += record.energy - problem.whiteners[index].energy(record.outputs - outputs)
    return total


def own_shares(signed: Array, mean: Array) -> Array:
    """(terms,) shares, 0 to 1, of signed scores that remain without a mean; 1 where the mean has the other sign."""
    same_sign = np.maximum(np.sign(signed) * mean, 0.0)
    return np.asarray(np.maximum(1.0 - same_sign / np.maximum(np.abs(signed), NOTHING), 0.0))


def own_share(gain: float, without: float, freed: float, criteria: Criteria) -> float:
    """The share of a gain that is the effect's own, within 0 to 1. without: gain by residuals on flights without the effect;
    freed: part of `gain` from priors and not from residuals.

    Of the gain by residuals, half the difference from `without` is its own, and half the sum comes from the noise of the
    controls; the uncertainty of the latter is subtracted.
    """
    by_residuals = gain - freed
    by_noise = max(0.5 * (by_residuals + without), 0.0)
    own = 0.5 * (by_residuals - without) - criteria.control_noise_known * by_noise
    return float(np.clip((min(own, by_residuals) + freed) / gain, 0.0, 1.0))


def smooth_control(record: FlightRecord, name: str, prepared: Array, noise: float) -> Array:
    """(N,) a control as prepared; near its steps, where the prepared values are the measured ones, without their noise. One of a
    coarsely rounded control has no stairs."""
    if name in record.grids:
        return without_stairs(prepared, record.interval, least=1)
    raw = record.raw.get(name)
    if raw is None or not raw.any():
        return prepared
    follows = record.follows.get(name, 0.0)
    smooth = denoise_many([prepared - follows], noise=noise)[0].values + follows
    return np.where(raw, smooth, prepared)


def course(record: FlightRecord, name: str, smooth: Array, rng: np.random.Generator) -> Array:
    """(N,) a course that a control may have taken: `smooth_control` with one draw of the possible errors of its preparation, away
    from steps."""
    grid = record.grids.get(name)
    if grid is not None:
        return smooth + grid.step * rng.uniform(-0.5, 0.5)
    draws = record.errors.get(name)
    error = 0.0 if draws is None or not len(draws) else np.asarray(draws[rng.integers(len(draws))], float)
    return np.where(record.raw.get(name, False), smooth, smooth + error)


def measured_control(record: FlightRecord, name: str, true: Array, noise: float, rng: np.random.Generator) -> Array:
    """(N,) a control as its potentiometer and converter may have recorded a true course. noise: of the recorded control."""
    white, grid = rng.standard_normal(true.size), record.grids.get(name)
    return true + noise * white if grid is None else grid.rounded(true + grid.noise_before(noise) * white)


def prepared_again(
    record: FlightRecord, name: str, measured: Sequence[Array], noise: float, baseline: Baseline
) -> list[Array]:
    """(N,) each: repeated measurements of a control, de-noised except for the part that follows the motion, and as measured near
    its steps where the record is; one that never rests is filtered."""
    if name in record.filtered:
        return [wiener(m, noise).values for m in measured]
    follows = record.follows.get(name, 0.0)
    smooth = [d.values + follows for d in denoise_many([m - follows for m in measured], noise=noise)]
    raw = record.raw.get(name)
    if raw is None or not raw.any():
        return smooth
    step, interval = baseline.criteria.surface_step, record.interval
    near = [near_edges(m, record.grids.get(name), interval) for m in measured]
    return [with_raw_steps(s, m, noise, step, interval)[0] for s, m in zip(smooth, near, strict=True)]
