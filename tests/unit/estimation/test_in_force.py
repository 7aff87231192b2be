"""What equations ask for while some of their terms rest."""

import pytest

from estimation.models.base import Parameter, Signal
from estimation.models.dependence import names_in_force, names_used
from tests.unit.estimation.gap.roll import ROLL


@pytest.mark.parametrize(
    ("expression", "names"),
    [
        ("a + k*b", {"a"}),
        ("a + k*b + b", {"a", "b"}),
        ("a*(1 + k)*b", {"a", "b"}),
        ("-k*b/c + a", {"a"}),
        ("a/(1 + k*b)", {"a"}),
        ("a - (k*b)*sin(c)", {"a"}),
        ("a + sin(k*b)*c", {"a", "c"}),
        ("a + (k + c)*b", {"a", "b", "c"}),
        ("a + c^2*k", {"a"}),
        ("k^2*a + pi*b", {"a", "b", "k"}),
        ("where(k > 0, a, b)", {"a", "b"}),
    ],
)
def test_a_term_times_zero_asks_for_nothing(expression: str, names: set[str]) -> None:
    assert names_in_force(expression, {"k"}) - {"k"} == names - {"k"}


def test_a_control_of_dormant_terms_only_is_not_asked_for() -> None:
    model = ROLL.plus(
        inputs=[Signal("delta_e", control=True)],
        parameters=[Parameter("L_de", fixed=True), Parameter("k_p", fixed=True)],
        lines=["shown = p + k_p*delta_e"],
        terms={"p_dot": "L_de*delta_e"},
        outputs={"p": "shown"},
    )
    assert "delta_e" in names_used(model, set())
    assert "delta_e" in names_used(model, {"k_p"})
    assert "delta_e" in names_used(model, {"L_de"})
    assert "delta_e" not in names_used(model, {"L_de", "k_p"})
    assert {"p", "delta_a", "L_p"} <= names_used(model, {"L_de", "k_p"})
