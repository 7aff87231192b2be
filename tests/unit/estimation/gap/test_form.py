"""A shape without a name: the spline as numbers and as text, where it may sit, formulas over it, and the whole search."""

import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

from estimation.engine.kernel import Array
from estimation.gap.answer.result import GapVerdict
from estimation.gap.answer.shape import ShapeCurve
from estimation.gap.effects import catalogue
from estimation.gap.pages.report import write_gap_report
from estimation.gap.shapes.increment import Increment, regressed
from estimation.gap.shapes.lag_swing import lag_behind
from estimation.gap.shapes.places import Place, coefficient_lines, places_of, products_of, variables_of
from estimation.gap.shapes.spline import KEPT, Range, basis, curve_lines, lines, polynomial
from estimation.gap.workflow import Options
from estimation.models.base import Parameter
from estimation.models.expressions import evaluate, split_line
from estimation.models.load import load_model, read_model
from groundstation.flight import Flight
from tests.studies import second_truth as truth
from tests.unit.estimation.gap.roll import ROLL
from tests.unit.estimation.gap.whole_run import analyse

FLOWN = Range(-0.1, 0.3)
NUMPY = {"min": np.minimum, "max": np.maximum, "abs": np.abs, "sign": np.sign, "tanh": np.tanh}


def followed(text: tuple[str, ...], symbols: Mapping[str, Array | float]) -> dict[str, Array | float]:
    """Lines evaluated one after the other by the reader of model text."""
    known = dict(symbols)
    for line in text:
        name, expression = split_line(line)
        known[name] = evaluate(expression, known, NUMPY)
    return known


# ------------------------------------------------------------------------------------------------ the spline
def test_columns_are_free_of_constant_and_line_and_smoother_ones_come_first() -> None:
    u = np.linspace(-1.0, 1.0, 4001)
    columns = basis().columns(u)
    assert columns.shape == (4001, KEPT)
    assert np.abs(columns.mean(axis=0)).max() < 0.01
    assert np.abs(columns.T @ u / u.size).max() < 0.01
    assert np.sqrt(np.mean(columns**2, axis=0)) == pytest.approx(np.ones(KEPT), abs=0.02)
    crossings = (np.diff(np.sign(columns), axis=0) != 0).sum(axis=0)
    assert (np.diff(crossings) >= 1).all()
    assert (np.diff(basis().spread) < 0.0).all()


def test_a_parabola_and_a_cubic_are_in_the_span() -> None:
    """Cubics hold them exactly with the constant and the line of the base; leaving out the roughest columns costs little."""
    u = np.linspace(-1.0, 1.0, 401)
    whole = np.column_stack([basis().columns(u), np.ones(401), u])
    for curve in (u**2, u**3):
        left = curve - whole @ np.linalg.lstsq(whole, curve, rcond=None)[0]
        assert np.sqrt(np.mean(left**2)) < 0.02 * np.std(curve)


def test_the_text_is_the_columns_and_holds_outside_the_range() -> None:
    x = np.linspace(-0.3, 0.5, 57)
    w = np.array([0.5, -1.0, 0.25, 2.0, -0.125, 0.75])
    expected = basis().columns(FLOWN.scaled(x)) @ w + 0.3 * np.clip(FLOWN.scaled(x), -1.0, 1.0) - 0.2
    scale = {"form_low": -0.1, "form_high": 0.3, "form_middle": 0.1, "form_half": 0.2}
    names = [f"w{j}" for j in range(KEPT)]
    text = lines("form", "beta", [*names, "slope", "shift"])
    values = dict(zip(names, w, strict=True)) | {"slope": 0.3, "shift": -0.2}
    assert followed(text, {"beta": x, **scale, **values})["form"] == pytest.approx(expected, abs=1e-9)
    short = curve_lines("Cn_nameless", "beta", FLOWN, polynomial(w, (0.3, -0.2)))
    found = followed(short, {"beta": x})["Cn_nameless"]
    assert found == pytest.approx(expected, abs=1e-9)
    assert np.ptp(np.asarray(found)[x > 0.3]) == 0.0


def test_the_range_is_that_of_all_flights_and_knows_what_lies_inside() -> None:
    assert Range.of([np.array([0.0, 0.3]), np.array([-0.1, 0.2])]) == FLOWN
    assert FLOWN.inside(np.array([-0.2, 0.0, 0.3, 0.4])) == 0.5


# ------------------------------------------------------------------------------------------------ where it may sit
def test_places_come_from_the_models_own_equations() -> None:
    lateral = load_model("lateral", "cdfp")
    assert coefficient_lines(lateral) == ("CY", "Cl", "Cn")
    six = {"beta", "p_hat", "r_hat", "delta_r", "delta_a", "alpha"}
    assert set(variables_of(lateral, ("CY", "Cl", "Cn"))) == six
    assert len(places_of(lateral)) == 18
    longitudinal = load_model("longitudinal", "cdfp")
    found = coefficient_lines(longitudinal)
    assert found == ("CL", "CD", "Cm")
    assert set(variables_of(longitudinal, found)) == {"alpha", "q_hat", "delta_e", "V"}
    assert {(p.line, p.variable) for p in places_of(ROLL)} == {("p_dot", "p"), ("p_dot", "delta_a")}
    assert len(products_of(ROLL)) == 2


