"""The output-error likelihood of any number of flights, as a problem for the optimisation loop.

J = sum over outputs of n/2 log R + priors, with R the residual variance (relaxation: the noise level that fits best at every
point, so that the gradient of J is that of 1/2 sum r' R^-1 r with R from the residuals; Jategaonkar, Flight Vehicle System
Identification, 2nd ed., chapter 4). Unknowns: shared parameters, local ones flight by flight, then the initial states segment by
segment.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from estimation.engine.kernel import Array, SegmentMotion
from estimation.engine.simulate import Simulator
from estimation.estimators.gauss_newton import SolverStep
from estimation.estimators.normal_equations import FlightBlocks, SegmentBlocks, pseudo_inverse
from estimation.models.base import Model
from estimation.prepare.flight_data import FlightData

BoolArray = NDArray[np.bool_]
Noise = Literal["diagonal", "full"]
LARGEST_SLOPE = 1e60  # of an output by an unknown: normal equations cannot hold larger ones
DEFINITELY_ZERO = 1e-9  # of the range of an output: smaller residuals are exact fits, and R must not vanish
LEAST_RANGE = 1e-6  # of an output, for the same reason
ROWS_PER_OUTPUT = 5  # complete samples for each output from which a full R is estimated


@dataclass
class LikelihoodPoint:
    """residuals and motions by flight and segment; R: (ny, ny) noise covariance; blocks: filled by `segment_blocks`."""

    cost: float
    residuals: list[list[Array]]
    motions: list[list[SegmentMotion]]
    R: Array
    blocks: list[list[SegmentBlocks]] = field(default_factory=list)


class OutputErrorProblem:
    """See the module head. free_states: (nx,) which initial states are estimated (by default those that the model does not hold);
    sigma: (ny,) given noise, or None; noise: whether R is diagonal or full."""

    def __init__(
        self,
        model: Model,
        flights: list[FlightData],
        simulator: Simulator,
        *,
        noise: Noise = "diagonal",
        sigma: Array | None = None,
        free_states: NDArray[np.bool_] | None = None,
    ) -> None:
        self.model, self.flights, self.simulator = model, flights, simulator
        self.noise, self.sigma = noise, sigma
        self.nx, self.ny = len(model.states), len(model.outputs)
        self.free = simulator.free
        parameters = [model.parameter(n) for n in self.free]
        local = np.array([p.local and len(flights) > 1 for p in parameters], bool)
        self.shared, self.local = np.flatnonzero(~local), np.flatnonzero(local)
        not_held = np.array([not s.held for s in model.states], bool)
        self.free_states = np.flatnonzero(not_held if free_states is None else free_states)
        self.lower = np.array([p.lower for p in parameters])
        self.upper = np.array([p.upper for p in parameters])
        self.prior_mean = np.array([np.nan if p.prior_mean is None else p.prior_mean for p in parameters])
        self.prior_weight = np.array([0.0 if p.prior_std is None else p.prior_std**-2 for p in parameters])
        self._fixed_values = {p.name: p.start for p in model.parameters if p.name not in self.free}
        self._floor = self._noise_floor()
        counts = [len(f.segments) for f in flights]
        self._state_offset = len(self.shared) + len(self.local) * len(flights)
        self.size = self._state_offset + len(self.free_states) * sum(counts)
        self._first_segment = np.concatenate([[0], np.cumsum(counts)]).astype(int)

    # -------------------------------------------------------------------------------------------- unknowns
    def pack(self, values: dict[str, float], x0: list[list[Array]] | None = None) -> Array:
        """Unknowns from parameter values and initial states (default: as measured)."""
        u = np.zeros(self.size)
        start = np.array([values[n] for n in self.free])
        u[: len(self.shared)] = start[self.shared]
        for i, flight in enumerate(self.flights):
            u[self._local_slice(i)] = start[self.local]
            for j, segment in enumerate(flight.segments):
                x = segment.x0 if x0 is None else x0[i][j]
                u[self._state_slice(i, j)] = x[self.free_states]
        return u

    def parameters(self, unknowns: Array, flight: int) -> Array:
        """Values of the free parameters (in the order of `free`) in one flight."""
        t = np.empty(len(self.free))
        t[self.shared] = unknowns[: len(self.shared)]
        t[self.local] = unknowns[self._local_slice(flight)]
        return t

    def set_local(self, unknowns: Array, flight: int, values: Mapping[str, float]) -> None:
        """Set the named local parameters of one flight, in place."""
        for k, name in enumerate(self.free[i] for i in self.local):
            if name in values:
                unknowns[self._local_slice(flight).start + k] = values[name]

    def values(self, unknowns: Array, flight: int) -> dict[str, float]:
        """All parameters by name in one flight."""
        return {**self._fixed_values, **dict(zip(self.free, self.parameters(unknowns, flight).tolist(), strict=True))}

    def initial_state(self, unknowns: Array, flight: int, segment: int) -> Array:
        """(nx,) initial state of one segment."""
        x0 = self.flights[flight].segments[segment].x0.copy()
        x0[self.free_states] = unknowns[self._state_slice(flight, segment)]
        return x0

    def _local_slice(self, flight: int) -> slice:
        first = len(self.shared) + flight * len(self.local)
        return slice(first, first + len(self.local))

    def _state_slice(self, flight: int, segment: int) -> slice:
        first = self._state_offset + (self._first_segment[flight] + segment) * len(self.free_states)
        return slice(first, first + len(self.free_states))

    def clip(self, unknowns: Array) -> Array:
        """The nearest unknowns within the limits of the parameters."""
        u = unknowns.copy()
        ns = len(self.shared)
        u[:ns] = np.clip(u[:ns], self.lower[self.shared], self.upper[self.shared])
        for i in range(len(self.flights)):
            s = self._local_slice(i)
            u[s] = np.clip(u[s], self.lower[self.local], self.upper[self.local])
        return u

    # -------------------------------------------------------------------------------------------- cost
    def motion(self, unknowns: Array, flight: int, segment: int, derivatives: bool) -> SegmentMotion:
        """Simulated motion of one segment; derivatives: with sensitivities."""
        return self.simulator.run(
            self.flights[flight].segments[segment],
            self.values(unknowns, flight),
            self.initial_state(unknowns, flight, segment),
            sensitivities=derivatives,
        )

    def response(self, unknowns: Array, flight: int, segment: int, du: Array, du_mid: Array) -> Array:
        """(N, ny, k) change of the outputs of a segment with k small changes of its inputs (N, nu, k)."""
        return self.simulator.response(
            self.flights[flight].segments[segment],
            self.values(unknowns, flight),
            self.initial_state(unknowns, flight, segment),
            du,
            du_mid,
        )

    def evaluate(self, unknowns: Array, derivatives: bool) -> LikelihoodPoint:
        """Cost, residuals and motions; the cost is inf where a motion diverges."""
        residuals: list[list[Array]] = []
        motions: list[list[SegmentMotion]] = []
        for i, flight in enumerate(self.flights):
            residuals.append([])
            motions.append([])
            for j, segment in enumerate(flight.segments):
                motion = self.motion(unknowns, i, j, derivatives)
                if not motion.finite or not np.all(np.isfinite(motion.y)) or _runaway(motion):
                    return LikelihoodPoint(np.inf, [], [], np.eye(self.ny))
                residuals[-1].append(segment.z - motion.y)
                motions[-1].append(motion)
        R = self._covariance(residuals)
        cost = self._cost(residuals, R) + self._prior_cost(unknowns)
        return LikelihoodPoint(cost, residuals, motions, R)

    def _noise_floor(self) -> Array:
        """(ny,) least variance of the residuals."""
        span = np.ones(self.ny)
        for c, column in enumerate(np.concatenate([s.z for f in self.flights for s in f.segments]).T):
            z = column[np.isfinite(column)]
            if z.size:
                span[c] = max(float(np.ptp(z)), LEAST_RANGE)
        return (DEFINITELY_ZERO * span) ** 2

    def _covariance(self, residuals: list[list[Array]]) -> Array:
        """R (ny, ny): given, or of the residuals; diagonal where few samples are complete."""
        if self.sigma is not None:
            return np.diag(self.sigma**2)
        stacked = np.concatenate([r for flight in residuals for r in flight])
        measured = np.isfinite(stacked)
        counts = np.maximum(measured.sum(axis=0), 1)
        filled = np.where(measured, stacked, 0.0)
        variance = np.maximum((filled**2).sum(axis=0) / counts, self._floor)
        if self.noise == "diagonal":
            return np.diag(variance)
        complete = measured.all(axis=1)
        if complete.sum() < ROWS_PER_OUTPUT * self.ny:
            return np.diag(variance)
        R = filled[complete].T @ filled[complete] / complete.sum()
        return R + np.diag(self._floor)

    def _cost(self, residuals: list[list[Array]], R: Array) -> float:
        """Negative log likelihood of the residuals, but for a constant."""
        if self.sigma is not None or self.noise == "full":
            total = 0.0
            for flight in residuals:
                for r in flight:
                    w, logdet = whiten(r, R)
                    total += 0.5 * float(np.sum(w**2)) + 0.5 * logdet
            return total
        counts = sum(np.isfinite(r).sum(axis=0) for flight in residuals for r in flight)
        return 0.5 * float(np.sum(counts * np.log(np.diag(R))))

    def _prior_cost(self, unknowns: Array) -> float:
        """Priors on shared parameters count once, on local ones once per flight."""
        total = 0.0
        for i in range(len(self.flights)):
            index = self.local if i else np.arange(len(self.free))
            deviation = self.parameters(unknowns, i)[index] - self.prior_mean[index]
            with_prior = self.prior_weight[index] > 0
            total += 0.5 * float(np.sum(self.prior_weight[index][with_prior] * deviation[with_prior] ** 2))
        return total

    # -------------------------------------------------------------------------------------------- steps
    def segment_blocks(self, point: LikelihoodPoint) -> list[list[SegmentBlocks]]:
        """Normal equations of every segment at a point evaluated with derivatives; computed once for a point."""
        if not point.blocks:
            n = len(self.free)
            keep = np.concatenate([np.arange(n), n + self.free_states])
            for residuals, motions in zip(point.residuals, point.motions, strict=True):
                point.blocks.append([])
                for r, motion in zip(residuals, motions, strict=True):
                    assert motion.dy is not None
                    J, w = whiten_all(motion.dy[:, :, keep], r, point.R)
                    M, g = J.T @ J, J.T @ w
                    point.blocks[-1].append(SegmentBlocks(M[:n, :n], M[:n, n:], M[n:, n:], g[:n], g[n:]))
        return point.blocks

    def flight_blocks(self, unknowns: Array, point: LikelihoodPoint, flight: int, damping: float = 0.0) -> FlightBlocks:
        """Information of one flight with its initial states eliminated and the priors of its local parameters included."""
        n = len(self.free)
        information, gradient = np.zeros((n, n)), np.zeros(n)
        for block in self.segment_blocks(point)[flight]:
            tt, gt = block.reduced()
            information += tt
            gradient += gt
        blocks = FlightBlocks.split(information, gradient, self.shared, self.local)
        if len(self.local):
            deviation = self.prior_mean[self.local] - self.parameters(unknowns, flight)[self.local]
            weight = self.prior_weight[self.local]
            ll = blocks.ll + np.diag(weight + damping * np.diag(blocks.ll))
            gl = blocks.gl + np.where(weight > 0, weight * np.where(weight > 0, deviation, 0.0), 0.0)
            blocks = FlightBlocks(blocks.ss, blocks.sl, ll, blocks.gs, gl)
        return blocks

    def shared_information(self, unknowns: Array, blocks: list[FlightBlocks]) -> tuple[Array, Array]:
        """Information and gradient about the shared parameters, all others eliminated, priors included."""
        information = np.diag(self.prior_weight[self.shared])
        deviation = self.prior_mean[self.shared] - self.parameters(unknowns, 0)[self.shared]
        gradient = np.where(self.prior_weight[self.shared] > 0, self.prior_weight[self.shared] * deviation, 0.0)
        for block in blocks:
            ss, gs = block.reduced()
            information = information + ss
            gradient = gradient + gs
        return information, gradient

    def step(self, unknowns: Array, point: LikelihoodPoint, damping: float) -> SolverStep:
        """Gauss-Newton step with Marquardt's damping; shared parameters at their limits are held."""
        blocks = [self.flight_blocks(unknowns, point, i, damping) for i in range(len(self.flights))]
        information, gradient = self.shared_information(unknowns, blocks)
        information = information + damping * np.diag(np.diag(information))
        current = unknowns[: len(self.shared)]
        change = self._bounded_solution(information, gradient, current)
        direction, weight = np.zeros(self.size), np.zeros(self.size)
        direction[: len(self.shared)] = change
        weight[: len(self.shared)] = np.diag(information)
        full = np.zeros(len(self.free))
        decrement = 0.5 * float(gradient @ change)
        for i, flight in enumerate(self.flights):
            full[self.shared] = change
            if len(self.local):
                full[self.local] = blocks[i].local(change)
                direction[self._local_slice(i)] = full[self.local]
                weight[self._local_slice(i)] = np.diag(blocks[i].ll)
                decrement += 0.5 * float(blocks[i].gl @ blocks[i].ll_inverse @ blocks[i].gl)
            for j in range(len(flight.segments)):
                block = point.blocks[i][j]
                direction[self._state_slice(i, j)] = block.states(full)
                weight[self._state_slice(i, j)] = np.diag(block.xx)
                decrement += 0.5 * float(block.gx @ block.xx_inverse @ block.gx)
        return SolverStep(direction, decrement, np.sqrt(np.maximum(weight, 0.0)))

    def _bounded_solution(self, information: Array, gradient: Array, current: Array) -> Array:
        """Solution of the reduced normal equations; parameters at a limit that would leave it are held there."""
        lower, upper = self.lower[self.shared], self.upper[self.shared]
        movable = ~(((current <= lower) & (gradient < 0)) | ((current >= upper) & (gradient > 0)))
        change = np.zeros(current.size)
        if movable.any():
            index = np.flatnonzero(movable)
            change[index] = pseudo_inverse(information[np.ix_(index, index)])[0] @ gradient[index]
        return change


