"""The quality of a test point while it is flown: what was moved, whether flight was steady before, and what spoils it.

A point begins when a control moves (`movement.TRAVEL` within a second) and is over when none has for some seconds. Steadiness and
gusts are of the seconds before. What a vane shows is noise, which second differences hold alone, the aircraft's own motion, which
gyros and accelerometers hold whatever its aerodynamics are, and the air.
"""

import math
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from daq.identification.airframe import Sample
from daq.identification.movement import TRAVEL, WITHIN
from daq.identification.next_manoeuvre import MOST_ALPHA, MOST_BANK, MOST_SIDESLIP
from daq.utilities.constants import GRAVITY

BEFORE_S = 2.0  # s of steady flight before an input: two periods of the fastest mode that a pilot sees
OVER_S = 3.0  # s without a movement after which a point is over: a Dutch roll has been seen to die away
FEWEST = 8  # samples from which anything is said of the seconds before
STEADY_BANK = math.radians(10.0)  # beyond, gravity enters as in no level trim
STEADY_RATE = math.radians(6.0)  # rad/s rms: a tenth of what an input makes
STEADY_SPEED = 1.5  # m/s between least and greatest: dynamic pressure changes by a fifth
GUSTY = math.radians(0.8)  # rad rms of a vane: five times usual air, as large as what a small input makes
LINE_LEAVES = 0.5
"""Of gusts' rms, what a straight line through two seconds of them leaves over (correlation time 1 s, some 17 m). The line takes
errors of attitude, and of the gyros and accelerometers."""
TOGETHER = 0.9  # correlation of two controls from which their derivatives are not told apart
MOVES_TOO = math.radians(0.5)  # rad rms from which a control counts as flown
AT_STOP = 0.98  # of a throw: a surface there does not go where it is asked to
AT_STOP_S = 0.2  # s at a stop that are worth a word
CONTROL_WORDS = {"delta_a": "aileron", "delta_r": "rudder", "delta_e": "elevator"}


@dataclass(frozen=True, slots=True)
class FlownPoint:
    """One test point. begin [s]; seconds: from the first movement to the last; moving: it is not over yet; peaks: control ->
    largest deflection from where it was before [rad]; gusts: vane -> rms of what the air adds [rad], where it can be told, and
    speed [m/s], before the input; faults: what spoils it, with what to do, in words."""

    begin: float
    seconds: float
    moving: bool
    peaks: Mapping[str, float]
    gusts: Mapping[str, float]
    speed: float
    faults: tuple[str, ...]


@dataclass
class _Calm:
    """The seconds before an input. trim: of every control and angle, means; faults: what was not steady."""

    trim: Mapping[str, float]
    gusts: Mapping[str, float]
    speed: float
    faults: tuple[str, ...]


@dataclass
class _Course:
    """What a point has seen so far. products: sums of deflections times deflections; largest: angle -> from trim [rad];
    at_stop: control -> seconds at an end of its throw."""

    begin: float
    calm: _Calm
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
"""Angle -> words, largest change that a linear model is for (the limits of what is advised), and the plane it belongs to."""


