"""Nulls: simulated flights of the fitted baseline with nothing hidden; and the random numbers of a run, in named streams.

Each null flies the fitted model through the recorded inputs with process noise of the strength found in these flights,
adds sensor noise to the outputs, treats the inputs as de-noised noisy measurements of the true ones, and is analysed by
the same linear algebra as the flights. Thresholds, floors and inflation factors come from nulls; none is assumed.

From the seed of a run there is one stream for every purpose, the same in any process.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from estimation.engine.kernel import Array
from estimation.engine.simulate import Segment
from estimation.gap.fit.linear_motion import BoundedMotion, linear_motion
from estimation.gap.fit.noise import ON_FORCES, NoiseModel, NoisePart, NoiseSource
from estimation.gap.fit.problem import LikelihoodProblem, ModelFit
from estimation.gap.fit.spikes import beside_neighbours, stepping_samples
from estimation.gap.fit.surface_steps import find_surface_steps
from estimation.gap.records.candidate_model import DISTURBANCE, RATE_OF
from estimation.gap.records.flight_records import FlightRecord
from estimation.models.base import Model
from estimation.signals.first_order import decaying_sum

KURTOSIS = 3.0  # of Gaussian noise
FEWEST = 300  # samples away from steps that show the tails of a channel's noise
SMOOTHED = 0.25  # of a frequency, to either side: the spectrum of errors falls slowly
ROUND = 1000  # added to the seed for every round: more than any offset used within a round
KINEMATIC = 31  # added to the seed of the run for the nulls of the kinematic check


class Stream(IntEnum):
    """What is drawn. The values are distinct large primes, so that no two streams start alike."""

    NULLS = 7919
    INPUT_ERRORS = 104729
    HELD_OUT_NULLS = 32452843
    KINEMATIC_INPUT_ERRORS = 49979687
    CLOSURE_NULLS = 86028121
    MEASURED_AGAIN = 122949823

    def generator(self, seed: int, *which: int) -> np.random.Generator:
        """The generator of one draw of this stream. which: indices of the draw, such as record and number."""
        return np.random.default_rng([seed, int(self), *which])


@dataclass(frozen=True)
class InputErrors:
    """Possible errors of the inputs of one record after de-noising. bank: name -> (realisations, N)."""

    bank: Mapping[str, Array]

    @property
    def count(self) -> int:
        """Number of realisations, the same for every input."""
        return min((len(courses) for courses in self.bank.values()), default=0)

    def course(self, names: Sequence[str], number: int) -> Array:
        """(N, names) one realisation of the errors of all inputs, zero for an input without errors."""
        zeros = np.zeros(next(iter(self.bank.values())).shape[1])
        return np.column_stack([self.bank[n][number] if n in self.bank else zeros for n in names])


def with_errors(
    records: Sequence[FlightRecord], model: Model, errors: Sequence[InputErrors]
) -> tuple[FlightRecord, ...]:
    """The records with the spectra of the errors of their controls in the nulls."""
    controls = [s.name for s in model.inputs if s.control]
    return tuple(
        replace(r, error_spectra={n: spectrum(e.bank[n]) for n in controls if n in e.bank})
        for r, e in zip(records, errors, strict=True)
    )


def spectrum(courses: Array) -> Array:
    """(frequencies,) variance per sample of random courses (many, N), smoothed over a share of the frequency to either side."""
    power = np.mean(np.abs(np.fft.rfft(courses, axis=1)) ** 2, axis=0) / courses.shape[1]
    bins = np.arange(power.size)
    reach = np.maximum(1, np.round(SMOOTHED * bins)).astype(int)
    total = np.concatenate([[0.0], np.cumsum(power)])
    low, high = np.maximum(bins - reach, 0), np.minimum(bins + reach + 1, power.size)
    return np.asarray((total[high] - total[low]) / (high - low))


def input_errors(record: FlightRecord, model: Model, rng: np.random.Generator) -> InputErrors:
    """Possible errors of each input: those drawn at its preparation, and its noise where the measured values are used."""
    bank = {}
    for signal in model.inputs:
        sigma, draws = record.input_noise.get(signal.name, 0.0), record.errors.get(signal.name)
        if draws is None or (sigma <= 0.0 and not draws.any()):
            continue
        raw = record.raw.get(signal.name, np.zeros(draws.shape[1], dtype=bool)) & (signal.name not in record.grids)
        bank[signal.name] = np.where(raw, sigma * rng.standard_normal(draws.shape), np.asarray(draws, float))
    return InputErrors(bank)


@dataclass(frozen=True)
class Modelled:
    """Modelled outputs (N, ny) of one record, and their changes (realisations, N, ny) by errors of the inputs."""

    outputs: Array
    changes: Array

    def draw(self, rng: np.random.Generator) -> Array:
        """(N, ny) outputs with one realisation of input errors, of either sign: the errors are small and their response is
        linear."""
        if not len(self.changes):
            return self.outputs
        sign, number = 2.0 * rng.integers(2) - 1.0, rng.integers(len(self.changes))
        return np.asarray(self.outputs + sign * self.changes[number])


@dataclass(frozen=True)
class NullFlyer:
    """Flies nulls of one fitted model. modelled: per record, None where the model runs away on it. jumps: per record sample,
    output column and standard deviation of the error next to a jump. states: disturbed state -> input column of its disturbance.
    driven: per record, the inputs of the fit, with the middles between samples. intervals: per record, sample interval [s].
    tails: per output, as of `heavy_tails`. bounded: per record, motion that no pilot holds, None where it does not grow."""

    problem: LikelihoodProblem
    fit: ModelFit
    noise: NoiseModel
    modelled: tuple[Modelled | None, ...]
    jumps: tuple[tuple[NDArray[np.int64], NDArray[np.int64], Array], ...]
    states: Mapping[str, int]
    driven: tuple[Segment, ...]
    intervals: tuple[float, ...]
    tails: tuple[Array | None, ...]
    bounded: tuple[BoundedMotion | None, ...]

    @classmethod
    def build(
        cls, problem: LikelihoodProblem, fit: ModelFit, noise: NoiseModel, errors: Sequence[InputErrors]
    ) -> "NullFlyer":
        """For the nulls of a fit. errors: possible errors of the inputs, per record."""
        names = problem.model.input_names
        disturbed = {part.of for part in noise.process if part.source in ON_FORCES}
        states = {s: names.index(DISTURBANCE.format(s)) for s in sorted(disturbed) if DISTURBANCE.format(s) in names}
        jumps = []
        outputs = {n: i for i, n in enumerate(problem.model.output_names)}
        for record, segment in zip(problem.records, problem.coarse, strict=True):
            linear = linear_motion(problem.model, problem.simulator, segment, fit.values)
            steps = find_surface_steps(problem.model, linear, segment, problem.criteria, record.restless)
            is_jump = np.array([n in steps.jumping for n in steps.name], dtype=bool)
            column = np.array([outputs[n] for n in steps.name if n in steps.jumping], dtype=int)
            jumps.append((steps.at[is_jump], column, (steps.step * steps.spread(noise.freedom))[is_jump]))
        bounded = BoundedMotion.of(problem, fit)
        modelled = tuple(_modelled(problem, fit, i, errors[i], bounded[i]) for i in range(len(problem.records)))
        inputs = tuple(problem.driven(grid, fit.values) for grid in problem.grids)
        intervals = tuple(float(np.median(np.diff(segment.time))) for segment in problem.coarse)
        tails = heavy_tails(problem, fit)
        return cls(problem, fit, noise, modelled, tuple(jumps), states, inputs, intervals, tails, bounded)

    def fly(self, index: int, rng: np.random.Generator) -> Array | None:
        """(N, ny) residual of one null of one record at the fitted parameters; None where it diverges."""
        modelled = self.modelled[index]
        observed = None if modelled is None else self.observed(index, rng, self.driven[index])
        return None if observed is None or modelled is None else observed - modelled.draw(rng)

    def residuals(self, index: int, stream: Stream, seed: int, count: int) -> list[Array]:
        """(N, ny) residuals of `count` nulls of one record; NaN where one diverges."""
        flown = (self.fly(index, stream.generator(seed, index, number)) for number in range(count))
        diverged = np.full(self.problem.coarse[index].z.shape, np.nan)
        return [diverged if residual is None else residual for residual in flown]

    def observed(self, index: int, rng: np.random.Generator, driven: Segment) -> Array | None:
        """(N, ny) measured outputs of one null of one record, NaN where the record has none; None where it diverges. driven: its
        inputs with the middles between samples."""
        outputs = self.flown(index, replace(driven, u=self.disturbed(index, rng, driven)))
        return None if outputs is None else self.measured(index, rng, outputs)

    def disturbed(self, index: int, rng: np.random.Generator, driven: Segment) -> Array:
        """(2N - 1, nu) inputs of one record with loose surfaces and gusts."""
        shaken = driven.u.copy()
        self._loosen_surfaces(shaken, rng)
        self._disturb(shaken, 0.5 * self.intervals[index], rng)
        return shaken

    def flown(self, index: int, driven: Segment) -> Array | None:
        """(N, ny) outputs of the fitted model on one record; None where it runs away. driven: inputs with the middles between
        samples."""
        if (bounded := self.bounded[index]) is not None:
            return bounded.outputs(driven.u)
        local = self.fit.locals[index]
        motion = self.problem.simulator.run_by_middles(driven, {**self.fit.values, **local.parameters}, local.x0)
        return motion.y if motion.finite else None

    def measured(self, index: int, rng: np.random.Generator, outputs: Array) -> Array:
        """(N, ny) outputs of one record with the noise of the instruments, NaN where the record has none."""
        problem, coarse, interval = self.problem, self.problem.coarse[index], self.intervals[index]
        louder = problem.records[index].louder
        white = rng.standard_normal(coarse.z.shape)
        for column, quantiles in enumerate(self.tails):
            if quantiles is not None:
                white[:, column] = np.interp(ndtr(white[:, column]), np.linspace(0.0, 1.0, quantiles.size), quantiles)
        noise = np.sqrt(self.noise.measurement * (1.0 if louder is None else louder)) * white
        self._wander(noise, interval, rng)
        samples, output, size = self.jumps[index]
        np.add.at(noise, (samples, output), size * rng.standard_normal(size.size))
        observed = outputs + noise
        observed[~np.isfinite(coarse.z)] = np.nan
        return np.asarray(observed)

    def _wander(self, noise: Array, h: float, rng: np.random.Generator) -> None:
        """Add the errors of filtered attitudes to the noise of the outputs (N, ny), h [s] apart: gyro noise and its integral,
        slow wandering."""
        outputs, process, count = self.problem.model.output_names, self.noise.process, len(noise)
        memory = self.problem.criteria.filter_memory
        for c, name in enumerate(outputs):
            strength = process.get(NoisePart(NoiseSource.WANDERING, name), 0.0)
            if strength > 0.0:  # density strength h on the rate
                noise[:, c] += _forgetting(np.sqrt(strength) * rng.standard_normal(count), h, memory, rng)
            strength = process.get(NoisePart(NoiseSource.GYRO, name), 0.0)
            if strength > 0.0:
                white = np.sqrt(strength) * rng.standard_normal(count)
                noise[:, outputs.index(RATE_OF[name])] += white
                noise[:, c] += _forgetting(0.5 * (white + np.concatenate([white[:1], white[:-1]])), h, memory, rng)

    def _loosen_surfaces(self, u: Array, rng: np.random.Generator) -> None:
        """Move the controls' mid-interval values (odd rows of (2N - 1, nu)) at random between their neighbours."""
        for j, signal in enumerate(self.problem.model.inputs):
            if signal.control:
                step = u[2::2, j] - u[:-2:2, j]
                freedom = self.noise.freedom.get(signal.name, self.problem.criteria.surface_freedom)
                u[1::2, j] += freedom * rng.standard_normal(step.size) * step

    def _disturb(self, u: Array, h: float, rng: np.random.Generator) -> None:
        """Add disturbances of the rates with the spectra of the noise model to the inputs (2N - 1, nu), h [s] apart."""
        active = [
            (part, strength)
            for part, strength in self.noise.process.items()
            if part.source in ON_FORCES and part.of in self.states
        ]
        white = rng.standard_normal((len(active), len(u)))
        for memory in dict.fromkeys(part.memory for part, _ in active):
            group = [i for i, (part, _) in enumerate(active) if part.memory == memory]
            slow = _slow(white[group], h, memory) if memory else np.zeros((len(group), len(u)))
            for i, course in zip(group, slow, strict=True):
                part, strength = active[i]
                # strength counts per sample of the record (2 h); white noise sampled every h has variance density / h
                disturbance = course if part.source is NoiseSource.TWIST else white[i] - course
                u[:, self.states[part.of]] += np.sqrt(strength * 2.0) * disturbance


