"""The rigid body, its air and its modes, against closed forms and published figures."""

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from daq.utilities.constants import GRAVITY
from firmware_sim.physics.atmosphere import Site as FlyingSite
from firmware_sim.physics.atmosphere import air_at, geodetic, pressure_altitude
from firmware_sim.physics.plant import ARMS, ATTITUDE, POSITION, RATES, RIGID_STATES, THRUST, Commands, Plant
from tests.unit.firmware_sim.plants import fly, level_state, motion_of, no_air, plain_plant

NEUTRAL = Commands(0.0, 0.0, 0.0, 0.0)


def symmetric() -> dict[str, float]:
    """Overrides that make the aircraft a mirror image of itself."""
    return {"CY_0": 0.0, "Cl_0": 0.0, "Cn_0": 0.0}


class TestRigidBody:
    def test_free_fall_is_a_parabola(self) -> None:
        plant = no_air(plain_plant())
        x = [0.0] * plant.size
        x[0], x[1], x[ATTITUDE], x[POSITION + 2] = 12.0, -3.0, 1.0, -500.0
        end = fly(plant, x, NEUTRAL, 2.0)
        assert end[POSITION : POSITION + 3] == pytest.approx([24.0, -6.0, -500.0 + 0.5 * GRAVITY * 4.0], abs=1e-9)
        motion, _ = motion_of(plant, end, NEUTRAL)
        assert (motion.ax, motion.ay, motion.az) == pytest.approx((0.0, 0.0, 0.0), abs=1e-12)

    def test_torque_free_tumbling_keeps_energy_and_angular_momentum(self) -> None:
        plant = no_air(plain_plant())
        inertia = np.array([[plant.Ixx, 0.0, -plant.Ixz], [0.0, plant.Iyy, 0.0], [-plant.Ixz, 0.0, plant.Izz]])
        x = [0.0] * plant.size
        x[0], x[ATTITUDE] = 15.0, 1.0
        x[RATES : RATES + 3] = [1.5, 2.0, -1.0]

        def conserved(state: list[float]) -> tuple[float, NDArray[np.float64]]:
            rates = np.array(state[RATES : RATES + 3])
            m, _ = motion_of(plant, state, NEUTRAL)
            to_ned = np.array([[m.c11, m.c12, m.c13], [m.c21, m.c22, m.c23], [m.c31, m.c32, m.c33]]).T
            return 0.5 * rates @ inertia @ rates, to_ned @ inertia @ rates

        energy, momentum = conserved(x)
        end = fly(plant, x, NEUTRAL, 20.0)
        energy_after, momentum_after = conserved(end)
        assert energy_after == pytest.approx(energy, rel=1e-7)
        np.testing.assert_allclose(momentum_after, momentum, atol=1e-6)
        assert not np.allclose(end[RATES : RATES + 3], x[RATES : RATES + 3], atol=0.1)

    def test_rotation_about_one_axis_turns_the_attitude_by_that_angle(self) -> None:
        plant = no_air(plain_plant())
        x = [0.0] * plant.size
        x[0], x[ATTITUDE], x[RATES + 1] = 15.0, 1.0, 0.4
        end = fly(plant, x, NEUTRAL, 2.0)
        motion, _ = motion_of(plant, end, NEUTRAL)
        assert math.asin(-motion.c13) == pytest.approx(0.8, abs=1e-9)

    def test_integration_is_of_fourth_order(self) -> None:
        plant = plain_plant()
        x, commands, _ = level_state(plant)
        x[RATES], x[1] = 1.2, 1.5
        fine = np.array(fly(plant, x, commands, 0.8, 0.0005))
        errors = [np.linalg.norm(np.array(fly(plant, x, commands, 0.8, h)) - fine) for h in (0.02, 0.01, 0.005)]
        orders = np.log2(np.array(errors[:-1]) / errors[1:])
        assert np.all((orders > 3.7) & (orders < 4.4)), orders

    def test_the_step_flown_leaves_no_integration_error_that_matters(self) -> None:
        plant = plain_plant()
        x, commands, _ = level_state(plant)
        x[RATES] = 1.2
        coarse, fine = fly(plant, x, commands, 2.0, 0.005), fly(plant, x, commands, 2.0, 0.0005)
        assert np.abs(np.array(coarse[:RIGID_STATES]) - fine[:RIGID_STATES]).max() < 1e-6


