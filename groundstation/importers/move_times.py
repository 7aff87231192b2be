"""When a surface moved that is known by its commands, by what the gyros show.

A log has a servo output every 20 to 100 ms, and the command changed at any time since the record before. An import dates each
change half an interval back, right in the mean and wrong by up to half an interval for each: an aeroplane that takes 90 ms to
its rate of roll shows that tens of times above the noise of a gyro, and whoever fits its motion afterwards finds it in the roll
damping, or as an effect that is not there.

The gyros say when: over windows of a second each rate is the integral of what drives it, linear in the other rates, side or
normal acceleration and the surfaces, whatever their derivatives are. The time of each change is an unknown beside those, expected
at the middle of its interval within what an even chance over it makes. So is a time by which all are late together (the
autopilot's latency, a servo whose lag is stated wrongly). That is taken out too where a servo's lag is stated, or flights would
differ by the chance mean of their moves; an estimate has an unknown of its own for what is left of it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from groundstation.flight.arrays import Array, true_runs
from groundstation.importers.columns import ColumnOrigin
from groundstation.importers.series import TimeSeries, held_changes, step_answer

SHOWN_BY: Mapping[str, tuple[str, str]] = MappingProxyType(
    {"delta_a": ("p", "ay"), "delta_e": ("q", "az"), "delta_r": ("r", "ay")}
)
"""Surface -> the rate that it drives, and the acceleration that stands for the flow angle on which that rate depends."""
RATES = ("p", "q", "r")
WINDOW = (
    1.0  # s, over which a straight line is all that the other moments leave: short beside a turn, long beside a servo
)
LONGEST = 100.0  # s that share their derivatives: airspeed and height stay alike
SHORTEST = 5.0  # s: fewer windows do not tell derivatives and times apart
MOST = 150  # changes in one such part, the largest: smaller ones move nothing
FEWEST = 3  # changes that have a time in common
SEEN = 2.0  # noises of the rate that a change makes, by one standard deviation of its time, to be asked about
PASSES = 6  # of Gauss and Newton: times change by less than a tenth of a millisecond after five
LATE = 0.02  # s, prior of the time by which all are late, and the most of it: servos stated wrongly, links
ENOUGH = 8  # changes that the gyros date, to say by how much all are late: five of a mode of 20 ms said 45 ms
ALIKE = 0.002  # s, by which outputs of one message are late alike: their servos differ
STEERING = "delta_e"  # holds pitch against the motion at all times, so that its own delay shows worst
SERVOS = (0.0, 0.02, 0.035, 0.05, 0.07, 0.1)  # s, lags that are tried where the log's map states none
SURE = 2.0  # times the bound by white residuals: those of a windowed regression follow one another
OFTENER = 1.9  # times as many readings of the gyro as commands, at least, for one to show what the other leaves out
ROUNDING = 1e-9  # rad, of a sum of servos
EVEN = 12.0**-0.5  # standard deviation of an even chance over an interval of one


@dataclass(frozen=True)
class Changes:
    """Changes of one surface's command. time: (m,) s at which each is dated; size: (m,) rad; lag: (m,) s of its servo."""

    time: Array
    size: Array
    lag: Array

    def answers(self, at: Array, later: Array | float = 0.0, lag: float | None = None, step: float = 0.0) -> Array:
        """(N, m) rad of the surface by each at `at` (N,) s, each `later` [s]. step: [s] over which one without a lag is averaged,
        for a sample cannot say otherwise where between two it was."""
        lags, since = self.lag if lag is None else np.full_like(self.lag, lag), at[:, None] - (self.time + later)
        answer = step_answer(since, lags)
        return self.size * (np.where(lags > 0.0, answer, np.clip(since / step + 0.5, 0.0, 1.0)) if step else answer)

    def some(self, which: NDArray[np.bool_ | np.int64]) -> "Changes":
        return Changes(self.time[which], self.size[which], self.lag[which])


@dataclass(frozen=True)
class Dated:
    """Changes of a command that the gyros date. later, std: (m,) s against where they stood, and the bound of that; all: [s]
    by which all of the surface is later; rows: where."""

    changes: Changes
    later: Array
    std: Array
    all: float
    rows: slice

    def placed(self, time: Array, values: Array, step: float) -> Array:
        """(N,) the surface with its changes where they were."""
        at = time[self.rows]
        rest = values[self.rows] - self.changes.answers(at).sum(axis=1)
        moved = np.interp(at - self.all, at, rest) + self.changes.answers(at - self.all, self.later, step=step).sum(
            axis=1
        )
        result = values.copy()
        result[self.rows] = moved
        return result


