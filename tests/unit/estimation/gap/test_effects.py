"""The catalogue: complete, addable, extendable, and without effect at the value that means no effect."""

from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from estimation.answers.gaps import untested_effects
from estimation.engine.simulate import simulate
from estimation.errors import EffectError
from estimation.gap.effects import catalogue, load_effects
from estimation.gap.effects.base import EffectParameter, Form
from estimation.gap.effects.catalogue import missing_derivatives
from estimation.gap.records.candidate_model import awakened, with_dormant
from estimation.models.base import Model
from estimation.models.expressions import evaluate
from estimation.models.load import load_model, read_model, write_model
from estimation.models.numeric import FUNCTIONS
from estimation.prepare.flight_data import FlightData, Segment

moved = partial(simulate, compile_="never")  # each model is asked once: compiling it would take longest

NAMES = """CY_da Cn_da CY_p_r Cl_alpha_beta Cn_alpha_beta Cl_da_de Cl_beta3 Cn_beta3 CY_beta3 Cl_da3 Cn_dr3 Cl_p_abs_p
stall_separation Cl_betadot Cn_betadot indicial_lag p_sin_alpha roll_kinematics inertial_coupling Ixz_error lateral_cg
prop_gyroscopic motor_torque slipstream_rudder p_factor aileron_delay rudder_delay aileron_lag rudder_lag servo_delay servo_lag
aileron_deadzone aileron_backlash rudder_backlash surface_compliance beta_scale beta_bias beta_lag vane_position
imu_lever_arm gyro_misalignment gyro_scale attitude_lag airspeed_scale time_skew gust wind_shear""".split()


def still(model: Model, samples: int = 60) -> FlightData:
    """A short made-up flight with everything moving a little."""
    rng = np.random.default_rng(3)
    t = np.arange(samples) / 20.0
    base = {"V": 17.0, "rho": 1.17, "alpha": 0.09, "theta": 0.09, "thrust": 5.0, "az": -9.8, "ax": 1.0}
    u = np.column_stack([base.get(n, 0.0) + 0.03 * np.sin(3.0 * t + rng.uniform(0, 6)) for n in model.input_names])
    z = np.full((samples, len(model.outputs)), np.nan)
    segment = Segment(0, t, u, z, np.full(len(model.states), 0.02))
    return FlightData("made up", samples, (segment,), np.zeros((samples, 0)), {}, (), ())


def test_every_fixed_name_is_there_once() -> None:
    assert [e.name for e in catalogue()] == NAMES


@pytest.mark.parametrize("effect", [e for e in catalogue() if e.forms], ids=lambda e: e.name)
def test_every_form_applies_somewhere_and_is_nothing_at_no_effect(effect) -> None:  # type: ignore[no-untyped-def]
    applied = 0
    for name in ("lateral", "lateral-simple", "longitudinal"):
        model = load_model(name, "cdfp")
        if effect.name == "CY_p_r" and "CY" in model.definitions:
            model = without(without(model, "CY_p", "p_hat"), "CY_r", "r_hat")
        for form in effect.applicable(model):
            applied += 1
            if form.states:
                continue  # a lag has no value at which it is nothing
            added = form.added_to(model)
            plain, flight = model, still(added)
            columns = [added.input_names.index(n) for n in plain.input_names]
            cut = FlightData("cut", 60, (replace_inputs(flight.segments[0], columns),), flight.states, {}, (), ())
            np.testing.assert_allclose(moved(added, flight), moved(plain, cut), rtol=1e-9, atol=1e-12)
    assert applied


def replace_inputs(segment: Segment, columns: list[int]) -> Segment:
    return Segment(segment.first, segment.time, np.ascontiguousarray(segment.u[:, columns]), segment.z, segment.x0)


def without(model: Model, parameter: str, regressor: str) -> Model:
    """`model` without one derivative."""
    from dataclasses import replace

    lines = tuple(line.replace(f" + {parameter}*{regressor}", "") for line in model.equations)
    return replace(model, equations=lines, parameters=tuple(p for p in model.parameters if p.name != parameter))


