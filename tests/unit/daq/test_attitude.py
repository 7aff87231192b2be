"""The attitude filter against known rotations; the direction cosines here are written out independently."""

import math

import numpy as np
import pytest

from daq.acquisition.attitude import AttitudeFilter, AttitudeStatus
from daq.sensors.config import AttitudeConfig
from daq.sensors.gravity_reference import VelocityFix

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


def weave(f: AttitudeFilter, late: float | None, compass: bool = True, seconds: float = 40.0) -> np.ndarray:
    """A skid from side to side: 2 m/s of sideways velocity at 0.25 Hz, heading east, a little bank.

    late: how old a fix is when it comes [s], None without GPS. Returns the error of the bank over the second half [deg].
    """
    turn, amplitude, bank = 2 * math.pi * 0.25, 2.0, math.radians(5)
    c = body_from_ned(bank, 0.0, math.pi / 2)
    across = c.T @ np.array((0.0, math.cos(bank), -math.sin(bank)))  # level and square to the flight path
    errors = []
    for k in range(int(seconds * RATE_HZ)):
        t = k / RATE_HZ
        force = c @ (amplitude * turn * math.cos(turn * t) * across - np.array((0.0, 0.0, G)))
        fix = None
        if late is not None and k % 2 == 0:
            velocity = np.array((0.0, 17.0, 0.0)) + amplitude * math.sin(turn * (t - late)) * across
            fix = VelocityFix(t - late, tuple(velocity))
        q = f.update(t, (0, 0, 0), force, c @ FIELD if compass else None, 17.0, fix).quaternion
        errors.append(angles(q)[0] - 5.0)
    return np.array(errors[len(errors) // 2 :])


def test_sideslip_leaves_no_trace_with_gps_velocities() -> None:
    """Airspeed and rates know nothing of a sideways velocity: the bank follows it by a degree and more. GPS knows it."""
    without = weave(make(acceleration_rejection_deg=0.0), None)
    assert np.abs(without).max() > 1.5
    assert np.abs(weave(make(acceleration_rejection_deg=0.0), 0.0)).max() < 0.1


def test_late_fixes_are_compared_with_their_own_time() -> None:
    assert np.abs(weave(make(acceleration_rejection_deg=0.0), 0.15)).max() < 0.1


def test_gps_velocities_are_not_used_without_a_heading() -> None:
    blind = weave(make(acceleration_rejection_deg=0.0), 0.0, compass=False)
    plain = weave(make(acceleration_rejection_deg=0.0), None, compass=False)
    assert blind == pytest.approx(plain, abs=1e-9)


def test_attitude_goes_on_when_the_fixes_stop() -> None:
    f = make(acceleration_rejection_deg=0.0)
    c = body_from_ned(0.0, 0.0, 0.0)
    for k in range(400):
        fix = VelocityFix(k / RATE_HZ, (17.0, 0.0, 0.0)) if k < 200 else None
        q = f.update(k / RATE_HZ, (0, 0, 0), c @ (0, 0, -G), c @ FIELD, 17.0, fix).quaternion
    assert angles(q) == pytest.approx((0.0, 0.0, 0.0), abs=0.05)


def test_antenna_away_from_the_imu_is_allowed_for() -> None:
    """Rolling with the antenna a metre below: it moves sideways, the aircraft does not."""
    place, turn = (0.0, 0.0, 1.0), 2 * math.pi * 0.3
    worst = {}
    for antenna in (place, (0.0, 0.0, 0.0)):
        f = make(acceleration_rejection_deg=0.0, antenna_m=antenna)
        error = 0.0
        for k in range(600):
            t = k / RATE_HZ
            bank, rate = 0.3 * math.sin(turn * t), (0.3 * turn * math.cos(turn * t), 0.0, 0.0)
            c = body_from_ned(bank, 0.0, 0.0)
            fix = VelocityFix(t, tuple(c.T @ np.cross(rate, place)))
            q = f.update(t, rate, c @ (0, 0, -G), c @ FIELD, 17.0, fix).quaternion
            error = max(error, abs(angles(q)[0] - math.degrees(bank)) if t > 10.0 else 0.0)
        worst[antenna] = error
    assert worst[place] < 0.1
    assert worst[(0.0, 0.0, 0.0)] > 3 * worst[place]


@pytest.mark.parametrize(("phi", "theta", "psi"), [(0, 0, 0), (25, -10, 200), (-40, 30, -75), (170, 20, 10)])
def test_begins_where_the_first_sample_points_and_says_until_when_it_settles(
    phi: float, theta: float, psi: float
) -> None:
    f = make()
    c = body_from_ned(*np.radians((phi, theta, psi)))
    first = f.update(0.0, (0, 0, 0), c @ (0, 0, -G), c @ FIELD)
    expected = np.array((phi, theta, psi if psi <= 180 else psi - 360), dtype=float)
    assert angles(first.quaternion) == pytest.approx(expected, abs=0.01)
    states = [f.update(k / RATE_HZ, (0, 0, 0), c @ (0, 0, -G), c @ FIELD).initialising for k in range(1, 80)]
    assert states.index(False) == pytest.approx(AttitudeFilter.SETTLING_S * RATE_HZ, abs=1)
    assert not any(states[states.index(False) :])


@pytest.mark.parametrize("rate", [0.5, 3.0, 6.0])
def test_fast_roll_is_added_up_to_the_right_angle(rate: float) -> None:
    """Ten seconds of constant roll rate: the finite turn of a step is a turn, not its tangent."""
    f = make(gain=0.0, aided_gain=0.0, use_magnetometer=False, airspeed_correction=False)
    settle(f, np.eye(3))
    for k in range(1, 201):
        q = f.update(8.0 - 1 / RATE_HZ + k / RATE_HZ, (rate, 0, 0), (0, 0, -G)).quaternion
    expected = rate * (10.0 - 0.5 / RATE_HZ)  # the rate comes up over the first step
    error = (math.radians(angles(q)[0]) - expected + math.pi) % (2 * math.pi) - math.pi
    assert abs(error) < 1e-3
