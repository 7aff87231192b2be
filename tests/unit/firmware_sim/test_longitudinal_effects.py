"""Hidden effects of the pitching plane and across planes: each does what its physics says, by numbers worked out here."""

import math
from collections.abc import Callable

import numpy as np
import pytest

from firmware_sim.physics.effects.registry import EFFECTS
from firmware_sim.physics.motion import Motion
from firmware_sim.physics.plant import ARMS
from firmware_sim.physics.plant import EFFECTS as EFFECT_STATES
from tests.unit.firmware_sim.plants import QUIET, level_state, motion_of, plain_plant
from tests.unit.firmware_sim.test_effects import at_state, sensed

AREA, CHORD, SPAN, DISC = 0.787, 0.61, 1.5, 0.0507
PULLED = {"q": 0.4, "left": 0.08, "right": 0.06, "v": 1.0, "p": 0.5, "r": 0.2, "rudder": 0.1}


def added(name: str, quantity: str, size: float = 1.0, climb: float = 0.0, **change: float) -> tuple[float, Motion]:
    """What an effect adds to a quantity at a motion with more downward speed `climb` [m/s], and the motion without it."""
    made = []
    for effect in (EFFECTS[name](size), None):
        plant = plain_plant(*([] if effect is None else [effect]))
        x, commands, _ = level_state(plant)
        if effect is not None:
            effect.start(motion_of(plant, x, commands)[0], x)
        places = {
            "v": 1,
            "w": 2,
            "p": 3,
            "q": 4,
            "r": 5,
            "left": ARMS,
            "right": ARMS + 1,
            "rudder": ARMS + 2,
            "down": 12,
        }
        for key, value in {**change, "w": climb}.items():
            x[places[key]] += value
        made.append(motion_of(plant, x, commands)[0])
    return getattr(made[0], quantity) - getattr(made[1], quantity), made[1]


def over(m: Motion) -> float:
    return float(m.alpha) - 0.086


@pytest.mark.parametrize(
    ("name", "quantity", "expected"),
    [
        ("CL_alpha2", "CL", lambda m: -4.0 * over(m) ** 2),
        ("CL_alpha3", "CL", lambda m: -15.0 * over(m) ** 3),
        ("Cm_alpha2", "Cm", lambda m: -0.4 * over(m) ** 2),
        ("Cm_alpha3", "Cm", lambda m: 2.0 * over(m) ** 3),
        ("CL_de3", "CL", lambda m: -3.0 * m.surface_e**3),
        ("Cm_de3", "Cm", lambda m: m.surface_e**3),
        ("Cm_alpha_de", "Cm", lambda m: 0.8 * over(m) * m.surface_e),
        ("CD_CL", "CD", lambda m: -0.03 * m.CL),
        ("CD_alpha4", "CD", lambda m: 8.0 * m.alpha**4),
        ("CD_de2", "CD", lambda m: 0.5 * m.surface_e**2),
        ("CD_q", "CD", lambda m: 0.2 * 0.4 * CHORD / (2 * m.V)),
        ("wing_compliance", "CL", lambda m: -0.15 * (m.qbar / 200 - 1) * 3.0 * m.alpha),
        ("propwash_CL", "CL", lambda m: 0.1 * m.thrust / (m.qbar * DISC) * 3.0 * m.alpha),
        ("propwash_elevator", "Cm", lambda m: 0.3 * m.thrust / (m.qbar * DISC) * -0.36 * m.surface_e),
        ("propwash_elevator", "CL", lambda m: 0.3 * m.thrust / (m.qbar * DISC) * m.surface_e),
        ("elevator_compliance", "surface_e", lambda m: -0.15 * (m.qbar / 200 - 1) * m.surface_e),
        ("elevator_compliance", "surface_a", lambda m: 0.0),
        ("thrust_z", "M", lambda m: 0.02 * m.thrust),
        ("thrust_tilt", "Z", lambda m: -m.thrust * math.sin(0.052)),
        ("thrust_tilt", "X", lambda m: m.thrust * (math.cos(0.052) - 1)),
        ("thrust_scale", "X", lambda m: 0.08 * m.thrust),
        ("Cm_beta2", "Cm", lambda m: 0.3 * m.beta**2),
        ("CL_beta2", "CL", lambda m: -1.0 * m.beta**2),
        ("CD_beta2", "CD", lambda m: 0.4 * m.beta**2),
        ("CL_da2", "CL", lambda m: 0.3 * m.surface_a**2),
        ("CD_da2", "CD", lambda m: 0.3 * m.surface_a**2),
        ("Cm_da2", "Cm", lambda m: 0.3 * m.surface_a**2),
        ("Cl_alpha_da", "Cl", lambda m: 0.2 * over(m) * m.surface_a),
        ("Cn_alpha_da", "Cn", lambda m: 0.1 * over(m) * m.surface_a),
        ("Cn_alpha_dr", "Cn", lambda m: 0.2 * over(m) * m.surface_r),
        ("Cl_alpha_p", "Cl", lambda m: over(m) * 0.5 * SPAN / (2 * m.V)),
        ("Cn_alpha_p", "Cn", lambda m: 0.3 * over(m) * 0.5 * SPAN / (2 * m.V)),
    ],
)
def test_an_effect_adds_what_its_formula_says(name: str, quantity: str, expected: Callable[[Motion], float]) -> None:
    amount, plain = added(name, quantity, climb=1.2, **PULLED)
    assert amount == pytest.approx(expected(plain), rel=1e-9, abs=1e-14)


