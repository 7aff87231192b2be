"""Least-squares fits of the bench: three-axis instruments from known vectors, and a magnetometer from a sphere."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from groundstation.calibration.errors import CalibrationError

Array = NDArray[np.float64]


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
    readings: Array, references: Array, reading_std: Array, reference_std: float, warmth: Array | None = None
) -> TriadFit:
    """A triad from dwells at known vectors: reading = S reference + bias (+ bias_per_kelvin warmth), solved for S and biases.

    readings, references, reading_std: (dwells, 3), output units. warmth: (dwells,) temperature less the reference [K].
    Covariance from the stated errors, enlarged where residuals are larger. Raises CalibrationError when the vectors do not
    span space or there are too few of them.
    """
    columns = [references, np.ones((len(references), 1))]
    if warmth is not None:
        columns.append(warmth[:, None])
    design = np.hstack(columns)
    size = design.shape[1]
    if len(design) < size + 1:
        raise CalibrationError(f"{len(design)} dwells cannot fix a three-axis calibration; record at least {size + 1}")
    if np.linalg.matrix_rank(design, tol=1e-6 * float(np.abs(design).max()) * len(design)) < size:
        raise CalibrationError("the reference vectors do not span all three axes (and the temperature): add dwells")
    sensitivity, bias, slope = np.zeros((3, 3)), np.zeros(3), np.zeros(3)
    row_std, bias_std = np.zeros((3, 3)), np.zeros(3)
    residuals = np.zeros_like(readings)
    for axis in range(3):
        sigma = np.sqrt(reading_std[:, axis] ** 2 + reference_std**2)
        weight = 1 / sigma if np.all(sigma > 0) else np.ones(len(design))
        weighted = design * weight[:, None]
        solution = np.linalg.lstsq(weighted, readings[:, axis] * weight, rcond=None)[0]
        residuals[:, axis] = readings[:, axis] - design @ solution
        chi2 = float(np.sum((residuals[:, axis] * weight) ** 2) / (len(design) - size))
        inflation = max(1.0, chi2) if np.all(sigma > 0) else chi2
        std = np.sqrt(inflation * np.diag(np.linalg.inv(weighted.T @ weighted)))
        sensitivity[axis], bias[axis] = solution[:3], solution[3]
        row_std[axis], bias_std[axis] = std[:3], std[3]
        slope[axis] = solution[4] if warmth is not None else 0.0
    matrix: Array = np.asarray(np.linalg.inv(sensitivity), np.float64)
    # first order: d(S^-1) = -S^-1 dS S^-1, elements of dS independent
    matrix_std: Array = np.sqrt((matrix**2) @ (row_std**2) @ (matrix**2))
    out_residual = residuals @ matrix.T
    return TriadFit(matrix, bias, slope, matrix_std, bias_std, float(np.sqrt(np.mean(out_residual**2))))


def fit_sphere(readings: Array, field: float, noise: float) -> TriadFit:
    """Hard and soft iron from readings turned through all directions: |matrix (reading - bias)| = field.

    readings: (N, 3). The matrix is symmetric: a rotation of the whole triad cannot be seen in magnitudes. Gauss-Newton on
    the nine parameters. Raises CalibrationError when the directions do not cover the sphere.
    """
    if len(readings) < 20:
        raise CalibrationError(
            f"{len(readings)} readings cannot fix hard and soft iron; turn the aircraft through all directions"
        )
    bias = 0.5 * (readings.max(axis=0) + readings.min(axis=0))
    spread = np.ptp(readings, axis=0)
    if float(spread.min()) < 0.8 * field:
        axis = "xyz"[int(np.argmin(spread))]
        raise CalibrationError(
            f"axis {axis} saw only {spread.min():.3g} of {2 * field:.3g}: turn the aircraft through all directions"
        )
    upper = np.triu_indices(3)
    theta = np.concatenate([np.eye(3)[upper], bias / field])
    reading = readings / field
    jacobian, left = _sphere_jacobian(theta, reading, upper)
    for _ in range(50):
        step = np.linalg.lstsq(jacobian, -left, rcond=None)[0]
        theta = theta + step
        jacobian, left = _sphere_jacobian(theta, reading, upper)
        if float(np.max(np.abs(step))) < 1e-12:
            break
    freedom = len(readings) - theta.size
    variance = max(float(left @ left) / freedom, (noise / field) ** 2)
    std = np.sqrt(variance * np.diag(np.linalg.inv(jacobian.T @ jacobian)))
    matrix, matrix_std = _symmetric(theta[:6], upper), _symmetric(std[:6], upper)
    rms = float(np.sqrt(np.mean(left**2))) * field
    return TriadFit(matrix, theta[6:] * field, np.zeros(3), matrix_std, std[6:] * field, rms)


def _symmetric(six: Array, upper: tuple[NDArray[np.int64], NDArray[np.int64]]) -> Array:
    matrix = np.zeros((3, 3))
    matrix[upper] = six
    return matrix + matrix.T - np.diag(np.diag(matrix))


def _sphere_jacobian(
    theta: Array, reading: Array, upper: tuple[NDArray[np.int64], NDArray[np.int64]]
) -> tuple[Array, Array]:
    """Derivatives of |M (reading - b)| - 1 with respect to the six elements of M and the three of b."""
    matrix, free = _symmetric(theta[:6], upper), reading - theta[6:]
    vector = free @ matrix.T
    length = np.linalg.norm(vector, axis=1)
    unit = vector / length[:, None]
    rows = [unit[:, i] * free[:, j] + (unit[:, j] * free[:, i] if i != j else 0.0) for i, j in zip(*upper, strict=True)]
    return np.column_stack([*rows, -(unit @ matrix)]), length - 1
