"""Hidden effects: each does what its physics says, by numbers worked out here, and none knows of the search for it."""

import ast
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from firmware_sim.physics.effects.actuator import DelayedHistory
from firmware_sim.physics.effects.base import HiddenEffect, Sensed
from firmware_sim.physics.effects.registry import EFFECTS, make_effects
from firmware_sim.physics.maths import FLOATS, array_maths
from firmware_sim.physics.motion import Motion
from firmware_sim.physics.plant import ARMS, RATES, Commands, Plant
from firmware_sim.physics.plant import EFFECTS as EFFECT_STATES
from firmware_sim.tables import ScenarioError
from firmware_sim.world.scenario import scenario_from
from firmware_sim.world.world import simulate_many, simulate_truth
from tests.unit.firmware_sim.plants import QUIET, fly, level_state, motion_of, plain_plant

# Names that a search is expected to know. Three more of that list are in every flight of a six-degree-of-freedom aircraft
# (p sin alpha, roll kinematics, inertial coupling) and hidden from nobody but a simplified model.
LISTED = """
CY_da Cn_da CY_p_r Cl_alpha_beta Cn_alpha_beta Cl_da_de Cl_beta3 Cn_beta3 CY_beta3 Cl_da3 Cn_dr3 Cl_p_abs_p stall_separation
Cl_betadot Cn_betadot indicial_lag Ixz_error lateral_cg prop_gyroscopic motor_torque slipstream_rudder p_factor
aileron_delay rudder_delay aileron_lag rudder_lag servo_delay servo_lag aileron_deadzone aileron_backlash rudder_backlash
surface_compliance
beta_scale beta_bias beta_lag vane_position imu_lever_arm gyro_misalignment gyro_scale attitude_lag airspeed_scale time_skew
gust wind_shear
""".split()


def at_state(effect: HiddenEffect | None, **change: float) -> tuple[Plant, Motion, list[float], list[float]]:
    """Plant, motion, state and rates of trimmed flight with some states changed; effect states as at the start."""
    plant = plain_plant(*([] if effect is None else [effect]))
    x, commands, _ = level_state(plant)
    if effect is not None:
        effect.start(motion_of(plant, x, commands)[0], x)
    places = {"v": 1, "p": RATES, "q": RATES + 1, "r": RATES + 2, "left": ARMS, "right": ARMS + 1, "rudder": ARMS + 2}
    for name, value in change.items():
        x[places[name]] += value
    m, dx = motion_of(plant, x, commands)
    return plant, m, x, dx


def added(name: str, quantity: str, **change: float) -> tuple[float, Motion]:
    """How much an effect adds to a quantity in a state, and the motion there."""
    _, with_effect, _, _ = at_state(EFFECTS[name](), **change)
    _, plain, _, _ = at_state(None, **change)
    return getattr(with_effect, quantity) - getattr(plain, quantity), plain


def sensed(effect: HiddenEffect, m: Motion, x: list[float]) -> Sensed:
    """What instruments are shown with the effect."""
    phi, theta, psi = math.atan2(m.c23, m.c33), math.asin(-m.c13), math.atan2(m.c12, m.c11)
    s = Sensed(m.ax, m.ay, m.az, m.p, m.q, m.r, phi, theta, psi, m.alpha, m.beta, m.V, m.arm_left, m.arm_right, m.arm_r)
    effect.sense(s, m, x)
    return s