def with_moves_dated(
    series: Mapping[str, TimeSeries], origins: Mapping[str, ColumnOrigin], time: Array, columns: Mapping[str, Array]
) -> tuple[dict[str, Array], dict[str, ColumnOrigin], list[str]]:
    """Columns (N,) on `time` with the surfaces that are commands moved to where the gyros date each of their changes; their
    origins, with how sure that is; and a note."""
    step = float(np.median(np.diff(time)))
    commanded = {n: c for n in SHOWN_BY if (c := _commanded(n, series, origins, columns, step)) is not None}
    parts = [_dated(time, rows, columns, commanded, origins) for rows in _parts(time, columns, tuple(commanded))]
    moved, stated, words = dict(columns), dict(origins), list[str]()
    for name in commanded:
        found = [d for part in parts if (d := part.get(name)) is not None]
        if not found:
            continue
        values = moved[name].copy()
        for d in found:
            values = d.placed(time, values, step)
        weights, variance = (
            np.concatenate(a) for a in zip(*((d.changes.size**2, d.std**2) for d in found), strict=True)
        )
        sure = float(np.sqrt(np.average(variance, weights=weights)))
        late = float(np.mean([d.all for d in found]))
        moved[name], stated[name] = values, replace(origins[name], dated=sure, late=late)
        shift = f", all {1e3 * abs(late):.0f} ms {'later' if late > 0 else 'earlier'}" if late else ""
        words.append(f"{weights.size} of {name} by {SHOWN_BY[name][0]} (+- {1e3 * sure:.1f} ms{shift})")
    interval = max((o.held or 0.0 for n, o in stated.items() if n in SHOWN_BY), default=0.0)
    note = f"servo outputs come every {1e3 * interval:.0f} ms, and a change of one may be that old: the gyros date "
    return moved, stated, [f"{note}{', '.join(words)}"] if words else []


def command_changes(series: Mapping[str, TimeSeries], origin: ColumnOrigin) -> Changes | None:
    """What the commands of a surface add to it, change by change; None where it is no sum of servos."""
    if origin.source.expression is not None:
        return None
    time, size, lag = list[Array](), list[Array](), list[Array]()
    for term in origin.source.parts:
        begins, rises = held_changes(series[term.column])
        time.append(begins)
        size.append(rises * term.factor * origin.source.sign * origin.source.factor)
        lag.append(np.full(begins.size, series[term.column].lag))
    # outputs of one record are one change of the surface: what moves two elevons alike leaves the aileron where it is
    each, which = np.unique(np.column_stack([np.concatenate(time), np.concatenate(lag)]), axis=0, return_inverse=True)
    total = np.bincount(which.ravel(), np.concatenate(size), len(each))
    return Changes(each[:, 0], np.where(np.abs(total) > ROUNDING, total, 0.0), each[:, 1])


def _commanded(
    name: str,
    series: Mapping[str, TimeSeries],
    origins: Mapping[str, ColumnOrigin],
    columns: Mapping[str, Array],
    step: float,
) -> Changes | None:
    """The changes of a surface that is a recorded command and drives a gyro that was read oftener; None of any other."""
    origin, (rate, acceleration) = origins.get(name), SHOWN_BY[name]
    if (
        origin is None
        or not origin.held
        or origin.rate is None
        or not all(c in columns for c in (name, rate, acceleration))
    ):
        return None
    shown = origins[rate].rate if rate in origins else None
    return command_changes(series, origin) if (shown or 1.0 / step) * origin.held >= OFTENER else None


def _parts(time: Array, columns: Mapping[str, Array], names: Sequence[str]) -> list[slice]:
    """Stretches in which surfaces and what shows them are measured, none longer than LONGEST."""
    needed = {*names, *(c for n in names for c in SHOWN_BY[n]), *(r for r in RATES if r in columns)}
    parts: list[slice] = []
    for a, b in true_runs(np.isfinite(np.sum([columns[c] for c in needed], axis=0))) if names else ():
        count = max(1, int(np.ceil((time[b - 1] - time[a]) / LONGEST)))
        edges = np.linspace(a, b, count + 1).round().astype(int)
        parts += [slice(i, j) for i, j in zip(edges[:-1], edges[1:], strict=True) if time[j - 1] - time[i] >= SHORTEST]
    return parts


