"""First-order recursions over all samples at once."""

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

Kind = TypeVar("Kind", np.float64, np.complex128)
FORGOTTEN = 1e-16  # share of an earlier value below which it no longer counts


def decaying_sum(share: NDArray[Kind] | complex, drive: NDArray[Kind]) -> NDArray[Kind]:
    """(..., N) y[k] = share[k] y[k-1] + drive[k], from rest. share: (N,) or one for all, of size 0 to 1, complex for an
    oscillation; share[0] is not used.

    By doubling: two steps in a row, (a, b) then (c, d), are one step (c a, c b + d) of the same kind. scipy.signal has this for
    a constant share only, and takes half a second to import.
    """
    a, b = np.full(drive.shape[-1], share), drive.copy()
    reach = 1
    while reach < b.shape[-1] and np.abs(a[reach:]).max() > FORGOTTEN:
        b[..., reach:] += a[reach:] * b[..., :-reach]
        a[reach:] = a[reach:] * a[:-reach]
        reach *= 2
    return b