def test_missing_derivatives_become_hypotheses() -> None:
    model = without(load_model("lateral", "cdfp"), "Cl_dr", "delta_r")
    assert [e.name for e in missing_derivatives(model, set(NAMES))] == ["Cl_dr"]
    held = load_model("lateral", "cdfp").fixed(Cn_p=0.0)
    (effect,) = missing_derivatives(held, set(NAMES))
    assert effect.name == "Cn_p"
    assert "Cn_p" in effect.forms[0].added_to(held).free_names


def test_two_changes_of_one_instrument_add_up() -> None:
    """A scaled vane that also lags still shows its scale when the motion is steady."""
    effects = {e.name: e for e in catalogue()}
    model = (
        effects["beta_lag"]
        .forms[0]
        .added_to(effects["beta_scale"].forms[0].added_to(load_model("lateral", "cdfp")), {"beta_lag": 0.1})
    )
    flight = still(model)
    y0 = simulate(model, flight, {"beta_scale": 0.0})[0, 0]
    assert simulate(model, flight, {"beta_scale": 0.5})[0, 0] == pytest.approx(1.5 * y0)


def test_an_awakened_form_equals_the_form_added() -> None:
    model = load_model("lateral", "cdfp")
    effects = catalogue()
    asleep = with_dormant(model, effects, frozenset(model.input_names))
    for name, value in (("Cn_da", -0.01), ("Cl_beta3", 1.0), ("aileron_delay", 0.06), ("airspeed_factor", 1.05)):
        form = next(f for e in effects for f in e.forms if f.parameters[0].name == name)
        one, two = awakened(asleep, form, {name: value}), form.added_to(model, {name: value})
        flight = still(two)
        wide = np.zeros((60, len(one.inputs)))
        for j, n in enumerate(one.input_names):
            if n in two.input_names:
                wide[:, j] = flight.segments[0].u[:, two.input_names.index(n)]
        s = flight.segments[0]
        both = FlightData("both", 60, (Segment(0, s.time, wide, s.z, s.x0),), flight.states, {}, (), ())
        np.testing.assert_allclose(moved(one, both), moved(two, flight), rtol=1e-9, atol=1e-12)


