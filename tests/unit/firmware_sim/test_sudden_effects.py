"""Failures in the air: nothing before they begin, the closed form of each afterwards."""

import math

import pytest

from firmware_sim.physics.effects.registry import make_effects
from firmware_sim.physics.effects.sudden import BEGINS_S, ICES_S
from firmware_sim.physics.motion import Motion
from firmware_sim.physics.plant import ARMS, RATES
from tests.unit.firmware_sim.test_effects import QUIET, level_state, plain_plant, sensed

SINCE = BEGINS_S + ICES_S  # by then all of it is there


def seen(name: str | None, t: float) -> tuple[Motion, list[float]]:
    """The motion at a time, both elevons deflected, with the effect as if it had been there since the start."""
    effects = () if name is None else make_effects([(name, 1.0)])
    plant = plain_plant(*effects)
    x, trimmed, _ = level_state(plain_plant())
    x = [*x, *[0.0] * (plant.size - len(x))]
    rest = plant.evaluate(0.0, x, trimmed, QUIET, [0.0] * plant.size)
    for effect in effects:
        effect.start(rest, x)
    x[1] += 1.5  # slipping
    x[ARMS], x[ARMS + 1], x[RATES] = x[ARMS] - 0.1, x[ARMS + 1] + 0.1, 0.5  # rolling, arms apart
    x[ARMS + 2] += 0.08
    return plant.evaluate(t, x, trimmed, QUIET, [0.0] * plant.size), x


@pytest.mark.parametrize("name", ["elevon_stuck", "vane_slipped", "ice", "mass_shift"])
def test_nothing_is_wrong_before_it_begins(name: str) -> None:
    with_effect, x = seen(name, BEGINS_S - 0.1)
    plain, _ = seen(None, BEGINS_S - 0.1)
    for quantity in ("Cl", "Cn", "CY", "CD", "L", "N", "surface_right"):
        assert getattr(with_effect, quantity) == getattr(plain, quantity)
    (effect,) = make_effects([(name, 1.0)])
    assert sensed(effect, plain, x).beta == plain.beta


def test_stuck_elevon_stands_where_it_stood() -> None:
    jammed, _ = seen("elevon_stuck", SINCE)
    free, _ = seen(None, SINCE)
    assert jammed.surface_left == free.surface_left
    assert jammed.surface_right == pytest.approx(jammed.arm_right - 0.1)
    assert free.surface_right == free.arm_right


def test_slipped_vane_is_off_by_its_size() -> None:
    plain, x = seen(None, SINCE)
    (effect,) = make_effects([("vane_slipped", 1.0)])
    assert sensed(effect, plain, x).beta == pytest.approx(plain.beta + 0.03)


def test_ice_takes_its_share_of_control_and_damping_and_grows() -> None:
    plain, _ = seen(None, SINCE)
    iced, _ = seen("ice", SINCE)
    half, _ = seen("ice", BEGINS_S + 0.5 * ICES_S)
    d = plain_plant().derivatives
    expected = -0.3 * (d["Cl_da"] * plain.surface_a + d["Cl_p"] * plain.p_hat)
    assert iced.Cl - plain.Cl == pytest.approx(expected)
    assert half.Cl - plain.Cl == pytest.approx(0.5 * expected)
    assert pytest.approx(0.03) == iced.CD - plain.CD


def test_shifted_mass_rolls_towards_itself() -> None:
    """15 mm to starboard: the lift, left of it now, rolls the aircraft to the right; the drag yaws it to the left."""
    plain, _ = seen(None, SINCE)
    shifted, _ = seen("mass_shift", SINCE)
    assert pytest.approx(-0.015 * plain.Z) == shifted.L - plain.L
    assert shifted.L > plain.L
    assert pytest.approx(0.015 * plain.X) == shifted.N - plain.N
    assert math.isfinite(shifted.p_dot)


def test_a_fin_that_sticks_stands_where_it_stood_and_an_engine_that_stops_has_no_thrust() -> None:
    plain, _ = seen(None, SINCE)
    assert seen("rudder_stuck", BEGINS_S - 0.1)[0].surface_r == plain.surface_r
    assert seen("rudder_stuck", SINCE)[0].surface_r == pytest.approx(plain.arm_r - 0.08)
    assert plain.thrust > 0.5
    stopped, _ = seen("engine_out", SINCE)
    assert stopped.thrust == 0.0
    assert pytest.approx(plain.thrust) == plain.X - stopped.X
    assert seen("engine_out", BEGINS_S - 0.1)[0].thrust == plain.thrust


@pytest.mark.parametrize(("name", "signal", "change"), [("gyro_jumped", "r", 0.05), ("pitot_blocked", "V", -0.4)])
def test_an_instrument_that_fails_shows_something_else(name: str, signal: str, change: float) -> None:
    plain, x = seen(None, SINCE)
    before, _ = seen(None, BEGINS_S - 0.1)
    (effect,) = make_effects([(name, 1.0)])
    truth = getattr(plain, signal)
    expected = truth * (1.0 + change) if signal == "V" else truth + change
    assert getattr(sensed(effect, plain, x), signal) == pytest.approx(expected)
    assert getattr(sensed(effect, before, x), signal) == pytest.approx(truth)
