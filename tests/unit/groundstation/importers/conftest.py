"""A short flight in SI, to be written in other people's units and formats."""

import numpy as np
import pytest

Columns = dict[str, np.ndarray]


@pytest.fixture
def flown(rng: np.random.Generator) -> Columns:
    """20 s at 20 Hz of consistent banking flight: phi is the integral of p, V and p_dynamic belong together."""
    t = np.arange(400) * 0.05
    phi, theta = 0.4 * np.sin(1.2 * t), 0.08 + 0.05 * np.sin(0.9 * t)
    p, q = 0.48 * np.cos(1.2 * t), 0.045 * np.cos(0.9 * t)
    speed = 16 + 0.5 * np.sin(0.3 * t)
    return {
        "time": t, "ax": 0.8 + 0.05 * rng.standard_normal(t.size), "ay": 0.1 * np.sin(2 * t),
        "az": -9.8 + 0.08 * rng.standard_normal(t.size), "p": p, "q": q, "r": 0.2 * np.sin(t), "phi": phi, "theta": theta,
        "psi": np.unwrap(2.9 + 0.05 * t), "alpha": 0.09 + 0.02 * np.sin(t), "beta": 0.05 * np.sin(2 * t), "V": speed,
        "delta_e": 0.02 * np.sin(3 * t), "delta_a": 0.1 * np.sign(np.sin(t)), "delta_r": 0.03 * np.sin(2 * t),
        "p_dynamic": 0.5 * 1.17 * speed**2, "rho": np.full(t.size, 1.17), "p_static": np.full(t.size, 99_000.0),
        "temperature": np.full(t.size, 294.0), "altitude": 60 + np.sin(0.1 * t),
    }  # fmt: skip
