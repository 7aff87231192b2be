"""Gusts: level, spectrum and starting distribution."""

import math

import numpy as np
import pytest

from firmware_sim.physics.maths import FLOATS, array_maths
from firmware_sim.physics.wind import GUST_STATES, gusts_for, stationary_start

SPEED, SPAN, LEVEL = 17.0, 1.5, math.radians(1.0)


def run(flights: int, seconds: float, step: float) -> np.ndarray:
    """Gust states (samples, GUST_STATES, flights) from the stationary start, integrated with Heun steps."""
    xp = array_maths(flights)
    gusts = gusts_for(np.full(flights, LEVEL), np.full(flights, SPEED), SPAN, xp)
    rng = np.random.default_rng(11)
    x = np.array(stationary_start(gusts, rng.standard_normal((GUST_STATES, flights))))
    out = []
    for _ in range(round(seconds / step)):
        noise = rng.standard_normal((4, flights)) / math.sqrt(step)
        k1, k2 = np.zeros_like(x), np.zeros_like(x)
        gusts.derivatives(x, 0, noise, k1, xp)
        gusts.derivatives(x + step * k1, 0, noise, k2, xp)
        x = x + 0.5 * step * (k1 + k2)
        out.append(x)
    return np.array(out)


def test_lateral_gust_has_the_angle_asked_for_from_the_first_instant_on() -> None:
    states = run(4000, 1.0, 0.005)
    for sample in (states[0], states[-1]):
        assert sample[1].std() / SPEED == pytest.approx(LEVEL, rel=0.05)
        assert sample[3].std() / SPEED == pytest.approx(0.7 * LEVEL, rel=0.05)
        assert sample[0].std() / SPEED == pytest.approx(LEVEL, rel=0.05)


def test_start_and_flow_agree_on_the_joint_distribution_of_the_filter() -> None:
    states = run(4000, 1.0, 0.005)
    first, last = (np.cov(states[k, 1:3]) for k in (0, -1))
    np.testing.assert_allclose(last, first, rtol=0.12)


def test_along_path_gust_forgets_with_the_time_it_takes_to_cross_its_length() -> None:
    states = run(6000, 2.0, 0.01)
    u = states[:, 0]
    lag = 150
    correlation = np.mean(u[0] * u[lag]) / np.sqrt(np.mean(u[0] ** 2) * np.mean(u[lag] ** 2))
    assert correlation == pytest.approx(math.exp(-lag * 0.01 * SPEED / 50.0), abs=0.05)


def test_no_level_no_gust() -> None:
    gusts = gusts_for(0.0, SPEED, SPAN, FLOATS)
    assert stationary_start(gusts, np.ones(GUST_STATES)) == [0.0] * GUST_STATES
    dx = [1.0] * GUST_STATES
    gusts.derivatives([0.0] * GUST_STATES, 0, [3.0] * 4, dx, FLOATS)
    assert dx == [0.0] * GUST_STATES
