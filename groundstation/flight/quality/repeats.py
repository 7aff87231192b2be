"""Repeated values of a channel, told apart by what the motion must have done to it: a coarse step, a slow sensor, a stuck one.

A quantised channel repeats while the aircraft hardly moves it; a slow one repeats in step, and jumps by many quanta where
a new value comes; a stuck one repeats though its own noise, or the motion that the other channels show, must have moved it
by several quanta. The quantum is read off the data. Values closer than `SAME` of the range count as equal, so that dither
far below the quantum changes nothing.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from groundstation.flight.flight import Flight

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

SAME = 1e-9  # of the range: four orders above the rounding of doubles, far below a step of 24 bit (6e-8)
STUCK = 1.0  # s of one value, at least
STUCK_SAMPLES = 20
SEVERAL = 5.0  # quanta: rounding alone moves a channel by one, a bad quantum estimate by two
BIG = 3.0  # quanta: a step that is no flicker between two neighbouring levels
SLOW_RUNS = 20  # new values by big steps, at least, before a channel is called slow
SLOW_SHARE = 1 / 3  # of those new values that are held for more than one sample (three new values in four samples)
LONGEST_HOLD = 0.6  # s: slower channels (1 Hz GNSS and less) are sampled too rarely to be called measured in between
EVEN = 0.8  # share of holds within one sample of the usual: an ideal step command holds its values unevenly
LATE = 0.05  # share of holds of more than two in a row: a slow sensor may lose a value, two one after the other seldom
REPEATED = 0.3  # share of samples that repeat the last one: 0.27 where noise is one quantum, less where it is more
BEYOND_ERROR = 4.0  # times the usual error of the prediction that a predicted movement must exceed
FEWEST = 40  # samples from which any of this can be told
ALTERNATING = -0.4  # lag-one correlation of third differences: -0.75 for white noise, positive for a smooth curve
GAUSSIAN = 0.6744897501960817  # median of the absolute value of a standard normal variable
THIRD = np.sqrt(20.0)  # standard deviation of a third difference of white noise of 1

SENSED = (
    "ax", "ay", "az", "p", "q", "r", "phi", "theta", "psi", "alpha", "beta", "V", "altitude", "p_static", "p_dynamic",
)  # fmt: skip
"""Columns of sensors that the motion of the aircraft moves."""


@dataclass(frozen=True)
class RepeatedValues:
    """What the repeated values of one column are. quantum: smallest step [column's unit], 0 where it has none.

    held: (N,) samples that repeat the last value of a slow sensor; rate: new values a second [Hz], 0 where it is not slow.
    stuck: (N,) samples at which the sensor is stuck. at_rest: (N,) samples of a channel that stands still with all others.
    """

    column: str
    quantum: float
    held: Mask
    stuck: Mask
    at_rest: Mask
    rate: float

    @property
    def slow(self) -> bool:
        """Whether new values come more slowly than samples."""
        return self.rate > 0.0


def repeats(flight: Flight, column: str) -> RepeatedValues:
    """Judge the repeated values of one column of a flight."""
    values = flight[column]
    nothing = np.zeros(len(flight), bool)
    known = values[np.isfinite(values)]
    if (
        known.size < FEWEST or np.ptp(known) == 0.0 or flight.held(column) is not None
    ):  # a command rests, and is no sensor
        return RepeatedValues(column, 0.0, nothing, nothing, nothing, 0.0)
    step = quantum(known)
    same = _same(flight, values)
    held, rate = _held(flight, values, same, step)
    runs = _long_runs(flight, same)
    judge = _Judge(flight, column, values, same, held, step, runs)
    stuck, rest = nothing.copy(), nothing.copy()
    for a, b in runs:
        resting = judge.all_rest(a, b)
        rest[a:b] |= resting
        stuck[a:b] |= not resting and (judge.noise_stopped(a, b) or judge.motion_missed(a, b))
    return RepeatedValues(column, step, held & ~stuck, stuck, rest, rate)


def quantum(values: Array) -> float:
    """Smallest step between the levels of a channel [its unit]; next to nothing for one without a visible quantum.

    The twentieth part of the gaps between neighbouring levels is below it: one rounded twice has a few odd ones. values:
    finite.
    """
    gaps = np.diff(np.unique(values))
    gaps = gaps[gaps > SAME * span_of(values)]
    return float(np.quantile(gaps, 0.05)) if gaps.size else 0.0


def span_of(values: Array) -> float:
    """Range of a channel that one wild value in a hundred does not widen; all of it for one that mostly rests."""
    low, high = np.quantile(values, [0.01, 0.99]).tolist()
    return float(high - low) or float(np.ptp(values))


def runs_of(mask: Mask) -> list[tuple[int, int]]:
    """[start, stop) of each run of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8)))
    return [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def _same(flight: Flight, values: Array) -> Mask:
    """(N,) whether a sample shows the value of the one before, of the same segment."""
    span = span_of(values[np.isfinite(values)])
    same = np.zeros(values.size, bool)
    with np.errstate(invalid="ignore"):
        same[1:] = (np.abs(np.diff(values)) <= SAME * span) & (np.diff(flight.segment) == 0)
    return same


def _long_runs(flight: Flight, same: Mask) -> list[tuple[int, int]]:
    """[start, stop) of values repeated for as long as a stuck sensor would."""
    whole = [(a - 1, b) for a, b in runs_of(same)]
    time = flight.time
    return [(a, b) for a, b in whole if b - a >= STUCK_SAMPLES and time[b - 1] - time[a] >= STUCK]


def _held(flight: Flight, values: Array, same: Mask, step: float) -> tuple[Mask, float]:
    """Repeats of a slow sensor, and its rate [Hz]; none and 0 where it is as fast as the samples, or only coarse."""
    none = np.zeros(values.size, bool)
    starts = np.flatnonzero(~same & np.isfinite(values))
    if starts.size <= SLOW_RUNS:
        return none, 0.0
    length = np.diff(starts)
    jump = np.abs(np.diff(values[starts]))  # into the next value
    big = jump >= BIG * step
    # a value between two big steps: what was held there was moved meanwhile
    between = big[:-1] & big[1:] & (length[1:] * flight.sample_interval <= LONGEST_HOLD)
    holds = length[1:][between]
    if holds.size < SLOW_RUNS or float(np.mean(holds >= 2)) < SLOW_SHARE:
        return none, 0.0
    usual = float(np.median(holds))
    if float(np.mean(np.abs(holds - usual) <= 1.0)) < EVEN or float(np.mean(holds > 2.0 * usual + 1.0)) > LATE:
        return none, 0.0
    return same.copy(), float(1.0 / (holds.mean() * flight.sample_interval))


class _Judge:
    """Evidence on the long runs of one column."""

    def __init__(
        self,
        flight: Flight,
        column: str,
        values: Array,
        same: Mask,
        held: Mask,
        step: float,
        runs: list[tuple[int, int]],
    ) -> None:
        self.flight, self.column, self.step, self.runs = flight, column, step, runs
        self.still = np.zeros(values.size, bool)
        for a, b in runs:
            self.still[a:b] = True
        self.alive = values[~self.still & ~held & np.isfinite(values)]
        self.repeated = float(np.mean(same[~self.still & ~held])) if self.alive.size else 0.0
        self.shadow = shadow(flight, column, ~self.still) if runs else None
        self.values = values
        self._flicker: dict[str, float] = {}
        self.others = [c for c in SENSED if c != column and flight.measured(c)]

    def all_rest(self, a: int, b: int) -> bool:
        """Whether everything that is measured stands still in a run, or repeats itself: nothing says that it moved."""
        return bool(self.others) and not any(self._moves(c, a, b) for c in self.others)

    def _moves(self, column: str, a: int, b: int) -> bool:
        """Whether another column moves by more than the flicker of its last digit in a run."""
        if column not in self._flicker:
            known = self.flight[column][np.isfinite(self.flight[column])]
            self._flicker[column] = max(SAME * span_of(known), BIG * quantum(known))
        inside = self.flight[column][a:b]
        inside = inside[np.isfinite(inside)]
        return bool(inside.size > 1 and np.ptp(inside) > self._flicker[column])

    def noise_stopped(self, a: int, b: int) -> bool:
        """Whether noise of at least one quantum, which the channel shows elsewhere, is missing in a run."""
        if self.alive.size < STUCK_SAMPLES or self.repeated > REPEATED:
            return False
        third = np.diff(self.alive, 3)
        level = float(np.median(np.abs(third))) / GAUSSIAN / THIRD
        return level >= max(self.step, SAME * span_of(self.alive)) and _alternating(third)

    def motion_missed(self, a: int, b: int) -> bool:
        """Whether the other channels say that the run must have seen several quanta of movement."""
        if self.shadow is None:
            return False
        predicted = self.shadow[a:b]
        if not np.isfinite(predicted).all():
            return False
        moved = float(np.ptp(predicted))
        return moved > SEVERAL * self.step and moved > BEYOND_ERROR * self._usual_error(b - a)

    def _usual_error(self, length: int) -> float:
        """Movement within a stretch of that length that prediction and channel disagree on where it does not stand still."""
        assert self.shadow is not None
        off = np.where(self.still, np.nan, self.values - self.shadow)
        whole = [off[k : k + length] for k in range(0, off.size - length, max(1, length // 2))]
        errors = [float(np.ptp(w)) for w in whole if np.isfinite(w).all()]
        return float(np.median(errors)) if len(errors) >= 3 else np.inf


def _alternating(third: Array) -> bool:
    """Whether third differences are those of noise rather than of a curve. third: (n,)."""
    size = float(np.quantile(np.abs(third), 0.9))
    calm = np.clip(third, -size, size)  # edges of manoeuvres would decide alone
    calm = calm - calm.mean()
    power = float(calm @ calm)
    return power > 0.0 and float(calm[1:] @ calm[:-1]) / power < ALTERNATING


# ------------------------------------------------------------------------------- what the other channels say of a channel


def shadow(flight: Flight, column: str, trusted: Mask) -> Array | None:
    """(N,) the channel as the others show it, up to constants and slow drift; None where they cannot. trusted: (N,) samples
    that may be learnt from.

    Attitude from the rates and rates from the attitude, by kinematics; other channels by regression on the rest.
    """
    made = _KINEMATIC.get(column)
    if made is not None and all(flight.measured(c) for c in made.needs):
        return made.build({c: flight[c] for c in made.needs}, flight)
    if column not in SENSED:
        return None
    names = [c for c in (*SENSED, *CONTROLS) if c != column and flight.measured(c)]
    return _regressed(flight, column, names, trusted)


CONTROLS = ("delta_e", "delta_a", "delta_r")


def _regressed(flight: Flight, column: str, names: Sequence[str], trusted: Mask) -> Array | None:
    columns = [_standard(flight[c]) for c in names]
    X = np.column_stack([np.ones(len(flight)), *(c for c in columns if c is not None)])
    rows = trusted & np.isfinite(flight[column]) & np.isfinite(X).all(axis=1)
    if rows.sum() < 4 * X.shape[1]:
        return None
    beta = np.linalg.lstsq(X[rows], flight[column][rows], rcond=1e-9)[0]
    return np.asarray(X @ beta)


def _standard(values: Array) -> Array | None:
    spread = float(np.nanstd(values))
    return (values - float(np.nanmean(values))) / spread if spread > 0.0 else None


@dataclass(frozen=True)
class _Made:
    needs: tuple[str, ...]
    build: Callable[[Mapping[str, Array], Flight], Array]


def _integrated(rate: Array, flight: Flight) -> Array:
    """Running integral of a rate, from zero in each segment (trapezoidal rule)."""
    result = np.full(rate.size, np.nan)
    for part in flight.segments:
        mean = 0.5 * (rate[part][1:] + rate[part][:-1])
        result[part] = np.concatenate([[0.0], np.cumsum(mean * np.diff(flight.time[part]))])
    return result


def _turn(c: Mapping[str, Array]) -> Array:
    """Rate of turn about the vertical times cos(theta) [rad/s]."""
    return c["q"] * np.sin(c["phi"]) + c["r"] * np.cos(c["phi"])


_SMOOTHED = 5  # samples of a running mean over slopes of an attitude


def _slope(angle: Array, flight: Flight) -> Array:
    """Slope [rad/s] of an attitude, over a few samples."""
    result = np.full(angle.size, np.nan)
    kernel = np.full(_SMOOTHED, 1.0 / _SMOOTHED)
    for part in flight.segments:
        if part.stop - part.start > 2 * _SMOOTHED:
            result[part] = np.convolve(np.gradient(np.unwrap(angle[part]), flight.time[part]), kernel, "same")
    return result


_KINEMATIC: Mapping[str, _Made] = {
    "phi": _Made(("p", "q", "r", "phi", "theta"), lambda c, f: _integrated(c["p"] + np.tan(c["theta"]) * _turn(c), f)),
    "theta": _Made(
        ("q", "r", "phi"), lambda c, f: _integrated(c["q"] * np.cos(c["phi"]) - c["r"] * np.sin(c["phi"]), f)
    ),
    "psi": _Made(("q", "r", "phi", "theta"), lambda c, f: _integrated(_turn(c) / np.cos(c["theta"]), f)),
    "p": _Made(("phi", "psi", "theta"), lambda c, f: _slope(c["phi"], f) - _slope(c["psi"], f) * np.sin(c["theta"])),
    "q": _Made(
        ("phi", "theta", "psi"),
        lambda c, f: (
            _slope(c["theta"], f) * np.cos(c["phi"]) + _slope(c["psi"], f) * np.cos(c["theta"]) * np.sin(c["phi"])
        ),
    ),
    "r": _Made(
        ("phi", "theta", "psi"),
        lambda c, f: (
            _slope(c["psi"], f) * np.cos(c["theta"]) * np.cos(c["phi"]) - _slope(c["theta"], f) * np.sin(c["phi"])
        ),
    ),
}