def test_a_coefficient_is_no_function_of_what_it_drives_itself() -> None:
    """A base with Cm by the rate of alpha, as one that was saved or of a simulation: lift and drag drive that rate."""
    base = load_model("longitudinal", "cdfp")
    rated = base.plus(parameters=[Parameter("Cm_rate")], terms={"Cm": "Cm_rate*alpha_dot"})
    assert ("Cm", "alpha_dot") in {(p.line, p.variable) for p in places_of(rated)}
    assert not {("CL", "alpha_dot"), ("CD", "alpha_dot")} & {(p.line, p.variable) for p in places_of(rated)}
    products = {(p.line, p.variable, p.by) for p in products_of(rated)}
    assert ("Cm", "alpha", "alpha_dot") in products
    assert not {("CL", "alpha", "alpha_dot"), ("CL", "alpha_dot", "alpha")} & products
    assert len(places_of(rated)) == len(places_of(base)) + 1


def test_the_increment_has_a_line_where_the_base_has_no_derivative() -> None:
    found = {(p.line, p.variable): p for p in places_of(load_model("lateral", "cdfp"))}
    assert not found["Cn", "beta"].lacks_line
    assert not found["Cn", "beta"].lacks_constant
    assert found["Cn", "delta_a"].lacks_line
    assert found["Cl", "alpha"].lacks_line
    drag = {(p.line, p.variable): p for p in places_of(load_model("longitudinal", "cdfp"))}
    assert not drag["CD", "alpha"].lacks_constant
    products = {(p.variable, p.by): p for p in products_of(load_model("lateral", "cdfp")) if p.line == "Cn"}
    assert products["alpha", "beta"].lacks_line
    assert not products["alpha", "beta"].lacks_constant, "Cn_beta is free"
    assert products["beta", "delta_a"].lacks_constant, "the base has no Cn_da"
    assert all(p.lacks_constant for p in places_of(ROLL))


# ------------------------------------------------------------------------------------------------ formulas, memory
@pytest.mark.parametrize(
    ("curve", "text"),
    [
        (lambda x: 3.0 * np.abs(x), "abs({x})"),
        (lambda x: 2.0 * x**2 + 5.0 * x + 1.0, "{x}^2"),
        (lambda x: -4.0 * x**3 + x, "{x}^3"),
        (lambda x: np.sign(x) * np.maximum(np.abs(x) - 0.06, 0.0), "sign({x})*max(abs({x}) - {w}, 0)"),
        (lambda x: np.tanh(x / 0.04), "tanh({x}/{w})"),
    ],
)
def test_the_formula_of_a_curve_is_found_whatever_constant_and_line_it_has(curve: object, text: str) -> None:
    x = np.random.default_rng(1).uniform(-0.2, 0.2, 3000)
    increment = Increment(Place("Cn", "beta", False, False), Range(-0.2, 0.2), 1.0, np.ones(KEPT))
    best = regressed(x, curve(x), increment)[0]  # type: ignore[operator]
    assert best.formula.text == text
    assert best.missed < 0.02


def test_a_line_is_a_formula_only_where_the_base_has_none() -> None:
    x = np.linspace(-0.2, 0.2, 300)
    without = Increment(Place("Cn", "delta_a", True, False), Range(-0.2, 0.2), 1.0, np.ones(KEPT + 1))
    assert regressed(x, 0.1 * x, without)[0].formula.text == "{x}"
    carried = Increment(Place("Cn", "beta", False, False), Range(-0.2, 0.2), 1.0, np.ones(KEPT))
    assert "{x}" not in [s.formula.text for s in regressed(x, x**2, carried)]


def test_a_lag_is_behind_a_ramp_by_its_time_constant() -> None:
    time = np.arange(0.0, 6.0, 0.025)
    behind = lag_behind(2.0 * time, time, 0.5)
    assert behind[0] == 0.0
    assert behind[-1] == pytest.approx(-2.0 * 0.5, rel=0.06)


# ------------------------------------------------------------------------------------------------ the whole search
# What yaws in rolling; all 45 are asked by the study of nameless truths.
NEAR = ("Cn_da", "CY_p_r", "Cn_alpha_beta", "Cn_beta3", "Cn_dr3", "Cl_p_abs_p", "Cn_betadot", "Ixz_error", "inertial_coupling",
        "prop_gyroscopic", "aileron_lag", "rudder_lag", "vane_position", "gyro_misalignment", "gust")  # fmt: skip


