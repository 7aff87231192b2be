"""Time skew between channels of the same motion, to a fraction of the sample interval: attitude against the integral of its rate
by the gyros, a surface against its command."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from groundstation.flight.arrays import MOST_WINDOWS, Array, integral, true_runs
from groundstation.flight.flight import Flight
from groundstation.flight.kinematics import EULER_RATES, GYROS

_WINDOW = 10.0  # [s] over which the drift of an integrated rate is a parabola
_FEWEST_SAMPLES = 20  # of a window
_CELLS = 50_000  # samples of a window times lags that are tried at once: 400 kB, which fits the cache
_LEAST_RATE = 0.05  # [rad/s] rms of a rate, below which its angle has not moved enough
_LEAST_SURFACE = 0.01  # [rad] rms of a command, below which its surface has not moved enough
_LAGS = (-0.15, 0.4)  # [s] that a surface may follow its command; negative ones show mistakes of the time stamps
_LAG_STEPS = 10  # lags tried in a sample interval
_CORRELATION_LAGS = 20  # samples, over which the autocorrelation of residuals is summed with falling weight
_ITERATIONS, _CONVERGED = 6, 1e-5  # steps of Gauss-Newton, at most, and the size of the last [s]


@dataclass(frozen=True)
class Skew:
    """Column `late` shows what `early` shows `delay` seconds later; std is the one-sigma bound of the delay [s]."""

    late: str
    early: str
    delay: float
    std: float


def attitude_skew(flight: Flight) -> tuple[Skew, ...]:
    """Delay of phi, theta and psi behind p, q and r, of those that moved enough. None where one of the six is not measured."""
    if not all(flight.measured(c) for c in (*GYROS, *GYROS.values())):
        return ()
    skews = []
    for angle, gyro in GYROS.items():
        windows = _windows(flight, flight[angle], EULER_RATES[angle](flight))
        delay = _delay([(t, np.unwrap(a), _corrected_integral(t, b), b) for t, a, b in windows], _LEAST_RATE)
        if delay is not None:
            skews.append(Skew(angle, gyro, *delay))
    return tuple(skews)


def control_skew(flight: Flight) -> tuple[Skew, ...]:
    """Delay of delta_* behind cmd_*, including the servo's lag, of those that moved enough."""
    skews = []
    for surface, command in ((f"delta_{axis}", f"cmd_{axis}") for axis in "ear"):
        if flight.measured(surface) and flight.measured(command):
            windows = _windows(flight, flight[surface], flight[command])
            delay = _correlation_delay([w for w in windows if np.std(w[2]) > _LEAST_SURFACE])
            if delay is not None:
                skews.append(Skew(surface, command, *delay))
    return tuple(skews)


def _windows(flight: Flight, late: Array, early: Array) -> Iterator[tuple[Array, Array, Array]]:
    """Time and both columns in unbroken stretches of at most _WINDOW seconds; in a long record MOST_WINDOWS evenly spaced
    ones."""
    every = max(_WINDOW, float(np.ptp(flight.time)) / MOST_WINDOWS)
    for start, stop in true_runs(np.isfinite(late) & np.isfinite(early), flight.segments):
        while start < stop:
            end = start + int(np.searchsorted(flight.time[start:stop], flight.time[start] + _WINDOW, side="right"))
            if end - start >= _FEWEST_SAMPLES:
                yield flight.time[start:end], late[start:end], early[start:end]
            following = int(np.searchsorted(flight.time, flight.time[start] + every, side="right"))
            start = max(end, following) if every > _WINDOW else end


def _corrected_integral(t: Array, rate: Array) -> Array:
    """(n,) running integral by the trapezoidal rule with the first Euler-Maclaurin correction."""
    correction = np.cumsum(np.diff(t) ** 2 / 12 * np.diff(np.gradient(rate, t)))
    return integral(t, rate) - np.concatenate([[0.0], correction])