class TestAtmosphere:
    # U.S. Standard Atmosphere 1976, table I: geometric altitudes taken as geopotential.
    @pytest.mark.parametrize(
        ("height", "pressure", "temperature", "density"),
        [(0.0, 101325.0, 288.150, 1.2250), (1000.0, 89874.6, 281.650, 1.1116), (5000.0, 54019.9, 255.650, 0.73612)],
    )
    def test_standard_air(self, height: float, pressure: float, temperature: float, density: float) -> None:
        air = air_at(height, 0.0)
        assert air.pressure == pytest.approx(pressure, rel=2e-4)
        assert air.temperature == pytest.approx(temperature, abs=1e-6)
        assert air.density == pytest.approx(density, rel=2e-4)
        assert pressure_altitude(air.pressure) == pytest.approx(height, abs=1e-6)

    def test_density_at_the_field_is_that_of_the_published_flights(self) -> None:
        assert air_at(60.0, FlyingSite().temperature_offset_k).density == pytest.approx(1.17, abs=0.003)

    def test_pressure_falls_by_the_weight_of_the_air(self) -> None:
        h = 0.5
        low, middle, high = (air_at(100.0 + dh, 11.8) for dh in (-h, 0.0, h))
        assert (low.pressure - high.pressure) / (2 * h) == pytest.approx(middle.density * GRAVITY, rel=1e-6)

    def test_a_minute_of_latitude_is_a_nautical_mile(self) -> None:
        site = FlyingSite()
        latitude, longitude = geodetic(site, 1853.2, 0.0)
        assert (latitude - site.latitude_deg) * 60.0 == pytest.approx(1.0, abs=1e-3)
        assert longitude == site.longitude_deg


class TestTrim:
    @pytest.mark.parametrize("speed", [13.0, 15.0, 17.0, 20.0, 25.0])
    def test_trimmed_flight_does_not_accelerate(self, speed: float) -> None:
        plant = plain_plant(**symmetric())
        x, commands, trim = level_state(plant, speed)
        _, dx = motion_of(plant, x, commands)
        assert np.abs(dx[:6]).max() < 1e-9
        assert dx[POSITION + 2] == pytest.approx(0.0, abs=1e-12)
        assert trim.thrust > 0.0

    def test_slower_flight_needs_more_angle_of_attack_and_up_elevator(self) -> None:
        slow, fast = (level_state(plain_plant(), speed)[2] for speed in (14.0, 20.0))
        assert slow.alpha > fast.alpha
        assert slow.elevator < fast.elevator

    def test_level_flight_stays_level(self) -> None:
        plant = plain_plant(**symmetric())
        x, commands, _ = level_state(plant)
        end = fly(plant, x, commands, 10.0)
        assert end[POSITION + 2] == pytest.approx(-60.0, abs=0.02)


def lateral_modes(speed: float) -> NDArray[np.complex128]:
    """Eigenvalues of the plant linearised by central differences about level flight: v, p, r, phi."""
    plant = plain_plant(**symmetric())
    x, commands, trim = level_state(plant, speed)

    def rates(v: float, p: float, r: float, phi: float) -> NDArray[np.float64]:
        state = list(x)
        state[1], state[RATES], state[RATES + 2] = v, p, r
        ct, st = math.cos(trim.alpha / 2), math.sin(trim.alpha / 2)
        cp, sp = math.cos(phi / 2), math.sin(phi / 2)
        state[ATTITUDE : ATTITUDE + 4] = [cp * ct, sp * ct, cp * st, -sp * st]
        _, dx = motion_of(plant, state, commands)
        return np.array([dx[1], dx[RATES], dx[RATES + 2], p + math.tan(trim.alpha) * r * math.cos(phi)])

    h = 1e-5
    columns = [(rates(*(h * e)) - rates(*(-h * e))) / (2 * h) for e in np.eye(4)]
    return np.linalg.eigvals(np.array(columns).T)


class TestModes:
    @pytest.mark.parametrize(("speed", "roll", "period"), [(15.0, -16.2, 2.0), (20.0, -21.5, 1.6)])
    def test_modes_are_those_expected_of_this_aircraft(self, speed: float, roll: float, period: float) -> None:
        modes = lateral_modes(speed)
        oscillation = modes[modes.imag > 1e-6]
        real = np.sort(modes[np.abs(modes.imag) <= 1e-6].real)
        assert real[0] == pytest.approx(roll, rel=0.04)
        assert -0.2 < real[1] < 0.0, "the spiral is slightly stable"
        assert len(oscillation) == 1
        damping = -oscillation[0].real / abs(oscillation[0])
        assert 2 * math.pi / oscillation[0].imag == pytest.approx(period, abs=0.1)
        assert 0.12 < damping < 0.20

    def test_simulated_dutch_roll_has_the_frequency_and_damping_of_its_eigenvalue(self) -> None:
        modes = lateral_modes(17.0)
        expected = modes[modes.imag > 1e-6][0]
        plant = plain_plant(**symmetric())
        x, commands, _ = level_state(plant)
        x[1] = 0.3
        sideslip = []
        for _ in range(1600):
            sideslip.append(x[1])
            x = fly(plant, x, commands, 0.005)
        # Least squares of a damped oscillation as a linear recurrence on samples 50 ms apart, once the roll mode is gone.
        z = np.array(sideslip[300::10])
        z = z[2:] - 0.0, z[1:-1], z[:-2], np.ones(len(z) - 2)
        (a, b, _), *_ = np.linalg.lstsq(np.stack(z[1:], axis=1), z[0], rcond=None)
        root = np.log(np.roots([1.0, -a, -b]).astype(complex)) / 0.05
        found = root[root.imag > 0][0]
        assert found.imag == pytest.approx(expected.imag, rel=0.01)
        assert found.real == pytest.approx(expected.real, rel=0.05)

    def test_roll_rate_after_an_aileron_step_has_the_time_constant_and_size_of_the_roll_mode(self) -> None:
        plant = plain_plant(**symmetric(), Cl_beta=0.0, Cl_r=0.0, Cn_p=0.0)
        x, commands, _ = level_state(plant)
        aileron = 0.01
        x[ARMS] -= aileron
        x[ARMS + 1] += aileron
        held = Commands(commands.left - aileron, commands.right + aileron, 0.0, commands.throttle)
        motion, _ = motion_of(plant, x, held)
        d, craft = plant.derivatives, plant.aircraft
        steady = -d["Cl_da"] / d["Cl_p"] * aileron * 2.0 * motion.V / craft.span
        moment = motion.qbar * craft.area * craft.span * craft.span / (2 * motion.V)
        tau = -plant.Ixx * (1.0 - plant.Ixz**2 / (plant.Ixx * plant.Izz)) / (moment * d["Cl_p"])
        early = fly(plant, x, held, 0.05)[RATES]
        assert early == pytest.approx(steady * (1.0 - math.exp(-0.05 / tau)), rel=0.02)
        assert fly(plant, x, held, 0.4)[RATES] == pytest.approx(steady, rel=0.03)


