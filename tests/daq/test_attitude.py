"""The attitude filter against known rotations; the direction cosines here are written out independently."""

import math

import numpy as np
import pytest

from daq.attitude import AttitudeFilter, AttitudeStatus
from daq.sensors.config import AttitudeConfig

G = 9.80665
FIELD = np.array((22e-6, 0.0, 40e-6))  # north and down
RATE_HZ = 20.0


def body_from_ned(phi: float, theta: float, psi: float) -> np.ndarray:
    """Turn about z by psi, then y by theta, then x by phi (Etkin, Dynamics of Flight, 3rd ed., eq 4.4,5)."""
    cz, sz = math.cos(psi), math.sin(psi)
    cy, sy = math.cos(theta), math.sin(theta)
    cx, sx = math.cos(phi), math.sin(phi)
    about_z = np.array(((cz, sz, 0), (-sz, cz, 0), (0, 0, 1)))
    about_y = np.array(((cy, 0, -sy), (0, 1, 0), (sy, 0, cy)))
    about_x = np.array(((1, 0, 0), (0, cx, sx), (0, -sx, cx)))
    return about_x @ about_y @ about_z


def angles(q: tuple[float, ...]) -> np.ndarray:
    w, x, y, z = q
    return np.degrees(
        (
            math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)),
            math.asin(2 * (w * y - z * x)),
            math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)),
        )
    )


def make(**changes: object) -> AttitudeFilter:
    return AttitudeFilter(AttitudeConfig(**changes), RATE_HZ, math.radians(500))  # type: ignore[arg-type]


def settle(f: AttitudeFilter, attitude: np.ndarray, seconds: float = 8.0, airspeed: float | None = 15.0) -> float:
    count = int(seconds * RATE_HZ)
    for k in range(count):
        f.update(k / RATE_HZ, (0, 0, 0), attitude @ (0, 0, -G), attitude @ FIELD, airspeed)
    return count / RATE_HZ


@pytest.mark.parametrize(
    ("phi", "theta", "psi"),
    [(0, 0, 0), (30, 0, 0), (0, 20, 0), (0, 0, 90), (-25, 15, -120), (20, -10, 70), (5, 60, 179)],
)
def test_static_attitudes_in_our_axes(phi: float, theta: float, psi: float) -> None:
    f = make()
    c = body_from_ned(*np.radians((phi, theta, psi)))
    time = settle(f, c, airspeed=None)
    attitude = f.update(time, (0, 0, 0), c @ (0, 0, -G), c @ FIELD)
    assert angles(attitude.quaternion) == pytest.approx((phi, theta, psi), abs=0.05)
    assert attitude.status == AttitudeStatus.MAGNETOMETER_USED
    assert attitude.quaternion[0] >= 0


def test_declination_is_added_to_the_heading() -> None:
    f = make(declination_deg=12.0)
    c = body_from_ned(*np.radians((10.0, 5.0, 40.0)))
    time = settle(f, c)
    q = f.update(time, (0, 0, 0), c @ (0, 0, -G), c @ FIELD, 15.0).quaternion
    assert angles(q) == pytest.approx((10.0, 5.0, 52.0), abs=0.05)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_gyro_is_integrated_about_the_right_axis_with_the_right_sign(axis: int) -> None:
    """A half-sine of rate carries the attitude through a known angle; plumb line and compass are kept consistent."""
    f = make(gain=0.0001, airspeed_correction=False)
    start = settle(f, np.eye(3))
    duration, total = 1.0, math.radians(40.0)
    attitude = None
    for k in range(int(duration * RATE_HZ) + 1):
        t = k / RATE_HZ
        rate = np.zeros(3)
        rate[axis] = total * math.pi / 2 / duration * math.sin(math.pi * t / duration)
        turned = np.zeros(3)
        turned[axis] = total / 2 * (1 - math.cos(math.pi * t / duration))
        c = body_from_ned(*turned)
        attitude = f.update(start + t, rate, c @ (0, 0, -G), c @ FIELD, 15.0)
    expected = np.zeros(3)
    expected[axis] = 40.0
    assert attitude is not None
    assert angles(attitude.quaternion) == pytest.approx(expected, abs=0.3)


