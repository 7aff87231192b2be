"""Time skew between channels that show the same motion, estimated to a fraction of the sample interval.

Attitude is compared with the integral of the Euler rate that the gyro gives, a surface with its command.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from groundstation.flight.arrays import MOST_WINDOWS, Array, integral, true_runs
from groundstation.flight.flight import Flight
from groundstation.flight.kinematics import EULER_RATES, GYROS

_WINDOW = 10.0  # s over which the drift of an integrated rate is a parabola
_CELLS = 50_000  # samples of a window times lags that are tried together: 400 kB, which stays in the cache
_LEAST_RATE = 0.05  # rad/s rms below which an attitude has not moved enough
_LEAST_SURFACE = 0.01  # rad rms below which a surface has not moved enough


@dataclass(frozen=True)
class Skew:
    """Column `late` shows what `early` shows `delay` seconds later; std is the one-sigma bound of the delay [s]."""

    late: str
    early: str
    delay: float
    std: float


def attitude_skew(flight: Flight) -> tuple[Skew, ...]:
    """Delay of phi, theta and psi behind p, q and r, for those that moved enough. Needs all six columns."""
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
    """Delay of delta_* behind cmd_*, servo lag included, for those that moved enough."""
    skews = []
    for surface, command in ((f"delta_{axis}", f"cmd_{axis}") for axis in "ear"):
        if flight.measured(surface) and flight.measured(command):
            windows = _windows(flight, flight[surface], flight[command])
            delay = _correlation_delay([w for w in windows if np.std(w[2]) > _LEAST_SURFACE])
            if delay is not None:
                skews.append(Skew(surface, command, *delay))
    return tuple(skews)


def _windows(flight: Flight, late: Array, early: Array) -> Iterator[tuple[Array, Array, Array]]:
    """Unbroken stretches of at most _WINDOW seconds of both columns, of a long record over MOST_WINDOWS of them."""
    every = max(_WINDOW, float(np.ptp(flight.time)) / MOST_WINDOWS)
    for start, stop in true_runs(np.isfinite(late) & np.isfinite(early), flight.segments):
        while start < stop:
            end = start + int(np.searchsorted(flight.time[start:stop], flight.time[start] + _WINDOW, side="right"))
            if end - start >= 20:
                yield flight.time[start:end], late[start:end], early[start:end]
            following = int(np.searchsorted(flight.time, flight.time[start] + every, side="right"))
            start = max(end, following) if every > _WINDOW else end


def _corrected_integral(t: Array, rate: Array) -> Array:
    """Running integral with the trapezoid's third-order correction by the change of slope (Euler-Maclaurin)."""
    correction = np.cumsum(np.diff(t) ** 2 / 12 * np.diff(np.gradient(rate, t)))
    return integral(t, rate) - np.concatenate([[0.0], correction])


def _delay(parts: list[tuple[Array, Array, Array, Array]], least: float) -> tuple[float, float] | None:
    """Delay of a measured angle behind an integrated one, with a parabola per window for initial value and gyro bias.

    The integrated angle is moved in time until what remains has no part along the rate (Gauss-Newton on the delay).
    """
    parts = [part for part in parts if float(np.std(part[3])) > least]
    if not parts:
        return None
    delay = 0.0
    for _ in range(6):
        top = bottom = 0.0
        residuals = []
        for t, angle, gyro_angle, rate in parts:
            shifted, slope = np.interp(t - delay, t, gyro_angle), np.interp(t - delay, t, rate)
            trend = np.vander((t - t.mean()) / _WINDOW, 3)
            difference, slope = (_without(trend, v) for v in (shifted - angle, slope))
            top, bottom = top + float(slope @ difference), bottom + float(slope @ slope)
            residuals.append((slope, difference))
        if bottom <= 0:
            return None
        step = top / bottom
        delay += step
        if abs(step) < 1e-5:
            break
    return delay, _coloured(residuals, step, bottom)


def _without(trend: Array, values: Array) -> Array:
    return np.asarray(values - trend @ np.linalg.lstsq(trend, values, rcond=None)[0])


def _coloured(parts: list[tuple[Array, Array]], step: float, bottom: float) -> float:
    """One sigma of the delay with the residual's own autocorrelation: var = sum_k R(k) (s_i s_i+k) / (s s)^2."""
    total = 0.0
    for slope, difference in parts:
        residual = difference - step * slope
        n = residual.size
        for lag in range(min(20, n)):
            weight = (1 if lag == 0 else 2) * (1 - lag / 20)
            autocovariance = float(residual[lag:] @ residual[: n - lag]) / n
            total += weight * autocovariance * float(slope[lag:] @ slope[: n - lag])
    return float(np.sqrt(max(total, 0.0)) / bottom) if total > 0 else float(np.sqrt(abs(step) / bottom))


def _correlation_delay(parts: list[tuple[Array, Array, Array]]) -> tuple[float, float] | None:
    """Delay of the first signal behind the second at the largest cross-correlation, to a fraction of a sample."""
    if not parts:
        return None
    interval = float(np.median(np.diff(parts[0][0])))
    lags = np.arange(-0.15, 0.4, interval / 10)
    cost = np.zeros(lags.size)
    samples, curvature = 0, 0.0
    for t, response, command in parts:
        scale = float(np.std(response) / np.std(command)) if np.std(command) > 0 else 1.0
        together = max(1, _CELLS // t.size)
        for first in range(0, lags.size, together):
            shifted = scale * np.interp(t - lags[first : first + together, None], t, command)
            left_over = response - response.mean() - shifted + shifted.mean(axis=1, keepdims=True)
            cost[first : first + together] += np.sum(left_over**2, axis=1)
        samples += t.size
        curvature += float(np.sum((scale * np.gradient(command, t)) ** 2))
    lowest = int(np.argmin(cost))
    if lowest in (0, lags.size - 1) or curvature <= 0:
        return None
    left_cost, middle, right_cost = cost[lowest - 1 : lowest + 2]
    bend = left_cost - 2 * middle + right_cost
    fraction = 0.5 * (left_cost - right_cost) / bend if bend > 0 else 0.0
    sigma2 = middle / max(samples - 1, 1)
    steps = interval / np.sqrt(12.0)  # a step lies anywhere between two samples, and a line is drawn between them
    return float(lags[lowest] + fraction * (lags[1] - lags[0])), float(np.hypot(np.sqrt(sigma2 / curvature), steps))
