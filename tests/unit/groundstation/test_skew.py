"""Time skew estimated from attitude and gyro: unbiased, and scattering as its bound says."""

import numpy as np
import pytest

from groundstation.flight import Flight
from groundstation.flight.quality.skew import attitude_skew, control_skew


def rolling(rng: np.random.Generator, delay: float, noise: float = 0.005, bias: float = 0.01) -> Flight:
    t = np.arange(600) * 0.05

    def phi(at: np.ndarray) -> np.ndarray:
        return 0.3 * np.sin(1.7 * at) + 0.2 * np.sin(3.1 * at + 1)

    p = 0.51 * np.cos(1.7 * t) + 0.62 * np.cos(3.1 * t + 1)
    n = rng.standard_normal
    zero = np.zeros_like(t)
    rates = {"p": p + bias, "q": zero, "r": zero}
    angles = {"phi": phi(t - delay), "theta": zero, "psi": zero}
    columns = {k: v + 0.007 * n(t.size) for k, v in rates.items()} | {
        k: v + noise * n(t.size) for k, v in angles.items()
    }
    return Flight.build("x", t, columns)


@pytest.mark.parametrize("delay", [0.0, 0.06, -0.02, 0.15])
def test_planted_delay_comes_back(rng: np.random.Generator, delay: float) -> None:
    (skew,) = attitude_skew(rolling(rng, delay))  # theta and psi did not move
    assert (skew.late, skew.early) == ("phi", "p")
    assert skew.delay == pytest.approx(delay, abs=max(4 * skew.std, 1e-3))
    assert skew.std < 0.003


def test_bound_is_honest(rng: np.random.Generator) -> None:
    """Error over bound has a spread near one over many flights."""
    ratio = []
    for _ in range(60):
        (skew,) = attitude_skew(rolling(rng, 0.03))
        ratio.append((skew.delay - 0.03) / skew.std)
    assert 0.6 < np.std(ratio) < 1.5
    assert abs(np.mean(ratio)) < 0.6


def test_surface_behind_its_command(rng: np.random.Generator) -> None:
    t = np.arange(600) * 0.05
    command = 0.1 * np.sign(np.sin(1.5 * t))
    surface = np.interp(t - 0.07, t, command) + 0.001 * rng.standard_normal(t.size)
    (skew,) = control_skew(Flight.build("x", t, {"cmd_a": command, "delta_a": surface}))
    assert skew.delay == pytest.approx(0.07, abs=0.01)


def test_no_motion_no_answer() -> None:
    t = np.arange(100) * 0.05
    assert (
        attitude_skew(Flight.build("x", t, {c: np.zeros_like(t) for c in ("p", "q", "r", "phi", "theta", "psi")})) == ()
    )
    assert control_skew(Flight.build("x", t, {"V": t})) == ()


@pytest.mark.parametrize("phase", [0.0, 0.01, 0.02, 0.03, 0.04])
def test_bound_of_a_servo_s_delay_counts_that_steps_lie_between_samples(phase: float) -> None:
    """Few steps, wherever their edges lie, and a servo of 5 ms: at 20 Hz nothing is surer than 14 ms."""
    t = 0.05 * np.arange(600)
    command = 0.1 * np.sign(np.sin(2.0 * np.pi * (t - phase) / 5.37))
    surface = 0.1 * np.sign(np.sin(2.0 * np.pi * (t - 0.005 - phase) / 5.37))
    (skew,) = control_skew(Flight.build("x", t, {"cmd_a": command, "delta_a": surface}))
    assert skew.std > 0.014
    assert abs(skew.delay - 0.005) < 2.0 * skew.std
