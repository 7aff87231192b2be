"""What the whole chain shows when nothing is hidden: the fitted baseline flown again, many times.

Each null flies the fitted model through the recorded inputs with process noise of the strength found in these flights,
adds sensor noise to the outputs, takes the inputs as a de-noised noisy measurement of the true ones, and is analysed by
the same linear algebra as the flights. Thresholds, floors and inflation factors come from here; none is assumed.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from estimation.engine.kernel import Array
from estimation.engine.simulate import Segment, Simulator
from estimation.gap.fitting import Fit, Problem, fine_grid
from estimation.gap.whitening import NoiseModel
from estimation.models.base import Model, Signal
from estimation.preprocess import denoise

BANK = 6  # de-noised realisations kept per input; a null draws one of them and its sign
DISTURBANCE = "disturbance_{}"


@dataclass(frozen=True)
class InputErrors:
    """What de-noising leaves wrong in the inputs of one record: (realisations, N, nu)."""

    bank: Array

    def draw(self, rng: np.random.Generator) -> Array:
        """(N, nu) errors: every input from its own realisation, with its own sign."""
        count, _, nu = self.bank.shape
        which = rng.integers(count, size=nu)
        sign = rng.choice((-1.0, 1.0), size=nu)
        return sign * self.bank[which, :, np.arange(nu)].T


def input_errors(problem: Problem, index: int, rng: np.random.Generator) -> InputErrors:
    """Add the noise found on each input to its de-noised course, de-noise again, and keep the difference."""
    segment, record = problem.coarse[index], problem.records[index]
    bank = np.zeros((BANK, *segment.u.shape))
    for j, signal in enumerate(problem.model.inputs):
        sigma = record.input_noise.get(signal.name, 0.0)
        if sigma <= 0.0:
            continue
        clean = segment.u[:, j]
        for k in range(BANK):
            noisy = clean + sigma * rng.standard_normal(clean.size)
            bank[k, :, j] = denoise(noisy, order=1 if signal.control else 2, noise=sigma).values - clean
    return InputErrors(bank)


@dataclass(frozen=True)
class NullFlyer:
    """Flies nulls of one fitted model. errors: of each record's inputs."""

    problem: Problem
    fit: Fit
    noise: NoiseModel
    errors: tuple[InputErrors, ...]
    disturbed: Simulator
    states: tuple[str, ...]

    @classmethod
    def build(cls, problem: Problem, fit: Fit, noise: NoiseModel, rng: np.random.Generator) -> "NullFlyer":
        states = tuple(dict.fromkeys(n.partition(":")[0] for n in noise.process if n.partition(":")[0] in problem.model.state_names))
        inputs = [Signal(DISTURBANCE.format(s)) for s in states]
        model: Model = problem.model.plus(inputs=inputs, terms={f"{s}_dot": DISTURBANCE.format(s) for s in states})
        errors = tuple(input_errors(problem, i, rng) for i in range(len(problem.records)))
        return cls(problem, fit, noise, errors, Simulator.build(model, (), substeps=1, work=1e9), states)

    def fly(self, index: int, rng: np.random.Generator) -> Array | None:
        """(N, ny) residual of one null of one record at the fitted parameters; None where it diverges."""
        problem, local = self.problem, self.fit.locals[index]
        grid = problem.grids[index]
        driven = problem._driven(grid, self.fit.values)
        w = self._disturbance(grid.segment, rng)
        flown = replace(driven, u=np.ascontiguousarray(np.concatenate([driven.u, w], axis=1)))
        motion = self.disturbed.run(flown, {**self.fit.values, **local.parameters}, local.x0)
        if not motion.finite:
            return None
        measured = motion.y[::2] + np.sqrt(self.noise.measurement) * rng.standard_normal((grid.segment.time.size // 2 + 1, self.noise.measurement.size))
        seen = problem.coarse[index].u + self.errors[index].draw(rng)
        modelled = problem.residual(index, self.fit.values, local, inputs=seen)
        if modelled is None:
            return None
        predicted = problem.coarse[index].z - modelled
        residual = measured - predicted
        residual[~np.isfinite(problem.coarse[index].z)] = np.nan
        return residual

    def _disturbance(self, fine: Segment, rng: np.random.Generator) -> Array:
        """(2N - 1, states) disturbances of the rates with the spectra of the noise model."""
        h = float(np.median(np.diff(fine.time)))
        w = np.zeros((fine.time.size, len(self.states)))
        for name, strength in self.noise.process.items():
            state, _, tau = name.partition(":")
            if state not in self.states:
                continue
            # strength counts per sample of the record (2 h); white noise sampled every h has variance density / h
            white = np.sqrt(strength * 2.0) * rng.standard_normal(fine.time.size)
            if tau:
                white = white - _slow(white, h, float(tau))
            w[:, self.states.index(state)] += white
        return w


def _slow(white: Array, h: float, tau: float) -> Array:
    """First-order low-pass of time constant tau [s], started in its steady state of no motion."""
    from scipy.signal import lfilter

    a = np.exp(-h / tau)
    return np.asarray(lfilter([1 - a], [1, -a], white))


def fly_nulls(
    flyer: NullFlyer, count: int, seed: int, tell: Callable[[int], None] = lambda done: None
) -> list[tuple[Array, ...]]:
    """`count` nulls, each a tuple of residuals per record. The same seed gives the same nulls in any process."""
    return list(_nulls(flyer, count, seed, tell))


def _nulls(flyer: NullFlyer, count: int, seed: int, tell: Callable[[int], None]) -> Iterator[tuple[Array, ...]]:
    made = 0
    for number in range(2 * count):
        if made == count:
            return
        rng = np.random.default_rng([seed, 7919, number])
        residuals = [flyer.fly(i, rng) for i in range(len(flyer.problem.records))]
        if all(r is not None for r in residuals):
            made += 1
            tell(made)
            yield tuple(r for r in residuals if r is not None)


def columns_of(nulls: Sequence[tuple[Array, ...]]) -> list[list[Array]]:
    """Nulls per record: record -> list of residual columns, as `build_screen` takes them."""
    return [[null[i] for null in nulls] for i in range(len(nulls[0]))] if nulls else []


def summary(noise: NoiseModel, outputs: Sequence[str]) -> Mapping[str, float]:
    """Standard deviations of the measurement noise by output."""
    return {n: float(np.sqrt(v)) for n, v in zip(outputs, noise.measurement, strict=True)}
