"""Bounds of instrument factors from the innovations of the kinematic filter, and sets that cannot be told apart."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from estimation.compatibility.kalman import Run
from estimation.errors import DataError
from estimation.models.base import Model

Array = NDArray[np.float64]

USEFUL: Mapping[str, float] = {
    "m/s2": 0.2,
    "rad/s": 0.01,
    "1": 0.1,
    "rad": 0.02,
    "m": 0.25,
    "s": 0.03,
    "m/s": 1.0,
}
"""A bound wider than this, by unit, says nothing worth knowing of an instrument of this kind."""
CORRELATION_WINDOW_S = 2.0
SINGULAR = 1e-9


def normal(runs: list[list[Run]], slopes: list[list[Array]]) -> tuple[Array, Array]:
    n = slopes[0][0].shape[2]
    information, gradient = np.zeros((n, n)), np.zeros(n)
    for flight_runs, flight_slopes in zip(runs, slopes, strict=True):
        for run, s in zip(flight_runs, flight_slopes, strict=True):
            information += np.einsum("kjp,kjq->pq", s, s)
            gradient += np.einsum("kjp,kj->p", s, run.normalised)
    return information, gradient


def refuse_singular(model: Model, information: Array, names: str) -> None:
    """A set of factors that the data cannot separate at all is refused, by name. names: of the flights, for the message."""
    if not np.isfinite(information).all():
        raise DataError(f"{names}: the motion integrated from accelerations and rates runs away; check units and signs")
    scale = np.array([USEFUL[q.unit] for q in model.parameters])
    scaled = information * scale[:, None] * scale[None, :]
    blind = np.diag(scaled) < SINGULAR * max(float(np.diag(scaled).max()), 1e-300)
    if blind.any():
        gone = ", ".join(n for n, b in zip(model.parameter_names, blind, strict=True) if b)
        raise DataError(f"{names}: {gone} leaves no trace in any measured channel; leave it out with --factors")
    d = np.sqrt(np.diag(scaled))
    values, vectors = np.linalg.eigh(scaled / d[:, None] / d[None, :])
    if values[0] < SINGULAR:
        tied = [n for n, w in zip(model.parameter_names, np.abs(vectors[:, 0]), strict=True) if w > 0.2]
        raise DataError(
            f"{names}: {' and '.join(tied)} cannot be told from each other in this data; leave one of them out with --factors"
        )


def coloured(runs: list[list[Run]], slopes: list[list[Array]], information: Array, step: float) -> Array:
    """Covariance with the correlation left in the innovations counted (Morelli and Klein 1997): sandwich with the
    estimated autocorrelation per channel, tapered over CORRELATION_WINDOW_S."""
    lags = max(1, round(CORRELATION_WINDOW_S / step))
    meat = np.zeros_like(information)
    for flight_runs, flight_slopes in zip(runs, slopes, strict=True):
        known = np.vstack([r.known for r in flight_runs])
        for j in range(known.shape[1]):
            gamma = autocorrelation([r.normalised[:, j] for r in flight_runs], lags)
            for s in flight_slopes:
                column = s[:, j, :]
                meat += gamma[0] * column.T @ column
                for lag in range(1, min(lags, len(column) - 1)):
                    taper = 1.0 - lag / lags
                    cross = column[:-lag].T @ column[lag:]
                    meat += taper * gamma[lag] * (cross + cross.T)
    inverse = np.linalg.inv(information)
    covariance = inverse @ meat @ inverse
    plain = np.diag(inverse)
    diagonal = np.maximum(np.diag(covariance), plain)  # the correction never makes a bound smaller
    grow = np.sqrt(diagonal / np.maximum(np.diag(covariance), 1e-300))
    return np.asarray(covariance * grow[:, None] * grow[None, :])


def autocorrelation(series: list[Array], lags: int) -> Array:
    total = sum(len(s) for s in series)
    return np.array([sum(float(s[: len(s) - k] @ s[k:]) for s in series if len(s) > k) / total for k in range(lags)])