def _dated(
    time: Array,
    rows: slice,
    columns: Mapping[str, Array],
    commanded: Mapping[str, Changes],
    origins: Mapping[str, ColumnOrigin],
) -> dict[str, Dated | None]:
    """The changes of surfaces within some rows that the gyros date.

    Outputs of one message are late alike: a rudder that rests between its pulses does not show by how much, an aileron that
    steers does.
    """
    fits: dict[str, _Fit] = {}
    for name, changes in commanded.items():
        inside = (changes.time > time[rows][0]) & (changes.time < time[rows][-1]) & (changes.size != 0.0)
        asked = changes.some(np.sort(np.flatnonzero(inside)[np.argsort(-np.abs(changes.size[inside]))[:MOST]]))
        if asked.time.size:
            fits[name] = _fitted(time[rows], rows, columns, name, changes, asked, origins[name].held or 0.0)
    stated = [n for n, f in fits.items() if f.asked.lag.any()]
    steady = [n for n in stated if n != STEERING and fits[n].tells_all]
    if steady:
        surest = min(steady, key=lambda n: fits[n].late[1])
        expected = (fits[surest].late[0], float(np.hypot(fits[surest].late[1], ALIKE)))
        for name in (n for n in stated if n != surest):
            held, changes = origins[name].held or 0.0, commanded[name]
            fits[name] = _fitted(time[rows], rows, columns, name, changes, fits[name].asked, held, expected)
    return {n: f.dated(origins[n].held or 0.0, rows) for n, f in fits.items()}


def _fitted(
    at: Array,
    rows: slice,
    columns: Mapping[str, Array],
    name: str,
    changes: Changes,
    asked: Changes,
    interval: float,
    expected: tuple[float, float] = (0.0, LATE),
) -> "_Fit":
    """Times of the changes that are asked about, with the servo that explains the rate best where none is stated."""
    fits = []
    for lag in (None,) if asked.lag.any() else SERVOS:
        surfaces = {c: columns[c][rows] for c in SHOWN_BY if c in columns and np.isfinite(columns[c][rows]).all()}
        if lag is not None:
            surfaces[name] = changes.answers(at, 0.0, lag).sum(axis=1)
        fits.append(_Regression.of(at, columns, rows, name, surfaces).fitted(asked, interval, lag, expected))
    return min(fits, key=lambda f: f.cost)


@dataclass(frozen=True)
class _Fit:
    """later, std, seen: of each change asked about; late: time by which all are, and its bound [s]."""

    cost: float
    late: tuple[float, float]
    asked: Changes
    later: Array
    std: Array
    seen: Array

    @property
    def tells_all(self) -> bool:
        """Whether they are enough to say by how much all are late."""
        return int(np.count_nonzero(self.seen)) >= ENOUGH

    def dated(self, interval: float, rows: slice) -> Dated | None:
        """Those that the gyros date twice as well as an even chance over the interval."""
        sure = np.asarray(self.seen, bool) & (self.std < 0.5 * EVEN * interval)
        together = self.late[0] if self.asked.lag.any() and self.tells_all else 0.0
        return Dated(self.asked.some(sure), self.later[sure], self.std[sure], together, rows) if sure.any() else None


