"""A stretch of flight in the frequency domain: transforms of the measured outputs and of the model's.

Frequencies are those of the stretch, w_k = 2 pi k / T: there transforms of white noise are independent, constants vanish, and the
ends appear only as d = x(0) - x(T), because exp(-j w_k T) = 1. Integrated by parts (V. Klein and E. A. Morelli, Aircraft
System Identification, 2nd ed., chapter 7; R. Pintelon and J. Schoukens, System Identification, 2nd ed., chapter 6):

    (j w I - A) X = F - A X_m + d,    Y = C X + G - C X_m

with A = df/dx, C = dg/dx of x_dot = f(x, u), y = g(x, u) at the mean state and input of the stretch, and F, G, X_m the transforms
of f(x_m, u), g(x_m, u) and the measured motion x_m, so that a changing airspeed causes no bias. A state that is not measured
has its start value in x_m: the model is linear in it. The bin w = 0 has the means, which determine the constants.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from estimation.engine.kernel import Array
from estimation.engine.simulate import Simulator
from estimation.engine.trace import Traced, trace
from estimation.engine.transforms import apply_transforms, transform_derivatives
from estimation.prepare.flight_data import FlightData, Segment
from estimation.signals.curves import Complex, curve_through, fine_times, finite_transform, longest_hole

RELATIVE_STEP = 1e-4  # of a parameter: step of central differences of A and C, which are linear in most parameters
LARGEST_CONDITION = 1e10  # of A: beyond it, as with a free integrator, the means do not follow from the equations
NYQUIST = 0.5  # periods of the highest frequency: longest hole in an output that is compared


@dataclass(frozen=True)
class LinearisedSystem:
    """A: (nx, nx), C: (ny, nx); A_p: (n, nx, nx), C_p: (n, ny, nx) their slopes by the n free parameters."""

    A: Array
    C: Array
    A_p: Array
    C_p: Array


def state_matrices(traced: Traced, state: Array, inputs: Array, p: Array) -> tuple[Array, Array]:
    """(A (nx, nx), C (ny, nx)) at one point. p: parameters and constants as traced."""
    nx, _, _, ny = traced.sizes
    jacobians = []
    for function, key, rows in ((traced.rates_jacobian, "f_x", nx), (traced.outputs_jacobian, "y_x", ny)):
        matrix = np.zeros((rows, nx))
        matrix[traced.patterns[key]] = np.asarray(function(state, inputs, p)[1]).ravel()
        jacobians.append(matrix)
    return jacobians[0], jacobians[1]


def linearise_at(simulator: Simulator, values: Mapping[str, float], state: Array, inputs: Array) -> LinearisedSystem:
    """The model of a simulator at parameter `values`, about state (nx,) and inputs (nu,)."""
    traced, p = trace(simulator.model.structure), simulator.vector(values)
    A, C = state_matrices(traced, state, inputs, p)
    A_p, C_p = np.zeros((len(simulator.free), *A.shape)), np.zeros((len(simulator.free), *C.shape))
    names = simulator.model.parameter_names
    for j, name in enumerate(simulator.free):
        h = RELATIVE_STEP * max(abs(values[name]), RELATIVE_STEP)
        plus, minus = p.copy(), p.copy()
        plus[names.index(name)] += h
        minus[names.index(name)] -= h
        (A1, C1), (A0, C0) = state_matrices(traced, state, inputs, plus), state_matrices(traced, state, inputs, minus)
        A_p[j], C_p[j] = (A1 - A0) / (2 * h), (C1 - C0) / (2 * h)
    return LinearisedSystem(A, C, A_p, C_p)


@dataclass(frozen=True)
class Band:
    """Frequencies [Hz] that are compared, beside the mean."""

    low: float
    high: float


@dataclass(frozen=True)
class SpectralResponse:
    """Outputs of the model in a stretch, and their slopes. y: (bins, ny); by_parameter: (bins, ny, n); by_ends: (bins, ny,
    nx)."""

    y: Complex
    by_parameter: Complex
    by_ends: Complex


@dataclass
class _NonlinearTerms:
    """Transforms of f, g and their slopes at some values of the free parameters, and the slopes over time."""

    values: Array
    F: Complex
    G: Complex
    F_p: Complex
    G_p: Complex
    slopes: tuple[Array, Array]


class SpectralSegment:
    """One segment of a flight. omega: (bins,) rad/s, the first zero; z: (bins, ny) outputs, NaN where not compared; duration
    [s]."""

    def __init__(self, simulator: Simulator, flight: FlightData, segment: Segment, band: Band) -> None:
        self._simulator = simulator
        self._fine = fine_times(segment.time)
        self._step = float(self._fine[1] - self._fine[0])
        self.duration = float(segment.time[-1] - segment.time[0])
        first = max(1, int(np.ceil(band.low * self.duration)))
        last = int(np.floor(band.high * self.duration))
        self._first, self._count = first, max(last - first + 1, 0)
        self.omega = 2 * np.pi / self.duration * np.concatenate([[0], np.arange(first, first + self._count)])
        self._x = self._states(flight, segment)
        controls = [s.control or s.servo for s in simulator.model.inputs]
        self._u = (
            np.stack(
                [curve_through(segment.time, segment.u[:, i], self._fine, edges=e) for i, e in enumerate(controls)],
                axis=1,
            )
            if controls
            else np.zeros((self._fine.size, 0))
        )
        self._X = self._transform(self._x)
        self.z = self._outputs(segment, band)
        self._last: _NonlinearTerms | None = None

    @cached_property
    def drift(self) -> Complex:
        """(bins,) transform of a rise by one unit over the stretch, with mean zero."""
        rise = (self._fine - self._fine[0]) / self.duration - 0.5
        return self._transform(rise[:, None])[:, 0]

    @property
    def compared(self) -> NDArray[np.bool_]:
        """(bins, ny) what is compared."""
        return np.isfinite(self.z.real)

    def _states(self, flight: FlightData, segment: Segment) -> Array:
        """(M, nx) measured motion on the fine grid."""
        measured = flight.states[segment.rows]
        columns = [curve_through(segment.time, measured[:, i], self._fine) for i in range(measured.shape[1])]
        guesses = [np.full(self._fine.size, x) for x in segment.x0]
        return np.stack([c if np.isfinite(c).all() else g for c, g in zip(columns, guesses, strict=True)], axis=1)

    def _outputs(self, segment: Segment, band: Band) -> Complex:
        """(bins, ny) measured outputs; NaN for one with a long hole."""
        z = np.full((segment.z.shape[1], self._fine.size), np.nan)
        for i, column in enumerate(segment.z.T):
            if longest_hole(segment.time, column) <= NYQUIST / band.high:
                z[i] = curve_through(segment.time, column, self._fine)
        return self._transform(z.T)

    def transformed(self, time: Array, values: Array) -> Complex:
        """(bins, ny, k) transforms of histories (N, ny, k) at the samples of the stretch."""
        from scipy.interpolate import CubicSpline  # here: a user of `state_matrices` does not need it

        flat = CubicSpline(time, values.reshape(len(time), -1))(np.minimum(self._fine, time[-1]))
        return self._transform(flat).reshape(self.omega.size, *values.shape[1:])

    def _transform(self, values: Array) -> Complex:
        """(bins, columns) transforms of values (M, columns) on the fine grid; NaN for a column that is not complete."""
        complete = np.isfinite(values).all(axis=0)
        result = np.full((1 + self._count, values.shape[1]), np.nan + 0j)
        spacing = 2 * np.pi / self.duration
        columns = values[:, complete]
        result[:1, complete] = finite_transform(columns, self._step, 0.0, spacing, 1)
        result[1:, complete] = finite_transform(columns, self._step, self._first * spacing, spacing, self._count)
        return result

    # ------------------------------------------------------------------------------------------------ the model
    def response(self, values: Mapping[str, float], ends: Array) -> SpectralResponse:
        """Outputs and their slopes at parameter `values` and differences `ends` (nx,) of the states between the ends."""
        nonlinear = self._nonlinear(values)
        linear = linearise_at(self._simulator, values, self._x.mean(axis=0), self._u.mean(axis=0))
        nx = linear.A.shape[0]
        system = 1j * self.omega[:, None, None] * np.eye(nx) - linear.A
        means_known = self.means_determined(linear.A)
        if not means_known:
            system[0] = np.eye(nx)
        forcing = nonlinear.F - self._X @ linear.A.T + ends
        inverse = _inverse(np.asarray(system, np.complex128))
        X = np.einsum("kij,kj->ki", inverse, forcing)
        deviation = X - self._X
        y = X @ linear.C.T + nonlinear.G - self._X @ linear.C.T
        X_p = np.einsum("kij,kjn->kin", inverse, nonlinear.F_p + np.einsum("nij,kj->kin", linear.A_p, deviation))
        y_p = _slopes(linear.C, linear.C_p, X_p, nonlinear.G_p, deviation)
        y_d = np.einsum("oi,kij->koj", linear.C, inverse)
        if not means_known:
            y[0] = np.nan
        return self._delayed(values, SpectralResponse(y, y_p, y_d))

    @staticmethod
    def means_determined(A: Array) -> bool:
        """Whether the means follow from the equations, which they do not where a state only integrates."""
        return bool(A.size and np.isfinite(A).all() and np.linalg.cond(A) < LARGEST_CONDITION)

    def _nonlinear(self, values: Mapping[str, float]) -> _NonlinearTerms:
        """Transforms of f and g at the measured motion, and their slopes; linear extrapolation where parameters enter
        linearly."""
        simulator = self._simulator
        free = [simulator.model.parameter_names.index(n) for n in simulator.free]
        free_values = np.array([values[n] for n in simulator.free])
        u, du, names = self._transformed_inputs(values)
        f, f_p, y, y_p = simulator.kernel.evaluate(self._x, u, simulator.vector(values))
        f_p, y_p = f_p[:, :, free], y_p[:, :, free]
        if names:
            f_p, y_p = self._by_transforms(values, u, du, names, f_p.copy(), y_p.copy())
        old = self._last
        if old is not None and not names and all(map(np.array_equal, old.slopes, (f_p, y_p))):
            change = free_values - old.values
            return _NonlinearTerms(
                free_values, old.F + old.F_p @ change, old.G + old.G_p @ change, old.F_p, old.G_p, old.slopes
            )
        F, G = self._transform(f), self._transform(y)
        self._last = _NonlinearTerms(free_values, F, G, self._slopes(f_p), self._slopes(y_p), (f_p, y_p))
        return self._last

    def _slopes(self, values: Array) -> Complex:
        """(bins, rows, n) transforms of slopes (M, rows, n), most of which are zero."""
        count, rows, n = values.shape
        flat = values.reshape(count, rows * n)
        nonzero = np.flatnonzero(np.abs(flat).max(axis=0) > 0.0)
        result = np.zeros((1 + self._count, rows * n), complex)
        result[:, nonzero] = self._transform(flat[:, nonzero])
        return result.reshape(-1, rows, n)

    def _transformed_inputs(self, values: Mapping[str, float]) -> tuple[Array, Array, tuple[str, ...]]:
        """Inputs (M, nu) of the equations, their slopes (M, nu, nt) by the free parameters of input transforms, and these
        names."""
        model, names = self._simulator.model, self._simulator.transform_names()
        if not model.transforms:
            return self._u, np.zeros((*self._u.shape, 0)), names
        u = apply_transforms(model.transforms, model.input_names, self._fine, self._u, values)
        du = transform_derivatives(model.transforms, model.input_names, self._fine, self._u, values, names)
        return u, du, names

    def _by_transforms(
        self, values: Mapping[str, float], u: Array, du: Array, names: tuple[str, ...], f_p: Array, y_p: Array
    ) -> tuple[Array, Array]:
        """Slopes with the effect of the parameters of input transforms through the inputs."""
        simulator = self._simulator
        traced = trace(simulator.model.structure)
        p = simulator.vector(values)
        for function, key, slopes in ((traced.rates_by_input, "f_u", f_p), (traced.outputs_by_input, "y_u", y_p)):
            rows, columns = traced.patterns[key]
            entries = np.asarray(function.map(len(u))(self._x.T, u.T, np.tile(p[:, None], len(u))))
            for k, (row, column) in enumerate(zip(rows, columns, strict=True)):
                for t, name in enumerate(names):
                    slopes[:, row, simulator.free.index(name)] += entries[k] * du[:, column, t]
        return f_p, y_p

    def _delayed(self, values: Mapping[str, float], response: SpectralResponse) -> SpectralResponse:
        """The response with delayed outputs: a delay is a factor here (what it moves across the ends is neglected)."""
        simulator = self._simulator
        for output, name in simulator.model.output_delays.items():
            c = simulator.model.output_names.index(output)
            factor = np.exp(-1j * self.omega * values[name])
            for part in (response.y, response.by_parameter, response.by_ends):
                part[:, c] *= factor.reshape(-1, *(1,) * (part.ndim - 2))
            if name in simulator.free:
                response.by_parameter[:, c, simulator.free.index(name)] -= 1j * self.omega * response.y[:, c]
        return response


def _inverse(system: Complex) -> Complex:
    """Inverses (bins, nx, nx); NaN, which makes the search halve its step, where a frequency lies on an undamped mode."""
    try:
        return np.asarray(np.linalg.inv(system), np.complex128)
    except np.linalg.LinAlgError:
        return np.full_like(system, np.nan)


def _slopes(C: Array, C_p: Array, X_p: Complex, G_p: Complex, deviation: Complex) -> Complex:
    return np.asarray(np.einsum("oi,kin->kon", C, X_p) + G_p + np.einsum("noi,ki->kon", C_p, deviation))
