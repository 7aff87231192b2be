"""Effects of the pitching plane and across planes: offered where they belong, nothing at no effect, right in size."""

import math
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from estimation.answers.designs import with_effects
from estimation.engine.simulate import simulate
from estimation.engine.transforms import apply_transforms
from estimation.errors import EstimationError
from estimation.gap.effects import catalogue
from estimation.gap.effects.base import Effect, Form
from estimation.models.base import InputTransform, Model
from estimation.models.expressions import FUNCTIONS, evaluate
from estimation.models.load import load_model
from estimation.prepare.flight_data import FlightData, Segment

LONGITUDINAL = """CL_alphadot Cm_alphadot downwash_lag CL_alpha2 CL_alpha3 Cm_alpha2 Cm_alpha3 stall_separation stall_hysteresis
CL_de3 Cm_de3 Cm_alpha_de CD_CL CD_alpha4 CD_de2 CD_q ground_effect wing_compliance thrust_z thrust_tilt thrust_scale mass_error
thrust_lag propwash_elevator propwash_CL elevator_delay elevator_lag elevator_deadzone elevator_backlash elevator_rate_limit
elevator_compliance alpha_scale alpha_bias alpha_position alpha_lag V_scale V_alpha imu_x imu_z imu_tilt q_scale theta_lag
rho_error Iyy_error cg_x pitch_inertial_coupling gust""".split()
CROSS = """Cm_beta2 CL_beta2 CD_beta2 CL_da2 CD_da2 Cm_da2 Cl_alpha_da Cn_alpha_da Cn_alpha_dr Cl_alpha_p Cn_alpha_p
pitch_inertial_coupling prop_gyroscopic""".split()
moved = partial(simulate, compile_="never")  # each model is asked once: compiling it would take longest
PITCHING, ALL_AXES = load_model("longitudinal", "cdfp"), load_model("six-dof", "cdfp")
MOTION = {
    "V": 16.0, "alpha": 0.13, "beta": 0.06, "theta": 0.11, "phi": 0.2, "p": 0.4, "q": 0.5, "r": -0.3, "ay": 0.4, "rho": 1.17,
    "thrust": 6.0, "delta_e": 0.04, "delta_a": -0.07, "delta_r": 0.05, "height": 1.0,
}  # fmt: skip


def effect(name: str, model: Model = PITCHING) -> Effect:
    return next(e for e in catalogue(model=model) if e.name == name)


def at_motion(model: Model, **values: float) -> dict[str, float]:
    """Every line of a model at one motion, by plain arithmetic on its text: another way than the engine's compiled one."""
    known = {**model.constants, **model.starts(), **MOTION, **values}
    functions = {
        n: getattr(math, n, None) or {"abs": abs, "min": min, "max": max, "sign": np.sign, "where": np.where}[n]
        for n in FUNCTIONS
    }
    waiting = dict(model.definitions)
    while waiting:
        for name, text in list(waiting.items()):
            try:
                known[name] = float(evaluate(text, known, functions))
            except KeyError:
                continue
            del waiting[name]
            break
        else:
            raise AssertionError(f"lines {list(waiting)} go in a circle")
    return known


def changed(
    name: str, size: dict[str, float], model: Model = PITCHING, form: int = 0
) -> tuple[dict[str, float], dict[str, float]]:
    """All lines with an effect of a size, and without it."""
    chosen = effect(name, model).forms[form]
    return at_motion(chosen.added_to(model, size), **size), at_motion(model)


def moving(model: Model, samples: int = 40) -> FlightData:
    """A made-up flight in which everything moves a little about the motion above."""
    rng = np.random.default_rng(3)
    t = np.arange(samples) / 20.0
    u = np.column_stack(
        [MOTION.get(n, 0.0) * (1 + 0.05 * np.sin(3.0 * t + rng.uniform(0, 6))) for n in model.input_names]
    )
    x0 = np.array([MOTION.get(s.name, MOTION.get(str(s.start), 0.0)) for s in model.states])
    segment = Segment(0, t, u, np.full((samples, len(model.outputs)), np.nan), x0)
    return FlightData("made up", samples, (segment,), np.zeros((samples, 0)), {}, (), ())


def test_every_model_is_asked_for_the_effects_of_its_own_axes() -> None:
    lateral = [e.name for e in catalogue()]
    assert [e.name for e in catalogue(model=load_model("lateral", "cdfp"))] == lateral
    assert [e.name for e in catalogue(model=load_model("lateral-simple", "cdfp"))] == lateral
    assert [e.name for e in catalogue(model=PITCHING)] == LONGITUDINAL
    assert {e.name for e in catalogue(model=ALL_AXES)} == {*lateral, *LONGITUDINAL, *CROSS}


