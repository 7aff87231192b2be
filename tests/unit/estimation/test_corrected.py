"""What `check --write` moves: factors that were estimated and factors that were given, accelerations and flow angles."""

import numpy as np
import pytest

from estimation.compatibility.correct import correct_flight
from estimation.compatibility.reconstruction import Compatibility, FactorEstimate
from groundstation.flight import Flight

TIME = np.arange(600) * 0.04
RATES = {"p": 0.3 * np.sin(1.5 * TIME), "q": 0.08 * np.cos(1.1 * TIME), "r": 0.12 * np.sin(0.9 * TIME + 1.0)}
SLOPES = {"p": 0.45 * np.cos(1.5 * TIME), "q": -0.088 * np.sin(1.1 * TIME), "r": 0.108 * np.cos(0.9 * TIME + 1.0)}
VANE = {"x_vane": 8.0, "y_vane": -0.5, "z_vane": 0.3}
IMU = {"x_imu": 1.2, "y_imu": 0.1, "z_imu": -0.2}


def at_the_centre() -> dict[str, np.ndarray]:
    return {
        "V": 100.0 + np.sin(0.3 * TIME),
        "alpha": 0.07 + 0.02 * np.sin(0.8 * TIME),
        "beta": 0.05 * np.sin(1.3 * TIME),
        "ax": 0.3 + 0.0 * TIME,
        "ay": 0.5 * np.sin(TIME),
        "az": -9.8 + 0.0 * TIME,
        **RATES,
    }


def as_shown() -> Flight:
    """The same motion as instruments away from the centre of gravity show it: velocity and acceleration of a rigid body's points,
    written out by components."""
    c = at_the_centre()
    V, alpha, beta, (p, q, r) = c["V"], c["alpha"], c["beta"], RATES.values()
    x, y, z = VANE.values()
    u = V * np.cos(alpha) * np.cos(beta) - r * y + q * z
    v = V * np.sin(beta) + r * x - p * z
    w = V * np.sin(alpha) * np.cos(beta) - q * x + p * y
    shown = {**c, "alpha": np.arctan2(w, u), "beta": np.arctan2(v, np.sqrt(u**2 + w**2))}
    x, y, z = IMU.values()
    dp, dq, dr = SLOPES.values()
    shown["ax"] = c["ax"] - (q**2 + r**2) * x + (p * q - dr) * y + (p * r + dq) * z
    shown["ay"] = c["ay"] + (p * q + dr) * x - (p**2 + r**2) * y + (q * r - dp) * z
    shown["az"] = c["az"] + (p * r - dq) * x + (q * r + dp) * y - (p**2 + q**2) * z
    return Flight.build("shown", TIME, shown)


def result(factors: dict[str, float], known: dict[str, float]) -> Compatibility:
    found = {n: FactorEstimate(n, "m", v, 0.01, 0.01, True) for n, v in factors.items()}
    return Compatibility(found, np.eye(len(found)), (), True, "converged", 1, 0.1, known)


@pytest.mark.parametrize("given", [True, False])
def test_positions_held_or_estimated_move_what_they_say(given: bool) -> None:
    places = {**VANE, **IMU}
    moved = correct_flight(as_shown(), result({} if given else places, places if given else {}))
    truth, inner = at_the_centre(), slice(5, -5)  # the rates' parabolas end there
    for name, close in (("alpha", 1e-5), ("beta", 1e-5), ("ax", 2e-3), ("ay", 2e-3), ("az", 2e-3)):
        assert np.abs(moved[name] - truth[name])[inner].max() < close, name
        assert np.abs(as_shown()[name] - truth[name])[inner].max() > 20 * close, name
    assert all(f"{n} {v:+.4g}" in moved.notes[0].text for n, v in places.items())


def test_a_vane_that_cannot_be_moved_is_said() -> None:
    flight = as_shown()
    blind = flight.with_columns(V=np.full(len(flight), np.nan))
    moved = correct_flight(blind, result({}, VANE))
    assert np.array_equal(moved["beta"], blind["beta"])
    assert "x_vane" in moved.notes[1].text
    assert "x_vane" not in moved.notes[0].text
