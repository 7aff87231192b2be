"""Euler angles of a foreign log's quaternion."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def euler_from_quaternion(w: Array, x: Array, y: Array, z: Array) -> tuple[Array, Array, Array]:
    """Roll, pitch and yaw [rad] of the body from the quaternion NED to body, scalar first."""
    roll = np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    pitch = np.arcsin(np.clip(2 * (w * y - z * x), -1.0, 1.0))
    yaw = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    return roll, pitch, yaw