class TestRegistry:
    def test_all_listed_names_and_at_least_eight_unlisted_ones_exist(self) -> None:
        assert set(LISTED) <= set(EFFECTS)
        assert sum(not effect.catalogued for effect in EFFECTS.values()) >= 8

    @pytest.mark.parametrize("name", sorted(EFFECTS))
    def test_each_says_what_it_is_and_how_large(self, name: str) -> None:
        effect = EFFECTS[name]
        assert effect.title
        assert effect.unit
        assert effect.typical != 0.0
        assert effect.__doc__

    def test_size_scales_the_typical_one(self) -> None:
        (half,) = make_effects([("Cn_da", 0.5)])
        assert half.size == 0.5 * EFFECTS["Cn_da"].typical

    def test_unknown_names_are_refused(self) -> None:
        with pytest.raises(ScenarioError, match="gremlins"):
            make_effects([("gremlins", 1.0)])

    def test_nothing_here_imports_estimation_but_the_aircraft(self) -> None:
        import firmware_sim

        package = Path(str(firmware_sim.__file__)).parent
        imported = set()
        for path in package.rglob("*.py"):
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                if isinstance(node, ast.ImportFrom) and node.module:
                    imported.add(node.module)
                elif isinstance(node, ast.Import):
                    imported |= {alias.name for alias in node.names}
        assert {name for name in imported if name.split(".")[0] == "estimation"} <= {"estimation.aircraft"}


ANGLE = 0.1
AILERON = {"left": -ANGLE, "right": ANGLE}


@pytest.mark.parametrize(
    ("name", "quantity", "change", "expected"),
    [
        ("Cn_da", "Cn", AILERON, lambda m: -0.010 * ANGLE),
        ("CY_da", "CY", AILERON, lambda m: 0.04 * ANGLE),
        ("CY_p_r", "CY", {"p": 1.0, "r": 0.5}, lambda m: 0.08 * (0.5 - 0.5) * 0.75 / m.V),
        ("CY_p_r", "CY", {"r": 0.5}, lambda m: 0.08 * 0.5 * 0.75 / m.V),
        ("Cl_alpha_beta", "Cl", {"v": 2.0, "q": 0.0}, lambda m: -0.75 * (m.alpha - 0.086) * m.beta),
        ("Cn_alpha_beta", "Cn", {"v": 2.0}, lambda m: -0.15 * (m.alpha - 0.086) * m.beta),
        ("Cl_da_de", "Cl", {"left": 0.0, "right": 0.2}, lambda m: 0.30 * m.surface_a * m.surface_e),
        ("Cl_beta3", "Cl", {"v": 3.0}, lambda m: 0.5 * math.asin(3.0 / m.V) ** 3),
        ("Cn_beta3", "Cn", {"v": -3.0}, lambda m: -0.25 * math.asin(3.0 / m.V) ** 3),
        ("CY_beta3", "CY", {"v": 3.0}, lambda m: -1.5 * math.asin(3.0 / m.V) ** 3),
        ("Cl_da3", "Cl", AILERON, lambda m: 0.0948 * 2.6 * ANGLE**3),
        ("Cn_dr3", "Cn", {"rudder": ANGLE}, lambda m: 0.0327 * 4.5 * ANGLE**3),
        ("Cl_p_abs_p", "Cl", {"p": -1.5}, lambda m: 0.4951 * 1.43 * (1.5 * 0.75 / m.V) ** 2),
        ("lateral_cg", "L", {}, lambda m: 0.008 * m.mass * 9.80665 * math.cos(m.alpha)),
        ("prop_gyroscopic", "N", {"q": 0.4}, lambda m: 0.15 * math.sqrt(m.thrust / 5.5) * 0.4),
        ("prop_gyroscopic", "M", {"r": 0.4}, lambda m: -0.15 * math.sqrt(m.thrust / 5.5) * 0.4),
        ("motor_torque", "L", {}, lambda m: -0.03 * m.thrust),
        ("p_factor", "N", {}, lambda m: -0.25 * m.thrust * m.alpha),
        ("slipstream_rudder", "CY", {"rudder": ANGLE}, lambda m: 0.4174 * ANGLE * 0.5 * m.thrust / (m.qbar * 0.0507)),
        ("surface_compliance", "surface_r", {"rudder": ANGLE}, lambda m: ANGLE * (1 / (1 + 7e-4 * m.qbar) - 1)),
        ("aileron_deadzone", "surface_a", AILERON, lambda m: -0.014),
        ("aileron_deadzone", "surface_a", {"left": 0.01, "right": -0.01}, lambda m: 0.01),
        ("Cl_betadot", "L", {"v": 1.0}, lambda m: m.qbar * 0.787 * 1.5 * 0.10 * m.beta_dot * 0.75 / m.V),
        ("Cn_betadot", "N", {"v": 1.0}, lambda m: m.qbar * 0.787 * 1.5 * 0.03 * m.beta_dot * 0.75 / m.V),
    ],
)
def test_static_effects_add_what_their_formula_says(
    name: str, quantity: str, change: dict[str, float], expected: Callable[[object], float]
) -> None:
    amount, plain = added(name, quantity, **change)

    class WithMass:
        mass = 3.501  # 34.335 N

        def __getattr__(self, key: str) -> float:
            return float(getattr(plain, key))

    tolerance = 2e-3 if name == "lateral_cg" else 1e-9
    assert amount == pytest.approx(expected(WithMass()), rel=tolerance, abs=1e-12)


