"""How many nulls a round flies: the first of them where something stands clearly out, all of them otherwise."""

import numpy as np
import pytest

from estimation.gap.effects import catalogue
from estimation.gap.search.state import Options
from estimation.gap.significance.calibration import CLEAR, FIRST_NULLS, Round
from estimation.gap.workflow import _Run
from estimation.models.load import load_model
from tests.studies import fourth_simulator as fourth

MOST = FIRST_NULLS + 10
ASKED = ("Cn_da", "Cl_beta3")


def first_round(size: float, nulls: int) -> tuple[Round, list[str]]:
    """The first round about flights with a `Cn_da` of so many usual sizes, and what was said meanwhile."""
    model, said = load_model("lateral", "cdfp"), list[str]()
    flown = fourth.fly(80330, fourth.Kind(axes="lateral", hidden=(("Cn_da", size),)), (14.5, 16.5))
    effects = [e for e in catalogue(model=model) if e.name in ASKED]
    run = _Run.of(model, flown, (), (), effects, Options(nulls=nulls), lambda what, share: said.append(what))
    setting, baseline = run.set_up(model)
    return setting.screened(baseline, 0), said


@pytest.fixture(scope="module")
def nothing() -> tuple[Round, list[str]]:
    return first_round(0.0, MOST)


def test_all_nulls_are_flown_where_nothing_stands_clearly_out(nothing: tuple[Round, list[str]]) -> None:
    round_, said = nothing
    assert len(round_.null_residuals) == MOST
    assert said[-1] == f"round 1: null {MOST} of {MOST}"
    assert round_.standardised().max() < CLEAR * round_.threshold


def test_the_first_nulls_suffice_where_something_does() -> None:
    round_, said = first_round(1.0, MOST)
    assert len(round_.null_residuals) == FIRST_NULLS
    assert said[-1] == f"round 1: null {FIRST_NULLS} of {MOST}"
    best = int(np.argmax(round_.standardised()))
    assert round_.screen.hypotheses[best].effect.name == "Cn_da"
    assert round_.standardised()[best] > CLEAR * round_.threshold


def test_the_first_nulls_of_many_are_those_of_few(nothing: tuple[Round, list[str]]) -> None:
    """So an answer with more of them differs by its thresholds alone."""
    few, _ = first_round(0.0, 8)
    for of_few, of_many in zip(few.null_residuals, nothing[0].null_residuals, strict=False):
        np.testing.assert_array_equal(np.stack(of_few), np.stack(of_many))
    assert few.threshold == pytest.approx(nothing[0].threshold, rel=0.4)