def test_what_couples_the_planes_is_asked_only_of_a_model_that_has_both() -> None:
    for name in CROSS[:-2]:
        for form in effect(name, ALL_AXES).forms:
            assert form.obstacle(ALL_AXES) is None
            assert form.obstacle(PITCHING) is not None
            assert form.obstacle(load_model("lateral", "cdfp")) is not None


def forms_of(model: Model) -> list[tuple[str, Form]]:
    return [(e.name, f) for e in catalogue(model=model) for f in e.applicable(model)]


BOUNDED = (
    "stall_separation",
    "indicial_lag",
    "ground_effect",
    "surface_compliance",
    "wing_compliance",
    "elevator_compliance",
)
"""Effects of which nature has no more: flow that lies or has left, a surface that gives way wholly, a wing near
the ground, lift that comes within a few chords."""


@pytest.mark.parametrize(("model", "largest"), [(ALL_AXES, 8.0), (PITCHING, 8.0)], ids=["six-dof", "longitudinal"])
def test_an_effect_eight_times_its_usual_size_lies_within_its_limits(model: Model, largest: float) -> None:
    """One at its limit is refused as impossible: what is named when small was not when large."""
    near = {
        (name, p.name)
        for name, form in forms_of(model)
        for p in form.parameters
        if max(p.upper - p.null_value(model), p.null_value(model) - p.lower) < 1.05 * largest * p.typical
    }
    assert {name for name, _ in near} <= set(BOUNDED), sorted(near)


