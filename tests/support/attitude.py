"""Attitude as simulated logs state it, in closed form: the program itself takes rotations from scipy."""

import numpy as np


def quaternion(phi: np.ndarray, theta: np.ndarray, psi: np.ndarray) -> list[np.ndarray]:
    """w, x, y, z of the turn by psi, theta, phi [rad], in that order: from the axes of the earth to those of the body."""
    (cr, cp, cy), (sr, sp, sy) = ([f(angle / 2) for angle in (phi, theta, psi)] for f in (np.cos, np.sin))
    return [
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    ]
