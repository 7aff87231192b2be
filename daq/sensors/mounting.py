"""Turning counts from chip axes to body axes by a signed permutation, exact in integers."""

from collections.abc import Callable
from typing import Literal

Axis = Literal["+x", "-x", "+y", "-y", "+z", "-z"]
Mounting = tuple[Axis, Axis, Axis]
AS_PRINTED: Mounting = ("+x", "+y", "+z")
Rotation = Callable[[int, int, int], tuple[int, int, int]]
"""Chip x, y, z counts to body x, y, z counts."""


_DETERMINANT_SIGN = {"xyz": 1, "yzx": 1, "zxy": 1, "xzy": -1, "zyx": -1, "yxz": -1}


def check_mounting(mounting: Mounting) -> Mounting:
    """A mounting that is a rotation: each chip axis once, right-handed. Raises ValueError otherwise."""
    letters = "".join(axis[1] for axis in mounting)
    if letters not in _DETERMINANT_SIGN:
        raise ValueError(f"mounting must name each of x, y and z once, not {', '.join(mounting)}")
    sign = _DETERMINANT_SIGN[letters]
    for axis in mounting:
        sign *= -1 if axis[0] == "-" else 1
    if sign < 0:
        raise ValueError(f"mounting {', '.join(mounting)} is a mirror image, not a rotation; change one sign")
    return mounting


def _as_it_is(x: int, y: int, z: int) -> tuple[int, int, int]:
    return x, y, z


def rotation(mounting: Mounting) -> Rotation:
    """The turn of a mounting: entry i names the chip axis along body axis i.

    A reversed axis maps -32768 to 32767, so that the result always fits 16 bits; that count is out of range anyway.
    """
    if tuple(mounting) == AS_PRINTED:
        return _as_it_is
    (i, si), (j, sj), (k, sk) = (("xyz".index(axis[1]), -1 if axis[0] == "-" else 1) for axis in mounting)

    def turn(x: int, y: int, z: int) -> tuple[int, int, int]:
        counts = (x, y, z)
        return min(si * counts[i], 32767), min(sj * counts[j], 32767), min(sk * counts[k], 32767)

    return turn
