"""The noise of every channel, and the attitudes that are the output of a filter: found before any fit."""

import math
from collections.abc import Sequence

import numpy as np

from estimation.engine.kernel import Array
from estimation.gap.criteria import Criteria
from estimation.gap.records.candidate_model import RATE_OF
from estimation.gap.records.flight_records import FlightRecord
from estimation.gap.records.sampling import MOTION, white_share
from estimation.signals.denoise import noise_level
from groundstation.flight.arrays import integral
from groundstation.flight.kinematics import EULER_RATES

KNOWN = 0.2  # share of the steps from sample to sample that must be measured to represent all of them
QUIETEST = 1e-4  # of the range of a channel: the least noise, as a coarsely rounded channel shows no scatter at all
SMALLEST_RANGE = 1e-9  # [unit of the channel] of one that never changes


def channel_noise(records: Sequence[FlightRecord]) -> Array:
    """(ny,) standard deviation of the white part of every output, median over the records; 1 of an output that none has
    measured."""
    levels = np.array([[noise_level(column) for column in record.z.T] for record in records])
    spans = [np.fmax.reduce(record.z) - np.fmin.reduce(record.z) for record in records]
    span = np.fmax.reduce(spans)  # NaN where no record has measured an output
    least = QUIETEST * np.maximum(span, SMALLEST_RANGE)
    return np.where(np.isnan(span), 1.0, np.maximum(np.median(levels, axis=0), least))


def filtered_attitudes(
    records: Sequence[FlightRecord], outputs: Sequence[str], white: Array, criteria: Criteria
) -> tuple[str, ...]:
    """Those attitudes among the outputs that come from a filter which integrates the gyro. white: (ny,) noise of the outputs.

    From sample to sample they are smoother than the gyro's noise integrated over one step, as no independent measurement can be;
    or their difference from the integrated rates is not white, as the noise of a measurement would be.
    """
    step = float(np.median(np.concatenate([np.diff(record.time) for record in records])))
    attitudes = []
    for attitude, rate in RATE_OF.items():
        if attitude in outputs:
            input_levels = [record.input_noise.get(rate, 0.0) for record in records]
            noise = white[outputs.index(rate)] if rate in outputs else float(np.median(input_levels))
            smooth = white[outputs.index(attitude)] <= noise * step
            if smooth or _white_share(records, outputs, attitude) < criteria.filter_white:
                attitudes.append(attitude)
    return tuple(attitudes)


def _white_share(records: Sequence[FlightRecord], outputs: Sequence[str], attitude: str) -> float:
    """Median over the records of the share of an attitude's steps against the integrated gyros that is white noise; 1 where there
    are no gyros."""
    shares = []
    for record in records:
        motion = _motion(record, outputs)
        if motion[RATE_OF[attitude]].any():
            rate = np.nan_to_num(EULER_RATES[attitude](motion))
            shares.append(white_share(_measured(record, outputs, attitude), integral(record.time, rate)))
    return float(np.median(shares)) if shares else 1.0


def bank_error(records: Sequence[FlightRecord], outputs: Sequence[str], scatter: Array, criteria: Criteria) -> Array:
    """`scatter` (ny,) with the noise of the bank angle raised to its slow error where the bank angle comes from a filter.

    An attitude filter integrates the gyro and corrects slowly, so that its angle is smooth from sample to sample. Its error shows
    only in its difference from the integrated rates over the record (`slow_error`).
    """
    return _with_slow_error("phi", ("p", "r"), ("q", "theta"), records, outputs, scatter, criteria)


def pitch_error(records: Sequence[FlightRecord], outputs: Sequence[str], scatter: Array, criteria: Criteria) -> Array:
    """`scatter` (ny,) with the noise of the pitch attitude raised to its slow error where it comes from a filter, as in
    `bank_error`."""
    return _with_slow_error("theta", ("q",), (), records, outputs, scatter, criteria)


def _with_slow_error(
    attitude: str,
    gyros: Sequence[str],
    others: Sequence[str],
    records: Sequence[FlightRecord],
    outputs: Sequence[str],
    scatter: Array,
    criteria: Criteria,
) -> Array:
    """`scatter` (ny,) with the noise of a filter's attitude raised to the median of its slow errors. gyros: outputs without which
    none is known; others: outputs or inputs without which that of a record is not."""
    if not {*gyros} <= set(outputs) or attitude not in filtered_attitudes(records, outputs, scatter, criteria):
        return scatter
    errors = []
    for record in records:
        if {*others} <= {*record.inputs, *outputs}:
            motion = _motion(record, outputs)
            # as measured: zero for a gyro that was off would be a wrong rate
            motion |= {n: record.z[:, outputs.index(n)] for n in (attitude, *gyros)}
            errors.append(slow_error(record.time, motion[attitude], EULER_RATES[attitude](motion)))
    wider = scatter.copy()
    if known_errors := [e for e in errors if e is not None]:
        column = outputs.index(attitude)
        wider[column] = max(scatter[column], float(np.median(known_errors)))
    return wider


def slow_error(time: Array, angle: Array, rate: Array) -> float | None:
    """Rms difference of a measured angle (N,) from its integrated rate (N,), without a constant and a drift.

    Steps of which a sample is missing (NaN) are taken to be as wrong as the others; None where fewer than `KNOWN` are left.
    """
    dt = np.diff(time)
    difference = np.diff(angle) - 0.5 * dt * (rate[1:] + rate[:-1])
    measured = np.isfinite(difference)
    if np.mean(measured) < KNOWN:
        return None
    error = np.concatenate([[0.0], np.cumsum(np.where(measured, difference, 0.0))]) / np.mean(measured)
    return float(np.std(error - np.polyval(np.polyfit(time, error, 1), time)))


def _motion(record: FlightRecord, outputs: Sequence[str]) -> dict[str, Array]:
    """Rates and attitudes (N,) of a record, as of `_measured`."""
    return {n: _measured(record, outputs, n) for n in MOTION}


def _measured(record: FlightRecord, outputs: Sequence[str], name: str) -> Array:
    """(N,) an output or an input; zero where the flight has neither, or the output was never measured."""
    zeros = np.zeros(len(record))
    if name not in outputs:
        return record.inputs.get(name, zeros)
    output = record.z[:, outputs.index(name)]
    return output if np.isfinite(output).any() else zeros


def sample_interval(records: Sequence[FlightRecord]) -> float:
    """Median over the records of their sample interval [s]."""
    return float(np.median([r.interval for r in records]))


def time_bound(std: float, interval: float, criteria: Criteria) -> float:
    """Standard deviation [s] of a time of which a fit gives the bound `std` [s], with the uncertainty that samples at `interval`
    [s] add."""
    return math.hypot(std, criteria.timing_share * interval)