def test_no_lead_while_rolling() -> None:
    """Trapezoidal integration: during a constant roll acceleration the bank is right at every sample."""
    f = make(gain=0.0001, airspeed_correction=False)
    start = settle(f, np.eye(3))
    acceleration = math.radians(60.0)
    for k in range(1, 21):
        t = k / RATE_HZ
        c = body_from_ned(acceleration * t * t / 2, 0, 0)
        q = f.update(start + t - 1 / RATE_HZ, (acceleration * t, 0, 0), c @ (0, 0, -G), c @ FIELD, 15.0).quaternion
        assert angles(q)[0] == pytest.approx(math.degrees(acceleration * t * t / 2), abs=0.15)


def turn(f: AttitudeFilter, airspeed: float | None, seconds: float = 40.0) -> float:
    """A level coordinated turn at 20 deg of bank and 18 m/s; returns the bank found at its end [deg]."""
    start = settle(f, body_from_ned(math.radians(20), 0, 0), airspeed=airspeed)
    bank, speed = math.radians(20), 18.0
    heading_rate = G * math.tan(bank) / speed
    rate = (0.0, heading_rate * math.sin(bank), heading_rate * math.cos(bank))
    load = np.array((0, 0, -G / math.cos(bank)))
    q = (1.0, 0.0, 0.0, 0.0)
    for k in range(int(seconds * RATE_HZ)):
        t = k / RATE_HZ
        field = body_from_ned(bank, 0, heading_rate * t) @ FIELD
        q = f.update(start + t, rate, load, field, airspeed).quaternion
    return float(angles(q)[0])


def test_coordinated_turn_does_not_level_the_horizon() -> None:
    """Without the airspeed the plumb line follows the turn and the bank is lost; with it the bank stays."""
    assert turn(make(gain=0.5, acceleration_rejection_deg=0.0), 18.0) == pytest.approx(20.0, abs=0.5)
    assert turn(make(gain=0.5, acceleration_rejection_deg=0.0), None) < 10.0


def test_launch_does_not_tip_the_horizon() -> None:
    """Four seconds of forward acceleration at 0.4 g, level: the plumb line alone would be 22 deg off."""
    f, acceleration = make(gain=0.5, acceleration_rejection_deg=0.0), 0.4 * G
    start = settle(f, np.eye(3), airspeed=0.0)
    worst = 0.0
    for k in range(int(4 * RATE_HZ)):
        t = k / RATE_HZ
        q = f.update(start + t, (0, 0, 0), (acceleration, 0, -G), FIELD, acceleration * t).quaternion
        worst = max(worst, abs(float(angles(q)[1])))
    assert worst < 6.0  # while the airspeed is being smoothed
    assert abs(float(angles(q)[1])) < 3.0


def test_bias_is_found_standing_and_left_alone_in_flight() -> None:
    bias = np.radians((0.8, -0.5, 0.3))
    ground, air = make(), make()
    for k in range(200):
        ground.update(k / RATE_HZ, bias, (0, 0, -G), FIELD, 0.0)
        air.update(k / RATE_HZ, bias, (0, 0, -G), FIELD, 18.0)
    assert ground.gyro_bias == pytest.approx(tuple(bias), abs=math.radians(0.01))
    assert air.gyro_bias == (0.0, 0.0, 0.0)


def test_magnetic_disturbance_is_rejected_and_said() -> None:
    f = make()
    time = settle(f, np.eye(3))
    attitude = f.update(time, (0, 0, 0), (0, 0, -G), (0.0, 30e-6, 40e-6), 15.0)
    assert AttitudeStatus.MAGNETIC_REJECTED in attitude.status
    assert abs(angles(attitude.quaternion)[2]) < 1.0


def test_acceleration_is_rejected_and_said() -> None:
    f = make()
    time = settle(f, np.eye(3))
    attitude = f.update(time, (0, 0, 0), (0, 6.0, -G), FIELD, 15.0)
    assert AttitudeStatus.ACCELERATION_REJECTED in attitude.status


def test_starts_again_after_a_long_gap() -> None:
    f = make()
    time = settle(f, np.eye(3))
    c = body_from_ned(0, 0, math.radians(90))
    attitude = f.update(time + 5.0, (0, 0, 0), c @ (0, 0, -G), c @ FIELD, 15.0)
    assert attitude.initialising


def test_counts_fit_the_channels() -> None:
    f = make()
    settle(f, np.eye(3))
    counts = f.update(8.0, (0, 0, 0), (0, 0, -G), FIELD, 15.0).counts()
    assert counts["quaternion_w"] == pytest.approx(32767, abs=1)
    assert set(counts) == {"quaternion_w", "quaternion_x", "quaternion_y", "quaternion_z", "attitude_status"}
