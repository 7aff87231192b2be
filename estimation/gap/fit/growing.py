"""Motion that grows: how fast it does, and disturbances of it that stay bounded.

A fitted model may be unstable because a pilot flew the aircraft, or because an effect that it lacks bends it. Simulated without a
pilot the noise of half a minute then becomes a departure, which no flight shows. The likelihood has the bounded motion: in the
frequency domain a mode that grows responds as strongly as one that decays. In the time domain that is the response that is at
rest in the end, integrated backwards: S. Devasia, D. Chen and B. Paden, "Nonlinear inversion-based output tracking", IEEE
Transactions on Automatic Control 41 (1996), 930-942, section III.
"""

from collections.abc import Sequence
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


@dataclass(frozen=True)
class BoundedMotion:
    """One record of a fit whose motion grows. fitted: (N, ny) its outputs; inputs: (2N - 1, nu) with which, middles between
    samples included; linear: small motion about it, over all inputs, in steps of half a sample."""

    fitted: Array
    inputs: Array
    linear: Linear

    @classmethod
    def of(cls, problem: LikelihoodProblem, model_fit: ModelFit) -> "tuple[BoundedMotion | None, ...]":
        """Those of all records; None each where the motion grows on none, or where one runs away with its own inputs."""
        names, values = problem.model.input_names, model_fit.values
        motions = [linear_motion(problem.model, problem.simulator, s, values, names) for s in problem.coarse]
        if max(growth(m) for m in motions) < GROWS:
            return (None,) * len(motions)
        made: list[BoundedMotion | None] = []
        for i, linear in enumerate(motions):
            fitted, inputs = (
                problem.modelled(i, values, model_fit.locals[i]),
                problem.driven(problem.grids[i], values).u,
            )
            made.append(None if fitted is None else cls(fitted, inputs, replace(linear, dt=0.5 * linear.dt)))
        return tuple(made)

    def outputs(self, inputs: Array) -> Array:
        """(N, ny) with other inputs (2N - 1, nu)."""
        return np.asarray(self.fitted + bounded_response(self.linear, (inputs - self.inputs)[:, :, None])[::2, :, 0])

    def changes(self, courses: Sequence[Array]) -> Array:
        """(k, N, ny) by changes (N, nu) of the inputs, on straight lines between samples."""
        if not courses:
            return np.zeros((0, *self.fitted.shape))
        whole = replace(self.linear, dt=2.0 * self.linear.dt)
        return np.moveaxis(bounded_response(whole, np.stack(courses, axis=2)), 2, 0)


def growth(linear: Linear) -> float:
    """Largest real part [1/s] of the eigenvalues of a motion; negative where all modes decay."""
    return float(np.linalg.eigvals(linear.A).real.max())


def bounded_response(linear: Linear, courses: Array) -> Array:
    """(N, ny, k) changes of the outputs by k small courses (N, inputs, k) of the inputs, on straight lines between samples
    `linear.dt` apart: modes that grow are at rest in the end, all others in the beginning."""
    nx, h = len(linear.A), linear.dt
    growing = _projector(linear.A)
    remaining = np.eye(nx) - growing
    # over one interval the motion and the integral of its response to a constant input
    block = expm(h * np.block([[linear.A, linear.B], [np.zeros((linear.B.shape[1], nx + linear.B.shape[1]))]]))
    forward, backward = remaining @ block[:nx, :nx], growing @ expm(-h * linear.A)
    drive = np.einsum("xu,nuk->nxk", block[:nx, nx:], 0.5 * (courses[1:] + courses[:-1]))
    states, later = np.zeros((len(courses), nx, courses.shape[2])), np.zeros((nx, courses.shape[2]))
    for n, push in enumerate(drive):
        states[n + 1] = forward @ states[n] + remaining @ push
    for n in range(len(drive) - 1, -1, -1):
        later = backward @ (later - drive[n])
        states[n] += later
    return np.asarray(linear.C @ states + linear.D @ courses)


def _projector(A: Array) -> Array:
    """(nx, nx) onto the modes that grow, along all others."""
    values, left, right = eig(A, left=True)
    grows = values.real > STANDING
    left, right = left[:, grows], right[:, grows]
    return np.asarray(np.real(right @ np.linalg.solve(left.conj().T @ right, left.conj().T)))
