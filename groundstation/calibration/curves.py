"""Calibration curves and triads: evaluation, validity, uncertainty, and least-squares fits with covariance.

Values are computed element by element (no linear-algebra library), so that a sample calibrated alone, live, and the same sample
calibrated within a whole recording are the same to the last bit.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import ValidationError

from groundstation.calibration.schema import CalibrationCurve, CalibrationError

Array = NDArray[np.float64]

MARGIN = 0.02
"""How far a fitted curve is valid beyond its outermost points, as a share of their span: noise at an end is no extrapolation."""

_RANGE_POINTS = 21  # over which the uncertainty of a curve is averaged: it is smooth
_FEWEST_SPHERE_READINGS = 20  # over twice the nine parameters of a sphere
_SPHERE_COVERAGE = 0.8  # span of each axis, at least, in radii: less leaves bias and scale of the axis correlated
_SPHERE_ITERATIONS = 50  # of Gauss-Newton, which starts near the solution and needs only a few
_SPHERE_TOLERANCE = 1e-12  # of the last step: near the resolution of a float
_RANK_TOLERANCE = 1e-6  # of a singular value over the largest element and row: below it the axis was not excited


def evaluate(curve: CalibrationCurve, reading: ArrayLike) -> Array:
    """Output of the curve [output unit] at `reading` (N,) [input unit]; NaN stays NaN.

    Beyond the ends a polynomial is continued as it is and a table along its end segments; see `extrapolated`.
    """
    x = np.ascontiguousarray(reading, float)
    if curve.kind == "table":
        return _interpolate(np.array(curve.inputs), np.array(curve.outputs), x)
    dx = x - curve.centre
    value = np.full_like(dx, curve.coefficients[-1])
    for c in reversed(curve.coefficients[:-1]):
        value = value * dx + c
    return np.where(np.isnan(x), np.nan, value)


def extrapolated(curve: CalibrationCurve, reading: ArrayLike) -> NDArray[np.bool_]:
    """(N,) True where a reading lies outside the range the curve was calibrated in."""
    x = np.asarray(reading, float)
    return np.asarray((x < curve.valid[0]) | (x > curve.valid[1]))


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


def sigma_over_range(curve: CalibrationCurve) -> Array:
    """(_RANGE_POINTS,) one sigma of the calibration [output unit] at equal steps over the calibrated range."""
    return standard_deviation(curve, np.linspace(*curve.valid, _RANGE_POINTS))


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
    the reference, independent from point to point. Covariance of the coefficients: as in `_weighted_fit`. Raises
    CalibrationError for too few points.
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
    solution, covariance, residual = _weighted_fit(design, y, sigma)
    rescale = np.array([scale**-k for k in range(degree + 1)])
    covariance = covariance * np.outer(rescale, rescale)
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


def _weighted_fit(design: Array, values: Array, sigma: Array) -> tuple[Array, Array, Array]:
    """Least-squares solution (m,), its covariance (m, m) and the residuals (n,) of `values` (n,) = design (n, m) solution.

    sigma: (n,) one sigma of each value. The covariance follows from sigma, enlarged by the residuals where these are larger than
    stated; where a sigma is 0 all values weigh the same and the residuals alone give the covariance.
    """
    weighted = bool(np.all(sigma > 0))
    weight = 1 / sigma if weighted else np.ones_like(values)
    weighted_design = design * weight[:, None]
    solution = np.linalg.lstsq(weighted_design, values * weight, rcond=None)[0]
    residual = values - design @ solution
    chi2 = float(np.sum((residual * weight) ** 2) / (len(design) - design.shape[1]))
    inflation = max(1.0, chi2) if weighted else chi2
    covariance = inflation * np.linalg.inv(weighted_design.T @ weighted_design)
    return np.asarray(solution, np.float64), np.asarray(covariance, np.float64), residual


def _interpolate(grid: Array, outputs: Array, x: Array) -> Array:
    i = np.clip(np.searchsorted(grid, x) - 1, 0, grid.size - 2)
    return np.asarray(outputs[i] + (x - grid[i]) * ((outputs[i + 1] - outputs[i]) / (grid[i + 1] - grid[i])))


@dataclass(frozen=True)
class TriadFit:
    """output = matrix (reading - bias - bias_per_kelvin (T - T0)), with standard deviations.

    matrix, matrix_std: (3, 3). bias, bias_std, bias_per_kelvin: (3,). residual_rms in output units.
    """

    matrix: Array
    bias: Array
    bias_per_kelvin: Array
    matrix_std: Array
    bias_std: Array
    residual_rms: float


def fit_vectors(
    readings: Array, references: Array, reading_std: Array, reference_std: float, warming: Array | None = None
) -> TriadFit:
    """A triad from dwells at known vectors: reading = S reference + bias (+ bias_per_kelvin warming), solved for S and biases.

    readings, references, reading_std: (dwells, 3), output units. warming: (dwells,) temperature less the reference [K].
    Standard deviations: from `_weighted_fit`. Raises CalibrationError when the vectors do not span space or there are too few
    of them.
    """
    columns = [references, np.ones((len(references), 1))]
    if warming is not None:
        columns.append(warming[:, None])
    design = np.hstack(columns)
    size = design.shape[1]
    if len(design) < size + 1:
        raise CalibrationError(f"{len(design)} dwells cannot fix a three-axis calibration; record at least {size + 1}")
    if np.linalg.matrix_rank(design, tol=_RANK_TOLERANCE * float(np.abs(design).max()) * len(design)) < size:
        raise CalibrationError("the reference vectors do not span all three axes (and the temperature): add dwells")
    sensitivity, bias, slope = np.zeros((3, 3)), np.zeros(3), np.zeros(3)
    row_std, bias_std = np.zeros((3, 3)), np.zeros(3)
    residuals = np.zeros_like(readings)
    for axis in range(3):
        sigma = np.sqrt(reading_std[:, axis] ** 2 + reference_std**2)
        solution, covariance, residuals[:, axis] = _weighted_fit(design, readings[:, axis], sigma)
        std = np.sqrt(np.diag(covariance))
        sensitivity[axis], bias[axis] = solution[:3], solution[3]
        row_std[axis], bias_std[axis] = std[:3], std[3]
        slope[axis] = solution[4] if warming is not None else 0.0
    matrix: Array = np.asarray(np.linalg.inv(sensitivity), np.float64)
    # first order: d(S^-1) = -S^-1 dS S^-1, elements of dS independent
    matrix_std: Array = np.sqrt((matrix**2) @ (row_std**2) @ (matrix**2))
    residual_rms = float(np.sqrt(np.mean((residuals @ matrix.T) ** 2)))
    return TriadFit(matrix, bias, slope, matrix_std, bias_std, residual_rms)


def fit_sphere(readings: Array, field: float, noise: float) -> TriadFit:
    """Hard and soft iron from readings turned through all directions: |matrix (reading - bias)| = field.

    readings: (N, 3). noise: one sigma of a reading, a floor under the residuals. The matrix is symmetric: a rotation of the whole
    triad cannot be seen in magnitudes. Gauss-Newton on the nine parameters. Raises CalibrationError when the directions do not
    cover the sphere.
    """
    if len(readings) < _FEWEST_SPHERE_READINGS:
        raise CalibrationError(
            f"{len(readings)} readings cannot fix hard and soft iron; turn the aircraft through all directions"
        )
    bias = 0.5 * (readings.max(axis=0) + readings.min(axis=0))
    spread = np.ptp(readings, axis=0)
    if float(spread.min()) < _SPHERE_COVERAGE * field:
        axis = "xyz"[int(np.argmin(spread))]
        raise CalibrationError(
            f"axis {axis} saw only {spread.min():.3g} of {2 * field:.3g}: turn the aircraft through all directions"
        )
    upper = np.triu_indices(3)
    theta = np.concatenate([np.eye(3)[upper], bias / field])
    reading = readings / field
    jacobian, residual = _sphere_jacobian(theta, reading, upper)
    for _ in range(_SPHERE_ITERATIONS):
        step = np.linalg.lstsq(jacobian, -residual, rcond=None)[0]
        theta = theta + step
        jacobian, residual = _sphere_jacobian(theta, reading, upper)
        if float(np.max(np.abs(step))) < _SPHERE_TOLERANCE:
            break
    freedom = len(readings) - theta.size
    variance = max(float(residual @ residual) / freedom, (noise / field) ** 2)
    std = np.sqrt(variance * np.diag(np.linalg.inv(jacobian.T @ jacobian)))
    matrix, matrix_std = _symmetric(theta[:6], upper), _symmetric(std[:6], upper)
    rms = float(np.sqrt(np.mean(residual**2))) * field
    return TriadFit(matrix, theta[6:] * field, np.zeros(3), matrix_std, std[6:] * field, rms)


def _symmetric(six: Array, upper: tuple[NDArray[np.int64], NDArray[np.int64]]) -> Array:
    """(3, 3) symmetric matrix from its six elements at `upper`."""
    matrix = np.zeros((3, 3))
    matrix[upper] = six
    return matrix + matrix.T - np.diag(np.diag(matrix))


def _sphere_jacobian(
    theta: Array, reading: Array, upper: tuple[NDArray[np.int64], NDArray[np.int64]]
) -> tuple[Array, Array]:
    """Derivatives of |M (reading - b)| - 1 with respect to the six elements of M and the three of b, and its values."""
    matrix, centred = _symmetric(theta[:6], upper), reading - theta[6:]
    vector = centred @ matrix.T
    length = np.linalg.norm(vector, axis=1)
    unit = vector / length[:, None]
    rows = [
        unit[:, i] * centred[:, j] + (unit[:, j] * centred[:, i] if i != j else 0.0)
        for i, j in zip(*upper, strict=True)
    ]
    return np.column_stack([*rows, -(unit @ matrix)]), length - 1
