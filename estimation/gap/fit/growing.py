"""Motion that grows: how fast it does, and disturbances of it that stay bounded.

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
from estimation.gap.fit.problem import LikelihoodProblem, ModelFit
from estimation.gap.fit.spectra import Linear, linear_motion

GROWS = 0.15  # 1/s: motion that doubles in less than five seconds, with which no pilot flies a whole record
STANDING = 0.01  # 1/s: a mode that grows or decays so slowly stands still
FOLDS = 3.0  # by which power of e the motion may grow in a stretch: 20 times the noise of its beginning
SHORTEST = 4.0  # s, of a stretch


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
