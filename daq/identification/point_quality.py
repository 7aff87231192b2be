"""The quality of a test point while it is flown: which controls moved, whether flight was steady before, and its faults.

A test point begins when a control moves by more than `movement.TRAVEL` within a second, and ends when none has moved for
`OVER_S`. Steadiness and gusts are taken from the seconds before the input. A vane shows three things: noise, which is estimated
from second differences; the turning of the aircraft itself, which gyros and accelerometers give whatever the aerodynamics are;
and the motion of the air, which is what remains.
"""

import math
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from daq.identification.airframe import Sample
from daq.identification.movement import TRAVEL, WITHIN
from daq.identification.next_manoeuvre import MOST_ALPHA, MOST_BANK, MOST_SIDESLIP
from daq.identification.simulated_motion import alpha_rate, beta_rate

BEFORE_S = 2.0  # s of steady flight before an input: two periods of the fastest mode that a pilot sees
OVER_S = 3.0  # s without a movement after which a point is over: a Dutch roll has been seen to die away
FEWEST = 8  # samples of the seconds before an input that a standard deviation needs
STEADY_BANK = math.radians(10.0)  # beyond, gravity enters as in no level trim
STEADY_RATE = math.radians(6.0)  # rad/s rms: a tenth of what an input makes
STEADY_SPEED = 1.5  # m/s between least and greatest: dynamic pressure changes by a fifth
GUSTY = math.radians(0.8)  # rad rms of a vane: five times usual air, as large as what a small input makes
DETRENDED_SHARE = 0.5
"""Share of the gusts' rms that remains when a straight line is fitted to two seconds of them and taken out (correlation time 1 s,
some 17 m). The line is there to absorb the errors of attitude, gyros and accelerometers."""
MOST_CORRELATED = 0.9  # correlation of two controls beyond which their derivatives cannot be separated
LEAST_MOVEMENT = math.radians(0.5)  # rad rms from which a control counts as moved in this point
AT_STOP = 0.98  # share of a throw beyond which a surface no longer follows its command
AT_STOP_S = 0.2  # s at a stop from which it is reported
CONTROL_WORDS = {"delta_a": "aileron", "delta_r": "rudder", "delta_e": "elevator"}


@dataclass(frozen=True, slots=True)
class FlownPoint:
    """One test point. begin [s]; seconds: from the first movement to the last [s]; moving: it is not over yet; peaks: control ->
    largest deflection from its trim [rad]; gusts: vane -> rms of gusts before the input [rad], of the vanes whose gusts the
    inertial instruments can separate; speed: mean before the input [m/s]; faults: sentences, each with its remedy."""

    begin: float
    seconds: float
    moving: bool
    peaks: Mapping[str, float]
    gusts: Mapping[str, float]
    speed: float
    faults: tuple[str, ...]


@dataclass
class _BeforeInput:
    """The seconds before an input. trim: mean of every control and angle [rad] and of V [m/s]; gusts, speed, faults: as of
    `FlownPoint`."""

    trim: Mapping[str, float]
    gusts: Mapping[str, float]
    speed: float
    faults: tuple[str, ...]


@dataclass
class _PointInProgress:
    """Sums over the samples of a point. products: of deflections times deflections [rad2], controls by controls; count: samples;
    peaks: control -> largest deflection [rad]; largest: angle -> largest change from trim [rad]; at_stop: control -> seconds at
    an end of its throw."""

    begin: float
    before: _BeforeInput
    products: np.ndarray
    last_moved: float
    count: int = 0
    peaks: dict[str, float] = field(default_factory=dict)
    largest: dict[str, float] = field(default_factory=dict)
    at_stop: dict[str, float] = field(default_factory=dict)


RESPONSES: Mapping[str, tuple[str, float, str]] = {
    "beta": ("sideslip", MOST_SIDESLIP, "lateral"),
    "phi": ("bank", MOST_BANK, "lateral"),
    "alpha": ("angle of attack", MOST_ALPHA, "longitudinal"),
}
"""Angle -> its words, the largest change [rad] that a linear model holds for (as `next_manoeuvre` advises), and its plane."""


