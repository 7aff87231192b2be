"""Sensors in any of the 24 ways that a box of right angles can sit, and exchanged columns, in a flight of exact kinematics."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from groundstation.flight.quality.axes import EXCHANGES, TURNS, Axes, boresight, wrong_axes
from groundstation.flight.quality.plausibility import suspicions

GRAVITY = 9.80665
STEP = 0.04
TIME = np.arange(0.0, 24.0, STEP)


def flight() -> dict[str, np.ndarray]:
    """A flight that rolls, pitches, slips and changes its speed; specific force from dv/dt + omega x v - gravity."""
    rates = np.array([0.6 * np.sin(2.1 * TIME), 0.25 * np.sin(1.7 * TIME + 0.4), 0.2 * np.sin(2.0 * TIME + 1.0)])
    attitude, turned = Rotation.from_euler("ZYX", [0.3, 0.06, 0.0]), []
    for rate in rates.T:
        turned.append(attitude)
        attitude = attitude * Rotation.from_rotvec(rate * STEP)
    down = np.array([a.inv().apply([0.0, 0.0, 1.0]) for a in turned]).T
    alpha, beta = 0.05 + 0.03 * np.sin(1.5 * TIME), 0.05 * np.sin(2.0 * TIME + 0.7)
    speed = 18.0 + 2.0 * np.sin(0.4 * TIME)
    air = speed * np.array([np.cos(alpha) * np.cos(beta), np.sin(beta), np.sin(alpha) * np.cos(beta)])
    force = np.gradient(air, STEP, axis=1) + np.cross(rates, air, axis=0) - GRAVITY * down
    rng = np.random.default_rng(3)
    force, rates = force + 0.1 * rng.standard_normal(force.shape), rates + 0.01 * rng.standard_normal(rates.shape)
    return {"alpha": alpha, "beta": beta, "V": speed, **imu(force, rates, down)}


def imu(force: np.ndarray, rates: np.ndarray, down: np.ndarray) -> dict[str, np.ndarray]:
    columns = dict(zip(("ax", "ay", "az", "p", "q", "r"), (*force, *rates), strict=True))
    return {**columns, "phi": np.arctan2(down[1], down[2]), "theta": -np.arcsin(np.clip(down[0], -1.0, 1.0))}


def turned(columns: dict[str, np.ndarray], axes: Axes, *, attitude: bool = True) -> dict[str, np.ndarray]:
    """The same flight as an IMU in this mounting records it."""
    recorded = TURNS[axes].T
    force, rates = (recorded @ np.array([columns[n] for n in names]) for names in (("ax", "ay", "az"), ("p", "q", "r")))
    phi, theta = columns["phi"], columns["theta"]
    down = np.array([-np.sin(theta), np.sin(phi) * np.cos(theta), np.cos(phi) * np.cos(theta)])
    found = imu(force, rates, recorded @ down)
    return {**columns, **{n: v for n, v in found.items() if attitude or n not in ("phi", "theta")}}


@pytest.fixture(scope="module")
def sound() -> dict[str, np.ndarray]:
    return flight()


def test_each_of_the_24_mountings_is_named_and_the_right_one_is_not(sound: dict[str, np.ndarray]) -> None:
    assert len(TURNS) == 24
    assert not suspicions(TIME, sound)
    for axes in list(TURNS)[1:]:
        (finding,) = wrong_axes(TIME, turned(sound, axes))
        assert f"recorded as {', '.join(axes)} lies along" in finding.text
        assert "phi" in finding.columns


@pytest.mark.parametrize("axes", [("-x", "-y", "+z"), ("+x", "-y", "-z"), ("+y", "-x", "+z")])
def test_attitude_of_another_box_stays(sound: dict[str, np.ndarray], axes: Axes) -> None:
    (finding,) = wrong_axes(TIME, turned(sound, axes, attitude=False))
    assert f"recorded as {', '.join(axes)} lies along" in finding.text
    assert "phi" not in finding.columns


def test_gyros_of_another_box_than_the_accelerometers(sound: dict[str, np.ndarray]) -> None:
    rates = np.array([sound[n] for n in ("p", "q", "r")])
    recorded = dict(zip(("p", "q", "r"), TURNS["+y", "-x", "+z"].T @ rates, strict=True))
    (finding,) = wrong_axes(TIME, {**sound, **recorded})
    assert finding.columns == ("p", "q", "r")
    assert "the gyros sit turned: what was recorded as +y, -x, +z lies along" in finding.text


@pytest.mark.parametrize("pair", EXCHANGES[:5])
def test_two_columns_exchanged_are_named(sound: dict[str, np.ndarray], pair: tuple[str, str]) -> None:
    a, b = pair
    (finding,) = suspicions(TIME, {**sound, a: sound[b], b: sound[a]})
    assert finding.columns == pair
    assert "are the two columns mixed up?" in finding.text


@pytest.mark.parametrize("columns", ["beta", "p phi", "r", "alpha", "q theta", "phi"])
def test_one_wrong_sign_is_no_wrong_axes(sound: dict[str, np.ndarray], columns: str) -> None:
    assert not list(wrong_axes(TIME, {**sound, **{n: -sound[n] for n in columns.split()}}))


def test_a_turned_imu_is_one_finding_and_no_list_of_signs(sound: dict[str, np.ndarray]) -> None:
    (finding,) = suspicions(TIME, turned(sound, ("+x", "-y", "-z")))
    assert "matrix = [[1, 0, 0], [0, -1, 0], [0, 0, -1]]" in finding.text
    assert "boresight = [3.1416, 0.0, 0.0]" in finding.text


def test_boresight_is_the_turn_from_body_to_recorded_axes() -> None:
    for axes, matrix in TURNS.items():
        roll, pitch, yaw = boresight(axes)
        made = Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_matrix()
        assert np.allclose(made, matrix, atol=1e-3), axes
