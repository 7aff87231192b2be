"""The Whittle likelihood of any number of flights, as a problem for the optimisation loop.

Transforms of residuals v at different frequencies are independent and complex Gaussian with variance T S(w) (P. Whittle
1953; Klein and Morelli, 2nd ed., chapter 7): J = sum over outputs and frequencies of log S + |v|^2 / (T S). As in the
time domain, the level of S is the one that fits best at every point (relaxation); its `shape` over frequency is given.
Unknowns: shared parameters, local ones flight by flight, then for each segment the differences of the states between its ends
and a slow drift of each output.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from estimation.engine.kernel import Array
from estimation.engine.simulate import Simulator
from estimation.estimators.frequency_domain.transformed import Band, SpectralResponse, SpectralSegment
from estimation.estimators.likelihood import DEFINITELY_ZERO, LikelihoodPoint, OutputErrorProblem
from estimation.estimators.normal_equations import SegmentBlocks
from estimation.prepare.flight_data import FlightData
from estimation.signals.curves import Complex


@dataclass
class FrequencyPoint(LikelihoodPoint):
    """v: (bins, ny) residuals by flight and segment, over the root of T, NaN where not compared; responses: of the model."""

    v: list[list[Complex]] = field(default_factory=list)
    responses: list[list[SpectralResponse]] = field(default_factory=list)


@dataclass(frozen=True)
class SegmentRows:
    """One segment in units of its noise, real parts over imaginary ones. residual: (rows,); by_parameter: (rows, n); nuisance:
    (rows, k)."""

    residual: Array
    by_parameter: Array
    nuisance: Array


class FrequencyProblem(OutputErrorProblem):
    """See the module head. shapes: by flight and segment (bins, ny), S relative to its level; flat where none are given."""

    def __init__(
        self,
        flights: list[FlightData],
        simulator: Simulator,
        band: Band,
        *,
        drift: bool = True,
        stretches: list[list[SpectralSegment]] | None = None,
        shapes: Sequence[Sequence[Array]] | None = None,
    ) -> None:
        model = simulator.model
        nuisances = len(model.states) + (len(model.outputs) if drift else 0)
        super().__init__(model, flights, simulator, free_states=np.ones(nuisances, bool))
        self.band, self.drift = band, drift
        self.stretches = stretches or [[SpectralSegment(simulator, f, s, band) for s in f.segments] for f in flights]
        self.shapes = shapes or [[np.ones(s.z.shape) for s in flight] for flight in self.stretches]

    def shaped(self, shapes: Sequence[Sequence[Array]]) -> "FrequencyProblem":
        """The problem with other shapes of the noise."""
        return FrequencyProblem(
            self.flights, self.simulator, self.band, drift=self.drift, stretches=self.stretches, shapes=shapes
        )

    def begin(self, values: dict[str, float]) -> Array:
        """Unknowns at parameter values, without differences between ends and without drift."""
        zero = np.zeros(len(self.free_states))
        return self.pack(values, [[zero] * len(f.segments) for f in self.flights])

    def evaluate(self, unknowns: Array, derivatives: bool) -> FrequencyPoint:
        """Cost, residuals and responses; the cost is inf where a response is not finite."""
        v: list[list[Complex]] = []
        responses: list[list[SpectralResponse]] = []
        for i, flight in enumerate(self.stretches):
            v.append([])
            responses.append([])
            values = self.values(unknowns, i)
            for j, stretch in enumerate(flight):
                nuisance = unknowns[self._state_slice(i, j)]
                response = stretch.response(values, nuisance[: self.nx])
                outputs = response.y
                if self.drift:
                    outputs = outputs + stretch.drift[:, None] * nuisance[self.nx :]
                residual = (stretch.z - outputs) / np.sqrt(stretch.duration)
                if not np.all(np.isfinite(response.y[1:])):
                    return FrequencyPoint(np.inf, [], [], np.eye(self.ny))
                v[-1].append(residual)
                responses[-1].append(response)
        level = self._levels(v)
        cost = float(np.sum(self.counts() * np.log(level))) + self._prior_cost(unknowns)
        return FrequencyPoint(cost, [], [], np.diag(level), [], v, responses)

    def counts(self) -> Array:
        """(ny,) number of complex values compared; a mean counts half."""
        weights = [s.compared * _weights(s.omega)[:, None] for flight in self.stretches for s in flight]
        return np.asarray(sum(s.sum(axis=0) for s in weights), float)

    def _levels(self, v: list[list[Complex]]) -> Array:
        """(ny,) level of S that fits best."""
        total = np.zeros(self.ny)
        for flight, shapes, stretches in zip(v, self.shapes, self.stretches, strict=True):
            for transform, shape, stretch in zip(flight, shapes, stretches, strict=True):
                power = np.nan_to_num(np.abs(transform) ** 2 / shape)
                total += np.sum(_weights(stretch.omega)[:, None] * power, axis=0)
        floor = DEFINITELY_ZERO**2 * self._measured_power()
        return np.asarray(np.maximum(total / np.maximum(self.counts(), 0.5), floor))

    def _measured_power(self) -> Array:
        """(ny,) mean power of the measured outputs, which sets the least level of S."""
        power = [np.abs(np.nan_to_num(s.z[1:])) ** 2 / s.duration for flight in self.stretches for s in flight]
        return np.asarray(np.maximum(np.concatenate(power).mean(axis=0), 1e-300))

    # ------------------------------------------------------------------------------------------------ steps
    def response(self, unknowns: Array, flight: int, segment: int, du: Array, du_mid: Array) -> Array:
        """(N, ny, k) change of the outputs over time with k small changes of the inputs (N, nu, k), from the
        measured initial state."""
        part = self.flights[flight].segments[segment]
        return self.simulator.response(part, self.values(unknowns, flight), part.x0, du, du_mid)

    def _scale(self, point: FrequencyPoint, flight: int, segment: int) -> Array:
        """(bins, ny) factor that gives residuals real and imaginary parts of unit variance."""
        shape, omega = self.shapes[flight][segment], self.stretches[flight][segment].omega
        return np.asarray(np.sqrt(2.0 * _weights(omega))[:, None] / np.sqrt(shape * np.diag(point.R)))

    def in_noise(self, changes: Complex, point: FrequencyPoint, flight: int, segment: int) -> Array:
        """(rows, k) transforms of changes of the outputs (bins, ny, k) in units of the noise, as in `SegmentRows`."""
        scale = self._scale(point, flight, segment) / np.sqrt(self.stretches[flight][segment].duration)
        return _real(changes * scale[:, :, None], point.v[flight][segment])

    def rows(self, point: FrequencyPoint, flight: int, segment: int) -> SegmentRows:
        """One segment in units of its noise at a point evaluated with derivatives."""
        stretch = self.stretches[flight][segment]
        response, v = point.responses[flight][segment], point.v[flight][segment]
        nuisance = response.by_ends
        if self.drift:
            drift = stretch.drift[:, None, None] * np.eye(self.ny)
            nuisance = np.concatenate([nuisance, drift], axis=2)
        return SegmentRows(
            _real(v * self._scale(point, flight, segment), v),
            self.in_noise(response.by_parameter, point, flight, segment),
            self.in_noise(nuisance, point, flight, segment),
        )

    def segment_blocks(self, point: LikelihoodPoint) -> list[list[SegmentBlocks]]:
        assert isinstance(point, FrequencyPoint)
        if not point.blocks:
            for i, flight in enumerate(self.stretches):
                point.blocks.append([])
                for j in range(len(flight)):
                    r = self.rows(point, i, j)
                    J, N = r.by_parameter, r.nuisance
                    point.blocks[-1].append(
                        SegmentBlocks(J.T @ J, J.T @ N, N.T @ N, J.T @ r.residual, N.T @ r.residual)
                    )
        return point.blocks


def _weights(omega: Array) -> Array:
    """(bins,) weight of each bin: 1, and one half for the mean, which is real."""
    return np.where(omega > 0.0, 1.0, 0.5)


def _real(values: Complex, v: Complex) -> Array:
    """(2 bins ny, ...) real parts over imaginary parts, zero where `v` (bins, ny) is not compared."""
    compared = np.isfinite(v.real)
    masked = np.where(compared.reshape(compared.shape + (1,) * (values.ndim - 2)), values, 0.0)
    flat = masked.reshape(-1, *values.shape[2:])
    return np.asarray(np.concatenate([flat.real, flat.imag]))
