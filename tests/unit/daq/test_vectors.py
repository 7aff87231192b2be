"""Vectors as tuples against numpy."""

import numpy as np
import pytest

from daq.sensors.vectors import Axes, Vector, cross, dot, plus, times, turned, turned_back


def triple(a: np.ndarray) -> Vector:
    x, y, z = a.tolist()
    return x, y, z


def test_products_sums_and_turns(rng: np.random.Generator) -> None:
    for _ in range(20):
        a, b = rng.normal(size=(2, 3))
        matrix = rng.normal(size=(3, 3))
        axes: Axes = (triple(matrix[0]), triple(matrix[1]), triple(matrix[2]))
        assert dot(triple(a), triple(b)) == pytest.approx(a @ b)
        assert cross(triple(a), triple(b)) == pytest.approx(np.cross(a, b))
        assert plus(triple(a), triple(b)) == pytest.approx(a + b)
        assert plus(triple(a), triple(b), -2.5) == pytest.approx(a - 2.5 * b)
        assert times(3.0, triple(a)) == pytest.approx(3.0 * a)
        assert turned(axes, triple(a)) == pytest.approx(matrix @ a)
        assert turned_back(axes, triple(a)) == pytest.approx(matrix.T @ a)
