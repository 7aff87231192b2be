"""How noisy every channel is, and which attitudes are the output of a filter: before anything is fitted."""

import math
from collections.abc import Sequence

import numpy as np

from estimation.engine.kernel import Array
from estimation.gap.criteria import Criteria
from estimation.gap.records.attitudes import white_share
from estimation.gap.records.candidate_model import RATE_OF
from estimation.gap.records.flight_records import FlightRecord
from estimation.signals.denoise import noise_level
from groundstation.flight.arrays import integral
from groundstation.flight.kinematics import attitude_rates

KNOWN = 0.2  # of the steps from sample to sample, for what is seen of them to stand for the rest
QUIETEST = 1e-4  # of the span of a channel: a coarsely rounded one shows no scatter at all


def channel_noise(records: Sequence[FlightRecord]) -> Array:
    """(ny,) standard deviation of the white part of every output, median over the records."""
    ny = records[0].z.shape[1]
    levels = np.zeros((len(records), ny))
    span = np.zeros(ny)
    for k, record in enumerate(records):
        for i in range(ny):
            measured = record.z[np.isfinite(record.z[:, i]), i]
            if measured.size:
                levels[k, i] = noise_level(record.z[:, i])
                span[i] = max(span[i], float(np.ptp(measured)))
    return np.maximum(np.median(levels, axis=0), QUIETEST * np.maximum(span, 1e-9))


def filtered_attitudes(
    records: Sequence[FlightRecord], outputs: Sequence[str], white: Array, criteria: Criteria
) -> tuple[str, ...]:
    """Those attitudes among the outputs, of white noise `white` (ny,), that come from a filter which integrates the gyro.

    From sample to sample they are smoother than one step of the gyro's own noise, which no independent measurement can be; or
    what parts them from the integrated rates is not white from sample to sample, as the noise of a measurement is.
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
    """Median over the records of what of an attitude's steps against the gyros is white; 1 where the gyros are not known."""
    shares = []
    for record in records:
        motion = [_measured(record, outputs, n) for n in ("p", "q", "r", "phi", "theta")]
        if motion["pqr".index(RATE_OF[attitude])].any():
            rate = np.nan_to_num(attitude_rates(*motion)[attitude])
            shares.append(white_share(_measured(record, outputs, attitude), integral(record.time, rate)))
    return float(np.median(shares)) if shares else 1.0


def bank_error(records: Sequence[FlightRecord], outputs: Sequence[str], scatter: Array, criteria: Criteria) -> Array:
    """`scatter` with the noise of the bank angle replaced by its slow error where the bank angle is a filter's.

    An attitude filter integrates the gyro and corrects slowly: from sample to sample its angle is smoother than one
    step of the gyro's own noise, which no independent measurement can be. What is wrong with it is then not seen in
    that smoothness but in how it parts from the integrated rates (without a constant and a drift) over the record.
    """
    if not {"p", "r"} <= set(outputs) or "phi" not in filtered_attitudes(records, outputs, scatter, criteria):
        return scatter
    p, r, phi = (outputs.index(n) for n in ("p", "r", "phi"))
    errors = []
    for record in records:
        if not {"q", "theta"} <= {*record.inputs, *outputs}:
            continue
        bank, (pitching, pitch) = record.z[:, phi], (_measured(record, outputs, n) for n in ("q", "theta"))
        turn = pitching * np.sin(bank) + record.z[:, r] * np.cos(bank)
        errors.append(slow_error(record.time, bank, record.z[:, p] + np.tan(pitch) * turn))
    return _widened(scatter, phi, errors)


def pitch_error(records: Sequence[FlightRecord], outputs: Sequence[str], scatter: Array, criteria: Criteria) -> Array:
    """`scatter` with the noise of the pitch attitude replaced by its slow error where the attitude is a filter's: see
    `bank_error`."""
    if "q" not in outputs or "theta" not in filtered_attitudes(records, outputs, scatter, criteria):
        return scatter
    q, theta = outputs.index("q"), outputs.index("theta")
    errors = []
    for record in records:
        bank, yaw = (_measured(record, outputs, n) for n in ("phi", "r"))
        rate = record.z[:, q] * np.cos(bank) - yaw * np.sin(bank)
        errors.append(slow_error(record.time, record.z[:, theta], rate))
    return _widened(scatter, theta, errors)


def slow_error(time: Array, angle: Array, rate: Array) -> float | None:
    """rms of how far a measured angle (N,) parts from its integrated rate (N,), without a constant and a drift. What it does
    between samples of which one is missing (NaN) is taken to be as wrong as the rest; None where most of it is missing."""
    dt = np.diff(time)
    difference = np.diff(angle) - 0.5 * dt * (rate[1:] + rate[:-1])
    measured = np.isfinite(difference)
    if np.mean(measured) < KNOWN:
        return None
    course = np.concatenate([[0.0], np.cumsum(np.where(measured, difference, 0.0))]) / np.mean(measured)
    return float(np.std(course - np.polyval(np.polyfit(time, course, 1), time)))


def _widened(scatter: Array, column: int, errors: Sequence[float | None]) -> Array:
    """`scatter` with the usual one of the errors that are known for a column, where that is more."""
    known_errors = [e for e in errors if e is not None]
    wider = scatter.copy()
    wider[column] = max(scatter[column], float(np.median(known_errors))) if known_errors else scatter[column]
    return wider


def _measured(record: FlightRecord, outputs: Sequence[str], name: str) -> Array:
    """(N,) an output or an input, zero where the flight has neither."""
    zeros = np.zeros(len(record))
    output = record.z[:, outputs.index(name)] if name in outputs else zeros
    return record.inputs.get(name, zeros) if name not in outputs else output if np.isfinite(output).any() else zeros


def sample_interval(records: Sequence[FlightRecord]) -> float:
    """Median over the records of their sample interval [s]."""
    return float(np.median([np.median(np.diff(r.time)) for r in records]))


def time_bound(std: float, interval: float, criteria: Criteria) -> float:
    """Standard deviation [s] of a time that a fit knows to `std` [s], with what samples at `interval` [s] leave open of it."""
    return math.hypot(std, criteria.timing_share * interval)
