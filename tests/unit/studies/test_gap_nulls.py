"""The fourth simulator against what must be so, and the table of false answers by kind."""

import numpy as np

from tests.studies.fourth_simulator import DEG, RESOLUTION, Kind, fly
from tests.studies.gap_nulls import table

QUIET = tuple((n, 0.0) for n in ("ax", "ay", "az", "p", "q", "r", "phi", "theta", "psi", "alpha", "beta", "V"))


def test_its_motion_obeys_the_kinematics_it_does_not_integrate_by() -> None:
    """Euler angles of the quaternion turn as the body rates say; the air data move as the accelerations do."""
    (f,) = fly(5, Kind(rate=100, duration=6.0, noise=QUIET, axes="six-dof"), (16.5,))
    h, g = 0.01, 9.80665
    phi, theta, alpha, beta = (f[n] for n in ("phi", "theta", "alpha", "beta"))
    turned = f["p"] + np.tan(theta) * (f["q"] * np.sin(phi) + f["r"] * np.cos(phi))
    assert np.ptp(phi) > 5 * DEG
    assert np.max(np.abs(np.gradient(phi, h) - turned)[2:-2]) < 0.02
    u = f["V"] * np.cos(alpha) * np.cos(beta)
    v, w = f["V"] * np.sin(beta), f["V"] * np.sin(alpha) * np.cos(beta)
    force = f["ax"] - g * np.sin(theta) + f["r"] * v - f["q"] * w
    assert np.max(np.abs(np.gradient(u, h) - force)[2:-2]) < 0.05


def test_its_instruments_are_as_asked() -> None:
    (f,) = fly(6, Kind(duration=4.0, quantised=True), (16.5,))
    levels = f["q"] / RESOLUTION["q"]
    assert np.allclose(levels, np.round(levels))
    (slow,) = fly(6, Kind(rate=50, duration=4.0, attitude="held"), (16.5,))
    assert np.array_equal(slow["theta"][0:200:5], slow["theta"][4:200:5])
    (usual, limited) = (fly(6, Kind(duration=4.0, fastest=x), (16.5,))[0]["delta_e"] for x in (6.0, 0.1))
    assert np.max(np.abs(np.diff(limited))) < 0.6 * np.max(np.abs(np.diff(usual)))


def test_the_table_counts_names_and_rests_by_kind_and_hidden_ones_by_size() -> None:
    def row(source: str, hidden: str = "", named: tuple[str, ...] = (), verdict: str = "no_gap") -> dict[str, object]:
        steps = [{"effect": n} for n in named]
        return {
            "source": source,
            "model": "lateral",
            "hidden": hidden,
            "size": 0.5 * bool(hidden),
            "steps": steps,
            "verdict": verdict,
        }

    rows = [
        row("a"), row("a", named=("servo_lag",), verdict="gap_closed"),
        row("b", verdict="cannot_tell"), row("b", verdict="error"),
        row("a", "Cn_da", ("Ixz_error",), "gap_closed"), row("a", "Cn_da"),
    ]  # fmt: skip
    text = table(rows)
    assert "| a | 1 of 2 (servo_lag) |" in text
    assert "| b | 1 of 2 (error) |" in text
    assert "size 0.5: detected 0.50" in text
    assert "exact 0.00" in text
    assert "class 0.50" in text
