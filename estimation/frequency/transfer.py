"""Low-order transfer functions with delay, fitted to a frequency response over the band of good coherence.

Two fits of the same form: with the cost of CIFER's NAVFIT (M. B. Tischler and R. K. Remple, Aircraft and Rotorcraft System
Identification, 2nd ed., chapter 11: magnitude in dB weighted 1, phase in degrees 0.01745, coherence [1.58 (1 - exp(-g2))]^2;
J <= 100 is acceptable, <= 50 cannot be distinguished from the data) and, for estimates with bounds, by maximum likelihood:
complex differences over their random errors. The bounds allow for the correlation of neighbouring points, and are widened where
the form does not fit.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from estimation.errors import DataError, EstimationError
from estimation.frequency.forms import TransferForm, form_for, general_forms
from estimation.frequency.response import FrequencyResponse
from estimation.frequency.spectra import tapers
from estimation.signals.curves import Complex
from groundstation.flight import Array

GOOD = 0.6  # coherence from which a point is fitted (Tischler and Remple, chapter 7)
PHASE_WEIGHT = 0.01745  # of one degree squared against one dB squared
DELAYS = (0.0, 0.05, 0.1, 0.2, 0.4)  # s, of the starts of the search
SEARCHES = 2  # from the best starts
ROUNDS = 8  # of Sanathanan and Koerner's iteration for a start
SPARE = 2  # real numbers beyond the unknowns that a fit needs
LEAST_ERROR = 1e-9  # random error over the largest magnitude, at least
SMALLEST_NORM = 1e-8  # of a column of the Jacobian, in place of zero
SMALLEST_SCALE = 1e-3  # of an unknown, in the search
TAPER_POINTS, LARGEST_PHASE, PHASE_POINTS = 201, 60.0, 601  # of the table of correlations; beyond its end they are 0


@dataclass(frozen=True)
class FittedNumber:
    """An estimate and its bound (one standard deviation)."""

    estimate: float
    std: float
    unit: str


@dataclass(frozen=True)
class TransferFunction:
    """H = numerator / denominator exp(-delay s), coefficients from the highest power on. cifer: values of the unknowns at the
    least cost J of CIFER, which is `cost`; misfit: rms of differences over their random errors at `parameters`; points: number
    fitted; omega: the band [rad/s]; covariance: in the order of `parameters`."""

    form: TransferForm
    parameters: Mapping[str, FittedNumber]
    cifer: Mapping[str, float]
    cost: float
    misfit: float
    points: int
    omega: tuple[float, float]
    covariance: Array

    @property
    def values(self) -> Array:
        return np.array([p.estimate for p in self.parameters.values()])

    def at(self, omega: Array) -> Complex:
        """H at frequencies (n,) rad/s."""
        return self.form.response(self.values, omega)

    def to_json(self) -> dict[str, Any]:
        numerator, denominator, delay = self.form.polynomials(self.values)
        return {
            "form": self.form.name,
            "equation": self.form.equation,
            "numerator": numerator.tolist(),
            "denominator": denominator.tolist(),
            "delay": delay,
            "parameters": {
                n: {"estimate": p.estimate, "std": p.std if math.isfinite(p.std) else None, "unit": p.unit}
                for n, p in self.parameters.items()
            },
            "cost": self.cost,
            "cifer": dict(self.cifer),
            "misfit": self.misfit,
            "points": self.points,
            "band": list(self.omega),
        }


def fit_transfer(response: FrequencyResponse, form: str | TransferForm = "auto") -> TransferFunction:
    """The transfer function of a form: roll, dutch-roll, short-period, orders M/N, or auto, which is the classic form for this
    input and output, else the best of the general forms.

    Raises EstimationError for an unknown form, DataError where too few points are coherent for the unknowns of the form.
    """
    coherent = response.coherence >= GOOD
    if form == "auto" and form_for(response.input, response.output) is None:
        return min((_fitted(response, coherent, f) for f in general_forms()), key=_information)
    transfer_form = form if isinstance(form, TransferForm) else form_for(response.input, response.output, form)
    if transfer_form is None:
        raise EstimationError(f"form {form!r}: give roll, dutch-roll, short-period, auto, or orders like 1/2")
    return _fitted(response, coherent, transfer_form)


def _information(transfer_function: TransferFunction) -> float:
    """Bayesian information criterion; a frequency counts as two numbers."""
    count = 2.0 * transfer_function.points
    return count * transfer_function.misfit**2 + len(transfer_function.parameters) * math.log(count)


def _fitted(response: FrequencyResponse, coherent: NDArray[np.bool_], form: TransferForm) -> TransferFunction:
    names = form.names
    if 2 * int(coherent.sum()) < len(names) + SPARE:
        raise DataError(
            f"{int(coherent.sum())} frequencies with a coherence of {GOOD:g} or more cannot settle the {len(names)} "
            f"unknowns of form {form.name}: fly longer or with more input, or fit a smaller form"
        )
    omega, H, g2 = response.omega[coherent], response.H[coherent], response.coherence[coherent]
    std = np.maximum(response.std[coherent], LEAST_ERROR * np.abs(H).max())
    classic = _best_search(form, omega, H, lambda x: _navfit(form, x, omega, H, g2))
    likelihood_fit = least_squares(lambda x: _errors(form, x, omega, H, std), classic.x, x_scale=_scale(classic.x))
    covariance, misfit = _covariance(likelihood_fit.jac, likelihood_fit.fun, omega, response.length[coherent])
    spread = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    units = form.units
    parameters = {
        n: FittedNumber(float(v), float(s), u)
        for n, v, s, u in zip(names, likelihood_fit.x, spread, units, strict=True)
    }
    return TransferFunction(
        form,
        parameters,
        dict(zip(names, classic.x.tolist(), strict=True)),
        float(np.sum(classic.fun**2)),
        misfit,
        int(coherent.sum()),
        (float(omega[0]), float(omega[-1])),
        covariance,
    )


def _scale(x: Array) -> Array:
    return np.maximum(np.abs(x), SMALLEST_SCALE)


def _best_search(form: TransferForm, omega: Array, H: Complex, residuals: Any) -> Any:
    """The least-squares fit of the best search, from starts with several delays."""
    starts = []
    for delay in DELAYS:
        begin = form.from_polynomials(*_levy(form, omega, H * np.exp(1j * omega * delay)), delay)
        if np.all(np.isfinite(begin)) and np.all(np.isfinite(residuals(begin))):
            starts.append((float(np.sum(residuals(begin) ** 2)), begin))
    if not starts:
        raise DataError(f"form {form.name}: no start was found; try another form")
    starts.sort(key=lambda start: start[0])
    fits = [least_squares(residuals, begin, x_scale=_scale(begin)) for _, begin in starts[:SEARCHES]]
    return min(fits, key=lambda f: float(f.cost))


def _levy(form: TransferForm, omega: Array, H: Complex) -> tuple[Array, Array]:
    """Numerator and monic denominator by least squares, reweighted by the last denominator (Levy 1959; Sanathanan, Koerner
    1963)."""
    m, n = form.orders
    scale = float(np.exp(np.mean(np.log(omega))))
    s = 1j * omega / scale
    columns = np.concatenate(
        [
            np.stack([s**k for k in range(m, -1, -1)], axis=1),
            -H[:, None] * np.stack([s**k for k in range(n - 1, -1, -1)], axis=1),
        ],
        axis=1,
    )
    right = H * s**n
    weight = 1.0 / np.abs(H)
    x = np.zeros(columns.shape[1])
    for _ in range(ROUNDS):
        A, b = columns * weight[:, None], right * weight
        x = np.linalg.lstsq(np.concatenate([A.real, A.imag]), np.concatenate([b.real, b.imag]), rcond=None)[0]
        denominator = np.concatenate([[1.0], x[m + 1 :]])
        weight = 1.0 / np.maximum(np.abs(H) * np.abs(np.polyval(denominator, s)), 1e-12)
    powers_n, powers_m = scale ** np.arange(n + 1.0), scale ** (n - m + np.arange(m + 1.0))
    return x[: m + 1] * powers_m, np.concatenate([[1.0], x[m + 1 :]]) * powers_n


def _navfit(form: TransferForm, x: Array, omega: Array, H: Complex, coherence: Array) -> Array:
    """Residuals whose sum of squares is CIFER's cost J."""
    ratio = form.response(x, omega) / H
    trust = np.sqrt(20.0 / omega.size) * 1.58 * (1.0 - np.exp(-coherence))
    decibels = 20.0 * np.log10(np.maximum(np.abs(ratio), 1e-12))
    degrees = np.degrees(np.angle(ratio))
    return np.concatenate([trust * decibels, math.sqrt(PHASE_WEIGHT) * trust * degrees])