@pytest.mark.parametrize(
    ("name", "form"),
    [*forms_of(PITCHING), *((n, f) for n, f in forms_of(ALL_AXES) if n in CROSS)],
    ids=lambda v: v if isinstance(v, str) else v.label,
)
def test_every_form_is_nothing_at_no_effect(name: str, form: Form) -> None:
    model = ALL_AXES if name in CROSS else PITCHING
    added = form.added_to(model)
    if any(p.lower > p.null_value(model) for p in form.parameters):
        assert name in ("alpha_lag", "theta_lag")  # a lag of a state has no value at which it is nothing
        return
    flight = moving(added)
    columns = [added.input_names.index(n) for n in model.input_names]
    s = flight.segments[0]
    cut = replace(flight, segments=(replace(s, u=np.ascontiguousarray(s.u[:, columns]), x0=s.x0[: len(model.states)]),))
    np.testing.assert_allclose(moved(added, flight), moved(model, cut), rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize(
    ("name", "line", "expected"),
    [
        ("CL_alpha2", "CL", lambda k, m: k * 0.03**2),
        ("CL_alpha3", "CL", lambda k, m: k * 0.03**3),
        ("Cm_alpha2", "Cm", lambda k, m: k * 0.03**2),
        ("Cm_alpha3", "Cm", lambda k, m: k * 0.03**3),
        ("CL_de3", "CL", lambda k, m: k * 0.04**3),
        ("Cm_de3", "Cm", lambda k, m: k * 0.04**3),
        ("Cm_alpha_de", "Cm", lambda k, m: k * 0.03 * 0.04),
        ("CD_CL", "CD", lambda k, m: k * m["CL"]),
        ("CD_alpha4", "CD", lambda k, m: k * 0.13**4),
        ("CD_de2", "CD", lambda k, m: k * 0.04**2),
        ("CD_q", "CD", lambda k, m: k * 0.5 * 0.61 / 32.0),
        ("wing_compliance", "CL", lambda k, m: -k * (m["q_dyn"] / 200 - 1) * 3.0 * 0.13),
        ("elevator_compliance", "Cm", lambda k, m: -k * (m["q_dyn"] / 200 - 1) * -0.36 * 0.04),
        ("thrust_z", "Cm", lambda k, m: k * 6.0 / (m["q_dyn"] * 0.787 * 0.61)),
        ("thrust_tilt", "az", lambda k, m: -6.0 * math.sin(k) / 3.5),
        ("thrust_tilt", "ax", lambda k, m: 6.0 * (math.cos(k) - 1.0) / 3.5),
        ("thrust_scale", "ax", lambda k, m: k * 6.0 / 3.5),
        ("propwash_elevator", "Cm", lambda k, m: k * 6.0 / (m["q_dyn"] * 0.787) * -0.36 * 0.04),
        ("propwash_CL", "CL", lambda k, m: k * 6.0 / (m["q_dyn"] * 0.787) * 3.0 * 0.13),
        ("ground_effect", "CD", lambda k, m: -k * 0.24 * m["CL"] ** 2 / (1 + (16.0 / 1.5) ** 2)),
        ("Cm_alphadot", "Cm", lambda k, m: k * m["alpha_dot"] * 0.61 / 32.0),
        ("cg_x", "Cm", lambda k, m: k / 0.61 * m["CZ"]),
        ("rho_error", "q_dyn", lambda k, m: (k - 1) * 0.5 * 1.17 * 16.0**2),
    ],
)
def test_a_form_adds_what_its_formula_says(name: str, line: str, expected) -> None:  # type: ignore[no-untyped-def]
    parameter = effect(name).forms[0].parameters[0]
    size = parameter.null_value(PITCHING) + parameter.typical
    with_it, plain = changed(name, {parameter.name: size})
    assert with_it[line] - plain[line] == pytest.approx(expected(size, plain), rel=1e-9, abs=1e-15)
    assert abs(expected(size, plain)) > 1e-7


@pytest.mark.parametrize(
    ("name", "line", "expected"),
    [
        ("Cm_beta2", "Cm", lambda k: k * 0.06**2),
        ("CL_beta2", "CL", lambda k: k * 0.06**2),
        ("CD_beta2", "CD", lambda k: k * 0.06**2),
        ("Cm_da2", "Cm", lambda k: k * 0.07**2),
        ("CL_da2", "CL", lambda k: k * 0.07**2),
        ("CD_da2", "CD", lambda k: k * 0.07**2),
        ("Cl_alpha_da", "Cl", lambda k: k * 0.03 * -0.07),
        ("Cn_alpha_da", "Cn", lambda k: k * 0.03 * -0.07),
        ("Cn_alpha_dr", "Cn", lambda k: k * 0.03 * 0.05),
        ("Cl_alpha_p", "Cl", lambda k: k * 0.03 * 0.4 * 1.5 / 32.0),
        ("Cn_alpha_p", "Cn", lambda k: k * 0.03 * 0.4 * 1.5 / 32.0),
        ("prop_gyroscopic", "Cn", lambda k: k * 0.5 / (0.5 * 1.17 * 256 * 0.787 * 1.5)),
        ("prop_gyroscopic", "Cm", lambda k: k * 0.3 / (0.5 * 1.17 * 256 * 0.787 * 0.61)),
    ],
)
def test_a_form_across_the_axes_adds_what_its_formula_says(name: str, line: str, expected) -> None:  # type: ignore[no-untyped-def]
    parameter = effect(name, ALL_AXES).forms[0].parameters[0]
    with_it, plain = changed(name, {parameter.name: parameter.typical}, ALL_AXES)
    # drag contains the square of lift: what an effect adds to lift is not counted as drag of its own
    assert with_it[line] - plain[line] == pytest.approx(expected(parameter.typical), rel=1e-9)


def test_lift_from_the_rate_of_angle_of_attack_is_solved_with_the_rate_that_it_changes() -> None:
    with_it, plain = changed("CL_alphadot", {"CL_alphadot": 4.0})
    added = with_it["CL"] - plain["CL"]
    assert added == pytest.approx(4.0 * with_it["alpha_dot"] * 0.61 / 32.0, rel=1e-9)
    assert abs(with_it["alpha_dot"]) < 0.95 * abs(plain["alpha_dot"])  # and not with the rate that would be without it


def test_readings_of_instruments_follow_rigid_body_kinematics() -> None:
    """An accelerometer at r feels a + dw/dt x r + w x (w x r), turned by its mounting; a vane there the wind of w x r."""
    plain = at_motion(PITCHING)
    spin, spin_up = np.array([0.4, 0.5, -0.3]), np.array([0.0, plain["q_dot"], 0.0])
    at_cg = np.array([plain["ax"], 0.4, plain["az"]])
    for name, arm in (("imu_x", [0.08, 0.0, 0.0]), ("imu_z", [0.0, 0.0, 0.08])):
        shown = changed(name, {name: 0.08})[0]
        felt = at_cg + np.cross(spin_up, arm) + np.cross(spin, np.cross(spin, arm))
        assert (shown["ax_measured"], shown["az_measured"]) == pytest.approx((felt[0], felt[2]), rel=1e-9)
    shown = changed("imu_tilt", {"imu_tilt": 0.02})[0]
    x_axis, z_axis = np.array([math.cos(0.02), -math.sin(0.02)]), np.array([math.sin(0.02), math.cos(0.02)])
    assert shown["ax_measured"] == pytest.approx(x_axis @ at_cg[[0, 2]])
    assert shown["az_measured"] == pytest.approx(z_axis @ at_cg[[0, 2]])
    wind = np.cross(spin, [0.4, 0.0, 0.0])[2], np.cross(spin, [0.0, 0.4, 0.0])[2]
    for form, moved in enumerate(wind):
        name = ("x_alpha_vane", "y_alpha_vane")[form]
        shown = changed("alpha_position", {name: 0.4}, form=form)[0]
        assert shown["alpha_measured"] - 0.13 == pytest.approx(moved / 16.0)


@pytest.mark.parametrize(
    ("name", "value", "carried"),
    [
        ("Iyy_error", {"Iyy": 0.276}, dict.fromkeys(("Cm_0", "Cm_alpha", "Cm_q", "Cm_de"), 1.2)),
        (
            "rho_error",
            {"rho_factor": 1.1},
            {
                **dict.fromkeys(
                    ("CL_0", "CL_alpha", "CL_q", "CL_de", "CD_0", "Cm_0", "Cm_alpha", "Cm_q", "Cm_de"), 1 / 1.1
                ),
                "CD_k": 1.1,
            },
        ),
    ],
)
def test_what_is_said_to_be_carried_by_derivatives_is(
    name: str, value: dict[str, float], carried: dict[str, float]
) -> None:
    chosen = effect(name)
    assert chosen.tied_to
    started = {n: PITCHING.starts()[n] * factor for n, factor in carried.items()}
    with_it = chosen.forms[0].added_to(PITCHING, value).with_starts(started)
    flight = moving(PITCHING)
    for rate in ("p", "r"):  # in rolling turns their product tells the moment of inertia
        flight.segments[0].u[:, PITCHING.input_names.index(rate)] = 0.0
    np.testing.assert_allclose(moved(with_it, flight), moved(PITCHING, flight), rtol=1e-9, atol=1e-12)


def test_mass_and_thrust_are_one_unknown() -> None:
    """A heavier aircraft with stronger derivatives flies as the lighter one with less thrust."""
    heavier = effect("mass_error").forms[0].added_to(PITCHING, {"m": 3.5 * 1.1})
    names = ("CL_0", "CL_alpha", "CL_q", "CL_de", "CD_0")
    heavier = heavier.with_starts(
        {**{n: 1.1 * PITCHING.starts()[n] for n in names}, "CD_k": PITCHING.starts()["CD_k"] / 1.1}
    )
    weaker = effect("thrust_scale").forms[0].added_to(PITCHING, {"thrust_scale": 1 / 1.1 - 1})
    flight = moving(PITCHING)
    np.testing.assert_allclose(moved(heavier, flight), moved(weaker, flight), rtol=1e-9, atol=1e-12)


def test_a_design_may_separate_effects_of_the_models_own_axes() -> None:
    made, sizes = with_effects(PITCHING, ("thrust_z", "elevator_delay"))
    assert sizes == {"thrust_z": 0.02, "elevator_delay": 0.04}
    assert {"thrust_z", "elevator_delay"} <= set(made.free_names)
    with pytest.raises(EstimationError, match="Cn_da: neither"):
        with_effects(PITCHING, ("thrust_z", "Cn_da"))


def test_downwash_is_asked_of_an_aircraft_with_a_tail_and_looks_like_its_derivative() -> None:
    (form,) = effect("downwash_lag").forms
    tailed = replace(PITCHING, constants={**PITCHING.constants, "tail_arm": 0.8})
    assert "tail_arm" in (form.obstacle(PITCHING) or "")
    late = at_motion(form.added_to(tailed), downwash_moment=0.3, alpha_wake=0.11)
    assert late["alpha_wake_dot"] == pytest.approx(0.02 * 16.0 / 0.8)
    assert late["Cm"] - at_motion(PITCHING)["Cm"] == pytest.approx(0.3 * -0.02)


def test_hysteresis_is_asked_of_a_model_that_separates() -> None:
    separating = effect("stall_separation").forms[0].added_to(PITCHING, {"k_separation": 1.0})
    (form,) = effect("stall_hysteresis").forms
    assert form.obstacle(PITCHING) is not None
    attached, separated = (
        at_motion(form.added_to(separating), stall_hysteresis=0.05, alpha=0.19, separation=x) for x in (0.0, 1.0)
    )
    # going up through 0.19 rad the flow stays, coming down it has not returned
    assert 0.15 * attached["separation_dot"] == pytest.approx(0.5 * (1 + math.tanh(25 * -0.02)))
    assert 0.15 * separated["separation_dot"] == pytest.approx(0.5 * (1 + math.tanh(25 * 0.03)) - 1.0)


def test_a_rate_limit_touches_large_steps_only() -> None:
    time = np.arange(8) / 20.0
    steps = np.column_stack([np.where(time > 0.1, 0.2, 0.0)])
    limit = (InputTransform("rate_limit", "delta_e", ("k",)),)
    done = apply_transforms(limit, ("delta_e",), time, steps, {"k": 0.5})[:, 0]
    np.testing.assert_allclose(done, [0.0, 0.0, 0.0, 0.1, 0.2, 0.2, 0.2, 0.2], atol=1e-12)
    np.testing.assert_array_equal(apply_transforms(limit, ("delta_e",), time, steps, {"k": 0.0}), steps)
    np.testing.assert_array_equal(
        apply_transforms(limit, ("delta_e",), time, 0.1 * steps, {"k": 0.5})[:, 0], 0.1 * steps[:, 0]
    )
