"""A lag of a coefficient behind its variable, and a swing: what no function of the motion explains.

A mass that can move in the airframe, or a structure that bends, answers accelerations with its own frequency and damping. Below
that frequency it follows them and looks like a small error of a lever arm or a moment of inertia, which the base or a named
effect absorbs. Only the swing at its own frequency after the aircraft has stopped is unique. No function of the motion and no
first-order lag does that. So a separate screen looks for an oscillator, at a grid of frequencies, driven by all accelerations of
the model.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np

from estimation.engine.kernel import Array
from estimation.estimators.normal_equations import solved
from estimation.gap.answer.shape import LaggedTerm, SwingingTerm
from estimation.gap.criteria import Criteria
from estimation.gap.shapes.places import ACCELERATIONS, ModelMotion, Place, ranked
from estimation.gap.significance.calibration import Round
from estimation.gap.significance.screen import Projected, gram_of
from estimation.gap.significance.tangent import Tangent
from estimation.signals.first_order import decaying_sum

TIMES = (0.05, 0.1, 0.2, 0.5, 1.0)  # s, time constants: signatures of neighbours are much alike
SLOWEST = 2.0  # rad/s: a swing in three seconds; slower ones are motions of the aircraft itself
FASTEST = 0.5  # of the highest frequency that the samples can show
RATIO = 1.2  # of successive frequencies: within the width of a resonance with that damping
DAMPING = 0.1
AROUND = 0.85 * 1.05 ** np.arange(8)  # of the best frequency of the grid: the finer grid
DAMPINGS = (0.02, 0.05, 0.1, 0.2, 0.4, 0.8)  # of the finer grid


def lag_behind(course: Array, time: Array, memory: float) -> Array:
    """(N,) output of a first-order lag with time constant `memory` [s] minus its input (N,), started at rest."""
    keep = float(np.exp(-np.median(np.diff(time)) / memory))
    departure = course - course[0]
    return np.asarray(decaying_sum(keep, (1.0 - keep) * departure) - departure)


def find_memory(motion: ModelMotion, round_: Round, places: Sequence[Place]) -> LaggedTerm | None:
    """The place and time constant with the largest gain by linear theory; None where it is not above the nulls."""
    candidates = [(p, t) for p in places if motion.shows(p) for t in TIMES]

    def changes(i: int) -> Iterator[Array]:
        courses, time = motion.courses[i], motion.segments[i].time
        lags = [(p.line, lag_behind(courses[p.variable], time, t) / motion.reach(p.variable)) for p, t in candidates]
        return motion.changes(i, lags)

    gram = gram_of(round_.tangent, changes)
    gains = Projected.of(gram, len(motion.problem.free), len(candidates)).scores() ** 2
    result = ranked([p for p, _ in candidates], gains, round_.criteria)
    if not result.order:
        return None
    leader = result.order[0]
    place, time = candidates[leader]
    return LaggedTerm(
        place.line, place.variable, time, float(result.gains[leader]), float(result.scores[leader]), result.threshold
    )


@dataclass(frozen=True)
class _Oscillator:
    """One column: the part of a coefficient that an oscillator driven by one acceleration adds."""

    line: str
    by: str
    frequency: float
    damping: float

    @property
    def group(self) -> tuple[str, float, float]:
        return self.line, self.frequency, self.damping

    def course(self, driven: Array, time: Array) -> Array:
        return oscillator(driven, time, self.frequency, self.damping)


@dataclass(frozen=True)
class _Direct:
    """One column: a part of a coefficient proportional to an acceleration, or to its rate."""

    line: str
    by: str
    rate: bool

    def course(self, driven: Array, time: Array) -> Array:
        return np.gradient(driven, time) if self.rate else driven - driven[0]


def oscillator(course: Array, time: Array, frequency: float, damping: float) -> Array:
    """(N,) response of an oscillator of unit gain to a course (N,) that is linear between samples, started at rest at its first
    value.

    From the complex pole of an oscillator damped less than critically: the imaginary part of one first-order lag.
    """
    step, departure = float(np.median(np.diff(time))), course - course[0]
    damped = frequency * np.sqrt(1.0 - damping**2)
    pole = complex(-damping * frequency, damped)
    decay = np.exp(pole * step)
    end_weight = (decay - 1.0 - pole * step) / (pole**2 * step)  # of the value at the end of a step
    start_weight = (decay - 1.0) / pole - end_weight  # of the value at its start
    drive = end_weight * departure
    drive[1:] += start_weight * departure[:-1]
    return np.asarray(course[0] + frequency**2 / damped * decaying_sum(decay, drive).imag)


def frequencies(time: Array) -> Array:
    """(many,) trial frequencies [rad/s] for a record: from a swing in three seconds to half the Nyquist frequency."""
    interval = 2.0 * float(np.median(np.diff(time)))  # of the samples; courses have a point between every two of them
    highest = FASTEST * np.pi / interval
    count = max(int(np.log(highest / SLOWEST) / np.log(RATIO)), 0)
    return np.asarray(SLOWEST * RATIO ** np.arange(count + 1))


def find_swing(motion: ModelMotion, round_: Round) -> SwingingTerm | None:
    """The coefficient and oscillator with the largest gain by linear theory; None where it is not above the nulls or does not
    ring.

    Parts proportional to the accelerations and their rates are projected out first: an oscillator faster than the motion has only
    these.
    """
    drives = [a for a in ACCELERATIONS if a in motion.courses[0] and motion.moves(a)]
    lines = [line for line, size in motion.scale.items() if size > 0.0]
    if not drives or not lines:
        return None
    coarse_grid = frequencies(motion.segments[0].time)
    oscillators = [_Oscillator(n, a, w, DAMPING) for n in lines for w in coarse_grid for a in drives]
    result = ranked(*_Grams.of(motion, round_.tangent, lines, drives, oscillators).gains(), round_.criteria)
    if not result.order:
        return None
    leader = result.order[0]
    line, coarse, _ = result.places[leader]
    oscillators = [_Oscillator(line, a, w * coarse, z) for w in AROUND for z in DAMPINGS for a in drives]
    finer = _Grams.of(motion, round_.tangent, [line], drives, oscillators)
    groups, gains = finer.gains()
    nearest = int(np.argmax(gains[:, 0]))
    _, frequency, damping = groups[nearest]
    if not rings(damping, round_.criteria):
        return None
    span = range(nearest * len(drives), (nearest + 1) * len(drives))
    projected = finer.projected(line, without_direct=False)
    selected = _needed(projected, span, round_.criteria)
    sizes = solved(projected.B[np.ix_(selected, selected)], projected.b[selected, 0])
    return SwingingTerm(
        line,
        {oscillators[k].by: float(x) / motion.reach(oscillators[k].by) for k, x in zip(selected, sizes, strict=True)},
        float(frequency),
        float(damping),
        projected.gain(span) - len(span),
        float(result.scores[leader]),
        result.threshold,
    )


def rings(damping: float, criteria: Criteria) -> bool:
    """Whether a swing has little enough damping: with more it is a lag, and in the limit any small error."""
    return damping <= criteria.halfway


def _needed(projected: Projected, span: Sequence[int], criteria: Criteria) -> list[int]:
    """The columns of one oscillator that are needed: the best one, then each with a significant gain beside the earlier ones."""
    selected: list[int] = []
    gain = 0.0
    while len(selected) < len(span):
        gained = {k: projected.gain([*selected, k]) for k in span if k not in selected}
        leader = max(gained, key=lambda k: gained[k])
        if selected and gained[leader] - gain < criteria.certain**2:
            break
        selected, gain = [*selected, leader], gained[leader]
    return selected


@dataclass(frozen=True)
class _Grams:
    """gram: products of the n columns of the base, the direct parts, the oscillators and the residuals."""

    gram: Array
    n: int
    direct: tuple[_Direct, ...]
    oscillators: tuple[_Oscillator, ...]

    @classmethod
    def of(
        cls,
        motion: ModelMotion,
        tangent: Tangent,
        lines: Sequence[str],
        drives: Sequence[str],
        oscillators: Sequence[_Oscillator],
    ) -> "_Grams":
        direct = tuple(_Direct(n, a, rate) for n in lines for a in drives for rate in (False, True))
        columns: tuple[_Oscillator | _Direct, ...] = (*direct, *oscillators)

        def changes(i: int) -> Iterator[Array]:
            courses, time = motion.courses[i], motion.segments[i].time
            return motion.changes(i, [(c.line, c.course(courses[c.by], time) / motion.reach(c.by)) for c in columns])

        return cls(gram_of(tangent, changes), len(tangent.problem.free), direct, tuple(oscillators))

    def gains(self) -> tuple[list[tuple[str, float, float]], Array]:
        """Oscillators (coefficient, frequency, damping), and (oscillators, residuals) the gain of each with all accelerations."""
        groups, gains = [], []
        for line, oscillators in groupby(self.oscillators, key=lambda o: o.line):
            projected, first = self.projected(line, without_direct=True), 0
            for group, members in groupby(oscillators, key=lambda o: o.group):
                span = range(first, first + len(list(members)))
                first = span.stop
                groups.append(group)
                gains.append(projected.gains(span, slice(None)))
        return groups, np.array(gains)

    def projected(self, line: str, without_direct: bool) -> Projected:
        """The oscillators of a coefficient with the base projected out, and with the direct parts too where `without_direct`."""
        removed = [self.n + k for k, column in enumerate(self.direct) if column.line == line] if without_direct else []
        first = self.n + len(self.direct)
        columns = [first + k for k, oscillator in enumerate(self.oscillators) if oscillator.line == line]
        index = [*range(self.n), *removed, *columns, *range(first + len(self.oscillators), len(self.gram))]
        return Projected.of(self.gram[np.ix_(index, index)], self.n + len(removed), len(columns))
