"""Calibration curves: evaluation, validity, uncertainty, and least-squares fits with covariance.

Values are computed element by element (no linear-algebra library), so that a sample calibrated alone, live, and the
same sample calibrated within a whole recording are the same to the last bit.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import ValidationError

from groundstation.calibration.errors import CalibrationError
from groundstation.calibration.schema import CalibrationCurve

Array = NDArray[np.float64]

MARGIN = 0.02
"""A fitted curve is valid so far beyond its outermost points, as a part of their span: noise about an end is no extrapolation."""


def evaluate(curve: CalibrationCurve, reading: ArrayLike) -> Array:
    """Output of the curve [output unit] at `reading` (N,) [input unit]; NaN stays NaN.

    Beyond the ends a polynomial is continued as it is and a table along its end segments; `extrapolated` tells where.
    """
    x = np.ascontiguousarray(reading, float)
    if curve.kind == "table":
        return _interpolate(np.array(curve.inputs), np.array(curve.outputs), x)
    dx = x - curve.centre
    out = np.full_like(dx, curve.coefficients[-1])
    for c in reversed(curve.coefficients[:-1]):
        out = out * dx + c
    return np.where(np.isnan(x), np.nan, out)


def extrapolated(curve: CalibrationCurve, reading: ArrayLike) -> NDArray[np.bool_]:
    """Where a reading lies outside the range the curve was calibrated in."""
    x = np.asarray(reading, float)
    return np.asarray((x < curve.valid[0]) | (x > curve.valid[1]))


def slope(curve: CalibrationCurve, reading: ArrayLike) -> Array:
    """Derivative of the output with respect to the reading."""
    x = np.ascontiguousarray(reading, float)
    if curve.kind == "table":
        grid, out = np.array(curve.inputs), np.array(curve.outputs)
        i = np.clip(np.searchsorted(grid, x) - 1, 0, grid.size - 2)
        return np.asarray((out[i + 1] - out[i]) / (grid[i + 1] - grid[i]))
    terms = [k * c for k, c in enumerate(curve.coefficients)][1:] or [0.0]
    total = np.zeros_like(x)
    for c in reversed(terms):
        total = total * (x - curve.centre) + c
    return total


def standard_deviation(curve: CalibrationCurve, reading: ArrayLike) -> Array:
    """One sigma of the calibration [output unit] at each reading: from the covariance of the fit, else the stated one.

    The stated uncertainty is a floor under the fitted one (reference errors common to all points are in it).
    """
    x = np.ascontiguousarray(reading, float)
    variance = np.full_like(x, curve.uncertainty**2)
    if curve.covariance:
        powers = np.stack([(x - curve.centre) ** k for k in range(len(curve.coefficients))])
        variance = variance + np.einsum("in,ij,jn->n", powers, np.array(curve.covariance), powers)
    return np.sqrt(variance)


def fit_polynomial(
    reading: ArrayLike,
    reference: ArrayLike,
    degree: int,
    *,
    reading_std: ArrayLike = 0.0,
    reference_std: float = 0.0,
    input_unit: str,
    output_unit: str,
) -> CalibrationCurve:
    """Least-squares polynomial of `degree` through bench points.

    reading, reference: (points,). reading_std: one sigma of each reading (mean of a dwell); reference_std: one sigma of
    the reference, independent from point to point. The covariance of the coefficients is taken from the stated errors,
    and enlarged by the residuals where these are larger than stated. Raises CalibrationError for too few points.
    """
    x, y = np.asarray(reading, float), np.asarray(reference, float)
    if x.size < degree + 2:
        raise CalibrationError(
            f"{x.size} bench points cannot fix a curve of degree {degree}; record at least {degree + 2}"
        )
    if np.ptp(x) == 0:
        raise CalibrationError(
            "all bench points have the same reading; is the sensor connected, did the reference move?"
        )
    centre = float(np.round(np.mean(x), 12))
    scale = float(np.max(np.abs(x - centre)))
    design = np.stack([((x - centre) / scale) ** k for k in range(degree + 1)], axis=1)
    rough = np.linalg.lstsq(design, y, rcond=None)[0]
    gradient = sum(k * rough[k] * ((x - centre) / scale) ** (k - 1) for k in range(1, degree + 1)) / scale
    sigma = np.hypot(np.asarray(gradient) * np.asarray(reading_std, float), reference_std)
    weighted = bool(np.all(sigma > 0))
    weight = 1 / sigma if weighted else np.ones_like(y)
    solution = np.linalg.lstsq(design * weight[:, None], y * weight, rcond=None)[0]
    residual = y - design @ solution
    freedom = x.size - degree - 1
    chi2 = float(np.sum((residual * weight) ** 2) / freedom)
    inflation = max(1.0, chi2) if weighted else chi2
    normal = np.linalg.inv((design * weight[:, None]).T @ (design * weight[:, None]))
    rescale = np.array([scale**-k for k in range(degree + 1)])
    covariance = inflation * normal * np.outer(rescale, rescale)
    try:
        return CalibrationCurve(
            kind="polynomial",
            input_unit=input_unit,
            output_unit=output_unit,
            centre=centre,
            coefficients=tuple((solution * rescale).tolist()),
            valid=(float(x.min() - MARGIN * np.ptp(x)), float(x.max() + MARGIN * np.ptp(x))),
            residual_rms=float(np.sqrt(np.mean(residual**2))),
            covariance=tuple(tuple(row) for row in covariance.tolist()),
        )
    except ValidationError as error:
        raise CalibrationError(
            f"the points give no usable curve ({error.errors()[0]['loc'][0]} out of range); check readings and references"
        ) from error


def _interpolate(grid: Array, out: Array, x: Array) -> Array:
    i = np.clip(np.searchsorted(grid, x) - 1, 0, grid.size - 2)
    return np.asarray(out[i] + (x - grid[i]) * ((out[i + 1] - out[i]) / (grid[i + 1] - grid[i])))