def test_inertia_errors_change_the_mass_properties_and_nothing_else() -> None:
    plant, m, _, _ = at_state(EFFECTS["Ixz_error"](), **AILERON)
    plain_p, plain, _, _ = at_state(None, **AILERON)
    assert plant.Ixz - plain_p.Ixz == pytest.approx(0.015)
    assert pytest.approx((plain.L, plain.N)) == (m.L, m.N)
    assert m.r_dot < plain.r_dot  # rolling left drags the nose left through a positive product of inertia
    heavier, _, _, _ = at_state(EFFECTS["mass_scale"]())
    assert heavier.mass == pytest.approx(plain_p.mass * 1.08)
    assert at_state(EFFECTS["Ixx_scale"]())[0].Ixx == pytest.approx(plain_p.Ixx * 1.10)


@pytest.mark.parametrize(
    ("name", "channel", "change", "expected"),
    [
        ("beta_scale", "beta", {"v": 2.0}, lambda m: 1.08 * m.beta),
        ("beta_bias", "beta", {"v": 2.0}, lambda m: m.beta + 0.006),
        ("vane_position", "beta", {"r": 0.5}, lambda m: m.beta + 0.35 * 0.5 / m.V),
        ("vane_position", "alpha", {"q": 0.5}, lambda m: m.alpha - 0.35 * 0.5 / m.V),
        ("imu_lever_arm", "ay", {**AILERON, "r": 0.3, "q": 0.2}, lambda m: m.ay + 0.08 * (0.2 * 0.3 - m.p_dot)),
        ("gyro_misalignment", "r", {"p": 1.0}, lambda m: math.sin(0.03)),
        ("gyro_scale", "p", {"p": 1.0}, lambda m: 1.03),
        ("airspeed_scale", "V", {}, lambda m: 1.05 * m.V),
        ("gyro_clipping", "p", {"p": -1.0}, lambda m: -0.22),
        ("gyro_clipping", "r", {"r": 0.1}, lambda m: 0.1),
    ],
)
def test_instrument_errors_bend_the_channel_they_name(
    name: str, channel: str, change: dict[str, float], expected: Callable[[Motion], float]
) -> None:
    effect = EFFECTS[name]()
    _, m, x, _ = at_state(effect, **change)
    assert getattr(sensed(effect, m, x), channel) == pytest.approx(expected(m), abs=1e-12)


@pytest.mark.parametrize(
    ("name", "quantity", "change", "size"),
    [
        ("aileron_lag", "surface_a", AILERON, 0.06),
        ("rudder_lag", "surface_r", {"rudder": ANGLE}, 0.06),
        ("servo_lag", "surface_r", {"rudder": ANGLE}, 0.06),
    ],
)
def test_a_lagging_surface_starts_where_it_was_at_the_rate_of_its_time_constant(
    name: str, quantity: str, change: dict[str, float], size: float
) -> None:
    effect = EFFECTS[name]()
    plant, m, _, dx = at_state(effect, **change)
    assert getattr(m, quantity) == pytest.approx(0.0, abs=1e-12)
    assert dx[plant.size - 1] == pytest.approx(ANGLE / size)


