"""Attitudes that come more rarely than samples, of filters that integrate the gyros: between their values as the gyros say.

An autopilot logs its attitude ten times a second beside rates at fifty. Repeats and straight lines between two values are
nobody's measurement, and left out they cut a hole of every other sample into the one channel whose errors are slow: what is slow
and seen with holes looks fast. The filter itself went from one value to the next as its gyros said, and those are recorded.
Where its instants lie between the samples no sample shows a value, and lines are seen by what they cut off the turning.
An attitude that is measured afresh each time (optically, say) is none of these and stays as it is.
"""

import numpy as np

from estimation.engine.kernel import Array
from estimation.gap.criteria import Criteria
from estimation.gap.records.sampling import Mask, known_at
from groundstation.flight import Flight
from groundstation.flight.arrays import integral
from groundstation.flight.kinematics import attitude_rates

MOTION = ("p", "q", "r", "phi", "theta")
PHASES = 20  # instants within an interval at which its lines may begin: the sag of one is known to a hundredth
FEWEST = 40  # values, for what is white in them to be told to a sixth


def with_attitudes_between(flight: Flight, criteria: Criteria) -> Flight:
    """The flight with bank and pitch attitude of a filter filled in between the values that its log has, and a note for each;
    itself where there is none to fill."""
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
            note = f"{attitude} is a filter's, logged at {rate:.3g} Hz: between its values it goes as the gyros say"
            flight = flight.with_columns(**{attitude: filled}).with_notes(note)
    return flight


def white_share(known: Array, summed: Array) -> float:
    """What of an attitude's steps against the summed rates is white noise of its values, 0 to 1; 1 where too few are known.

    known, summed: (N,) values in a row, NaN where not measured, and the integral of the rates there.

    White noise of the values makes a step too large and the next as much too small: of steps that are nothing else two in a row
    have a correlation of -1/2. Of a filter, which errs slowly and by its gyros' noise, none. Told where the aircraft turns
    evenly: an attitude that is late errs by what the rate changes.
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
        reach = int(np.median(np.diff(knots)))  # nobody held the last value for longer
        inside = np.arange(max(knots[0] - reach, 0), min(knots[-1] + reach, time.size))
        between = np.interp(time[inside], time[knots], at_knots - summed[knots])
        filled[segment.start + inside] = summed[inside] + between
    return filled if shares and max(shares) < criteria.filter_white else None


def _rounded(flight: Flight, values: Array, spacing: float, rate: Array, criteria: Criteria) -> Array | None:
    """Lines drawn between instants that lie `spacing` samples apart and on none of them, given back what they cut off.

    The summed rates lose as much where they are drawn so: of all instants the lines may begin at, those after which the least is
    left from sample to sample.
    """
    if spacing <= criteria.slow_control:
        return None
    from scipy.interpolate import CubicSpline  # here: rarely needed, and long to import

    filled, shares = values.copy(), []
    for segment in flight.segments:
        time, course = flight.time[segment], values[segment]
        if time.size < FEWEST * spacing or not np.isfinite(course).sum() > FEWEST * spacing:
            continue
        summed, every = integral(time, rate[segment]), spacing * flight.sample_interval
        knots = np.arange(time[0] - every, time[-1] + 2.0 * every, every)
        smooth = CubicSpline(time, summed)
        drawn = [
            np.interp(time, knots + begin, smooth(knots + begin))
            for begin in np.linspace(0.0, every, PHASES, endpoint=False)
        ]
        left = [float(np.nanmean(np.diff(course - lines, 2) ** 2)) for lines in drawn]
        filled[segment] = course - drawn[int(np.argmin(left))] + summed
        once = slice(None, None, round(spacing))
        shares.append(white_share(course[once], summed[once]))
    return filled if shares and max(shares) < criteria.filter_white else None


def _joined(flight: Flight, values: Array, known: Mask) -> Array:
    """(N,) straight lines through what is known of a column."""
    return np.interp(flight.time, flight.time[known], values[known]) if known.any() else np.zeros(values.size)
