"""A test for feedback: where the control follows the output, a response includes the pilot or autopilot.

Residuals of a causal model of the output from the control are disturbances and noise; in open loop they are independent of later
movements of the control. Correlation with these means feedback
(L. Ljung, System Identification, 2nd ed., section 16.6). The response by spectra then lies between that of the aircraft
and minus the inverse of the feedback (J. S. Bendat and A. G. Piersol, Random Data, 4th ed., chapter 7; Tischler and
Remple, chapter 8).
"""

import math

import numpy as np
from scipy.special import chdtri

from estimation.frequency.records import DetrendedStretch, Signals
from groundstation.flight import Array

SECONDS = 1.0  # s of the past in the models, and of the future in which a pilot or autopilot would have answered
CHANCE = 1e-4  # probability of a false warning for a flight in open loop
SHARE = 0.02  # of the innovations of the control: with less, feedback is too weak to matter
SAMPLES_A_COEFFICIENT = 4  # at least


def feedback_note(signals: Signals) -> str:
    """A warning where the control follows the output, else empty."""
    lags = max(2, round(SECONDS / signals.step))
    moments = [m for s in signals.stretches if (m := _moments(s, lags)) is not None]
    if not moments:
        return ""
    cross_sums, residual_powers, innovation_powers, counts = zip(*moments, strict=True)
    cross, count = np.sum(cross_sums, axis=0), sum(counts)
    norm = math.sqrt(sum(residual_powers) * sum(innovation_powers))
    if norm <= 0.0:
        return ""
    rho = cross / norm
    share = float(np.sum(rho**2)) - lags / count
    if share < SHARE or count * float(np.sum(rho**2)) < float(chdtri(lags, CHANCE)):
        return ""
    return (
        f"{signals.names[0]} follows {signals.output} ({100 * share:.0f} % of its new movements answer what "
        f"{signals.output} did before): the loop was closed, and the response is drawn towards minus the inverse of the pilot or "
        "autopilot where the disturbance is large; fly sweeps hands off, or take sideslip estimate --method ml-frequency"
    )


def _moments(stretch: DetrendedStretch, lags: int) -> tuple[Array, float, float, int] | None:
    """(sums of residual times later innovation of the control (lags,), power of residual, of innovation, samples); None where
    these are too few."""
    u, y = stretch.x, stretch.y
    count = len(y) - 2 * lags
    if count < SAMPLES_A_COEFFICIENT * lags * (1 + u.shape[1]):
        return None
    past_u = np.concatenate([_lagged(c, range(lags + 1), lags) for c in u.T], axis=1)
    past_y = _lagged(y, range(1, lags + 1), lags)
    residual = _remainder(y[lags:], np.concatenate([past_u, past_y], axis=1))
    innovation = _remainder(u[lags:, 0], _lagged(u[:, 0], range(1, lags + 1), lags))
    cross = np.array([residual[:-k] @ innovation[k:] for k in range(1, lags + 1)])
    return cross, float(residual @ residual), float(innovation @ innovation), len(residual)


def _lagged(values: Array, lags: range, first: int) -> Array:
    """(N - first, lags) values `lags` samples before each sample from `first` on."""
    return np.stack([values[first - k : len(values) - k] for k in lags], axis=1)


def _remainder(values: Array, columns: Array) -> Array:
    """Residual of the regression of values on columns."""
    return np.asarray(values - columns @ np.linalg.lstsq(columns, values, rcond=1e-9)[0])