def test_an_effect_of_ones_own_in_a_short_file(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(
        """[[effect]]
name = "Cl_r_abs_r"
title = "roll due to yaw, nonlinear"
group = "aerodynamic nonlinearity"
[[effect.form]]
label = "odd"
terms = { Cl = "Cl_r_abs_r*r_hat*abs(r_hat)" }
parameters = [{ name = "Cl_r_abs_r", unit = "1/rad2", typical = 0.5, lower = -5.0, upper = 5.0 }]
[[effect.form]]
equation = "C_l = ... + k r̂²"
terms = { Cl = "Cl_r2*r_hat^2" }
parameters = [{ name = "Cl_r2", unit = "1/rad2", typical = 0.5, lower = -5.0, upper = 5.0 }]
""",
        encoding="utf-8",
    )
    (mine,) = load_effects(path)
    assert [(f.label, f.equation) for f in mine.forms] == [("odd", ""), ("Cl_r_abs_r", "C_l = ... + k r̂²")]
    lateral = load_model("lateral", "cdfp")
    model = mine.applicable(lateral)[0].added_to(lateral, {"Cl_r_abs_r": 0.5})
    assert model.parameter("Cl_r_abs_r").start == 0.5
    write_model(model, tmp_path / "child.toml")
    assert read_model(tmp_path / "child.toml").definitions == model.definitions


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "[[effect]]"),
        ('[[effect]]\nname="a"\ntitle="b"\n', "[[effect.form]]"),
        ("x = [", "not a TOML file"),
        ('[[effect]]\nname="a"\ntitel="b"\n', "effect 'a': the key 'title' is missing; did you mean titel?"),
        ('[[effect]]\nname="a"\ntitle="b"\n[[effect.form]]\n', "the key 'parameters' is missing"),
        (
            '[[effect]]\nname="a"\ntitle="b"\n' + "[[effect.form]]\nparameters=[]\n" * 2,
            "effect 'a': two forms are called 'a'; give each a label",
        ),
        (
            '[[effect]]\nname="a"\ntitle="b"\n[[effect.form]]\nparameters=[]\noptional=["w"]\n[effect.form.outputs]\nq="2*q"\n',
            "optional 'w' is none of the form's outputs",
        ),
        (
            '[[effect]]\nname="a"\ntitle="b"\n[[effect.form]]\nparameters=[]\n' * 2,
            "two effects are called 'a'; give each a name of its own",
        ),
    ],
)
def test_a_bad_effect_file_says_what_is_wrong(tmp_path: Path, text: str, words: str) -> None:
    path = tmp_path / "bad.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(EffectError, match=words.replace("[", r"\[")):
        load_effects(path)


def test_a_device_shows_a_model_what_the_model_asks_of_it() -> None:
    """A late pitch gyro that also shows roll: both, one, or nothing to change."""
    form = Form(
        "late", (EffectParameter("t", "s", 0.05, -0.3, 0.3),), output_delays={"p": "t", "q": "t"}, optional=("p", "q")
    )
    delayed = {
        n: set(form.added_to(load_model(n, "cdfp")).output_delays) for n in ("six-dof", "lateral", "longitudinal")
    }
    assert delayed == {"six-dof": {"p", "q"}, "lateral": {"p"}, "longitudinal": {"q"}}
    elsewhere = replace(form, output_delays={"alpha": "t"}, optional=("alpha",))
    assert elsewhere.obstacle(load_model("lateral", "cdfp")) == "the model has no alpha"


@pytest.mark.parametrize(("label", "pair"), [("about y", ("p", "r")), ("about x", ("r", "q"))])
def test_a_gyro_turned_in_its_mount_shows_rates_turned_and_not_longer(label: str, pair: tuple[str, str]) -> None:
    """Turned by 14 deg it had needed a scale of the gyro beside it."""
    effect = next(e for e in catalogue() if e.name == "gyro_misalignment")
    form = next(f for f in effect.forms if f.label == label)
    rates = {"p": 0.7, "q": -0.2, "r": 0.4, form.parameters[0].name: 0.24}
    shown = [float(evaluate(form.outputs[n], rates, FUNCTIONS)) for n in pair]
    assert np.hypot(*shown) == pytest.approx(np.hypot(*(rates[n] for n in pair)))
    assert shown[0] == pytest.approx(rates[pair[0]] - 0.24 * rates[pair[1]], abs=0.03)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("raise RuntimeError('boom')", "cannot be run: RuntimeError: boom"),
        ("EFFECTS = (", "cannot be run: SyntaxError"),
        ("import nothing_of_that_name", "cannot be run: ModuleNotFoundError"),
        ("import sys; sys.exit(3)", "it ends Python"),
        ("EFFECTS = 5", "no tuple EFFECTS in it"),
        ("EFFECTS = (1, 2)", "EFFECTS holds 1, which is no Effect"),
    ],
)
def test_a_python_file_that_does_not_run_is_refused_with_its_name(tmp_path: Path, text: str, words: str) -> None:
    path = tmp_path / "mine.py"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(EffectError, match=words) as refused:
        load_effects(path)
    assert str(path) in str(refused.value)


def test_effects_of_ones_own_that_could_not_be_asked_are_named() -> None:
    """A misspelt signal had made an effect silently absent, and `no_gap` read as if it had been looked for."""
    details = {"cannot_tell": [{"effect": "b", "separate_by": ""}]}
    result = cast(Any, SimpleNamespace(scores={"a": 1.0}, steps=(), details=details))
    assert untested_effects({Path("mine.toml"): ["a", "b"]}, result) == []
    (words,) = untested_effects({Path("mine.toml"): ["a", "c", "d"], Path("more.toml"): ["b"]}, result)
    assert words.startswith("effects mine.toml: c, d not tested: a term needs a signal")
