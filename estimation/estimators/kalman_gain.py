"""The gain of a steady-state Kalman filter from process noise, for filter error in its published form.

Small motion about a point of flight, dx = (A x + w) dt, y = C x + v, sampled every `dt`: Phi = exp(A dt), P the covariance of
the prediction from the discrete Riccati equation, K = P C' (C P C' + R)^-1 the correction x <- x + K (z - y) (Maine and Iliff,
NASA RP-1168, section 6; Jategaonkar, Flight Vehicle System Identification, 2nd ed., chapter 5). Such a filter is stable whatever
the noise, which a free gain is not, and a handful of standard deviations make it up.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm, solve_discrete_are

from estimation.engine.kernel import Array

STEP = 1e-4  # of a noise, for the slope of the gain


@dataclass(frozen=True)
class GainLaw:
    """transition: Phi (nx, nx); C: (ny, nx); noise: (ny,) std of the measurements; unit: (n,) what 1 means for each unknown, as
    the std that a state gathers in a sample interval; states: (n,) the state each is of."""

    transition: Array
    C: Array
    noise: Array
    unit: Array
    states: tuple[int, ...]

    def gain(self, relative: Array) -> Array:
        """K (nx, ny) at process noise `relative` (n,), in units of `unit`. LinAlgError where the filter has no steady state that
        can be calculated, as where the model grows or decays beyond all numbers within a sample interval."""
        Q = np.zeros(self.transition.shape)
        for state, unit, size in zip(self.states, self.unit, relative, strict=True):
            Q[state, state] = (unit * size) ** 2
        P = self._prediction(Q)
        S = self.C @ P @ self.C.T + np.diag(self.noise**2)
        return np.asarray(np.linalg.solve(S, self.C @ P).T)

    def slopes(self, relative: Array) -> Array:
        """dK/d relative (n, nx, ny); at zero, where the gain begins, the slope to the right. LinAlgError as of `gain`."""
        found = []
        for i in range(relative.size):
            up, down = relative.copy(), relative.copy()
            up[i] += STEP
            down[i] = max(down[i] - STEP, 0.0)
            found.append((self.gain(up) - self.gain(down)) / (up[i] - down[i]))
        return np.array(found).reshape(relative.size, *self.transition.shape[:1], self.C.shape[0])

    def _prediction(self, Q: Array) -> Array:
        """Covariance of the one-step prediction. LinAlgError where the linearised motion has no steady filter."""
        if not (np.isfinite(self.transition).all() and np.isfinite(self.C).all() and np.isfinite(Q).all()):
            raise np.linalg.LinAlgError("the linearised motion grows beyond all numbers within one sample interval")
        R = np.diag(self.noise**2)
        # a state that nothing disturbs and that does not decay is known for good: its filter has no steady state but zero gain
        floor = TINY * max(float(Q.max()), float(R.min())) * np.eye(len(Q))
        try:
            return np.asarray(solve_discrete_are(self.transition.T, self.C.T, Q + floor, R))
        except ValueError as error:  # scipy's word for infinite intermediate results
            raise np.linalg.LinAlgError("the Riccati equation of its filter has no finite solution") from error


TINY = 1e-12  # of the largest process noise, or of the smallest noise of measurement


def gain_law(A: Array, C: Array, dt: float, noise: Array, unit: Array, states: tuple[int, ...]) -> GainLaw:
    """The law at a point of flight; A (nx, nx), C (ny, nx), dt [s] between samples."""
    with np.errstate(
        over="ignore", invalid="ignore"
    ):  # what grows beyond all numbers is refused where the gain is asked for
        return GainLaw(np.asarray(expm(A * dt)), C, noise, unit, states)