def heavy_tails(problem: LikelihoodProblem, fit: ModelFit) -> tuple[Array | None, ...]:
    """Per output the sorted values of its noise, of unit variance, where that has clearly heavier tails than Gaussian noise; else
    None.

    From residuals beside their neighbours, away from steps of the controls: what a model lacks is slower or follows a step.
    """
    controls = [i for i, s in enumerate(problem.model.inputs) if s.control]
    rest = [~stepping_samples(s.u[:, controls], problem.criteria) for s in problem.coarse]
    tails: list[Array | None] = []
    for column in range(len(problem.model.outputs)):
        parts = [beside_neighbours(r[:, column])[mask] for r, mask in zip(fit.residuals, rest, strict=True)]
        values = np.concatenate([p[np.isfinite(p)] for p in parts])
        unit = (values - values.mean()) / values.std() if values.size >= FEWEST and values.any() else np.zeros(1)
        excess = float(np.mean(unit**4)) - KURTOSIS
        tails.append(np.sort(unit) if excess > problem.criteria.heavy_tails else None)
    return tuple(tails)


def _modelled(
    problem: LikelihoodProblem, fit: ModelFit, index: int, errors: InputErrors, bounded: BoundedMotion | None
) -> Modelled | None:
    """The modelled record, without realisations of errors with which the model runs away; None where it always does."""
    names = problem.model.input_names
    if bounded is not None:
        return Modelled(bounded.fitted, bounded.changes([errors.course(names, n) for n in range(errors.count)]))
    local, coarse = fit.locals[index], problem.coarse[index]
    nominal = problem.modelled(index, fit.values, local)
    if nominal is None:
        return None
    perturbed = (
        problem.modelled(index, fit.values, local, inputs=coarse.u + errors.course(names, number))
        for number in range(errors.count)
    )
    changes = [outputs - nominal for outputs in perturbed if outputs is not None]
    return Modelled(nominal, np.array(changes).reshape(len(changes), *coarse.z.shape))


def _slow(white: Array, h: float, tau: float) -> Array:
    """First-order low-pass with time constant tau [s] of courses (many, N), started at rest."""
    a = np.exp(-h / tau)
    return np.asarray((1.0 - a) * decaying_sum(float(a), white))


def _forgetting(rate: Array, h: float, memory: float, rng: np.random.Generator) -> Array:
    """A sampled rate (N,) integrated over steps h [s] with the memory of an attitude filter [s], started in the steady state."""
    decay = float(np.exp(-h / memory))
    drive = h * rate
    drive[0] = float(np.std(rate)) * h / np.sqrt(1.0 - decay**2) * rng.standard_normal()
    return decaying_sum(decay, drive)


def fly_nulls(flyer: NullFlyer, most: int, seed: int) -> Iterator[tuple[Array, ...]]:
    """Up to `most` nulls, each a tuple of residuals per record; fewer where many diverge. The same seed gives the same nulls."""
    finite = 0
    for number in range(2 * most):
        if finite == most:
            break
        rng = Stream.NULLS.generator(seed, number)
        residuals = [flyer.fly(i, rng) for i in range(len(flyer.problem.records))]
        if all(r is not None for r in residuals):
            finite += 1
            yield tuple(r for r in residuals if r is not None)
