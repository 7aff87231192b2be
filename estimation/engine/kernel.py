"""Arguments and results of an integration back end; the two back ends agree to 1e-9 relative.

One call integrates one segment from x[0] through samples 0..N-1, by classical fourth-order Runge-Kutta with `substeps`
equal steps per sample interval. Within interval k an input runs straight from `u[k]` to `u_mid[k]` half-way and on to
`u_end[k]` (all equal where an input is held). Sensitivities come from the variational equations
S_dot = f_x S + f_p + f_u du/dpsi, integrated with the same stages (exact derivatives of the discrete solution).

With a gain, every sample corrects the state by x += K (z - y), without NaN samples of z (innovations form).
"""

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Integers = NDArray[np.int32]


@dataclass(frozen=True)
class SegmentInputs:
    """One segment as the integrator sees it.

    dt: (N,) s, time to the next sample (last entry unused). u: (N, nu) inputs at the samples, u_mid, u_end: (N, nu)
    inputs half-way through the interval after each sample and at its end. z: (N, ny) measured outputs (only used with
    a gain). du, du_mid, du_end: (N, nu, nt) derivatives of the inputs with respect to the parameters of input transforms.
    """

    dt: Array
    u: Array
    u_mid: Array
    u_end: Array
    z: Array
    du: Array = field(default_factory=lambda: np.zeros((0, 0, 0)))
    du_mid: Array = field(default_factory=lambda: np.zeros((0, 0, 0)))
    du_end: Array = field(default_factory=lambda: np.zeros((0, 0, 0)))


@dataclass(frozen=True)
class SensitivityColumns:
    """Which sensitivity column belongs to which unknown; -1 where none does.

    count: number n of columns. parameter: (np,) column of each entry of p. state: (nx,) of each initial state. transform: (nt,)
    of each transform parameter. gain: (nx, ny) of each entry of the gain.
    """

    count: int
    parameter: Integers
    state: Integers
    transform: Integers
    gain: Integers


@dataclass(frozen=True)
class SegmentMotion:
    """x: (N, nx), y: (N, ny), dy: (N, ny, n) or None. reached: number of samples before the motion diverged, else N."""

    x: Array
    y: Array
    dy: Array | None
    reached: int

    @property
    def finite(self) -> bool:
        """Whether the motion stayed finite throughout the segment."""
        return self.reached == self.y.shape[0]


class Kernel(Protocol):
    """An integration back end for one model structure."""

    label: str

    def run(
        self,
        drive: SegmentInputs,
        p: Array,
        x0: Array,
        substeps: int,
        columns: SensitivityColumns | None = None,
        gain: Array | None = None,
    ) -> SegmentMotion:
        """Integrate one segment; sensitivities where `columns` is given."""
        ...

    def evaluate(self, x: Array, u: Array, p: Array) -> tuple[Array, Array, Array, Array]:
        """(f (N, nx), df/dp (N, nx, np), y (N, ny), dy/dp (N, ny, np)) at given states and inputs, sample by sample."""
        ...
