"""What follows a signal with a first-order lag, over all samples at once."""

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

Kind = TypeVar("Kind", np.float64, np.complex128)
FORGOTTEN = 1e-16  # share of an earlier value of which nothing is felt any more


def decaying_sum(share: NDArray[Kind] | complex, drive: NDArray[Kind]) -> NDArray[Kind]:
    """(..., N) y[k] = share[k] y[k-1] + drive[k] from rest; share: (N,) or one for all, within 0 to 1 or of such a size, complex
    where something swings, the first of no account.

    By doubling: two steps in a row are one step of the same kind, (a, b) then (c, d) being (c a, c b + d); as far back as it is
    felt. scipy.signal, which has this for one share, takes half a second to import.
    """
    a, b = np.full(drive.shape[-1], share), drive.copy()
    reach = 1
    while reach < b.shape[-1] and np.abs(a[reach:]).max() > FORGOTTEN:
        b[..., reach:] += a[reach:] * b[..., :-reach]
        a[reach:] = a[reach:] * a[:-reach]
        reach *= 2
    return b
