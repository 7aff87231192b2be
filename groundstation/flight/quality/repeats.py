"""Repeated values of a channel, classified as those of a coarse, a slow or a stuck sensor; and flights that share samples.

A coarsely quantised channel repeats while the motion is small. A slow one repeats regularly, and jumps by many quanta at each new
value. A stuck one repeats although its noise, or the motion by other channels, must have moved it by several quanta. The quantum
is estimated from the data. Values closer than `SAME` of the range count as equal, so that dither far below the quantum has no
effect.

Sensors have noise, so two flights never have the same numbers for a second. Where they do, they are one record: a joint fit would
count it twice, and as a holdout it would prove nothing.
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
STUCK = 1.0  # [s] of one value, at least
STUCK_SAMPLES = 20  # of one value, at least
SEVERAL = 5.0  # quanta of missed movement: rounding moves a channel by one, a wrong quantum by two
BIG = 3.0  # quanta of a step that is more than a change between neighbouring levels
SLOW_RUNS = 20  # new values by big steps, at least, for a channel to be slow
SLOW_SHARE = 1 / 3  # of those values, at least, that last for more than one sample (three new values in four samples)
LONGEST_HOLD = 0.6  # [s]; slower channels (1 Hz GNSS and less) are too rare to be interpolated
EVEN = 0.8  # share of holds, at least, within one sample of the median: those of a commanded step are uneven
LATE = 0.05  # share of holds, at most, beyond twice the median: a slow sensor seldom loses two values in a row
BEYOND_ERROR = 4.0  # times the usual error of a prediction, that a predicted movement must exceed
ROWS_PER_PREDICTOR = 4  # of a regression on other channels, at least
FEWEST_ERRORS = 3  # stretches from which the usual error of a prediction is known
SMALL_GAPS = 0.05  # quantile
FEWEST = 40  # finite values of a channel, below which its repeats are not judged
GAUSSIAN = 0.6744897501960817  # median of the absolute value of a standard normal variable
THIRD = np.sqrt(20.0)  # standard deviation of a third difference of white noise of 1
SETTLES = 0.15  # of the median third difference, the lower quartile: 0.47 of noise, 0.01 of a settling servo
SMOOTHED = 5  # samples of the running mean over slopes of an attitude

MOVING = ("ax", "ay", "az", "p", "q", "r", "phi", "theta", "psi", "alpha", "beta", "V")
"""Columns that change from sample to sample in flight, so that a repeated value is an old one."""
SENSED = (*MOVING, "altitude", "p_static", "p_dynamic")  # columns of sensors that the motion of the aircraft moves


@dataclass(frozen=True)
class RepeatedValues:
    """The repeated values of one column, by cause. quantum: smallest step [column's unit], 0 without one.

    held: (N,) samples that repeat the last value of a slow sensor; rate: of its new values [Hz], 0 where it is not slow.
    stuck: (N,) samples at which the sensor is stuck. at_rest: (N,) samples at which all other channels stand still, too.
    """

    column: str
    quantum: float
    held: Mask
    stuck: Mask
    at_rest: Mask
    rate: float

    @property
    def slow(self) -> bool:
        """Whether new values are rarer than samples."""
        return self.rate > 0.0


def repeats(flight: Flight, column: str) -> RepeatedValues:
    """Classify the repeated values of one column of a flight; none of a command, or of too few values."""
    values = flight[column]
    no_samples = np.zeros(len(flight), bool)
    finite = values[np.isfinite(values)]
    commanded = flight.held(column) is not None  # a command is not measured: it may rest
    if finite.size < FEWEST or np.ptp(finite) == 0.0 or commanded:
        return RepeatedValues(column, 0.0, no_samples, no_samples, no_samples, 0.0)
    step = quantum(finite)
    repeated = _repeated(flight, values)
    held_samples, rate = _slow_repeats(flight, values, repeated, step)
    runs = _long_runs(flight, repeated)
    evidence = _StuckEvidence(flight, column, repeated, held_samples, step, runs)
    stuck, at_rest = no_samples.copy(), no_samples.copy()
    for a, b in runs:
        rests = evidence.all_rest(a, b)
        at_rest[a:b] |= rests
        stuck[a:b] |= not rests and (evidence.noise_stopped() or evidence.motion_missed(a, b))
    return RepeatedValues(column, step, held_samples & ~stuck, stuck, at_rest, rate)


def quantum(values: Array) -> float:
    """Step between the levels of a channel [its unit]; almost zero for one without a visible quantum. values: (n,), finite.

    It is the SMALL_GAPS quantile of the gaps between levels, since a channel that was rounded twice has a few smaller ones.
    """
    gaps = np.diff(np.unique(values))
    gaps = gaps[gaps > SAME * span_of(values)]
    return float(np.quantile(gaps, SMALL_GAPS)) if gaps.size else 0.0


def span_of(values: Array) -> float:
    """Range of a channel between its quantiles 0.01 and 0.99; the full range where they are equal. values: (n,), finite."""
    low, high = np.quantile(values, [0.01, 0.99]).tolist()
    return float(high - low) or float(np.ptp(values))


def _repeated(flight: Flight, values: Array) -> Mask:
    """(N,) whether a sample repeats the value of the one before it in its segment."""
    span = span_of(values[np.isfinite(values)])
    repeated = np.zeros(values.size, bool)
    with np.errstate(invalid="ignore"):
        repeated[1:] = (np.abs(np.diff(values)) <= SAME * span) & (np.diff(flight.segment) == 0)
    return repeated


def _long_runs(flight: Flight, repeated: Mask) -> list[tuple[int, int]]:
    """[start, stop) of each run of one value that is long enough for a stuck sensor."""
    runs = [(a - 1, b) for a, b in true_runs(repeated)]
    return [(a, b) for a, b in runs if b - a >= STUCK_SAMPLES and flight.time[b - 1] - flight.time[a] >= STUCK]


def _slow_repeats(flight: Flight, values: Array, repeated: Mask, step: float) -> tuple[Mask, float]:
    """(N,) repeats of a slow sensor, and its rate [Hz]; none and 0 where it is as fast as the samples, or only coarse.
    step: its quantum."""
    no_samples = np.zeros(values.size, bool)
    starts = np.flatnonzero(~repeated & np.isfinite(values))
    if starts.size <= SLOW_RUNS:
        return no_samples, 0.0
    length = np.diff(starts)
    jump = np.abs(np.diff(values[starts]))  # into the next value
    big = jump >= BIG * step
    # a value between two big steps was held while the quantity moved
    complete = big[:-1] & big[1:] & (length[1:] * flight.sample_interval <= LONGEST_HOLD)
    holds = length[1:][complete]
    if holds.size < SLOW_RUNS or float(np.mean(holds >= 2)) < SLOW_SHARE:
        return no_samples, 0.0
    typical = float(np.median(holds))
    if float(np.mean(np.abs(holds - typical) <= 1.0)) < EVEN or float(np.mean(holds > 2.0 * typical + 1.0)) > LATE:
        return no_samples, 0.0
    return repeated.copy(), float(1.0 / (holds.mean() * flight.sample_interval))


class _StuckEvidence:
    """Tests of whether the sensor of one column is stuck in a long run of one value.

    same: (N,) repeated samples; held: (N,) those of a slow sensor; step: quantum; runs: [start, stop) of all long runs.
    """

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
        self.prediction = predicted_channel(flight, column, ~self.still) if runs else None
        self._flicker: dict[str, float] = {}
        self.others = [c for c in SENSED if c != column and flight.measured(c)]

    def all_rest(self, a: int, b: int) -> bool:
        """Whether all other channels stand still in a run, too."""
        return bool(self.others) and not any(self._moves(c, a, b) for c in self.others)

    def _moves(self, column: str, a: int, b: int) -> bool:
        """Whether another column moves by more than a few of its quanta in a run."""
        if column not in self._flicker:
            finite = self.flight[column][np.isfinite(self.flight[column])]
            self._flicker[column] = max(SAME * span_of(finite), BIG * quantum(finite))
        values = self.flight[column][a:b]
        values = values[np.isfinite(values)]
        return bool(values.size > 1 and np.ptp(values) > self._flicker[column])

    def noise_stopped(self) -> bool:
        """Whether the channel has noise of at least one quantum outside the long runs."""
        if self.alive.size < STUCK_SAMPLES or self.repeated > REPEATED:
            return False
        third = np.diff(self.alive, 3)
        quarter, median = np.quantile(np.abs(third), [0.25, 0.5]).tolist()
        level = median / GAUSSIAN / THIRD
        # a servo without noise settles: its changes are of many sizes, those of noise are of one
        return level >= max(self.step, SAME * span_of(self.alive)) and quarter > SETTLES * median and alternates(third)

    def motion_missed(self, a: int, b: int) -> bool:
        """Whether the channel must have moved by several quanta in a run, as predicted from the others."""
        if self.prediction is None:
            return False
        predicted = self.prediction[a:b]
        if not np.isfinite(predicted).all():
            return False
        movement = float(np.ptp(predicted))
        return movement > SEVERAL * self.step and movement > BEYOND_ERROR * self._usual_error(b - a)

    def _usual_error(self, length: int) -> float:
        """Median range of the prediction's error within stretches of `length` samples outside the runs; infinite for too few."""
        assert self.prediction is not None
        error = np.where(self.still, np.nan, self.values - self.prediction)
        stretches = [error[k : k + length] for k in range(0, error.size - length, max(1, length // 2))]
        errors = [float(np.ptp(stretch)) for stretch in stretches if np.isfinite(stretch).all()]
        return float(np.median(errors)) if len(errors) >= FEWEST_ERRORS else np.inf


# ------------------------------------------------------------------------------------- a channel predicted from the others


def predicted_channel(flight: Flight, column: str, trusted: Mask) -> Array | None:
    """(N,) the channel by the other channels, but for constants and slow drift; None where they do not determine it.

    Attitude from rates and rates from attitude, by kinematics; other channels by regression on the rest, fitted to the samples
    `trusted` (N,).
    """
    kinematics = _KINEMATICS.get(column)
    if kinematics is not None and all(flight.measured(c) for c in kinematics[0]):
        return kinematics[1](flight)
    if column not in SENSED:
        return None
    predictors = [_standardised(flight[c]) for c in (*SENSED, *CONTROLS) if c != column and flight.measured(c)]
    X = np.column_stack([np.ones(len(flight)), *(c for c in predictors if c is not None)])
    rows = trusted & np.isfinite(flight[column]) & np.isfinite(X).all(axis=1)
    if rows.sum() < ROWS_PER_PREDICTOR * X.shape[1]:
        return None
    beta = np.linalg.lstsq(X[rows], flight[column][rows], rcond=1e-9)[0]
    return np.asarray(X @ beta)


def _standardised(values: Array) -> Array | None:
    """(N,) values less their mean, over their standard deviation; None for a constant."""
    spread = float(np.nanstd(values))
    return (values - float(np.nanmean(values))) / spread if spread > 0.0 else None


def _angle(name: str, flight: Flight) -> Array:
    """(N,) an angle of attitude [rad] as the integral of its rate by the gyros, from zero in each segment."""
    rate = EULER_RATES[name](flight)
    angle = np.full(rate.size, np.nan)
    for part in flight.segments:
        angle[part] = integral(flight.time[part], rate[part])
    return angle


def _angle_slope(name: str, flight: Flight) -> Array:
    """(N,) rate of an angle of attitude [rad/s], averaged over SMOOTHED samples."""
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
"""Column -> the columns from which kinematics give it, and the function that does."""


# ------------------------------------------------------------------------------------------------ flights that share samples

ROWS_IN_A_ROW = 20  # consecutive rows that must be equal
ROWS_MOVING = 0.5  # of them must differ from the row before: all aircraft at rest, and simulated trims, are alike
SHARED = 0.25  # of the shorter flight: flights simulated without noise may have the same beginning
FEWEST_COLUMNS = 3  # that all flights have measured
TENTH_OF_STEP = 0.1
"""Rounding to five digits is a thousandth of a channel's noise or less: it flips a row in one window of five."""


def one_record_twice(flights: Sequence[Flight]) -> tuple[int, int] | None:
    """Indices of the first two flights that share at least a quarter of the shorter one's samples; None without such a pair."""
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
    """A tenth of the usual change of a column from row to row; 1 for a column that mostly rests. A copy written with fewer digits
    is rounded by far less, and two flights differ by far more."""
    usual = [float(np.nanmedian(np.abs(np.diff(v)))) for v in courses if np.isfinite(np.diff(v)).any()]
    return TENTH_OF_STEP * float(np.median(usual)) if usual and np.median(usual) > 0.0 else 1.0


def _fingerprints(flight: Flight, columns: Sequence[str], steps: Array) -> set[int]:
    """A hash of every window of ROWS_IN_A_ROW rows in which the values move. steps: (columns,) to which values are rounded."""
    courses = [np.round(flight[c] / q) if q != 1.0 else flight[c] for c, q in zip(columns, steps, strict=True)]
    # single precision, so that a file with seven digits is equal; as bits, so that NaN equals NaN; + 0.0 makes -0.0 equal 0.0
    with np.errstate(over="ignore"):  # beyond its range, as where a simulation ran away, all values are infinite
        rows = np.column_stack([v.astype(np.float32) + np.float32(0.0) for v in courses]).view(np.uint32)
    changes = np.concatenate([[0], np.cumsum((rows[1:] != rows[:-1]).any(axis=1))])
    return {
        hash(rows[end - ROWS_IN_A_ROW : end].tobytes())
        for end in range(ROWS_IN_A_ROW, len(rows) + 1)
        if changes[end - 1] - changes[end - ROWS_IN_A_ROW] >= ROWS_MOVING * ROWS_IN_A_ROW
    }