def test_vane_lag_is_a_first_order_lag_of_the_sideslip() -> None:
    effect = EFFECTS["beta_lag"]()
    _, m, x, dx = at_state(effect, v=2.0)
    assert sensed(effect, m, x).beta == pytest.approx(0.0, abs=1e-12)
    assert dx[EFFECT_STATES] == pytest.approx(m.beta / 0.08)


class TestMemory:
    def test_history_gives_back_the_past_between_grid_points(self) -> None:
        past = DelayedHistory(0.1, 0.005, 0.0, FLOATS)
        for k in range(1, 60):
            past.push(k * 0.005, 3.0 * k * 0.005)
        assert past.at(0.295 - 0.0712) == pytest.approx(3.0 * (0.295 - 0.0712))
        many = DelayedHistory(0.1, 0.005, np.zeros(3), array_maths(3))
        for k in range(1, 60):
            many.push(k * 0.005, np.array([1.0, 2.0, 3.0]) * k * 0.005)
        delays = np.array([0.0, 0.0123, 0.06])
        np.testing.assert_allclose(many.at(0.295 - delays), np.array([1.0, 2.0, 3.0]) * (0.295 - delays))

    @pytest.mark.parametrize(("name", "place"), [("rudder_delay", "surface_r"), ("rudder_backlash", "surface_r")])
    def test_linkage_under_a_slow_swing(self, name: str, place: str) -> None:
        effect = EFFECTS[name]()
        plant = plain_plant(effect)
        x, commands, _ = level_state(plant)
        effect.start(motion_of(plant, x, commands)[0], x)
        arm, surface = [], []
        for k in range(1200):
            time = (k + 1) * 0.005
            x[ARMS + 2] = 0.1 * math.sin(2.0 * math.pi * 0.5 * time)
            m = plant.evaluate(time, x, commands, QUIET, [0.0] * plant.size)
            effect.commit(m, x)
            arm.append(x[ARMS + 2])
            surface.append(getattr(m, place))
        arm_, surface_ = np.array(arm[400:]), np.array(surface[400:])
        if name == "rudder_delay":
            late = round(effect.size / 0.005)
            np.testing.assert_allclose(surface_[late:], arm_[:-late], atol=2e-3)
        else:
            # A loop: on the way up the surface is half a gap behind, on the way down half a gap ahead, at rest at the turn.
            rising = (np.gradient(arm_) > 0) & (np.abs(arm_) < 0.05)
            falling = (np.gradient(arm_) < 0) & (np.abs(arm_) < 0.05)
            np.testing.assert_allclose((arm_ - surface_)[rising], effect.size, atol=1e-9)
            np.testing.assert_allclose((arm_ - surface_)[falling], -effect.size, atol=1e-9)
            assert surface_.max() == pytest.approx(0.1 - effect.size, abs=1e-4)

    def test_vane_friction_holds_then_slips(self) -> None:
        effect = EFFECTS["vane_friction"]()
        plant = plain_plant(effect)
        x, commands, _ = level_state(plant)
        effect.start(motion_of(plant, x, commands)[0], x)
        shown, true = [], []
        for k in range(400):
            x[1] = 1.5 * k / 400
            m = plant.evaluate(k * 0.005, x, commands, QUIET, [0.0] * plant.size)
            effect.commit(m, x)
            shown.append(sensed(effect, m, x).beta)
            true.append(m.beta)
        jumps = np.abs(np.diff(shown))
        assert np.mean(jumps == 0.0) > 0.9
        assert jumps.max() > 0.015
        assert np.abs(np.array(shown) - true).max() <= effect.size + 1e-3

    def test_vortex_flips_at_three_degrees_either_way_and_not_between(self) -> None:
        effect = EFFECTS["vortex_hysteresis"]()
        plant = plain_plant(effect)
        x, commands, _ = level_state(plant)
        effect.start(motion_of(plant, x, commands)[0], x)
        aims = []
        for sideslip in (0.0, 0.04, -0.04, -0.06, -0.04, 0.04, 0.06, 0.0):
            x[1] = 17.0 * math.sin(sideslip)
            m, dx = motion_of(plant, x, commands)
            effect.commit(m, x)
            _, dx = motion_of(plant, x, commands)
            aims.append(x[EFFECT_STATES] + dx[EFFECT_STATES] * 0.05)
        assert aims == pytest.approx([1.0, 1.0, 1.0, -1.0, -1.0, -1.0, 1.0, 1.0])

    def test_stale_vane_repeats_values_and_never_invents_one(self) -> None:
        scenario = scenario_from({"flight": {"duration_s": 6.0}, "hidden": [{"name": "stale_vane"}]}, "here")
        t = simulate_truth(scenario, 3, rate_hz=200.0)
        shown = t["sensed_beta"]
        fresh = np.flatnonzero(np.diff(shown) != 0.0) + 1
        assert 12 < len(fresh) < 40
        assert np.all(np.isclose(shown[fresh][:, None], t["beta"][None, :], atol=1e-12).any(axis=1))