def _errors(form: TransferForm, x: Array, omega: Array, H: Complex, std: Array) -> Array:
    scaled_error = (form.response(x, omega) - H) / std
    return np.concatenate([scaled_error.real, scaled_error.imag])


def _covariance(jacobian: Array, scaled_errors: Array, omega: Array, length: Array) -> tuple[Array, float]:
    """(covariance of the unknowns, rms of `scaled_errors`), with the noise of neighbouring frequencies correlated."""
    size = np.maximum(np.linalg.norm(jacobian, axis=0), SMALLEST_NORM)
    J = jacobian / size
    shared = _shared_noise(omega, length)
    half = len(omega)
    middle = J[:half].T @ shared @ J[:half] + J[half:].T @ shared @ J[half:]
    inverse = np.linalg.pinv(J.T @ J, rcond=1e-10)
    misfit = math.sqrt(float(np.mean(scaled_errors**2)))
    freedom = scaled_errors.size / max(scaled_errors.size - len(size), 1)
    return inverse @ middle @ inverse * max(1.0, misfit**2 * freedom) / np.outer(size, size), misfit


def _shared_noise(omega: Array, length: Array) -> Array:
    """(points, points) correlation of the noise between frequencies [rad/s], for Hann windows of `length` (points,) [s]."""
    mean = np.sqrt(length[:, None] * length[None, :])
    phase = np.abs(omega[:, None] - omega[None, :]) * mean
    taper = tapers(TAPER_POINTS)[0] ** 2
    window_time = np.linspace(-0.5, 0.5, TAPER_POINTS)
    table = np.linspace(0.0, LARGEST_PHASE, PHASE_POINTS)
    values = np.abs(np.exp(-1j * np.outer(table, window_time)) @ taper) / taper.sum()
    return np.interp(phase, table, values, right=0.0)