@pytest.fixture(scope="module")
def even() -> list[Flight]:
    """Three short flights with a yawing moment even in roll rate, which no entry of the catalogue is."""
    hidden = truth.Hidden("Cn", lambda s: 0.6 * s["p_hat"] ** 2)
    requests = [truth.Request(60 + i, v, duration=24.0, hidden=hidden) for i, v in enumerate((14.5, 19.0, 16.5))]
    return [
        Flight.build(f"f{i}", c["time"], {k: v for k, v in c.items() if k != "time"})
        for i, c in enumerate(truth.fly(requests))
    ]


@pytest.mark.usefixtures("unwritten_figures")
def test_an_effect_the_catalogue_does_not_hold_gets_a_shape_and_no_name(even: list[Flight], tmp_path: Path) -> None:
    options = Options(seed=3, nulls=20, most=2)
    asked = [e for e in catalogue() if e.name in NEAR]
    result = analyse(load_model("lateral", "cdfp"), even[:2], even[2:], asked, options,
                     lambda what, share: None, tmp_path / "report" / "models", tmp_path / "gap.json")  # fmt: skip
    answer = json.loads((tmp_path / "gap.json").read_text(encoding="utf-8"))
    assert result.verdict is GapVerdict.GAP_REDUCED
    assert [s["effect"] for s in answer["steps"]] == ["unknown"]
    form = answer["steps"][0]["form"]
    assert (form["output"], form["variables"], form["nameless"]) == ("Cn", ["p_hat"], True)
    assert form["closed"] > 0.7
    assert all(f["gain"] > 0.0 for f in form["left_out"])
    assert "no physical name" in answer["text"]
    (curve,) = (s.shape for s in result.steps)
    assert isinstance(curve, ShapeCurve)
    inside = np.abs(curve.grid) < 0.8 * np.abs(curve.grid).max()
    straight = np.column_stack([np.ones(curve.grid.size), curve.grid])[inside]
    true = 0.6 * curve.grid[inside] ** 2
    true -= straight @ np.linalg.lstsq(straight, true, rcond=None)[0]
    seen = curve.value[inside] - straight @ np.linalg.lstsq(straight, curve.value[inside], rcond=None)[0]
    assert np.sqrt(np.mean((seen - true) ** 2)) < 0.3 * np.std(true)
    child = read_model(answer["model_after"])
    assert child.name == "lateral+nameless"
    assert "Cn_nameless" in child.definitions["Cn"]
    assert not [n for n in child.parameter_names if n.startswith("form_")]
    page = write_gap_report(result, tmp_path / "report").read_text(encoding="utf-8")
    assert "The part of Cn without a name" in page


@pytest.mark.study
def test_an_effect_with_a_name_is_found_beside_a_shape_that_stood_over_it(tmp_path: Path) -> None:
    hidden = truth.Hidden("Cl", lambda s: 0.3 * s["beta"] ** 2)  # six times as plain as the adverse yaw
    flown = [
        truth.Request(80 + i, v, {"Cn_da": 1.0}, duration=24.0, hidden=hidden) for i, v in enumerate((14.5, 19.0, 16.5))
    ]
    flights = [
        Flight.build(f"f{i}", c["time"], {k: v for k, v in c.items() if k != "time"})
        for i, c in enumerate(truth.fly(flown))
    ]
    asked = [e for e in catalogue() if e.name in NEAR]
    result = analyse(load_model("lateral", "cdfp"), flights[:2], flights[2:], asked, Options(seed=3, nulls=40, most=2),
                     lambda what, share: None, tmp_path / "report" / "models", tmp_path / "gap.json")  # fmt: skip
    answer = json.loads((tmp_path / "gap.json").read_text(encoding="utf-8"))
    assert result.verdict is GapVerdict.GAP_REDUCED
    assert [s["effect"] for s in answer["steps"]] == ["Cn_da", "unknown"]
    name, unknown = answer["steps"]
    estimate = name["parameters"]["Cn_da"]
    assert estimate["estimate"] == pytest.approx(truth.TYPICAL["Cn_da"], abs=4.0 * estimate["std"])
    assert name["score"] > 2.0 * name["threshold"]
    assert name["gap"]["floor"] < 1.2 * name["gap"]["after"]  # of nulls with the shape, not of the base that lacks it
    assert not [n for n in name["migrated"] if n.startswith("form_")]
    assert "do not repeat" not in answer["text"]
    assert (unknown["form"]["output"], unknown["form"]["variables"]) == ("Cl", ["beta"])
    assert unknown["form"]["closed"] > 0.7
    assert "Cn_da" not in [r["effect"] for r in answer["rejected"]]
    child = read_model(answer["model_after"])
    assert child.name == "lateral+Cn_da+nameless"
    assert "Cl_nameless" in child.definitions["Cl"]
    assert child.parameter("Cn_da").start == pytest.approx(
        estimate["estimate"], rel=1e-3
    )  # sizes are the final model's
