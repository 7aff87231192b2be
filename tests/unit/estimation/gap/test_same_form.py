"""A shape without a name that has the form of an effect of the catalogue: which one, what it would be, why it is not its name."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from estimation.gap.answer.result import Rejected
from estimation.gap.answer.shape import Alike, ShapeCurve
from estimation.gap.answer.words import describe_curve
from estimation.gap.decision.unnamed import effects_of_same_form
from estimation.gap.effects import catalogue
from estimation.models.load import load_model

SIX = load_model("six-dof", "cdfp")
EFFECTS = catalogue(model=SIX)


def formula(text: str, a: float = 1.4, std: float = 0.07, **more: tuple[float, float]) -> Any:
    return SimpleNamespace(text=text, estimates={"a": (a, std), **more})


def found(text: str, line: str, a: float = 1.4, *rejected: Rejected) -> list[tuple[str, str, float]]:
    return [
        (x.effect, x.parameter, x.estimate[0])
        for x in effects_of_same_form([formula(text, a)], line, SIX, EFFECTS, rejected)
    ]


@pytest.mark.parametrize(
    ("text", "line", "names"),
    [
        ("a*beta^2", "Cm", ["Cm_beta2"]),
        ("a*abs(beta)", "CD", ["CD_abs_beta"]),
        ("a*alpha*beta", "Cl", ["Cl_alpha_beta"]),
        ("a*beta*alpha", "Cl", ["Cl_alpha_beta"]),
        ("a*delta_a", "Cn", ["Cn_da"]),
        ("a*abs(beta)", "Cm", []),
        ("a*beta^4", "Cm", []),
        ("a*beta^2", "Cn", []),
    ],
)
def test_the_effect_is_the_one_that_adds_the_same_function_to_the_same_coefficient(
    text: str, line: str, names: list[str]
) -> None:
    assert [n for _, n, _ in found(text, line)] == names
    assert all(value == pytest.approx(1.4) for _, _, value in found(text, line))


def test_a_formula_with_a_width_is_no_effects_form() -> None:
    assert not effects_of_same_form([formula("a*tanh(beta/w)", w=(0.1, 0.01))], "Cm", SIX, EFFECTS, ())


def test_an_effect_that_the_model_has_already_is_not_told() -> None:
    effect = next(e for e in EFFECTS if e.name == "Cm_beta2")
    assert not effects_of_same_form([formula("a*beta^2")], "Cm", effect.forms[0].added_to(SIX), EFFECTS, ())


def test_why_it_is_not_the_name_is_its_range_then_what_the_rounds_said() -> None:
    def why(a: float, *rejected: Rejected) -> str:
        (one,) = effects_of_same_form([formula("a*beta^2", a)], "Cm", SIX, EFFECTS, rejected)
        return one.why_not

    said = Rejected("Cm_beta2", "explains only 37% of what a nameless term does")
    assert why(3.7, said) == "that is outside what is physically possible (-3 to 3)"
    assert why(1.4, said) == "as a name it explains only 37% of what a nameless term does"
    assert why(1.4) == "as a name it does not stand by itself"


def test_the_words_claim_no_gap_in_the_catalogue_where_it_has_the_form() -> None:
    grid = np.linspace(-0.1, 0.1, 5)
    curve = ShapeCurve("Cm", ("beta",), grid, grid**2, 0.01 + 0.0 * grid, "rad", -0.1, 0.1, 0.97, "a*beta^2",
                  (("a*beta^2", {"a": (2.72, 0.05)}, 0.97, True),), (), (), "everywhere", "sweep beta")  # fmt: skip
    assert describe_curve(curve).startswith(
        "Something the catalogue does not hold, and no physical name is given to it"
    )
    known = replace(curve, alike=(Alike("Cm_beta2", "pitching moment from sideslip", "Cm_beta2", (2.72, 0.05), "1/rad2",
                                        "that is outside what is physically possible (-2 to 2)"),))  # fmt: skip
    text = describe_curve(known)
    assert "does not hold" not in text
    assert "no physical name is given to it" in text
    assert (
        "Cm_beta2 (pitching moment from sideslip) has that form and would be 2.72 +- 0.05 1/rad2; that is outside what is "
        "physically possible (-2 to 2)." in text
    )
    assert known.to_json()["alike"][0]["estimate"] == 2.72
    assert curve.to_json()["alike"] == []
