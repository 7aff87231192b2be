"""Does the control follow the output? Then a response holds the pilot or autopilot too.

Residuals of a causal model of the output from the control are disturbances and noise; in open loop they have nothing to
do with what the control does afterwards. Correlation of residuals with later movements of the control means feedback
(L. Ljung, System Identification, 2nd ed., section 16.6). The response by spectra then lies between that of the aircraft
and minus the inverse of the feedback (J. S. Bendat and A. G. Piersol, Random Data, 4th ed., chapter 7; Tischler and
Remple, chapter 8).
"""

import math

import numpy as np
from scipy.special import chdtri

from estimation.frequency.records import DetrendedStretch, Signals
from groundstation.flight import Array

SECONDS = 1.0  # of past that models look at, and of future in which a pilot or autopilot would have answered
CHANCE = 1e-4  # that this is said of a flight in open loop
SHARE = 0.02  # of the control's new movements, below which feedback is too weak to matter


def feedback_note(signals: Signals) -> str:
    """One sentence where the control follows the output, else nothing."""
    lags = max(2, round(SECONDS / signals.step))
    moments = [t for s in signals.stretches if (t := _moments(s, lags)) is not None]
    if not moments:
        return ""
    cross = np.sum([t[0] for t in moments], axis=0)
    norm = math.sqrt(sum(t[1] for t in moments) * sum(t[2] for t in moments))
    count = sum(t[3] for t in moments)
    if norm <= 0.0:
        return ""
    rho = cross / norm
    share = float(np.sum(rho**2)) - lags / count
    if share < SHARE or count * float(np.sum(rho**2)) < float(chdtri(lags, CHANCE)):
        return ""
    return (
        f"{signals.names[0]} follows {signals.output} ({100 * share:.0f} % of its new movements answer what "
        f"{signals.output} did before): the loop was "
        "closed, and the response is drawn towards minus the inverse of the pilot or autopilot where the "
        "disturbance is large; fly "
        "sweeps hands off, or take sideslip estimate --method ml-frequency"
    )


def _moments(stretch: DetrendedStretch, lags: int) -> tuple[Array, float, float, int] | None:
    """(sums of residual times later innovation of the control (lags,), both their powers, samples)."""
    u, y = stretch.x, stretch.y
    count = len(y) - 2 * lags
    if count < 4 * lags * (1 + u.shape[1]):
        return None
    past_u = np.concatenate([_lagged(c, range(lags + 1), lags) for c in u.T], axis=1)
    past_y = _lagged(y, range(1, lags + 1), lags)
    residual = _remainder(y[lags:], np.concatenate([past_u, past_y], axis=1))
    new = _remainder(u[lags:, 0], _lagged(u[:, 0], range(1, lags + 1), lags))
    cross = np.array([residual[:-k] @ new[k:] for k in range(1, lags + 1)])
    return cross, float(residual @ residual), float(new @ new), len(residual)


def _lagged(values: Array, lags: range, first: int) -> Array:
    """(N - first, lags) columns of values before each sample from `first` on."""
    return np.stack([values[first - k : len(values) - k] for k in lags], axis=1)


def _remainder(values: Array, columns: Array) -> Array:
    return np.asarray(values - columns @ np.linalg.lstsq(columns, values, rcond=1e-9)[0])
