"""Attitudes of a filter that are logged more slowly than the gyros: filled in between their values with the gyro rates.

An autopilot logs its attitude ten times a second beside rates at fifty. Repeats and straight lines between two values are no
measurement. Leaving them out would make holes in the one channel whose errors are slow, and a slow error seen through holes looks
fast. The filter itself went from one value to the next by integrating its gyros, and their rates are recorded.
Where the log's instants lie between the samples, no sample shows a value, and straight lines show by cutting off curvature.
An attitude that is measured independently each time (optically, say) stays as it is.
"""

import numpy as np

from estimation.engine.kernel import Array
from estimation.gap.criteria import Criteria
from estimation.gap.records.sampling import Mask, known_at
from groundstation.flight import Flight
from groundstation.flight.arrays import integral
from groundstation.flight.kinematics import attitude_rates

MOTION = ("p", "q", "r", "phi", "theta")
PHASES = 20  # trial instants within a log interval: the sag of a line is then known to a hundredth
FEWEST = 40  # values: the white share is then known to a sixth


def with_attitudes_between(flight: Flight, criteria: Criteria) -> Flight:
    """The flight with a filter's bank and pitch attitude filled in between the logged values, and a note for each; unchanged
    where there is nothing to fill."""
    if not all(flight.measured(c) for c in MOTION):
        return flight
    courses = {c: _joined(flight, flight[c], np.isfinite(flight[c])) for c in MOTION}
    knots = {c: known_at(flight, c) for c in ("phi", "theta")}
    courses |= {c: _joined(flight, flight[c], knots[c]) for c in knots}
    rates = attitude_rates(*(courses[c] for c in MOTION))
    for attitude, known in knots.items():
        if np.count_nonzero(known) < FEWEST:
            continue
        spacing = float(np.median(np.diff(np.flatnonzero(known))))
        if spacing > criteria.slow_control:
            filled = _filled(flight, flight[attitude], known, rates[attitude], criteria)
        else:
            spacing = 1.0 / ((flight.native_rate(attitude) or np.inf) * flight.sample_interval)
            filled = _rounded(flight, flight[attitude], spacing, rates[attitude], criteria)
        if filled is not None:
            rate = 1.0 / (spacing * flight.sample_interval)
            note = (
                f"{attitude} is a filter's, logged at {rate:.3g} Hz: filled in between its values with the gyro rates"
            )
            flight = flight.with_columns(**{attitude: filled}).with_notes(note)
    return flight


def white_share(known: Array, summed: Array) -> float:
    """Share of white measurement noise in the steps of an attitude beside the integrated rates, 0 to 1; 1 for too few steps.

    known, summed: (N,) successive values, NaN where not measured, and the integral of the rates there.

    White noise makes one step too large and the next too small by as much: successive steps have a correlation of -1/2. The
    errors of a filter are slow, with its gyros' noise, and give no correlation. Only samples with a steady rate count: a late
    attitude errs where the rate changes.
    """
    steps, turned = np.diff(known - summed), np.abs(np.diff(summed, 2))
    pairs = np.column_stack([steps[:-1], steps[1:]])
    measured = np.isfinite(pairs).all(axis=1) & np.isfinite(turned)
    if np.count_nonzero(measured) < FEWEST:
        return 1.0
    even = measured & (turned <= np.median(turned[measured]))
    pairs = pairs[even] - np.median(steps[np.isfinite(steps)])
    power = float(np.mean(pairs**2))
    return float(np.clip(-2.0 * np.mean(pairs[:, 0] * pairs[:, 1]) / power, 0.0, 1.0)) if power > 0.0 else 0.0


def _filled(flight: Flight, values: Array, known: Mask, rate: Array, criteria: Criteria) -> Array | None:
    filled, shares = np.where(known, values, np.nan), []
    for segment in flight.segments:
        time, knots = flight.time[segment], np.flatnonzero(known[segment])
        if knots.size < FEWEST:
            continue
        summed = integral(time, rate[segment])
        at_knots = values[segment][knots]
        shares.append(white_share(at_knots, summed[knots]))
        reach = int(np.median(np.diff(knots)))  # no value was held for longer
        inside = np.arange(max(knots[0] - reach, 0), min(knots[-1] + reach, time.size))
        between = np.interp(time[inside], time[knots], at_knots - summed[knots])
        filled[segment.start + inside] = summed[inside] + between
    return filled if shares and max(shares) < criteria.filter_white else None


def _rounded(flight: Flight, values: Array, spacing: float, rate: Array, criteria: Criteria) -> Array | None:
    """(N,) an attitude logged every `spacing` samples and interpolated by straight lines, with the curvature that these cut off.

    The integrated rates, interpolated in the same way, lose as much. Of the trial instants of the log those count that leave the
    smallest second differences. None where the attitude is no filter's.
    """
    if spacing <= criteria.slow_control:
        return None
    from scipy.interpolate import CubicSpline  # here: rarely needed, and long to import

    filled, shares = values.copy(), []
    for segment in flight.segments:
        time, course = flight.time[segment], values[segment]
        if time.size < FEWEST * spacing or not np.isfinite(course).sum() > FEWEST * spacing:
            continue
        summed, interval = integral(time, rate[segment]), spacing * flight.sample_interval
        knots = np.arange(time[0] - interval, time[-1] + 2.0 * interval, interval)
        smooth = CubicSpline(time, summed)
        drawn = [
            np.interp(time, knots + begin, smooth(knots + begin))
            for begin in np.linspace(0.0, interval, PHASES, endpoint=False)
        ]
        roughness = [float(np.nanmean(np.diff(course - lines, 2) ** 2)) for lines in drawn]
        filled[segment] = course - drawn[int(np.argmin(roughness))] + summed
        logged = slice(None, None, round(spacing))
        shares.append(white_share(course[logged], summed[logged]))
    return filled if shares and max(shares) < criteria.filter_white else None


def _joined(flight: Flight, values: Array, known: Mask) -> Array:
    """(N,) straight lines through the known values of a column."""
    return np.interp(flight.time, flight.time[known], values[known]) if known.any() else np.zeros(values.size)
