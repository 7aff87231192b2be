"""Time skew between channels that show the same motion, estimated to a fraction of the sample interval.

Attitude is compared with the integral of the Euler rate that the gyro gives, a surface with its command.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from groundstation.flight.flight import Flight

Array = NDArray[np.float64]

_WINDOW = 10.0  # s over which the drift of an integrated rate is a parabola
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
    if not all(flight.measured(c) for c in ("p", "q", "r", "phi", "theta", "psi")):
        return ()
    out = []
    phi, theta = flight["phi"], flight["theta"]
    p, q, r = flight["p"], flight["q"], flight["r"]
    turn = q * np.sin(phi) + r * np.cos(phi)
    rates = {
        "phi": ("p", p + np.tan(theta) * turn),
        "theta": ("q", q * np.cos(phi) - r * np.sin(phi)),
        "psi": ("r", turn / np.cos(theta)),
    }
    for angle, (gyro, rate) in rates.items():
        parts = list(_windows(flight, flight[angle], rate))
        found = _delay([(t, np.unwrap(a), *_integral(t, b)) for t, a, b in parts], _LEAST_RATE)
        if found is not None:
            out.append(Skew(angle, gyro, *found))
    return tuple(out)


def control_skew(flight: Flight) -> tuple[Skew, ...]:
    """Delay of delta_* behind cmd_*, servo lag included, for those that moved enough."""
    out = []
    for axis in "ear":
        measured, command = f"delta_{axis}", f"cmd_{axis}"
        if flight.measured(measured) and flight.measured(command):
            parts = [
                (t, a, b)
                for t, a, b in _windows(flight, flight[measured], flight[command])
                if np.std(b) > _LEAST_SURFACE
            ]
            found = _shift(parts)
            if found is not None:
                out.append(Skew(measured, command, *found))
    return tuple(out)


def _windows(flight: Flight, late: Array, early: Array) -> Iterator[tuple[Array, Array, Array]]:
    """Unbroken stretches of at most _WINDOW seconds of both columns."""
    for segment in flight.segments:
        t, a, b = flight.time[segment], late[segment], early[segment]
        good = np.isfinite(a) & np.isfinite(b)
        breaks = np.flatnonzero(~good)
        for part in np.split(np.arange(t.size), breaks):
            rows = part[good[part]]
            while rows.size:
                inside = rows[t[rows] <= t[rows[0]] + _WINDOW]
                if inside.size >= 20:
                    yield t[inside], a[inside], b[inside]
                rows = rows[inside.size :]


def _integral(t: Array, rate: Array) -> tuple[Array, Array]:
    steps = np.diff(t)
    trapezoid = 0.5 * (rate[1:] + rate[:-1])
    # third-order correction of the trapezoid by the change of slope (Euler-Maclaurin)
    slope = np.gradient(rate, t)
    area = steps * trapezoid - steps**2 / 12 * np.diff(slope)
    return np.concatenate([[0.0], np.cumsum(area)]), rate


def _delay(parts: list[tuple[Array, Array, Array, Array]], least: float) -> tuple[float, float] | None:
    """Delay of a measured angle behind an integrated one, with a parabola per window for initial value and gyro bias.

    The integrated angle is moved in time until what remains has no part along the rate (Gauss-Newton on the delay).
    """
    parts = [p for p in parts if float(np.std(p[3])) > least]
    if not parts:
        return None
    delay = 0.0
    for _ in range(6):
        top = bottom = 0.0
        residuals = []
        for t, angle, integral, rate in parts:
            moved, slope = np.interp(t - delay, t, integral), np.interp(t - delay, t, rate)
            trend = np.vander((t - t.mean()) / _WINDOW, 3)
            difference, slope = (_without(trend, v) for v in (moved - angle, slope))
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
        left = difference - step * slope
        for lag in range(min(20, left.size)):
            weight = (1 if lag == 0 else 2) * (1 - lag / 20)
            total += (
                weight
                * float(left[lag:] @ left[: left.size - lag])
                / left.size
                * float(slope[lag:] @ slope[: slope.size - lag])
            )
    return float(np.sqrt(max(total, 0.0)) / bottom) if total > 0 else float(np.sqrt(abs(step) / bottom))


def _shift(parts: list[tuple[Array, Array, Array]]) -> tuple[float, float] | None:
    """Delay of the first signal behind the second at the largest cross-correlation, to a fraction of a sample."""
    if not parts:
        return None
    interval = float(np.median(np.diff(parts[0][0])))
    lags = np.arange(-0.15, 0.4, interval / 10)
    cost = np.zeros(lags.size)
    samples = 0
    curvature = 0.0
    for t, late, early in parts:
        scale = float(np.std(late) / np.std(early)) if np.std(early) > 0 else 1.0
        for i, lag in enumerate(lags):
            moved = scale * np.interp(t - lag, t, early)
            cost[i] += float(np.sum((late - late.mean() - moved + moved.mean()) ** 2))
        samples += t.size
        curvature += float(np.sum((scale * np.gradient(early, t)) ** 2))
    best = int(np.argmin(cost))
    if best in (0, lags.size - 1) or curvature <= 0:
        return None
    left, middle, right = cost[best - 1 : best + 2]
    bend = left - 2 * middle + right
    fraction = 0.5 * (left - right) / bend if bend > 0 else 0.0
    sigma2 = middle / max(samples - 1, 1)
    return float(lags[best] + fraction * (lags[1] - lags[0])), float(np.sqrt(sigma2 / curvature))
