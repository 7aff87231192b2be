"""Repeated values of a channel, classified by what the motion must have done to it: a coarse step, a slow or a stuck sensor.

A quantised channel repeats while the aircraft hardly moves it; a slow one repeats in step, and jumps by many quanta where
a new value comes; a stuck one repeats though its own noise, or the motion that the other channels show, must have moved it
by several quanta. The quantum is read off the data. Values closer than `SAME` of the range count as equal, so that dither
far below the quantum changes nothing.

Whole records repeat, too: sensors have noise, so two flights never show the same numbers for a second. Where they do, a joint
fit counts them twice, and a flight held out proves nothing.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import combinations

import numpy as np

from groundstation.flight.arrays import REPEATED, Array, Mask, alternates, integral, true_runs
from groundstation.flight.flight import Flight
from groundstation.flight.kinematics import EULER_RATES
from groundstation.flight.manoeuvres import CONTROLS

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
BEYOND_ERROR = 4.0  # times the usual error of the prediction that a predicted movement must exceed
FEWEST = 40  # samples from which any of this can be told
GAUSSIAN = 0.6744897501960817  # median of the absolute value of a standard normal variable
THIRD = np.sqrt(20.0)  # standard deviation of a third difference of white noise of 1
SMOOTHED = 5  # samples of a running mean over slopes of an attitude

MOVING = ("ax", "ay", "az", "p", "q", "r", "phi", "theta", "psi", "alpha", "beta", "V")
"""Columns that change from sample to sample in flight: a repeated value there is an old value."""
SENSED = (*MOVING, "altitude", "p_static", "p_dynamic")  # columns of sensors that the motion of the aircraft moves


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
    no_samples = np.zeros(len(flight), bool)
    finite = values[np.isfinite(values)]
    commanded = flight.held(column) is not None  # a command rests, and is no sensor
    if finite.size < FEWEST or np.ptp(finite) == 0.0 or commanded:
        return RepeatedValues(column, 0.0, no_samples, no_samples, no_samples, 0.0)
    step = quantum(finite)
    repeated = _same(flight, values)
    held_samples, rate = _held(flight, values, repeated, step)
    runs = _long_runs(flight, repeated)
    evidence = _StuckEvidence(flight, column, repeated, held_samples, step, runs)
    stuck, at_rest = no_samples.copy(), no_samples.copy()
    for a, b in runs:
        rests = evidence.all_rest(a, b)
        at_rest[a:b] |= rests
        stuck[a:b] |= not rests and (evidence.noise_stopped() or evidence.motion_missed(a, b))
    return RepeatedValues(column, step, held_samples & ~stuck, stuck, at_rest, rate)


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


def _same(flight: Flight, values: Array) -> Mask:
    """(N,) whether a sample shows the value of the one before, of the same segment."""
    span = span_of(values[np.isfinite(values)])
    repeated = np.zeros(values.size, bool)
    with np.errstate(invalid="ignore"):
        repeated[1:] = (np.abs(np.diff(values)) <= SAME * span) & (np.diff(flight.segment) == 0)
    return repeated


def _long_runs(flight: Flight, same: Mask) -> list[tuple[int, int]]:
    """[start, stop) of values repeated for as long as a stuck sensor would."""
    runs = [(a - 1, b) for a, b in true_runs(same)]
    return [(a, b) for a, b in runs if b - a >= STUCK_SAMPLES and flight.time[b - 1] - flight.time[a] >= STUCK]


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
    complete = big[:-1] & big[1:] & (length[1:] * flight.sample_interval <= LONGEST_HOLD)
    holds = length[1:][complete]
    if holds.size < SLOW_RUNS or float(np.mean(holds >= 2)) < SLOW_SHARE:
        return none, 0.0
    typical = float(np.median(holds))
    if float(np.mean(np.abs(holds - typical) <= 1.0)) < EVEN or float(np.mean(holds > 2.0 * typical + 1.0)) > LATE:
        return none, 0.0
    return same.copy(), float(1.0 / (holds.mean() * flight.sample_interval))


class _StuckEvidence:
    """Whether the sensor of one column is stuck in a long run of one value. runs: all of them."""

    def __init__(
        self, flight: Flight, column: str, same: Mask, held: Mask, step: float, runs: list[tuple[int, int]]
    ) -> None:
        self.flight, self.step, self.values = flight, step, flight[column]
        self.still = np.zeros(len(flight), bool)
        for a, b in runs:
            self.still[a:b] = True
        live = ~self.still & ~held
        self.alive = self.values[live & np.isfinite(self.values)]
        self.repeated = float(np.mean(same[live])) if self.alive.size else 0.0
        self.shadow = predicted_channel(flight, column, ~self.still) if runs else None
        self._flicker: dict[str, float] = {}
        self.others = [c for c in SENSED if c != column and flight.measured(c)]

    def all_rest(self, a: int, b: int) -> bool:
        """Whether everything that is measured stands still in a run, or repeats itself: nothing says that it moved."""
        return bool(self.others) and not any(self._moves(c, a, b) for c in self.others)

    def _moves(self, column: str, a: int, b: int) -> bool:
        """Whether another column moves by more than the flicker of its last digit in a run."""
        if column not in self._flicker:
            finite = self.flight[column][np.isfinite(self.flight[column])]
            self._flicker[column] = max(SAME * span_of(finite), BIG * quantum(finite))
        values = self.flight[column][a:b]
        values = values[np.isfinite(values)]
        return bool(values.size > 1 and np.ptp(values) > self._flicker[column])

    def noise_stopped(self) -> bool:
        """Whether noise of at least one quantum, which the channel shows elsewhere, is missing in the runs."""
        if self.alive.size < STUCK_SAMPLES or self.repeated > REPEATED:
            return False
        third = np.diff(self.alive, 3)
        level = float(np.median(np.abs(third))) / GAUSSIAN / THIRD
        return level >= max(self.step, SAME * span_of(self.alive)) and alternates(third)

    def motion_missed(self, a: int, b: int) -> bool:
        """Whether the other channels say that the run must have seen several quanta of movement."""
        if self.shadow is None:
            return False
        predicted = self.shadow[a:b]
        if not np.isfinite(predicted).all():
            return False
        movement = float(np.ptp(predicted))
        return movement > SEVERAL * self.step and movement > BEYOND_ERROR * self._usual_error(b - a)

    def _usual_error(self, length: int) -> float:
        """Movement within a stretch of that length that prediction and channel disagree on where it does not stand still."""
        assert self.shadow is not None
        error = np.where(self.still, np.nan, self.values - self.shadow)
        stretches = [error[k : k + length] for k in range(0, error.size - length, max(1, length // 2))]
        errors = [float(np.ptp(stretch)) for stretch in stretches if np.isfinite(stretch).all()]
        return float(np.median(errors)) if len(errors) >= 3 else np.inf


# ------------------------------------------------------------------------------- what the other channels say of a channel


def predicted_channel(flight: Flight, column: str, trusted: Mask) -> Array | None:
    """(N,) the channel as the others show it, up to constants and slow drift; None where they cannot. trusted: (N,) samples
    that may be learnt from.

    Attitude from the rates and rates from the attitude, by kinematics; other channels by regression on the rest.
    """
    kinematics = _KINEMATICS.get(column)
    if kinematics is not None and all(flight.measured(c) for c in kinematics[0]):
        return kinematics[1](flight)
    if column not in SENSED:
        return None
    predictors = [_standardised(flight[c]) for c in (*SENSED, *CONTROLS) if c != column and flight.measured(c)]
    X = np.column_stack([np.ones(len(flight)), *(c for c in predictors if c is not None)])
    rows = trusted & np.isfinite(flight[column]) & np.isfinite(X).all(axis=1)
    if rows.sum() < 4 * X.shape[1]:
        return None
    beta = np.linalg.lstsq(X[rows], flight[column][rows], rcond=1e-9)[0]
    return np.asarray(X @ beta)


def _standardised(values: Array) -> Array | None:
    spread = float(np.nanstd(values))
    return (values - float(np.nanmean(values))) / spread if spread > 0.0 else None


def _angle(name: str, flight: Flight) -> Array:
    """An angle of attitude by what the gyros turn, from zero in each segment."""
    rate = EULER_RATES[name](flight)
    angle = np.full(rate.size, np.nan)
    for part in flight.segments:
        angle[part] = integral(flight.time[part], rate[part])
    return angle


def _angle_slope(name: str, flight: Flight) -> Array:
    """Slope [rad/s] of an angle of attitude, over a few samples."""
    slope = np.full(len(flight), np.nan)
    kernel = np.full(SMOOTHED, 1.0 / SMOOTHED)
    for part in flight.segments:
        if part.stop - part.start > 2 * SMOOTHED:
            slope[part] = np.convolve(np.gradient(np.unwrap(flight[name][part]), flight.time[part]), kernel, "same")
    return slope


def _p(f: Flight) -> Array:
    return _angle_slope("phi", f) - _angle_slope("psi", f) * np.sin(f["theta"])


def _q(f: Flight) -> Array:
    yaw_part = _angle_slope("psi", f) * np.cos(f["theta"]) * np.sin(f["phi"])
    return _angle_slope("theta", f) * np.cos(f["phi"]) + yaw_part


def _r(f: Flight) -> Array:
    yaw_part = _angle_slope("psi", f) * np.cos(f["theta"]) * np.cos(f["phi"])
    return yaw_part - _angle_slope("theta", f) * np.sin(f["phi"])


_ATTITUDE = ("phi", "theta", "psi")
_KINEMATICS: Mapping[str, tuple[tuple[str, ...], Callable[[Flight], Array]]] = {
    "phi": (("p", "q", "r", "phi", "theta"), partial(_angle, "phi")),
    "theta": (("q", "r", "phi"), partial(_angle, "theta")),
    "psi": (("q", "r", "phi", "theta"), partial(_angle, "psi")),
    "p": (_ATTITUDE, _p),
    "q": (_ATTITUDE, _q),
    "r": (_ATTITUDE, _r),
}
"""Column -> the columns that kinematics make it of, and how."""


# -------------------------------------------------------------------------------------------------- flights that are one record

ROWS_IN_A_ROW = 20  # rows in a row that have to be the same
ROWS_MOVING = 0.5  # of them have to differ from the row before: aircraft at rest and simulated trims look alike
SHARED = 0.25  # of the shorter flight: flights simulated without noise may begin alike
FEWEST_COLUMNS = 3  # that all have measured
TENTH_OF_STEP = (
    0.1  # five digits of a channel are a thousandth of its noise or less: one window of five has a row that flips
)


def one_record_twice(flights: Sequence[Flight]) -> tuple[int, int] | None:
    """Indices of the first two flights that share a quarter of the shorter one's samples; None where no two do."""
    columns = [c for c in SENSED if all(f.measured(c) for f in flights)]
    if len(columns) < FEWEST_COLUMNS:
        return None
    steps = np.array([_coarse_step([f[c] for f in flights]) for c in columns])
    prints = [_fingerprints(f, columns, steps) for f in flights]
    for a, b in combinations(range(len(flights)), 2):
        shared = len(prints[a] & prints[b])
        if shared and shared >= SHARED * min(len(flights[a]), len(flights[b])):
            return a, b
    return None