@pytest.mark.parametrize("name", ["CL_alpha2", "CL_da2", "propwash_elevator", "propwash_CL"])
def test_what_adds_lift_pays_for_it_by_the_polar(name: str) -> None:
    lift, plain = added(name, "CL", climb=1.2, **PULLED)
    drag, _ = added(name, "CD", climb=1.2, **PULLED)
    assert drag == pytest.approx(0.24 * ((plain.CL + lift) ** 2 - plain.CL**2), rel=1e-9)


def test_ground_effect_is_mccormicks_at_a_height_of_half_a_span() -> None:
    amount, plain = added("ground_effect", "CD", down=60.0 - 0.75)
    assert plain.down == pytest.approx(-0.75)
    s = (16 * 0.75 / 1.5) ** 2
    assert amount == pytest.approx(0.24 * plain.CL**2 * (s / (1 + s) - 1))
    assert abs(added("ground_effect", "CD")[0]) < 1e-4  # nothing at 60 m


def rate_of(m: Motion) -> float:
    """Rate of angle of attack from the rates of the velocity, in still air."""
    return float((m.u * m.w_dot - m.w * m.u_dot) / (m.u**2 + m.w**2))


def test_lift_from_the_rate_of_angle_of_attack_stands_with_the_rate_it_leaves() -> None:
    effect = EFFECTS["CL_alphadot"](2.0)
    _, m, _, _ = at_state(effect, q=0.6, left=0.05, right=0.05)
    _, plain, _, _ = at_state(None, q=0.6, left=0.05, right=0.05)
    lift = plain.Z * math.cos(plain.alpha) - plain.X * math.sin(plain.alpha)
    lift -= m.Z * math.cos(m.alpha) - m.X * math.sin(m.alpha)
    assert lift == pytest.approx(m.qbar * AREA * 3.0 * rate_of(m) * CHORD / (2 * m.V), rel=1e-9)
    assert abs(rate_of(m)) < 0.95 * abs(rate_of(plain))


def test_moment_from_the_rate_of_angle_of_attack() -> None:
    amount, plain = added("Cm_alphadot", "M", q=0.6)
    assert amount == pytest.approx(m_per_rate(plain) * rate_of(plain), rel=1e-9)
    assert amount < -0.01  # it damps


def m_per_rate(m: Motion) -> float:
    return float(m.qbar * AREA * CHORD * -0.4 * CHORD / (2 * m.V))


@pytest.mark.parametrize(
    ("name", "channel", "expected"),
    [
        ("alpha_scale", "alpha", lambda m: 1.1 * m.alpha),
        ("alpha_bias", "alpha", lambda m: m.alpha + 0.0087),
        ("alpha_position", "alpha", lambda m: m.alpha - 0.4 * 0.4 / m.V),
        ("V_scale", "V", lambda m: 1.03 * m.V),
        ("V_alpha", "V", lambda m: m.V * (1 + 0.3 * over(m))),
        ("q_scale", "q", lambda m: 1.03 * 0.4),
    ],
)
def test_instrument_errors_bend_the_channel_they_name(
    name: str, channel: str, expected: Callable[[Motion], float]
) -> None:
    effect = EFFECTS[name]()
    _, m, x, _ = at_state(effect, **PULLED)
    assert getattr(sensed(effect, m, x), channel) == pytest.approx(expected(m), abs=1e-12)


