"""Vectors of three components as plain tuples.

Twenty times a second the caches are cold, and then a call into numpy costs more than all arithmetic on three numbers.
"""

Vector = tuple[float, float, float]
Axes = tuple[Vector, Vector, Vector]
"""A rotation matrix by its rows."""

ZERO: Vector = (0.0, 0.0, 0.0)
UNTURNED: Axes = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


def dot(a: Vector, b: Vector) -> float:
    """The scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross(a: Vector, b: Vector) -> Vector:
    """The vector product."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def plus(a: Vector, b: Vector, factor: float = 1.0) -> Vector:
    """a + factor * b."""
    return a[0] + factor * b[0], a[1] + factor * b[1], a[2] + factor * b[2]


def times(factor: float, a: Vector) -> Vector:
    """factor * a."""
    return factor * a[0], factor * a[1], factor * a[2]


def turned(axes: Axes, a: Vector) -> Vector:
    """The vector in the frame whose axes, seen from its own frame, are the rows: axes @ a."""
    return dot(axes[0], a), dot(axes[1], a), dot(axes[2], a)


def turned_back(axes: Axes, a: Vector) -> Vector:
    """The inverse of `turned`: axes.T @ a."""
    x, y, z = axes
    return (
        x[0] * a[0] + y[0] * a[1] + z[0] * a[2],
        x[1] * a[0] + y[1] * a[1] + z[1] * a[2],
        x[2] * a[0] + y[2] * a[1] + z[2] * a[2],
    )