@dataclass(frozen=True)
class _Regression:
    """A rate over windows as the integral of what drives it. rate: (N,) without a line in each window; known: (N, k) likewise, of
    the integrals; surface, power: (N,) the surface, and what it is multiplied by; window: (N,) number of each."""

    time: Array
    rate: Array
    known: Array
    surface: Array
    power: Array
    window: Array

    @classmethod
    def of(
        cls, at: Array, columns: Mapping[str, Array], rows: slice, name: str, surfaces: Mapping[str, Array]
    ) -> "_Regression":
        rate, acceleration = SHOWN_BY[name]
        speed = columns["V"][rows] if "V" in columns else np.ones(at.size)
        usual = float(np.nanmedian(speed)) if np.isfinite(speed).any() else 1.0
        v = np.where(np.isfinite(speed), speed, usual) / usual if usual > 0.0 else np.ones(at.size)
        motion = {n: columns[n][rows] for n in RATES if n in columns}
        driving = [motion[n] * v for n in motion] + [columns[acceleration][rows]]
        names = list(motion)
        driving += [motion[a] * motion[b] for i, a in enumerate(names) for b in names[i + 1 :]]
        driving += [v**2 * s for n, s in surfaces.items() if n != name]
        window = np.floor((at - at[0]) / WINDOW).astype(int)
        known = np.column_stack([_integral(at, d) for d in driving])
        parts = _without_lines(np.column_stack([columns[rate][rows], known]), at, window)
        return cls(at, parts[:, 0], parts[:, 1:], surfaces[name], v**2, window)

    def fitted(self, asked: Changes, interval: float, lag: float | None, expected: tuple[float, float]) -> _Fit:
        """Times of the changes beside the derivatives and a time by which all are late, `expected` at so much +- so much."""
        later, late, noise, late_std = np.zeros(asked.time.size), expected[0], float(np.std(self.rate)), np.inf
        rest = self.surface - asked.answers(self.time, 0.0, lag).sum(axis=1)
        std, seen = np.full(later.size, np.inf), np.zeros(later.size, bool)
        k = self.known.shape[1] + 1
        for _ in range(PASSES):
            answers = asked.answers(self.time - late, later, lag)
            surface = np.interp(self.time - late, self.time, rest) + answers.sum(axis=1)
            courses = np.column_stack([_integral(self.time, self.power * surface), self.power * surface])
            driven = _without_lines(courses, self.time, self.window)
            columns = _without_lines(self.power[:, None] * answers, self.time, self.window)
            power = np.linalg.lstsq(np.column_stack([self.known, driven[:, 0]]), self.rate, rcond=None)[0][-1]
            matrix = np.column_stack([self.known, driven[:, 0], -power * driven[:, 1], -power * columns])
            precision = np.zeros(matrix.shape[1])
            precision[k], precision[k + 1 :] = (noise / expected[1]) ** 2, (noise / (EVEN * interval)) ** 2
            normal, right = matrix.T @ matrix + np.diag(precision), matrix.T @ self.rate
            right[k] -= precision[k] * (
                late - expected[0]
            )  # the prior is of the whole time, this step but a part of it
            right[k + 1 :] -= precision[k + 1 :] * later
            solution = np.linalg.lstsq(normal, right, rcond=1e-12)[0]
            residual = self.rate - matrix @ solution
            freedom = max(residual.size - matrix.shape[1] - 2 * (self.window[-1] + 1), 1)
            noise = float(np.sqrt(residual @ residual / freedom))
            late = float(np.clip(late + solution[k], -LATE, LATE))
            later = np.clip(later + solution[k + 1 :], -0.5 * interval, 0.5 * interval)
            strength = np.abs(power) * np.sqrt(np.einsum("ij,ij->j", columns, columns))
            inverse = np.linalg.pinv(normal, hermitian=True)
            late_std, covariance = SURE * noise * float(np.sqrt(abs(inverse[k, k]))), inverse[k + 1 :, k + 1 :]
            if later.size >= FEWEST:  # against one another: what is common to all is not told from being late together
                apart = np.eye(later.size) - 1.0 / later.size
                covariance = apart @ covariance @ apart
            std = SURE * noise * np.sqrt(np.abs(np.diag(covariance)))
            seen = strength * EVEN * interval > SEEN * noise
        return _Fit(noise**2, (late, late_std), asked, later, std, seen)


def _integral(time: Array, values: Array) -> Array:
    step = np.diff(time)
    return np.concatenate([[0.0], np.cumsum(0.5 * step * (values[1:] + values[:-1]))])


def _without_lines(values: Array, time: Array, window: Array) -> Array:
    """(N, k) less a straight line in each window."""
    result = values.copy()
    for w in range(int(window[-1]) + 1):
        rows = np.flatnonzero(window == w)
        line = np.vander(time[rows] - time[rows].mean(), 2) if rows.size > 2 else np.ones((rows.size, 1))
        basis = np.linalg.qr(line)[0]
        result[rows] -= basis @ (basis.T @ values[rows])
    return result