class PointMeter:
    """Feed samples in order of time; `point` is the present point, or the last one, None before the first.

    controls: signals; throws: signal -> least and greatest deflection [rad], where known.
    """

    def __init__(self, controls: Sequence[str], throws: Mapping[str, tuple[float, float]]) -> None:
        self._controls, self._throws = tuple(controls), dict(throws)
        self._recent: deque[Sample] = deque()
        self._course: _Course | None = None
        self._over: FlownPoint | None = None

    @property
    def point(self) -> FlownPoint | None:
        """As it is now."""
        return self._over if self._course is None else self._point(self._course, moving=True)

    def add(self, sample: Sample) -> None:
        """One sample."""
        moved = self._moves(sample)
        if self._course is None and moved:
            calm = self._calm([s for s in self._recent if s.time < sample.time - WITHIN] or list(self._recent)[:1])
            size = len(self._controls)
            self._course = _Course(sample.time, calm, np.zeros((size, size)), sample.time)
        self._recent.append(sample)
        while self._recent[0].time < sample.time - BEFORE_S - WITHIN:
            self._recent.popleft()
        if self._course is None:
            return
        if moved:
            self._course.last_moved = sample.time
        self._follow(self._course, sample)
        if sample.time - self._course.last_moved > OVER_S:
            self._over, self._course = self._point(self._course, moving=False), None

    def _moves(self, sample: Sample) -> bool:
        recent = [s for s in self._recent if s.time >= sample.time - WITHIN]
        values = [[getattr(s, c) for s in (*recent, sample)] for c in self._controls]
        return any(max(v) - min(v) > TRAVEL for v in values)

    def _calm(self, before: Sequence[Sample]) -> _Calm:
        columns = {n: np.array([getattr(s, n) for s in before]) for n in Sample._fields}
        trim = {n: float(np.mean(columns[n])) for n in (*self._controls, *RESPONSES, "V")}
        if len(before) < FEWEST:
            return _Calm(trim, {}, trim["V"], ("no steady seconds before it: hold still for two, then begin",))
        gusts = {n: _spread(columns[n] - turned) / LINE_LEAVES for n, turned in _turned(columns).items()}
        return _Calm(trim, gusts, trim["V"], tuple(_unsteady(columns, gusts)))

    def _follow(self, course: _Course, sample: Sample) -> None:
        trim = course.calm.trim
        moved = np.array([getattr(sample, c) - trim[c] for c in self._controls])
        course.products += np.outer(moved, moved)
        course.count += 1
        step = sample.time - self._recent[-2].time if len(self._recent) > 1 else 0.0
        for name, value in zip(self._controls, moved, strict=True):
            course.peaks[name] = max(course.peaks.get(name, 0.0), abs(float(value)))
            low, high = self._throws.get(name, (-math.inf, math.inf))
            if not AT_STOP * low < getattr(sample, name) < AT_STOP * high:
                course.at_stop[name] = course.at_stop.get(name, 0.0) + step
        for name in RESPONSES:
            course.largest[name] = max(course.largest.get(name, 0.0), abs(getattr(sample, name) - trim[name]))

    def _point(self, course: _Course, *, moving: bool) -> FlownPoint:
        faults = (*course.calm.faults, *self._spoilt(course))
        seconds = course.last_moved - course.begin
        return FlownPoint(course.begin, seconds, moving, course.peaks, course.calm.gusts, course.calm.speed, faults)

    def _spoilt(self, course: _Course) -> Iterator[str]:
        rms = np.sqrt(np.diag(course.products) / max(course.count, 1))
        for i, first in enumerate(self._controls):
            for k, second in enumerate(self._controls[:i]):
                if min(rms[i], rms[k]) > MOVES_TOO:
                    correlation = float(course.products[i, k] / (rms[i] * rms[k] * course.count))
                    if abs(correlation) > TOGETHER:
                        names = f"{CONTROL_WORDS[second]} and {CONTROL_WORDS[first]}"
                        yield f"{names} moved together ({correlation:+.2f}): fly one after the other"
        for name, seconds in course.at_stop.items():
            if seconds >= AT_STOP_S:
                yield f"{CONTROL_WORDS[name]} at its stop for {seconds:.1f} s: fly it smaller"
        planes = {"longitudinal" if c == "delta_e" else "lateral" for c in self._controls}
        for name, (words, limit, plane) in RESPONSES.items():
            change = course.largest.get(name, 0.0)
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


def _turned(before: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Vane -> angle by which the aircraft itself has turned out of still air since the first sample [rad], where inertial
    instruments tell it (Stevens and Lewis, Aircraft Control and Simulation, 2.5; for small sideslip)."""
    b, c, s = before, np.cos, np.sin
    side = b["ay"] + GRAVITY * c(b["theta"]) * s(b["phi"])
    down = b["az"] * c(b["alpha"]) - b["ax"] * s(b["alpha"])
    down += GRAVITY * (c(b["alpha"]) * c(b["theta"]) * c(b["phi"]) + s(b["alpha"]) * s(b["theta"]))
    rates = {"beta": side / b["V"] + b["p"] * s(b["alpha"]) - b["r"] * c(b["alpha"]), "alpha": b["q"] + down / b["V"]}
    steps = np.diff(b["time"])
    turned = {n: np.concatenate([[0.0], np.cumsum(0.5 * (v[1:] + v[:-1]) * steps)]) for n, v in rates.items()}
    return {
        n: v - np.polyval(np.polyfit(b["time"], v - b[n], 1), b["time"])
        for n, v in turned.items()
        if np.isfinite(v).all()
    }


def _noise(values: np.ndarray) -> float:
    """Standard deviation of white noise, by second differences."""
    return float(np.sqrt(np.mean(np.diff(values, 2) ** 2) / 6.0)) if len(values) > 2 else 0.0


def _spread(values: np.ndarray) -> float:
    """Standard deviation of what moves slower than from sample to sample."""
    return math.sqrt(max(float(np.var(values)) - _noise(values) ** 2, 0.0))
