"""Small motion about a flight: linearised, and bounded where it grows.

The motion is linearised about steady flight: lateral motion about zero, longitudinal motion about the trimmed speed, angles and
load factor.

A fitted model may be unstable because a pilot flew the aircraft, or because an effect that it lacks bends it. Simulated without a
pilot the noise of half a minute then becomes a departure, which no flight shows. The likelihood has the bounded motion: in the
frequency domain a mode that grows responds as strongly as one that decays. In the time domain that is the response that is at
rest in the end, integrated backwards: S. Devasia, D. Chen and B. Paden, "Nonlinear inversion-based output tracking", IEEE
Transactions on Automatic Control 41 (1996), 930-942, section III.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import eig, expm

from estimation.engine.kernel import Array
from estimation.engine.simulate import Segment, Simulator
from estimation.gap.fit.problem import LikelihoodProblem, ModelFit
from estimation.models.base import Model

STEADY = frozenset({"V", "alpha", "theta", "u", "w", "ax", "az"})
"""Quantities that have a value in straight and level flight; all others are zero there."""
DIFFERENCE = 1e-4  # rad, rad/s, m/s, step of central differences: rounding 1e-12 of the motion, curvature as little
SMALLEST_SCALE = 1e-9  # of an output that never leaves its steady value, so that one can divide by it
GROWS = 0.15  # 1/s: motion that doubles in less than five seconds, with which no pilot flies a whole record
STANDING = 0.01  # 1/s: a mode that grows or decays so slowly stands still


def steady_state(model: Model, segment: Segment) -> Array:
    """(nx,) state about which a record moves: medians of the measured outputs, zero for states that are zero in level flight.

    A state that is no output (a lag of a vane or of the flow) takes the value of the signal from which it starts.
    """
    levels = {n: level for n, level in zip(model.output_names, steady_outputs(model, segment), strict=True) if level}
    state = np.zeros(len(model.states))
    for i, signal in enumerate(model.states):
        first = float(segment.x0[i]) if signal.name in STEADY else 0.0
        shown = [levels[n] for n in (signal.name, signal.column, signal.start) if isinstance(n, str) and n in levels]
        state[i] = shown[0] if shown else first
    return state


def steady_outputs(model: Model, segment: Segment) -> Array:
    """(ny,) values of the outputs about which a record moves: medians, or zero for what is zero in level flight."""
    levels = np.zeros(len(model.outputs))
    for i, signal in enumerate(model.outputs):
        measured = segment.z[np.isfinite(segment.z[:, i]), i]
        if signal.name in STEADY and measured.size:
            levels[i] = np.median(measured)
    return levels


@dataclass(frozen=True)
class Linear:
    """Small motion of one record about its mean inputs: x' = A x + B u, y = C x + D u, with u over `inputs`.

    dt: sample interval [s]; scale: (ny,) rms of the measured outputs about their steady values, infinite where not measured."""

    A: Array
    B: Array
    C: Array
    D: Array
    inputs: tuple[str, ...]
    dt: float
    scale: Array


def linear_motion(
    model: Model,
    simulator: Simulator,
    segment: Segment,
    values: Mapping[str, float],
    inputs: Sequence[str] | None = None,
) -> Linear:
    """Linearise a model at the mean inputs of a record and small motion about its steady state. inputs: by default its
    controls."""
    p = simulator.vector(values)
    nx = len(model.states)
    u0 = segment.u.mean(axis=0)
    if inputs is None:
        inputs = [s.name for s in model.inputs if s.control]
    points_x = steady_state(model, segment) + np.concatenate(
        [np.zeros((1, nx)), DIFFERENCE * np.eye(nx), -DIFFERENCE * np.eye(nx), np.zeros((2 * len(inputs), nx))]
    )
    points_u = np.repeat(u0[None], points_x.shape[0], axis=0)
    for j, i in enumerate(model.input_names.index(n) for n in inputs):
        points_u[1 + 2 * nx + 2 * j, i] += DIFFERENCE
        points_u[2 + 2 * nx + 2 * j, i] -= DIFFERENCE
    f, _, y, _ = simulator.kernel.evaluate(points_x, points_u, p)
    first = 1 + 2 * nx  # point of the first input

    def by_inputs(values: Array) -> Array:
        return np.asarray((values[first::2] - values[first + 1 :: 2]).T / (2 * DIFFERENCE))

    return Linear(
        A=(f[1 : 1 + nx] - f[1 + nx : first]).T / (2 * DIFFERENCE),
        B=by_inputs(f),
        C=(y[1 : 1 + nx] - y[1 + nx : first]).T / (2 * DIFFERENCE),
        D=by_inputs(y),
        inputs=tuple(inputs),
        dt=float(np.median(np.diff(segment.time))),
        scale=np.maximum(rms_measured(segment.z - steady_outputs(model, segment)), SMALLEST_SCALE),
    )


def rms_measured(values: Array) -> Array:
    """(ny,) rms over the finite values of each column of (N, ny); infinite for a column without any, so that nothing stands out
    of it."""
    finite = np.isfinite(values)
    counts, squares = finite.sum(axis=0), np.sum(np.where(finite, values, 0.0) ** 2, axis=0)
    return np.sqrt(np.divide(squares, counts, out=np.full(counts.shape, np.inf), where=counts > 0))


def linear_motions(
    problem: LikelihoodProblem, values: Mapping[str, float], inputs: Sequence[str] | None = None
) -> list[Linear]:
    """The motion of a model about every record. inputs: by default its controls."""
    values = {**problem.starts(), **values}
    return [linear_motion(problem.model, problem.simulator, s, values, inputs) for s in problem.coarse]


def growth(linear: Linear) -> float:
    """Largest real part [1/s] of the eigenvalues of a motion; negative where all modes decay."""
    return float(np.linalg.eigvals(linear.A).real.max())


def fastest_growth(problem: LikelihoodProblem, model_fit: ModelFit) -> float:
    """The largest `growth` [1/s] on any record."""
    return max(growth(motion) for motion in linear_motions(problem, model_fit.values))


@dataclass(frozen=True)
class BoundedResponse:
    """Small motion in steps: modes that grow are at rest in the end, all others in the beginning.

    forward: (nx, nx) over one step, of the others; backward: of those that grow, over one step back; push: (nx, nu) by an input
    that is constant over a step; growing: (nx, nx) projector onto the modes that grow. linear: the motion, in such steps.
    """

    linear: Linear
    forward: Array
    backward: Array
    push: Array
    growing: Array

    @classmethod
    def of(cls, linear: Linear) -> "BoundedResponse":
        """In steps of `linear.dt`."""
        (nx, nu), h, growing = linear.B.shape, linear.dt, _projector(linear.A)
        block = expm(h * np.block([[linear.A, linear.B], [np.zeros((nu, nx + nu))]]))
        forward, backward = (np.eye(nx) - growing) @ block[:nx, :nx], growing @ expm(-h * linear.A)
        return cls(linear, forward, backward, block[:nx, nx:], growing)

    def outputs(self, courses: Array) -> Array:
        """(N, ny, k) changes of the outputs by k small courses (N, nu, k) of the inputs, on straight lines between steps."""
        pushes = np.einsum("xu,nuk->nxk", self.push, 0.5 * (courses[1:] + courses[:-1]))
        states, later = np.zeros((len(courses), *pushes.shape[1:])), np.zeros(pushes.shape[1:])
        for n, push in enumerate(pushes):
            states[n + 1] = self.forward @ states[n] + push - self.growing @ push
        for n in range(len(pushes) - 1, -1, -1):
            later = self.backward @ (later - pushes[n])
            states[n] += later
        return np.asarray(self.linear.C @ states + self.linear.D @ courses)


def _projector(A: Array) -> Array:
    """(nx, nx) onto the modes that grow, along all others."""
    values, left, right = eig(A, left=True)
    grows = values.real > STANDING
    left, right = left[:, grows], right[:, grows]
    return np.asarray(np.real(right @ np.linalg.solve(left.conj().T @ right, left.conj().T)))


@dataclass(frozen=True)
class BoundedMotion:
    """One record of a fit whose motion grows. fitted: (N, ny) its outputs; inputs: (2N - 1, nu) with which, middles between
    samples included; linear: small motion about it, over all inputs, in steps of one sample; by_middles: its response in steps
    of half a sample."""

    fitted: Array
    inputs: Array
    linear: Linear
    by_middles: BoundedResponse

    @classmethod
    def of(cls, problem: LikelihoodProblem, model_fit: ModelFit) -> "tuple[BoundedMotion | None, ...]":
        """Those of all records; None each where the motion grows on none, or where one runs away with its own inputs."""
        motions = linear_motions(problem, model_fit.values, problem.model.input_names)
        if max(growth(m) for m in motions) < GROWS:
            return (None,) * len(motions)
        made: list[BoundedMotion | None] = []
        for linear, grid, (i, local) in zip(motions, problem.grids, enumerate(model_fit.locals), strict=True):
            fitted = problem.modelled(i, model_fit.values, local)
            inputs = problem.driven(grid, model_fit.values).u
            halves = BoundedResponse.of(replace(linear, dt=0.5 * linear.dt))
            made.append(None if fitted is None else cls(fitted, inputs, linear, halves))
        return tuple(made)

    def outputs(self, inputs: Array) -> Array:
        """(N, ny) with other inputs (2N - 1, nu)."""
        return np.asarray(self.fitted + self.by_middles.outputs((inputs - self.inputs)[:, :, None])[::2, :, 0])

    def changes(self, courses: Sequence[Array]) -> Array:
        """(k, N, ny) by changes (N, nu) of the inputs, on straight lines between samples."""
        if not courses:
            return np.zeros((0, *self.fitted.shape))
        return np.moveaxis(BoundedResponse.of(self.linear).outputs(np.stack(courses, axis=2)), 2, 0)
