"""Motion of the surfaces between scans, for many flights at once, and the reliability of a prediction over such an interval.

As `daq.identification.surfaces`, with arrays instead of floats: where the servo's lag is known, the time of an edge follows from
the scans around it. Linear interpolation of an edge between scans a tenth of a second apart has a larger error than any effect
that is monitored.

The kind of an interval is given by its length, by whether surfaces moved in it, and by whether that motion is known. Where a
surface moved in a long interval in an unknown way, the prediction says nothing about the model, and its error stays in the
predictor for a second. Such an interval is blind, and so are the two after it, whose innovations whitening combines with its
own.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from daq.identification.surfaces import EDGE, LONG, SLACK, SURE

Array = NDArray[np.float64]

LATE = 0.85  # largest `u`: an edge in the last 6 ms counts to the next interval; slow hand movements look like it
FAR = math.radians(1.5)  # travel in one interval from which the uncertainty of the motion exceeds the noise
TINY = 1e-12  # least `u`: the fastest servo has settled long before
LEVELS, GUESSED = 5, 3
"""Levels of an interval: 0 at rest; 1 and 2 known motion, up to `FAR` and beyond; 3 and 4 (GUESSED and above) unknown motion."""


@dataclass(frozen=True, slots=True)
class SurfaceEdges:
    """Edges, (flights,) each: where `runs`, the servo moves towards `before` until `at` [s] after the start of the interval, then
    towards `after`, with time constant `lag` [s]."""

    runs: NDArray[np.bool_]
    before: Array
    after: Array
    at: Array
    lag: float


@dataclass(frozen=True, slots=True)
class SurfaceBetween:
    """One surface over an interval of `h` [s], (flights,) each: a monotone cubic from `first` to `last` with end slopes `rise`
    and `fall` [1/s], or an edge. level: how well that is known (`LEVELS`)."""

    h: float
    first: Array
    last: Array
    rise: Array
    fall: Array
    level: NDArray[np.intp]
    edge: SurfaceEdges | None

    def at(self, part: Array | float) -> Array:
        """Deflection after the fraction `part` of the interval."""
        remainder = 1.0 - part
        cubic = remainder * remainder * ((1.0 + 2.0 * part) * self.first + part * self.h * self.rise) + part * part * (
            (1.0 + 2.0 * remainder) * self.last - remainder * self.h * self.fall
        )
        e = self.edge
        if e is None:
            return np.asarray(cubic)
        t = part * self.h
        turn = e.before + (self.first - e.before) * np.exp(-e.at / e.lag)
        before_edge = e.before + (self.first - e.before) * np.exp(-t / e.lag)
        after_edge = e.after + (turn - e.after) * np.exp(np.minimum(e.at - t, 0.0) / e.lag)
        return np.where(e.runs, np.where(t <= e.at, before_edge, after_edge), cubic)


class SurfacesBetween:
    """The motion of one surface, interval by interval. lag: of its servo [s], None where not known."""

    def __init__(self, lag: float | None) -> None:
        self._lag = lag
        self._target: Array | None = None  # command that the servo moves to; NaN where not known

    def restart(self) -> None:
        """Begin after missing scans: the servo's command is not known."""
        self._target = None

    def middle(self, t: tuple[float, float, float, float], y: tuple[Array, Array, Array, Array]) -> SurfaceBetween:
        """The motion between the middle two of four scans at times t [s] with deflections y; without a first scan, pass the
        second twice."""
        h, first, last = t[2] - t[1], y[1], y[2]
        rise = _slope(t[1] - t[0], h, *y[:3])
        fall = _slope(h, t[3] - t[2], *y[1:])
        moves_far = np.abs(last - first) > FAR
        if self._lag is None:
            moves = np.abs(last - first) > EDGE
            level = np.where(moves, (GUESSED if h > LONG else 1) + moves_far, 0)
            return SurfaceBetween(h, first, last, rise, fall, level, None)
        edge, servo_turned, edge_known = self._edge(self._lag, h, t[3] - t[2], first, last, y[3])
        level = np.where(servo_turned & ~edge_known, GUESSED + moves_far, np.where(edge.runs, 1 + moves_far, 0))
        self._target = np.where(edge.runs, edge.after, np.nan)
        return SurfaceBetween(h, first, last, rise, fall, level, edge if edge.runs.any() else None)

    def _edge(
        self, lag: float, h: float, following: float, first: Array, last: Array, then: Array
    ) -> tuple[SurfaceEdges, NDArray[np.bool_], NDArray[np.bool_]]:
        """The edges in the interval, or the rest of earlier ones; where the servo's command changed in it; where the time of that
        is known."""
        fade, next_fade = math.exp(-h / lag), math.exp(-following / lag)
        target = first if self._target is None else np.where(np.isnan(self._target), first, self._target)
        goal = (last - first * fade) / (1.0 - fade)
        next_target = (then - last * next_fade) / (1.0 - next_fade)
        servo_turned = np.abs(last - target - (first - target) * fade) > EDGE
        # a servo that would reach another goal afterwards had its command changed within this interval
        next_goal_differs = (np.abs(next_target - goal) * (1.0 - next_fade) > EDGE) & (np.abs(last - first) > EDGE)
        turned_earlier = (
            ~servo_turned & next_goal_differs & _possible(_since(first, first, last, next_target, fade), fade)
        )
        target = np.where(turned_earlier, first, target)
        servo_turned = servo_turned | turned_earlier
        u = _since(target, first, last, next_target, fade)
        edge_found = servo_turned & (np.abs(next_target - target) >= EDGE) & _possible(u, fade)
        on_its_way = ~servo_turned & (np.abs(first - target) > EDGE)
        edge = SurfaceEdges(
            edge_found | on_its_way,
            np.where(edge_found, target, goal),
            np.where(edge_found, next_target, goal),
            np.where(edge_found, h + lag * np.log(np.clip(u, max(fade, TINY), 1.0)), 0.0),
            lag,
        )
        return edge, servo_turned, edge_found & (u >= SURE)


