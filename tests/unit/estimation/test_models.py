"""Models: text that is parsed and never evaluated, changes that make new models, classes of one's own."""

import math
from typing import Any, ClassVar

import numpy as np
import pytest

from estimation.aircraft import load_aircraft
from estimation.errors import AircraftError, ModelError
from estimation.models import InputTransform, Model, Parameter, Signal, load_model, read_model, write_model
from estimation.models.expressions import addends_in, evaluate, names_in, parse, without_addends_of
from estimation.models.library import BUILDERS
from estimation.models.own import model_from_class, sin, where

NUMPY = {"sin": np.sin, "cos": np.cos, "sqrt": np.sqrt, "where": lambda c, a, b: a if c else b, "max": max}


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("a + b*c^2", 1 + 2 * 9.0),
        ("-a**2", -1.0),
        ("2*pi", 2 * math.pi),
        ("where(a < b, a, b)", 1.0),
        ("max(a, c)/b", 1.5),
        ("sqrt(c*c)", 3.0),
    ],
)
def test_expression_values(text: str, value: float) -> None:
    assert evaluate(text, {"a": 1.0, "b": 2.0, "c": 3.0}, NUMPY) == pytest.approx(value)


@pytest.mark.parametrize(
    "text",
    [
        "__import__('os').system('true')", "a.b", "a[0]", "lambda: 1", "[a for a in b]", "a if b else c", "open('x')",
        "f'{a}'", "a and b", "sin(a, b)", "sin(x=a)", "where(a, b, c)", "'text'", "True", "a < b < c", "(" * 500, "1e999999 if",
        "a := 3", "*a", "a @ b", "a // b",
    ],
)  # fmt: skip
def test_nothing_but_arithmetic_is_read(text: str) -> None:
    with pytest.raises(ModelError):
        parse(text)


def test_names_leave_functions_and_numbers_out() -> None:
    assert names_in("sin(alpha)*p + pi*max(a, 2)") == {"alpha", "p", "a"}


@pytest.mark.parametrize(
    ("text", "addends"),
    [
        ("a - b*c + d", ("a", " - b*c", " + d")),
        ("(a + b) - (c)", ("(a + b)", " - (c)")),
        ("(a + b)", ("(a + b)",)),
        ("-(a+b) + (d - c)*e", ("-(a+b)", " + (d - c)*e")),
        ("1e-3*a + sin(b - c)", ("1e-3*a", " + sin(b - c)")),
    ],
)
def test_a_sum_is_cut_at_its_own_signs_alone(text: str, addends: tuple[str, ...]) -> None:
    assert addends_in(text) == addends


@pytest.mark.parametrize(
    ("text", "rest"),
    [("a + b*x/c - d", "a - d"), ("x*a+b", "b"), ("a -b*( x + 1)", "a"), ("x", "0"), ("a + b", "a + b")],
)
def test_addends_with_a_name_are_taken_out_however_they_are_written(text: str, rest: str) -> None:
    assert without_addends_of(text, "x") == rest


@pytest.mark.parametrize("name", sorted(BUILDERS))
def test_model_survives_a_file(name: str, tmp_path: Any) -> None:
    model = (
        load_model(name, "cdfp")
        .fixed("CY_0" if "lateral" in name else "CD_0")
        .with_prior(**{load_model(name, "cdfp").parameter_names[1]: (0.1, 0.2)})
    )
    write_model(model, tmp_path / "m.toml")
    again = read_model(tmp_path / "m.toml")
    assert again == model
    assert again.digest == model.digest


def test_model_file_with_everything(tmp_path: Any) -> None:
    model = (
        load_model("lateral", "cdfp")
        .with_biases("p")
        .plus(
            transforms=[InputTransform("delay", "delta_a", ("T",))],
            parameters=[Parameter("T", "s", 0.02, 0.0, 0.2), Parameter("skew", "s")],
            output_delays={"beta": "skew"},
        )
    )
    write_model(model, tmp_path / "m.toml")
    assert read_model(tmp_path / "m.toml") == model


