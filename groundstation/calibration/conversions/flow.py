"""From the vanes' readings to alpha and beta at the CG.

A vane sees the air that passes its own place: the free stream turned by the aircraft (upwash, sidewash) plus the
speed that rotation gives to that place, omega x r. A beta vane turns about the body z axis and therefore reads the
flank angle atan(v / u), not asin(v / V); at alpha = 0.2 rad the two differ by 2 %.
"""

import numpy as np
from numpy.typing import NDArray

from groundstation.calibration.conversions.inertial import Axes
from groundstation.calibration.schema import Vane

Array = NDArray[np.float64]

LOWEST_SPEED = 5.0
"""Below this airspeed [m/s] a vane does not follow the wind: its angle is given as it stands, without correction."""


def undo_wash(local: Array, vane: Vane) -> Array:
    """Flow angle at the vane's place without the aircraft's influence [rad]."""
    return (local - vane.wash_offset) / vane.wash_factor


def flow_angles(
    alpha_local: Array, beta_local: Array, speed: Array, rates: Axes, alpha_vane: Vane, beta_vane: Vane
) -> tuple[Array, Array]:
    """alpha and beta at the CG [rad] from the vane angles (wash undone), true airspeed [m/s] and rates [rad/s].

    With r the place of a vane, its wind is (u, v, w) + omega x r. Then w = u ta + dw and v = u tb + dv, where ta, tb are
    the tangents of the vane angles, and u follows from u^2 + v^2 + w^2 = V^2. NaN where speed or a rate is not measured.
    """
    p, q, r = rates
    xa, ya, za = alpha_vane.position
    xb, yb, zb = beta_vane.position
    ta, tb = np.tan(alpha_local), np.tan(beta_local)
    dw = (q * za - r * ya) * ta - (p * ya - q * xa)
    dv = (q * zb - r * yb) * tb - (r * xb - p * zb)
    a = 1 + ta * ta + tb * tb
    b = ta * dw + tb * dv
    c = dw * dw + dv * dv - speed * speed
    with np.errstate(invalid="ignore"):
        u = (np.sqrt(b * b - a * c) - b) / a
        alpha = np.arctan2(u * ta + dw, u)
        beta = np.arcsin((u * tb + dv) / speed)
    slow = speed < LOWEST_SPEED
    return np.where(slow, alpha_local, alpha), np.where(slow, beta_local, beta)
