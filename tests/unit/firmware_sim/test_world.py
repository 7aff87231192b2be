"""One flight from power-up to stillness, alone or in a crowd."""

import math

import numpy as np
import pytest

from firmware_sim.tables import ScenarioError
from firmware_sim.world.scenario import Scenario, load_scenario, scenario_from
from firmware_sim.world.simulation import WorldSimulation
from firmware_sim.world.truth import TRUTH_COLUMNS
from firmware_sim.world.world import World, simulate_many, simulate_truth

SHORT = {
    "flight": {"duration_s": 6.0, "manoeuvres": "rich"},
    "wind": {"gust_deg": 0.3, "speed_m_s": 3.0, "from_deg": 70.0},
}


def short(**tables: object) -> Scenario:
    """Six seconds of the rich plan in gusts and wind."""
    return scenario_from(SHORT, "short").altered(**tables)


def test_the_flight_does_not_depend_on_who_looks_and_when() -> None:
    curious, calm = World(short(), 4), World(short(), 4)
    for k in range(1, 120):
        curious.advance(k * 0.0371)
    assert curious.advance(5.0) == calm.advance(5.0)


def test_truth_between_grid_points_is_that_of_a_finer_clock() -> None:
    scenario = short(wind={"gust_deg": 0.0})
    world = World(scenario, 2)
    times = np.arange(0.0, 3.0, 0.0013)
    roll = np.array([world.advance(float(t)).rates[0] for t in times])
    slope = np.array([World(scenario, 2).advance(2.0).rate_derivatives[0]])
    k = int(np.searchsorted(times, 2.0))
    assert slope[0] == pytest.approx(np.gradient(roll, times)[k], abs=0.02)
    assert np.abs(np.diff(roll)).max() < 0.01


def test_time_does_not_go_back() -> None:
    world = World(short(), 1)
    world.advance(1.0)
    with pytest.raises(ValueError, match="passed"):
        world.advance(0.5)


@pytest.mark.parametrize("scenario", ["nominal", "quiet"])
def test_one_flight_is_flown_on_floats(scenario: str) -> None:
    # One numpy scalar, from a table or a draw, makes numpy scalars of all it meets: the same numbers at twice the time.
    world = World(load_scenario(scenario))
    for time in (0.0, 0.5 * world.takeoff_time, world.takeoff_time + 1.0, world.takeoff_time + 5.0):
        columns = world.advance(time).columns()
        assert {name: type(value) for name, value in columns.items() if type(value) is not float} == {}


def test_same_seed_same_flight_other_seed_other_flight() -> None:
    one, same, other = (simulate_truth(short(), seed) for seed in (5, 5, 6))
    assert all(np.array_equal(one[name], same[name]) for name in one)
    assert not np.allclose(one["beta"], other["beta"], atol=1e-3)


def test_a_flight_is_the_same_alone_and_in_a_crowd() -> None:
    slow = short(flight={"speed_m_s": 15.0})
    crowd = simulate_many([short(), slow, short()], [1, 2, 3], crowd_from=1)
    for scenario, seed, together in ((short(), 1, crowd[0]), (slow, 2, crowd[1])):
        alone = simulate_truth(scenario, seed)
        for name, values in alone.items():
            np.testing.assert_allclose(together[name], values, atol=1e-8, rtol=1e-9, err_msg=name)


def test_many_flights_keep_the_order_asked_for_whatever_is_hidden() -> None:
    hidden = short(hidden=[{"name": "Cn_da", "size": 2.0}])
    flights = simulate_many([short(), hidden, short()], [1, 1, 1])
    assert np.array_equal(flights[0]["r"], flights[2]["r"])
    assert not np.allclose(flights[0]["r"], flights[1]["r"], atol=1e-3)


def test_flights_that_share_nothing_are_not_flown_on_one_array() -> None:
    with pytest.raises(ScenarioError, match="share"):
        WorldSimulation([short(), short(hidden=[{"name": "Cn_da"}])], [1, 1], many=True)