def tiny(**changes: Any) -> Model:
    parts: dict[str, Any] = {
        "name": "tiny",
        "states": (Signal("x"),),
        "inputs": (Signal("u"),),
        "outputs": (Signal("x"),),
        "parameters": (Parameter("a"),),
        "equations": ("x_dot = a*x + u",),
    }
    return Model(**{**parts, **changes})


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"equations": ("x_dot = a*y",)}, "'y' in the line of 'x_dot' is defined nowhere"),
        ({"equations": ("y = 2",)}, "no line 'x_dot"),
        ({"equations": ("x_dot = y", "y = z", "z = y")}, "circle"),
        ({"equations": ("x_dot = u", "x_dot = 2*u")}, "defined twice"),
        ({"equations": ("x_dot == u",)}, "name = expression"),
        ({"parameters": (Parameter("u"),)}, "both input and parameter"),
        ({"parameters": (Parameter("a", start=2.0, upper=1.0),)}, "outside its limits"),
        ({"parameters": (Parameter("a", prior_mean=2.0),)}, "prior"),
        ({"parameters": (Parameter("2a"),)}, "2a"),
        ({"outputs": (Signal("y"),)}, "output 'y' has no line"),
        ({"transforms": (InputTransform("wobble", "u", ("a",)),)}, "no such kind"),
    ],
)
def test_wrong_models_are_refused_in_words(changes: dict[str, Any], said: str) -> None:
    with pytest.raises(ModelError, match=said):
        tiny(**changes)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("states = 3", "missing"),
        ("nonsense", "not a TOML file"),
        ('states=["x"]\noutputs=["x"]\nparameters=[{name="a", start="b"}]\nequations=["x_dot=a"]', "start = 'b'"),
        ('states=["x"]\noutputs=["x"]\nparameters=[]\nequations=["x_dot=__import__"]', "defined nowhere"),
        ('states=["x"]\noutputs=["x"]\nparameters=[]\nequations=["x_dot=1"]\ncolour=1', "unknown key 'colour'"),
        ('states=[{name="x", size=2}]\noutputs=["x"]\nparameters=[]\nequations=["x_dot=1"]', "unknown key 'size'"),
    ],
)
def test_wrong_model_files_name_file_and_key(text: str, said: str, tmp_path: Any) -> None:
    path = tmp_path / "m.toml"
    path.write_text(text)
    with pytest.raises(ModelError, match=said) as caught:
        read_model(path)
    assert "m.toml" in str(caught.value)


def test_plus_adds_terms_states_and_outputs() -> None:
    base = load_model("lateral", "cdfp")
    child = base.plus(
        name="child",
        terms={"Cn": "Cn_da*delta_a", "beta_dot": "-a - b"},
        parameters=[Parameter("Cn_da"), Parameter("a"), Parameter("b"), Parameter("T", "s", 0.1)],
        states=[Signal("vane", "rad", start="beta")],
        lines=["vane_dot = (beta - vane)/T"],
        outputs={"beta": "vane"},
    )
    assert child.definitions["Cn"].endswith("+ Cn_da*delta_a")
    assert child.definitions["beta_dot"].endswith("+ (-a - b)")
    assert child.definitions["beta_measured"] == "vane"
    assert "Cn_da" not in base.parameter_names


def test_output_changes_chain() -> None:
    model = (
        load_model("lateral", "cdfp")
        .with_biases("ay")
        .plus(outputs={"ay": "ay + x_imu*r_dot"}, parameters=[Parameter("x_imu", "m")])
    )
    assert model.definitions["ay_measured"] == "ay_shown0 + x_imu*r_dot"
    assert model.definitions["ay_shown0"] == "ay + bias_ay"


def test_a_parameter_may_take_the_place_of_a_constant() -> None:
    model = load_model("lateral", "cdfp").plus(parameters=[Parameter("Ixz", "kg m2", 0.008)])
    assert "Ixz" not in model.structure.remaining_constants
    assert "Ixz" in model.free_names