class TestModesOfTheirOwn:
    def frequency(self, name: str, start: float) -> float:
        """Angular frequency of an effect's own oscillator, aircraft held still by freezing its states."""
        effect = EFFECTS[name]()
        plant = plain_plant(effect)
        x, commands, _ = level_state(plant)
        x[effect.at] = start
        first = list(x)
        angles = []
        for _ in range(2000):
            angles.append(x[effect.at])
            x = fly(plant, x, commands, 0.001, 0.001)
            x[: effect.at] = first[: effect.at]
        crossings = np.flatnonzero(np.diff(np.sign(np.array(angles))) != 0)
        return math.pi / (0.001 * float(np.mean(np.diff(crossings))))

    def test_hung_load_swings_like_a_pendulum_of_half_a_metre(self) -> None:
        # Driven through the airframe it pulls on: the pull moves the frequency by a little.
        assert self.frequency("swinging_load", 0.1) == pytest.approx(math.sqrt(9.80665 / 0.5), rel=0.15)

    def test_fin_swings_at_its_own_frequency(self) -> None:
        assert self.frequency("flexible_fin", 0.01) == pytest.approx(2.0 * math.pi * 1.5, rel=0.02)

    def test_fin_stall_takes_force_above_its_angle_and_gives_it_back_lower_down(self) -> None:
        effect = EFFECTS["fin_stall"]()
        plant = plain_plant(effect)
        x, commands, _ = level_state(plant)
        effect.start(motion_of(plant, x, commands)[0], x)
        attached = {}
        sweep = np.concatenate([np.linspace(0.0, 0.12, 400), np.linspace(0.12, 0.0, 400)])
        for k, angle in enumerate(sweep):
            x[ARMS + 2] = angle
            for _ in range(20):
                _, dx = motion_of(plant, x, commands)
                x[effect.at] += 0.01 * dx[effect.at]
            attached["up" if k < 400 else "down", round(angle, 3)] = x[effect.at]
        assert attached["up", 0.075] > 0.8
        assert attached["up", 0.12] < 0.05
        assert attached["down", 0.075] < attached["up", 0.075] - 0.3
        assert attached["down", 0.03] > 0.9

    def test_separated_half_wing_drops(self) -> None:
        effect = EFFECTS["stall_separation"]()
        plant, m, x, _ = at_state(effect)
        x[effect.at + 1] = 0.2
        stalled, _ = motion_of(plant, x, level_state(plant)[1])
        assert stalled.Cl > m.Cl + 0.005  # right half lost its lift
        assert stalled.CL < m.CL

    def test_cross_wind_burst_lasts_three_seconds(self) -> None:
        effect = EFFECTS["shear_burst"]()
        plant = plain_plant(effect)
        x, commands, _ = level_state(plant)
        effect.start(motion_of(plant, x, commands)[0], x)
        times = np.arange(0.0, 30.0, 0.01)
        gusts = np.array([plant.evaluate(float(t), x, commands, QUIET, [0.0] * plant.size).gust_v for t in times])
        assert np.abs(gusts).max() == pytest.approx(1.2, rel=1e-3)
        assert 2.8 < 0.01 * np.count_nonzero(np.abs(gusts) > 1e-6) <= 3.01

    def test_levelling_attitude_filter_forgets_a_steady_turn(self) -> None:
        effect = EFFECTS["ahrs_turn_error"]()
        plant = plain_plant(effect)
        x, commands, _ = level_state(plant)
        effect.start(motion_of(plant, x, commands)[0], x)
        x[6], x[7] = math.cos(0.2), math.sin(0.2)  # banked 0.4 rad, no side force: apparent vertical is the wings' own
        x[8] = x[9] = 0.0
        m, dx = motion_of(plant, x, commands)
        assert dx[effect.at] == pytest.approx(-0.5 * (0.4 - math.atan2(-m.ay, -m.az)), rel=1e-6)
        assert dx[effect.at] < -0.15

    def test_warming_unit_drifts_towards_its_final_bias(self) -> None:
        effect = EFFECTS["thermal_drift"]()
        plant = plain_plant(effect)
        x, commands, _ = level_state(plant)
        shown = [
            sensed(effect, plant.evaluate(t, x, commands, QUIET, [0.0] * plant.size), x).p for t in (0.0, 12.0, 1e3)
        ]
        assert shown == pytest.approx([0.0, 0.025 * (1 - math.exp(-1.0)), 0.025])