class PointMeter:
    """Takes samples in order of time; `point` is the present point, or the last one; None before the first.

    controls: names of signals; throws: signal -> least and greatest deflection [rad], of the surfaces whose throw is known.
    """

    def __init__(self, controls: Sequence[str], throws: Mapping[str, tuple[float, float]]) -> None:
        self._controls, self._throws = tuple(controls), dict(throws)
        self._recent: deque[Sample] = deque()
        self._current: _PointInProgress | None = None
        self._finished: FlownPoint | None = None

    @property
    def point(self) -> FlownPoint | None:
        """The test point as it is now."""
        return self._finished if self._current is None else self._point(self._current, moving=True)

    def add(self, sample: Sample) -> None:
        """Take the next sample."""
        moved = self._control_moves(sample)
        if self._current is None and moved:
            steady = [s for s in self._recent if s.time < sample.time - WITHIN] or list(self._recent)[:1]
            size = len(self._controls)
            self._current = _PointInProgress(
                sample.time, self._before_input(steady), np.zeros((size, size)), sample.time
            )
        self._recent.append(sample)
        while self._recent[0].time < sample.time - BEFORE_S - WITHIN:
            self._recent.popleft()
        if self._current is None:
            return
        if moved:
            self._current.last_moved = sample.time
        self._accumulate(self._current, sample)
        if sample.time - self._current.last_moved > OVER_S:
            self._finished, self._current = self._point(self._current, moving=False), None

    def _control_moves(self, sample: Sample) -> bool:
        recent = [s for s in self._recent if s.time >= sample.time - WITHIN]
        values = [[getattr(s, c) for s in (*recent, sample)] for c in self._controls]
        return any(max(v) - min(v) > TRAVEL for v in values)

    def _before_input(self, before: Sequence[Sample]) -> _BeforeInput:
        columns = {n: np.array([getattr(s, n) for s in before]) for n in Sample._fields}
        trim = {n: float(np.mean(columns[n])) for n in (*self._controls, *RESPONSES, "V")}
        if len(before) < FEWEST:
            return _BeforeInput(trim, {}, trim["V"], ("no steady seconds before it: hold still for two, then begin",))
        gusts = {name: _spread(angles) / DETRENDED_SHARE for name, angles in _gust_angles(before)}
        return _BeforeInput(trim, gusts, trim["V"], tuple(_unsteady(columns, gusts)))

    def _accumulate(self, point: _PointInProgress, sample: Sample) -> None:
        trim = point.before.trim
        deflections = np.array([getattr(sample, c) - trim[c] for c in self._controls])
        point.products += np.outer(deflections, deflections)
        point.count += 1
        step = sample.time - self._recent[-2].time if len(self._recent) > 1 else 0.0
        for name, deflection in zip(self._controls, deflections, strict=True):
            point.peaks[name] = max(point.peaks.get(name, 0.0), abs(float(deflection)))
            low, high = self._throws.get(name, (-math.inf, math.inf))
            if not AT_STOP * low < getattr(sample, name) < AT_STOP * high:
                point.at_stop[name] = point.at_stop.get(name, 0.0) + step
        for name in RESPONSES:
            point.largest[name] = max(point.largest.get(name, 0.0), abs(getattr(sample, name) - trim[name]))

    def _point(self, point: _PointInProgress, *, moving: bool) -> FlownPoint:
        faults = (*point.before.faults, *self._faults(point))
        seconds = point.last_moved - point.begin
        return FlownPoint(point.begin, seconds, moving, point.peaks, point.before.gusts, point.before.speed, faults)

    def _faults(self, point: _PointInProgress) -> Iterator[str]:
        rms = np.sqrt(np.diag(point.products) / max(point.count, 1))
        for i, first in enumerate(self._controls):
            for k, second in enumerate(self._controls[:i]):
                if min(rms[i], rms[k]) > LEAST_MOVEMENT:
                    correlation = float(point.products[i, k] / (rms[i] * rms[k] * point.count))
                    if abs(correlation) > MOST_CORRELATED:
                        names = f"{CONTROL_WORDS[second]} and {CONTROL_WORDS[first]}"
                        yield f"{names} moved together ({correlation:+.2f}): fly one after the other"
        for name, seconds in point.at_stop.items():
            if seconds >= AT_STOP_S:
                yield f"{CONTROL_WORDS[name]} at its stop for {seconds:.1f} s: fly it smaller"
        planes = {"longitudinal" if c == "delta_e" else "lateral" for c in self._controls}
        for name, (words, limit, plane) in RESPONSES.items():
            change = point.largest.get(name, 0.0)
            if change > limit and plane in planes:
                share = 100.0 * limit / change
                yield f"{words} {math.degrees(change):.0f} deg from trim, a linear model is for less: fly {share:.0f} % of it"


def _unsteady(before: Mapping[str, np.ndarray], gusts: Mapping[str, float]) -> Iterator[str]:
    bank, speeds = abs(float(np.mean(before["phi"]))), before["V"]
    if bank > STEADY_BANK:
        yield f"bank {math.degrees(bank):.0f} deg before it: level the wings first"
    rate = max(float(np.sqrt(np.mean(before[n] ** 2))) for n in ("p", "q", "r"))
    if rate > STEADY_RATE:
        yield f"turning at {math.degrees(rate):.0f} deg/s before it: wait until motion has died away"
    if float(np.ptp(speeds)) > STEADY_SPEED + 4.0 * _noise(speeds):
        yield f"airspeed changed by {float(np.ptp(speeds)):.1f} m/s before it: trim first"
    gust = max(gusts.values(), default=0.0)
    swings = {n: swing for n in ("beta", "alpha") if (swing := _spread(before[n])) > GUSTY}
    if gust > GUSTY:
        yield f"gusts of {math.degrees(gust):.1f} deg: wait for calmer air"
    elif swings:
        name, swing = max(swings.items(), key=lambda item: item[1])
        part = f"{math.degrees(gusts[name]):.1f} of it gusts" if name in gusts else "its own motion or gusts"
        yield f"{RESPONSES[name][0]} unsteady by {math.degrees(swing):.1f} deg before it ({part}): wait until it is steady"


def _gust_angles(before: Sequence[Sample]) -> Iterator[tuple[str, np.ndarray]]:
    """Vane, and what it shows beyond the aircraft's own turning in still air [rad], less a straight line in time; of the vanes
    whose rate in still air the inertial instruments give."""
    time = np.array([s.time for s in before])
    rates = {"beta": [beta_rate(s) for s in before], "alpha": [alpha_rate(s, beta=0.0) for s in before]}
    for name, rate in rates.items():
        if np.isfinite(rate).all():
            shown = np.array([getattr(s, name) for s in before])
            excess = shown - _integral(time, np.array(rate))
            yield name, excess - np.polyval(np.polyfit(time, excess, 1), time)


def _integral(time: np.ndarray, rate: np.ndarray) -> np.ndarray:
    """Running integral by the trapezoidal rule, from 0."""
    return np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(time))])


def _noise(values: np.ndarray) -> float:
    """Standard deviation of white noise, by second differences."""
    return float(np.sqrt(np.mean(np.diff(values, 2) ** 2) / 6.0)) if len(values) > 2 else 0.0


def _spread(values: np.ndarray) -> float:
    """Standard deviation without that of white noise from sample to sample."""
    return math.sqrt(max(float(np.var(values)) - _noise(values) ** 2, 0.0))