@pytest.mark.parametrize(("name", "arm"), [("imu_x", (0.08, 0.0, 0.0)), ("imu_z", (0.0, 0.0, 0.08))])
def test_an_accelerometer_off_the_cg_feels_rigid_body_rotation(name: str, arm: tuple[float, float, float]) -> None:
    effect = EFFECTS[name]()
    _, m, x, _ = at_state(effect, **PULLED)
    spin, up = np.array([m.p, m.q, m.r]), np.array([m.p_dot, m.q_dot, m.r_dot])
    felt = np.array([m.ax, m.ay, m.az]) + np.cross(up, arm) + np.cross(spin, np.cross(spin, arm))
    shown = sensed(effect, m, x)
    assert (shown.ax, shown.az) == pytest.approx((felt[0], felt[2]))


def test_a_tilted_accelerometer_shows_part_of_the_weight_as_axial_force() -> None:
    effect = EFFECTS["imu_tilt"]()
    _, m, x, _ = at_state(effect)
    shown = sensed(effect, m, x)
    assert shown.ax - m.ax == pytest.approx(-m.az * 0.0175, rel=0.01)
    assert math.hypot(shown.ax, shown.az) == pytest.approx(math.hypot(m.ax, m.az))


@pytest.mark.parametrize(
    ("name", "size"), [("elevator_lag", 0.04), ("alpha_lag", 0.035), ("theta_lag", 0.04), ("thrust_lag", 0.2)]
)
def test_a_lag_moves_by_its_time_constant(name: str, size: float) -> None:
    effect = EFFECTS[name]()
    plant, _, x, _ = at_state(effect)
    x[effect.at] -= 0.02
    assert motion_of(plant, x, level_state(plant)[1])[1][EFFECT_STATES] == pytest.approx(0.02 / size)


def swung(name: str) -> tuple[np.ndarray, np.ndarray]:  # type: ignore[type-arg]
    """Arm and surface of the elevator, in a slow swing that begins at its arms' place."""
    effect = EFFECTS[name](1.0)
    plant = plain_plant(effect)
    x, commands, _ = level_state(plant)
    effect.start(motion_of(plant, x, commands)[0], x)
    arm, surface = [], []
    for k in range(1200):
        time = (k + 1) * 0.005
        x[ARMS], x[ARMS + 1] = (0.1 * math.sin(2 * math.pi * 0.5 * time) + a for a in (0.03, -0.03))
        m = plant.evaluate(time, x, commands, QUIET, [0.0] * plant.size)
        effect.commit(m, x)
        arm.append(0.5 * (x[ARMS] + x[ARMS + 1]))
        surface.append(m.surface_e)
        assert m.surface_a == pytest.approx(-0.03, abs=1e-12)  # the ailerons know nothing of it
    return np.array(arm[400:]), np.array(surface[400:])


def test_the_elevator_comes_late_rests_or_has_play() -> None:
    arm, surface = swung("elevator_delay")
    np.testing.assert_allclose(surface[5:], arm[:-5], atol=1e-9)
    arm, surface = swung("elevator_deadzone")
    np.testing.assert_allclose(surface, np.sign(arm) * np.maximum(np.abs(arm) - 0.0052, 0.0), atol=1e-12)
    arm, surface = swung("elevator_backlash")
    middle = np.abs(arm) < 0.05  # away from the turns, where the gap is being taken up
    rising, falling = middle & (np.gradient(arm) > 0), middle & (np.gradient(arm) < 0)
    np.testing.assert_allclose((arm - surface)[rising], 0.0052, atol=1e-9)
    np.testing.assert_allclose((arm - surface)[falling], -0.0052, atol=1e-9)


def test_a_slow_elevator_turns_no_faster_than_its_limit() -> None:
    arm, surface = swung("elevator_rate_limit")  # 0.31 rad/s at the most: within 2.5 rad/s it is not felt
    np.testing.assert_allclose(surface, arm, atol=1e-12)
    effect = EFFECTS["elevator_rate_limit"]()
    plant = plain_plant(effect)
    x, commands, _ = level_state(plant)
    effect.start(motion_of(plant, x, commands)[0], x)
    x[ARMS] += 0.2
    x[ARMS + 1] += 0.2
    start, shown = motion_of(plant, x, commands)[0].surface_e, []
    for k in range(1, 40):
        m = plant.evaluate(k * 0.005, x, commands, QUIET, [0.0] * plant.size)
        effect.commit(m, x)
        shown.append(m.surface_e - start)
    np.testing.assert_allclose(shown, np.minimum(np.arange(1, 40) * 0.005 / 0.4, 0.2), atol=1e-9)