def test_rough_air_has_its_level_and_shear_its_slope() -> None:
    gust, shear = EFFECTS["gust"](), EFFECTS["wind_shear"]()
    plant = plain_plant(gust, shear)
    x, commands, _ = level_state(plant)
    m, _ = motion_of(plant, x, commands)
    gust.start(m, x)
    shear.start(m, x)
    lateral = [plant.evaluate(t, x, commands, QUIET, [0.0] * plant.size).gust_v for t in np.arange(0.0, 200.0, 0.05)]
    assert np.std(lateral) / 17.0 == pytest.approx(gust.size, rel=0.12)
    x[12] -= 2.0
    assert motion_of(plant, x, commands)[0].wind_north == pytest.approx(-0.15 * 2.0)  # from the north, growing upwards


def test_effects_with_memory_are_the_same_alone_and_in_a_crowd() -> None:
    names = (
        "aileron_delay", "rudder_delay", "aileron_backlash", "rudder_backlash", "stale_vane", "vane_friction",
        "vortex_hysteresis", "shear_burst", "time_skew", "supply_sag", "gust", "wind_shear", "stall_separation",
    )  # fmt: skip
    scenario = scenario_from({"flight": {"duration_s": 2.0}, "hidden": [{"name": n} for n in names]}, "here")
    stronger = scenario.altered(hidden=[{"name": n, "size": 1.3} for n in names])
    crowd = simulate_many([stronger, scenario, scenario], [7, 8, 9], crowd_from=1)
    alone = simulate_truth(scenario, 9)
    for name, values in alone.items():
        np.testing.assert_allclose(crowd[2][name], values, atol=1e-7, err_msg=name)


@pytest.mark.parametrize("name", sorted(EFFECTS))
def test_every_effect_starts_and_steps_without_losing_the_aircraft(name: str) -> None:
    effect = EFFECTS[name]()
    plant = plain_plant(effect)
    x, commands, _ = level_state(plant)
    effect.start(motion_of(plant, x, commands)[0], x)
    held = Commands(commands.left - 0.05, commands.right + 0.05, 0.04, commands.throttle)
    for k in range(60):
        x = plant.step(k * 0.005, x, held, QUIET, 0.005)
        effect.commit(plant.evaluate((k + 1) * 0.005, x, held, QUIET, [0.0] * plant.size), x)
    m, _ = motion_of(plant, x, held)
    shown = sensed(effect, m, x)
    assert all(math.isfinite(v) for v in x)
    assert math.isfinite(shown.beta)
    assert 15.0 < m.V < 19.0