class TestKinematics:
    """The truth columns agree with one another, by relations the simulator does not use to make them."""

    def test_position_is_the_integral_of_velocity_and_wind_is_the_difference(self) -> None:
        t = simulate_truth(short(wind={"gust_deg": 0.0}), 3, rate_hz=200.0)
        dt = 1.0 / 200.0
        north = np.cumsum(0.5 * (t["vn"][1:] + t["vn"][:-1])) * dt
        moved = np.radians(t["latitude"][1:] - t["latitude"][0]) * 6371008.8
        np.testing.assert_allclose(moved, north, atol=1e-3)
        climbed = t["altitude_gnss"][1:] - t["altitude_gnss"][0]
        np.testing.assert_allclose(climbed, -np.cumsum(0.5 * (t["vd"][1:] + t["vd"][:-1])) * dt, atol=1e-3)

    def test_rates_turn_the_euler_angles(self) -> None:
        t = simulate_truth(short(wind={"gust_deg": 0.0}), 3, rate_hz=200.0)
        phi_dot = t["p"] + np.tan(t["theta"]) * (t["q"] * np.sin(t["phi"]) + t["r"] * np.cos(t["phi"]))
        psi_dot = (t["q"] * np.sin(t["phi"]) + t["r"] * np.cos(t["phi"])) / np.cos(t["theta"])
        np.testing.assert_allclose(np.gradient(t["phi"], 0.005)[1:-1], phi_dot[1:-1], atol=5e-3)
        np.testing.assert_allclose(np.gradient(t["psi"], 0.005)[1:-1], psi_dot[1:-1], atol=5e-3)

    def test_specific_force_is_acceleration_less_gravity(self) -> None:
        t = simulate_truth(short(wind={"gust_deg": 0.0}), 3, rate_hz=200.0)
        acceleration = np.stack([np.gradient(t[v], 0.005) for v in ("vn", "ve", "vd")])
        acceleration[2] -= 9.80665
        sp, cp, st, ct = np.sin(t["phi"]), np.cos(t["phi"]), np.sin(t["theta"]), np.cos(t["theta"])
        ss, cs = np.sin(t["psi"]), np.cos(t["psi"])
        lateral = (sp * st * cs - cp * ss) * acceleration[0] + (sp * st * ss + cp * cs) * acceleration[1]
        lateral += sp * ct * acceleration[2]
        np.testing.assert_allclose(lateral[1:-1], t["ay"][1:-1], atol=0.05)

    def test_the_compass_points_where_the_heading_says(self) -> None:
        t = simulate_truth(short(), 3)
        level = np.abs(t["phi"]) < 0.003
        pitch = t["theta"][level]
        ahead = t["mx"][level] * np.cos(pitch) + t["mz"][level] * np.sin(pitch)
        heading = np.arctan2(-t["my"][level], ahead) + math.atan2(0.5, 35.1)
        np.testing.assert_allclose(heading, t["psi"][level], atol=0.01)

    def test_pressures_temperature_and_density_agree(self) -> None:
        t = simulate_truth(short(), 3)
        np.testing.assert_allclose(t["rho"], t["p_static"] / (287.05287 * t["temperature"]), rtol=1e-9)
        np.testing.assert_allclose(t["p_dynamic"], 0.5 * t["rho"] * t["V"] ** 2, rtol=1e-9)


@pytest.fixture(scope="module")
def flight() -> dict[str, np.ndarray]:
    """Still, launch, six seconds of flying, landing, still."""
    scenario = short(ground={"before_s": 4.0, "after_s": 5.0, "launch_s": 12.0, "landing_s": 12.0})
    return simulate_truth(scenario, 3, rate_hz=50.0)


class TestWholeFlight:
    def test_it_lies_still_before_and_after(self, flight: dict[str, np.ndarray]) -> None:
        time = flight["time"]
        assert time[-1] == pytest.approx(4.0 + 12.0 + 6.0 + 12.0 + 5.0)
        for still in (time < 3.9, time > time[-1] - 4.9):
            for name in ("p", "q", "r", "vn", "ve", "vd"):
                assert np.abs(flight[name][still]).max() < 1e-9, name
            force = np.sqrt(flight["ax"] ** 2 + flight["ay"] ** 2 + flight["az"] ** 2)[still]
            np.testing.assert_allclose(force, 9.80665, rtol=1e-9)
            assert flight["thrust"][still].max() == 0.0

    def test_nothing_jumps_on_the_way_up_and_down(self, flight: dict[str, np.ndarray]) -> None:
        for name, limit in (("altitude_gnss", 0.3), ("vn", 0.2), ("vd", 0.2), ("theta", 0.03), ("V", 0.3)):
            assert np.abs(np.diff(flight[name])).max() < limit, name
        assert flight["altitude_gnss"].max() == pytest.approx(60.0, abs=1.0)

    def test_scripted_phases_keep_force_and_motion_consistent(self, flight: dict[str, np.ndarray]) -> None:
        time = flight["time"]
        rising = (time > 4.5) & (time < 15.5)
        down = np.gradient(flight["vd"], 0.02) - 9.80665
        north, east = np.gradient(flight["vn"], 0.02), np.gradient(flight["ve"], 0.02)
        made = flight["ax"] ** 2 + flight["ay"] ** 2 + flight["az"] ** 2
        np.testing.assert_allclose((north**2 + east**2 + down**2)[rising], made[rising], rtol=0.02)
        theta_dot = np.gradient(flight["theta"], 0.02)
        np.testing.assert_allclose(theta_dot[rising], flight["q"][rising], atol=0.01)


def test_pilot_keeps_height_speed_and_bank_in_bounds() -> None:
    flown = simulate_many([load_scenario("rich"), load_scenario("rich"), load_scenario("gusty")], [0, 1, 2])
    for t in flown:
        assert np.abs(t["altitude_gnss"] - 60.0).max() < 6.0
        assert np.abs(t["V"] - 17.0).max() < 2.0
        assert np.abs(t["phi"]).max() < math.radians(40.0)
        assert np.abs(t["beta"]).max() > math.radians(3.0)
        assert {0.0, 1.0} == set(np.unique(t["digital_1"]))


def test_servo_pulses_carry_the_commands() -> None:
    truth = World(short(), 2).advance(2.0)
    left, right, rudder, throttle, *spare = truth.pulses_us
    assert math.radians(25.0) * (left - 1500.0) / 500.0 == pytest.approx(truth.cmd_left)
    assert math.radians(25.0) * (right - 1500.0) / 500.0 == pytest.approx(truth.cmd_right)
    assert rudder == 1500.0
    assert 1000.0 < throttle < 2000.0
    assert spare == [1500.0, 1500.0]
    columns = truth.columns()
    assert columns["cmd_a"] == pytest.approx(0.5 * (truth.cmd_right - truth.cmd_left))


def test_columns_come_in_the_order_of_the_file() -> None:
    assert tuple(World(short(), 1).truth.columns()) == TRUTH_COLUMNS