def _delay(parts: list[tuple[Array, Array, Array, Array]], least_rate: float) -> tuple[float, float] | None:
    """Delay of a measured angle behind the integrated one and its std [s], by Gauss-Newton; None without enough motion.

    A parabola in each window stands for initial value and gyro bias. parts: time, angle, integrated angle and rate of each
    window. least_rate: rms rate [rad/s] that counts as motion.
    """
    parts = [part for part in parts if float(np.std(part[3])) > least_rate]
    if not parts:
        return None
    delay = 0.0
    for _ in range(_ITERATIONS):
        gradient = curvature = 0.0
        residuals = []
        for t, angle, gyro_angle, rate in parts:
            shifted, slope = np.interp(t - delay, t, gyro_angle), np.interp(t - delay, t, rate)
            trend = np.vander((t - t.mean()) / _WINDOW, 3)
            difference, slope = (_without(trend, v) for v in (shifted - angle, slope))
            gradient, curvature = gradient + float(slope @ difference), curvature + float(slope @ slope)
            residuals.append((slope, difference))
        if curvature <= 0:
            return None
        step = gradient / curvature
        delay += step
        if abs(step) < _CONVERGED:
            break
    return delay, _coloured_std(residuals, step, curvature)


def _without(trend: Array, values: Array) -> Array:
    """(n,) values less their least-squares fit by the columns of `trend` (n, k)."""
    return np.asarray(values - trend @ np.linalg.lstsq(trend, values, rcond=None)[0])


def _coloured_std(parts: list[tuple[Array, Array]], step: float, curvature: float) -> float:
    """Std of the delay [s] for coloured residuals: var = sum_k R(k) (s_i s_i+k) / (s s)^2, R their autocovariance.

    parts: slope and difference (n,) of each window; step: last change of the delay [s]; curvature: sum of the squared slopes.
    """
    total = 0.0
    for slope, difference in parts:
        residual = difference - step * slope
        n = residual.size
        for lag in range(min(_CORRELATION_LAGS, n)):
            weight = (1 if lag == 0 else 2) * (1 - lag / _CORRELATION_LAGS)
            autocovariance = float(residual[lag:] @ residual[: n - lag]) / n
            total += weight * autocovariance * float(slope[lag:] @ slope[: n - lag])
    return float(np.sqrt(total) / curvature) if total > 0 else float(np.sqrt(abs(step) / curvature))


def _correlation_delay(parts: list[tuple[Array, Array, Array]]) -> tuple[float, float] | None:
    """Delay of the first signal behind the second and its std [s], where the scaled, shifted second leaves the least squares of
    the first; None at an end of the tried lags. parts: time, surface and command of each window."""
    if not parts:
        return None
    interval = float(np.median(np.diff(parts[0][0])))
    lags = np.arange(*_LAGS, interval / _LAG_STEPS)
    cost = np.zeros(lags.size)
    samples, curvature = 0, 0.0
    for t, response, command in parts:
        scale = float(np.std(response) / np.std(command)) if np.std(command) > 0 else 1.0
        batch = max(1, _CELLS // t.size)
        for first in range(0, lags.size, batch):
            shifted = scale * np.interp(t - lags[first : first + batch, None], t, command)
            residual = response - response.mean() - shifted + shifted.mean(axis=1, keepdims=True)
            cost[first : first + batch] += np.sum(residual**2, axis=1)
        samples += t.size
        curvature += float(np.sum((scale * np.gradient(command, t)) ** 2))
    lowest = int(np.argmin(cost))
    if lowest in (0, lags.size - 1) or curvature <= 0:
        return None
    before, smallest, after = cost[lowest - 1 : lowest + 2]  # the minimum of the parabola through them
    bend = before - 2 * smallest + after
    fraction = 0.5 * (before - after) / bend if bend > 0 else 0.0
    sigma2 = smallest / max(samples - 1, 1)
    rounding = interval / np.sqrt(12.0)  # an edge lies anywhere between two samples
    return float(lags[lowest] + fraction * (lags[1] - lags[0])), float(np.hypot(np.sqrt(sigma2 / curvature), rounding))