def _coarse_step(courses: Sequence[Array]) -> float:
    """Tenth of how far a column usually goes from row to row: what a copy written with fewer digits is rounded by is far less,
    what two flights differ by far more. 1 for one that mostly rests."""
    usual = [float(np.nanmedian(np.abs(np.diff(v)))) for v in courses if np.isfinite(np.diff(v)).any()]
    return TENTH_OF_STEP * float(np.median(usual)) if usual and np.median(usual) > 0.0 else 1.0


def _fingerprints(flight: Flight, columns: Sequence[str], steps: Array) -> set[int]:
    """A number for the contents of every window of rows that move. steps: (columns,) to which values are rounded."""
    courses = [np.round(flight[c] / q) if q != 1.0 else flight[c] for c, q in zip(columns, steps, strict=True)]
    # bits, so that what is not measured is the same; zero and minus zero are
    rows = np.column_stack([v.astype(np.float32) + np.float32(0.0) for v in courses]).view(np.uint32)
    changes = np.concatenate([[0], np.cumsum((rows[1:] != rows[:-1]).any(axis=1))])
    return {
        hash(rows[end - ROWS_IN_A_ROW : end].tobytes())
        for end in range(ROWS_IN_A_ROW, len(rows) + 1)
        if changes[end - 1] - changes[end - ROWS_IN_A_ROW] >= ROWS_MOVING * ROWS_IN_A_ROW
    }
