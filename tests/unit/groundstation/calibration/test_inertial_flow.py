"""Lever arm, attitude and vanes against rotation matrices and a rigid body computed another way."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from groundstation.calibration import conversions
from groundstation.calibration.schema import MountingAngles, Triad, Vane


def arrays(values: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return tuple(np.atleast_1d(v).astype(float) for v in values)  # type: ignore[return-value]


def test_triad_undoes_scale_misalignment_and_warm_bias(rng: np.random.Generator) -> None:
    sensitivity = np.eye(3) + 0.02 * rng.standard_normal((3, 3))
    bias, slope = 0.1 * rng.standard_normal(3), 0.01 * rng.standard_normal(3)
    truth, warmth = rng.standard_normal(3) * 9, 25.0
    reading = sensitivity @ truth + bias + slope * warmth
    triad = Triad(
        output_unit="m/s2",
        matrix=tuple(map(tuple, np.linalg.inv(sensitivity))),
        bias=tuple(bias),
        bias_per_kelvin=tuple(slope),
        reference_temperature=300.0,
        valid=(-80, 80),
    )
    out = conversions.apply_triad(triad, arrays(reading), np.array([325.0]))
    np.testing.assert_allclose(np.concatenate(out), truth, rtol=1e-12)
    assert np.isnan(conversions.apply_triad(triad, arrays(reading), None)[0][0])  # a warm bias without a temperature


def test_lever_arm_against_the_motion_of_a_point(rng: np.random.Generator) -> None:
    """Acceleration of a point of a turning body by differentiating its position, Coriolis-free."""
    position = np.array([0.3, -0.2, 0.1])
    rate, rate_dot = rng.standard_normal(3), rng.standard_normal(3)

    def place(t: float) -> np.ndarray:
        # attitude integrated finely from omega(t) = rate + rate_dot t
        attitude, step = Rotation.identity(), t / 2000
        for k in range(2000):
            attitude = attitude * Rotation.from_rotvec((rate + rate_dot * (k + 0.5) * step) * step)
        return np.asarray(attitude.apply(position))

    h = 1e-3
    inertial_acceleration = (place(h) - 2 * position + place(-h)) / h**2
    at_imu = arrays(inertial_acceleration)
    at_cg = conversions.at_cg(at_imu, arrays(rate), arrays(rate_dot), tuple(position))
    np.testing.assert_allclose(np.concatenate(at_cg), 0.0, atol=2e-4 * np.linalg.norm(inertial_acceleration) + 1e-4)


def test_euler_angles_against_scipy(rng: np.random.Generator) -> None:
    angles = rng.uniform([-3, -1.4, -3], [3, 1.4, 3], (50, 3))
    x, y, z, w = Rotation.from_euler("ZYX", angles[:, ::-1]).as_quat().T
    phi, theta, psi = conversions.euler_angles(w, x, y, z, MountingAngles())
    np.testing.assert_allclose(np.stack([phi, theta, psi], axis=1), angles, atol=1e-12)


def test_boresight_is_taken_out_and_declination_added(rng: np.random.Generator) -> None:
    body, tilt = (0.3, -0.2, 1.0), (0.05, -0.03, 0.1)
    imu = Rotation.from_euler("ZYX", body[::-1]) * Rotation.from_euler("ZYX", tilt[::-1])
    x, y, z, w = (np.array([v]) for v in imu.as_quat())
    angles = conversions.euler_angles(w, x, y, z, MountingAngles(boresight=tilt, declination=0.02))
    np.testing.assert_allclose(np.concatenate(angles), [0.3, -0.2, 1.02], atol=1e-12)


def test_zero_quaternion_is_not_an_attitude() -> None:
    zero = np.zeros(1)
    assert all(np.isnan(a[0]) for a in conversions.euler_angles(zero, zero, zero, zero, MountingAngles()))


def test_vanes_off_the_cg_give_the_free_stream(rng: np.random.Generator) -> None:
    """Forward by vectors (u, v, w) + omega x r and the wash, back by the closed form."""
    alpha_vane = Vane(angle="alpha", position=(-0.16, -0.75, 0.05), wash_factor=1.15, wash_offset=0.01)
    beta_vane = Vane(angle="beta", position=(-0.16, 0.75, -0.05), wash_factor=0.92, wash_offset=-0.004)
    for _ in range(100):
        alpha, beta, speed = rng.uniform(-0.3, 0.4), rng.uniform(-0.3, 0.3), rng.uniform(10, 30)
        rates = rng.uniform(-2, 2, 3)
        wind = speed * np.array([np.cos(alpha) * np.cos(beta), np.sin(beta), np.sin(alpha) * np.cos(beta)])
        at_alpha = wind + np.cross(rates, alpha_vane.position)
        at_beta = wind + np.cross(rates, beta_vane.position)
        seen_alpha = 1.15 * np.arctan2(at_alpha[2], at_alpha[0]) + 0.01
        seen_beta = 0.92 * np.arctan2(at_beta[1], at_beta[0]) - 0.004
        back = conversions.flow_angles(
            conversions.undo_wash(np.array([seen_alpha]), alpha_vane),
            conversions.undo_wash(np.array([seen_beta]), beta_vane),
            np.array([speed]),
            arrays(rates),
            alpha_vane,
            beta_vane,
        )
        np.testing.assert_allclose(np.concatenate(back), [alpha, beta], atol=1e-12)


def test_antenna_place_and_speed_against_rotation_matrices(rng: np.random.Generator) -> None:
    """Earth axes of a point of a turning body: its place by scipy's rotation, its speed by moving that rotation on."""
    for _ in range(20):
        phi, theta, psi = (*rng.uniform(-1, 1, 2).tolist(), float(rng.uniform(-3, 3)))
        arm, rates = rng.uniform(-1, 1, 3), rng.uniform(-2, 2, 3)
        turn = Rotation.from_euler("ZYX", [psi, theta, phi])
        place, speed = conversions.point_in_earth_axes(tuple(arm), arrays(np.array([phi, theta, psi])), arrays(rates))
        np.testing.assert_allclose(np.concatenate(place), turn.apply(arm), atol=1e-12)
        h = 1e-6
        ahead, behind = (turn * Rotation.from_rotvec(sign * h * rates) for sign in (1, -1))
        np.testing.assert_allclose(np.concatenate(speed), (ahead.apply(arm) - behind.apply(arm)) / (2 * h), atol=1e-8)


def test_vane_is_left_alone_when_there_is_no_wind() -> None:
    vane = Vane(angle="alpha", position=(0.0, -0.7, 0.0))
    still = (np.array([1.0]),) * 3
    alpha, beta = conversions.flow_angles(np.array([0.5]), np.array([-0.4]), np.array([0.3]), still, vane, vane)
    assert (alpha[0], beta[0]) == (0.5, -0.4)


def test_without_speed_there_is_no_corrected_angle() -> None:
    vane = Vane(angle="alpha", position=(0.0, -0.7, 0.0))
    angles = conversions.flow_angles(
        np.array([0.1]), np.array([0.1]), np.array([np.nan]), (np.zeros(1),) * 3, vane, vane
    )
    assert np.isnan(angles[0][0])
    assert np.isnan(angles[1][0])


@pytest.mark.parametrize("angle", [0.0, 3.0, -3.5, 10.0])
def test_wrap(angle: float) -> None:
    wrapped = conversions.wrap(np.array([angle]))[0]
    assert -np.pi <= wrapped < np.pi
    assert np.sin(wrapped) == pytest.approx(np.sin(angle))