def _runaway(motion: SegmentMotion) -> bool:
    """Whether sensitivities are larger than LARGEST_SLOPE."""
    return motion.dy is not None and not float(np.abs(motion.dy).max(initial=0.0)) < LARGEST_SLOPE


def whiten(residual: Array, R: Array) -> tuple[Array, float]:
    """(residuals (N, ny) in units of their noise, zero where not measured; sum of log det R over the samples)."""
    measured = np.isfinite(residual)
    if _is_diagonal(R):
        sigma = np.sqrt(np.diag(R))
        return np.where(measured, residual, 0.0) / sigma, float(np.sum(measured * 2.0 * np.log(sigma)))
    result = np.zeros_like(residual)
    logdet = 0.0
    for rows, index in _measured_together(measured):
        L = np.linalg.cholesky(R[np.ix_(index, index)])
        result[np.ix_(rows, index)] = np.linalg.solve(L, residual[np.ix_(rows, index)].T).T
        logdet += 2.0 * float(np.sum(np.log(np.diag(L)))) * rows.size
    return result, logdet


def _is_diagonal(R: Array) -> bool:
    return np.count_nonzero(R - np.diag(np.diag(R))) == 0


def _measured_together(measured: BoolArray) -> Iterator[tuple[NDArray[np.intp], NDArray[np.intp]]]:
    """Rows at which the same outputs are measured, and these outputs, for each such set. measured: (N, ny)."""
    if measured.all():  # nearly always; np.unique would take longer than all else
        yield np.arange(len(measured)), np.arange(measured.shape[1])
        return
    for pattern in np.unique(measured, axis=0):
        if pattern.any():
            yield np.flatnonzero(np.all(measured == pattern, axis=1)), np.flatnonzero(pattern)


def whiten_all(dy: Array, residual: Array, R: Array) -> tuple[Array, Array]:
    """Jacobian (N ny, n) and residual (N ny,) in units of the noise, zero where not measured."""
    count, ny, n = dy.shape
    measured = np.isfinite(residual)
    w, _ = whiten(residual, R)
    if _is_diagonal(R):
        weight = measured / np.sqrt(np.diag(R))
        return (dy * weight[:, :, None]).reshape(count * ny, n), w.ravel()
    J = np.zeros_like(dy)
    for rows, index in _measured_together(measured):
        L = np.linalg.cholesky(R[np.ix_(index, index)])
        J[np.ix_(rows, index)] = np.linalg.solve(L, dy[np.ix_(rows, index)])
    return J.reshape(count * ny, n), w.ravel()