def _since(target: Array, first: Array, last: Array, after: Array, fade: float) -> Array:
    """u = exp(-(time since the edge) / lag) of a servo that moved to `target` before the edge and to `after` behind it."""
    jump = np.where(np.abs(after - target) < EDGE, EDGE, target - after)
    return np.asarray((last - after - (first - target) * fade) / jump)


def _possible(u: Array, fade: float) -> NDArray[np.bool_]:
    return np.asarray((u >= fade - SLACK) & (u <= LATE))


def _slope(h0: float, h1: float, y0: Array, y1: Array, y2: Array) -> Array:
    """As `curve.slope`; zero where h0 is."""
    if h0 <= 0.0:
        return np.zeros_like(y1)
    slope_before, slope_after = (y1 - y0) / h0, (y2 - y1) / h1
    weight_before, weight_after = 2.0 * h1 + h0, h1 + 2.0 * h0
    monotone = slope_before * slope_after > 0.0
    safe_before, safe_after = np.where(monotone, slope_before, 1.0), np.where(monotone, slope_after, 1.0)
    return np.where(
        monotone, (weight_before + weight_after) / (weight_before / safe_before + weight_after / safe_after), 0.0
    )


LENGTHS = np.array([0.06, 0.11, 0.16])  # s
BLIND = 2 * (len(LENGTHS) + 1) * LEVELS**2
KINDS = BLIND + 1
"""All kinds; the last one is `BLIND`."""

Kinds = NDArray[np.intp]


def guessed(surfaces: Sequence[SurfaceBetween]) -> NDArray[np.bool_]:
    """(flights,) where a surface moved in an unknown way."""
    return np.any([s.level >= GUESSED for s in surfaces], axis=0)


def kind_of(seconds: float, surfaces: Sequence[SurfaceBetween], before: Sequence[SurfaceBetween] | None) -> Kinds:
    """(flights,) kind of an interval of `seconds`, which depends on the one before too, whose error persists for a while.
    surfaces: two at most."""
    length = int(np.searchsorted(LENGTHS, seconds))
    level = sum(s.level * LEVELS**k for k, s in enumerate(surfaces))
    kind = length + (len(LENGTHS) + 1) * level
    if before is not None:
        kind = kind + BLIND // 2 * guessed(before)
    return np.asarray(np.where(guessed(surfaces), BLIND, kind) if seconds > LONG else kind)