class TestSigns:
    def reaction(self, plant: Plant, **change: float) -> dict[str, float]:
        x, commands, _ = level_state(plant)
        places = {
            "v": 1,
            "p": RATES,
            "q": RATES + 1,
            "r": RATES + 2,
            "left": ARMS,
            "right": ARMS + 1,
            "rudder": ARMS + 2,
        }
        for name, value in change.items():
            x[places[name]] += value
        m, _ = motion_of(plant, x, commands)
        return {"p_dot": m.p_dot, "q_dot": m.q_dot, "r_dot": m.r_dot, "ay": m.ay, "az": m.az, "beta": m.beta}

    @pytest.mark.parametrize(
        ("change", "response"),
        [
            ({"left": -0.05, "right": 0.05}, {"p_dot": -1}),  # right trailing edge down: + delta_a, rolls left
            ({"left": 0.05, "right": 0.05}, {"q_dot": -1, "az": -1}),  # trailing edges down: nose down, more lift
            ({"rudder": 0.05}, {"r_dot": -1, "ay": 1}),  # trailing edge to port: force to starboard, nose left
            ({"v": 1.0}, {"beta": 1, "ay": -1, "p_dot": -1, "r_dot": 1}),  # wind from the right
            ({"p": 0.5}, {"p_dot": -1}),
            ({"q": 0.5}, {"q_dot": -1}),
            ({"r": 0.5}, {"r_dot": -1, "p_dot": 1}),
        ],
    )
    def test_each_input_pushes_the_right_way(self, change: dict[str, float], response: dict[str, int]) -> None:
        plant = plain_plant(**symmetric())
        rest = self.reaction(plant)
        moved = self.reaction(plant, **change)
        for name, sign in response.items():
            assert sign * (moved[name] - rest[name]) > 1e-3, name

    def test_mirrored_input_gives_mirrored_flight(self) -> None:
        plant = plain_plant(**symmetric())
        x, commands, _ = level_state(plant)
        ends = []
        for side in (1.0, -1.0):
            start = list(x)
            start[1], start[RATES] = side * 0.5, side * 0.3
            held = Commands(commands.left - side * 0.02, commands.right + side * 0.02, side * 0.03, commands.throttle)
            ends.append(np.array(fly(plant, start, held, 3.0)[:RIGID_STATES]))
        mirror = np.array([1, -1, 1, -1, 1, -1, 1, -1, 1, -1, 1, -1, 1])
        np.testing.assert_allclose(ends[0], mirror * ends[1], atol=1e-9)


def test_servo_answers_with_lag_and_never_faster_than_its_rate() -> None:
    plant = plain_plant()
    x, commands, _ = level_state(plant)
    small = Commands(commands.left, commands.right, 0.02, commands.throttle)
    assert fly(plant, x, small, 0.035)[ARMS + 2] == pytest.approx(0.02 * (1 - math.exp(-1.0)), rel=1e-3)
    large = Commands(commands.left, commands.right, 2.0, commands.throttle)
    assert fly(plant, x, large, 0.05)[ARMS + 2] == pytest.approx(6.0 * 0.05, rel=1e-6)


def test_thrust_follows_the_throttle() -> None:
    plant = plain_plant()
    x, commands, _ = level_state(plant)
    idle = Commands(commands.left, commands.right, 0.0, 0.0)
    assert fly(plant, x, idle, 0.15)[THRUST] == pytest.approx(x[THRUST] * math.exp(-1.0), rel=1e-3)