class Spring:
    """Damped spring with a limiter."""

    states: ClassVar = {"x": "m", "v": "m/s"}
    inputs: ClassVar = {"delta_a": "rad"}
    measured: ClassVar = {"x": "m", "a": "m/s2"}
    parameters: ClassVar = {"k": ("1/s2", 4.0), "c": ("1/s", 0.5, 0.0, 9.0), "g": "m/s2"}

    def derivatives(self, x: Any, u: Any, p: Any) -> dict[str, Any]:
        force = -p.k * sin(x.x) - p.c * x.v**3 + np.float64(2.0) * np.cos(u.delta_a)
        return {"v": where(force > 1.0, 1.0, force), "x": x.v}

    def outputs(self, x: Any, u: Any, p: Any, xdot: Any) -> list[Any]:
        return [x.x, xdot.v - (p.g - (x.x - 1) / 2)]


def test_a_class_becomes_an_ordinary_model() -> None:
    model = model_from_class(Spring)
    lines = dict(model.definitions)
    symbols: dict[str, Any] = {"x": 0.3, "v": -0.4, "delta_a": 0.1, "k": 4.0, "c": 0.5, "g": 2.0}
    symbols["x_dot"] = evaluate(lines["x_dot"], symbols, NUMPY)
    for name in (n for n in lines if n.startswith("common")):
        symbols[name] = evaluate(lines[name], symbols, NUMPY)
    symbols["v_dot"] = evaluate(lines["v_dot"], symbols, NUMPY)
    force = -4.0 * math.sin(0.3) - 0.5 * (-0.4) ** 3 + 2 * math.cos(0.1)
    assert symbols["v_dot"] == pytest.approx(min(force, 1.0))
    assert evaluate(lines["a"], symbols, NUMPY) == pytest.approx(min(force, 1.0) - (2.0 - (0.3 - 1) / 2))
    assert model.inputs[0].control
    assert model.parameter("c").upper == 9.0


def test_branching_in_a_class_is_refused() -> None:
    class Branching(Spring):
        def derivatives(self, x: Any, u: Any, p: Any) -> dict[str, Any]:
            return {"v": 1.0 if x.x > 0 else 0.0, "x": x.v}

    with pytest.raises(ModelError, match="where"):
        model_from_class(Branching)


def test_own_names_must_exist() -> None:
    class Wrong(Spring):
        def derivatives(self, x: Any, u: Any, p: Any) -> dict[str, Any]:
            return {"v": x.speed, "x": x.v}

    with pytest.raises(ModelError, match="no state 'speed'"):
        model_from_class(Wrong)


def test_load_model_says_what_it_knows() -> None:
    with pytest.raises(ModelError, match="lateral-simple"):
        load_model("latral")
    with pytest.raises(ModelError, match="cannot import"):
        load_model("no_such_module:Thing")


def test_published_geometry_and_tunnel_values() -> None:
    """The Aeronautical Journal (2018), pp 889-912: geometry and wind-tunnel column."""
    aircraft = load_aircraft("cdfp")
    assert (aircraft.span, aircraft.area, aircraft.chord) == (1.50, 0.787, 0.61)
    assert aircraft.mass * 9.81 == pytest.approx(34.335)
    tunnel = {"CY_beta": -0.1204, "CY_dr": 0.4586, "Cl_beta": -0.0901, "Cl_da": -0.0963, "Cl_dr": 0.0195}
    tunnel |= {"Cn_beta": 0.0186, "Cn_dr": -0.0093}
    for name, value in tunnel.items():
        prior = aircraft.prior(name)
        assert prior is not None
        assert (prior.value, prior.source) == (value, "wind tunnel")


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ("span = -1.0", "geometry.span = -1.0 must be greater"),
        ("span = 'wide'", "geometry.span = 'wide' is not a number"),
        ("", "geometry.span is missing"),
    ],
)
def test_wrong_aircraft_files_name_the_key(change: str, said: str, tmp_path: Any) -> None:
    path = tmp_path / "a.toml"
    path.write_text(f"[geometry]\n{change}\narea=1.0\nchord=1.0\n[mass]\nmass=1.0\nIxx=1.0\nIyy=1.0\nIzz=1.0\n")
    with pytest.raises(AircraftError, match=said):
        load_model("lateral", load_aircraft(path))
