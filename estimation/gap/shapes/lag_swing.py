"""Where no function of the motion explains what is left: does a coefficient follow its variable late, or does something swing?

A mass that can move in the airframe and a structure that bends answer accelerations with a frequency and a damping of their own.
Slowly they follow, and look like a lever arm or a moment of inertia that is a little wrong, which the base or a name takes up;
what only they do is to go on at their own frequency when the aircraft has stopped. No function of the moment and no first-order
lag does that, so it is asked by itself: an oscillator at every one of some frequencies, driven by all accelerations of the model.
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

TIMES = (0.05, 0.1, 0.2, 0.5, 1.0)  # s, each twice the one before or so: signatures of neighbours are much alike
SLOWEST = 2.0  # rad/s: a swing in three seconds; slower ones are motions of the aircraft itself
FASTEST = 0.5  # of the highest frequency that the samples can show
APART = 1.2  # from one frequency to the next: within the width of a resonance of that damping
DAMPING = 0.1
AROUND = 0.85 * 1.05 ** np.arange(8)  # of the best frequency of the grid, then looked at
DAMPINGS = (0.02, 0.05, 0.1, 0.2, 0.4, 0.8)


def lag_behind(course: Array, time: Array, memory: float) -> Array:
    """(N,) how far a first-order lag [s] of a course (N,) is behind it, begun at rest."""
    keep = float(np.exp(-np.median(np.diff(time)) / memory))
    departure = course - course[0]
    return np.asarray(decaying_sum(keep, (1.0 - keep) * departure) - departure)


def find_memory(flown: ModelMotion, round_: Round, places: Sequence[Place]) -> LaggedTerm | None:
    """The place and time constant that gain most by linear theory, where they stand out of the nulls."""
    candidates = [(p, t) for p in places if flown.moves(p.variable) and flown.scale[p.line] > 0.0 for t in TIMES]

    def changes(i: int) -> Iterator[Array]:
        courses, time = flown.courses[i], flown.segments[i].time
        lags = [(p.line, lag_behind(courses[p.variable], time, t) / flown.reach(p.variable)) for p, t in candidates]
        return flown.changes(i, lags)

    gram = gram_of(round_.tangent, changes)
    gains = Projected.of(gram, len(flown.problem.free), len(candidates)).scores() ** 2
    result = ranked([p for p, _ in candidates], gains, round_.criteria)
    if not result.order:
        return None
    leader = result.order[0]
    place, time = candidates[leader]
    return LaggedTerm(
        place.line, place.variable, time, float(result.gains[leader]), float(result.scores[leader]), result.threshold
    )


@dataclass(frozen=True)
class _Ask:
    """One column: what an oscillator on a coefficient, driven by one acceleration, adds to it."""

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
class _AtOnce:
    """One column: what follows an acceleration, or its rate, at once."""

    line: str
    by: str
    rate: bool

    def course(self, driven: Array, time: Array) -> Array:
        return np.gradient(driven, time) if self.rate else driven - driven[0]


def oscillator(course: Array, time: Array, frequency: float, damping: float) -> Array:
    """(N,) what an oscillator of unit size makes of a course (N,) that is straight between samples, begun at rest where it is.

    By its complex pole, damped less than critically: the response is the imaginary part of one first-order lag.
    """
    step, departure = float(np.median(np.diff(time))), course - course[0]
    ringing = frequency * np.sqrt(1.0 - damping**2)
    pole = complex(-damping * frequency, ringing)
    keep = np.exp(pole * step)
    at_once = (keep - 1.0 - pole * step) / (pole**2 * step)  # of the value at the end of a step
    before = (keep - 1.0) / pole - at_once  # of that at its beginning
    drive = at_once * departure
    drive[1:] += before * departure[:-1]
    return np.asarray(course[0] + frequency**2 / ringing * decaying_sum(keep, drive).imag)


def frequencies(time: Array) -> Array:
    """(many,) frequencies [rad/s] asked of a record: from a swing in three seconds to half of what its samples show."""
    samples = 2.0 * float(np.median(np.diff(time)))  # courses have an instant between every two samples
    highest = FASTEST * np.pi / samples
    count = max(int(np.log(highest / SLOWEST) / np.log(APART)), 0)
    return np.asarray(SLOWEST * APART ** np.arange(count + 1))


def find_swing(flown: ModelMotion, round_: Round) -> SwingingTerm | None:
    """The coefficient and frequency that gain most by linear theory, where they stand out of the nulls and it rings.

    What follows the accelerations and their rates at once is taken out before: an oscillator faster than the motion does no more.
    """
    drives = [a for a in ACCELERATIONS if a in flown.courses[0] and flown.moves(a)]
    lines = [line for line, size in flown.scale.items() if size > 0.0]
    if not drives or not lines:
        return None
    asks = [_Ask(n, a, w, DAMPING) for n in lines for w in frequencies(flown.segments[0].time) for a in drives]
    screen = _Grams.of(flown, round_.tangent, lines, drives, asks)
    groups, gains = screen.gained()
    result = ranked(groups, gains, round_.criteria)
    if not result.order:
        return None
    leader = result.order[0]
    line, coarse, _ = result.places[leader]
    finer = _Grams.of(
        flown,
        round_.tangent,
        [line],
        drives,
        [_Ask(line, a, w * coarse, z) for w in AROUND for z in DAMPINGS for a in drives],
    )
    groups_near, gained = finer.gained()
    nearest = int(np.argmax(gained[:, 0]))
    _, frequency, damping = groups_near[nearest]
    if not rings(damping, round_.criteria):
        return None
    span = range(nearest * len(drives), (nearest + 1) * len(drives))
    projected = finer.with_what_follows(line)
    selected = _needed(projected, span, round_.criteria)
    sizes = solved(projected.B[np.ix_(selected, selected)], projected.b[selected, 0])
    return SwingingTerm(
        line,
        {finer.asks[k].by: float(x) / flown.reach(finer.asks[k].by) for k, x in zip(selected, sizes, strict=True)},
        float(frequency),
        float(damping),
        projected.gain(span) - len(span),
        float(result.scores[leader]),
        result.threshold,
    )


def rings(damping: float, criteria: Criteria) -> bool:
    """Whether something so damped swings at all: what does not is late, and at its limit anything that is a little wrong."""
    return damping <= criteria.swing_damping


def _needed(projected: Projected, span: Sequence[int], criteria: Criteria) -> list[int]:
    """Of the columns that drive one oscillator those needed: the best alone, then each that gains beside those before."""
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
    """gram: products of the n columns of the base, of what follows at once (`at_once`), of oscillators (`asks`), of residuals."""

    gram: Array
    n: int
    at_once: tuple[_AtOnce, ...]
    asks: tuple[_Ask, ...]

    @classmethod
    def of(
        cls,
        flown: ModelMotion,
        tangent: Tangent,
        lines: Sequence[str],
        drives: Sequence[str],
        asks: Sequence[_Ask],
    ) -> "_Grams":
        at_once = tuple(_AtOnce(n, a, rate) for n in lines for a in drives for rate in (False, True))
        columns: tuple[_Ask | _AtOnce, ...] = (*at_once, *asks)

        def changes(i: int) -> Iterator[Array]:
            courses, time = flown.courses[i], flown.segments[i].time
            return flown.changes(i, [(c.line, c.course(courses[c.by], time) / flown.reach(c.by)) for c in columns])

        return cls(gram_of(tangent, changes), len(tangent.problem.free), at_once, tuple(asks))

    def gained(self) -> tuple[list[tuple[str, float, float]], Array]:
        """Oscillators (coefficient, frequency, damping), and (oscillators, residuals) what all that drives one gains."""
        groups, gains = [], []
        for line, asks in groupby(self.asks, key=lambda ask: ask.line):
            projected, first = self._beside(line, at_once=False), 0
            for group, members in groupby(asks, key=lambda ask: ask.group):
                span = range(first, first + len(list(members)))
                first = span.stop
                groups.append(group)
                gains.append(projected.gains(span, slice(None)))
        return groups, np.array(gains)

    def with_what_follows(self, line: str) -> Projected:
        """The oscillators of a coefficient, where the base alone is taken out: what follows at once is theirs."""
        return self._beside(line, at_once=True)

    def _beside(self, line: str, at_once: bool) -> Projected:
        removed = [] if at_once else [self.n + k for k, column in enumerate(self.at_once) if column.line == line]
        first = self.n + len(self.at_once)
        columns = [first + k for k, ask in enumerate(self.asks) if ask.line == line]
        index = [*range(self.n), *removed, *columns, *range(first + len(self.asks), len(self.gram))]
        return Projected.of(self.gram[np.ix_(index, index)], self.n + len(removed), len(columns))
