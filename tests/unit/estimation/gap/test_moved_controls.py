"""When a simulation is asked again, at the control surfaces and the motion as they were found."""

from dataclasses import replace

import numpy as np
import pytest

from estimation.gap.answer.result import GapResult, GapVerdict
from estimation.gap.decision.conclusion import more_beside_what_records_show_wrong
from estimation.gap.effects import catalogue
from estimation.models.load import load_model
from tests.unit.estimation.gap.test_rerun_report import an_answer

EFFECTS = {e.name: e for e in catalogue()}


def answer(*names: str, verdict: GapVerdict = GapVerdict.GAP_CLOSED) -> GapResult:
    """An answer that names these effects, in this order."""
    result, model = an_answer(np.random.default_rng(1)), load_model("lateral", "cdfp")
    for name in names:
        model = EFFECTS[name].forms[0].added_to(model)
    return replace(
        result, verdict=verdict, model_after=model, steps=tuple(replace(result.steps[0], effect=n) for n in names)
    )


@pytest.mark.parametrize(
    "names",
    [
        ("aileron_lag", "Cn_da"),
        ("Cn_da", "aileron_lag"),
        ("rudder_backlash", "Cl_beta3"),
        ("beta_lag", "Cn_da"),
        ("Cn_da", "beta_scale"),
    ],
)
def test_a_late_or_loose_surface_or_a_wrong_instrument_with_something_beside_it(names: tuple[str, ...]) -> None:
    assert more_beside_what_records_show_wrong(answer(*names))


@pytest.mark.parametrize("name", ["aileron_lag", "beta_lag"])
def test_a_late_surface_or_vane_that_leaves_something_without_a_name(name: str) -> None:
    assert more_beside_what_records_show_wrong(answer(name, verdict=GapVerdict.UNKNOWN))


@pytest.mark.parametrize("names", [("aileron_lag",), ("beta_lag",), ("Cn_da", "Cl_beta3"), ()])
def test_nothing_else_left_or_nothing_recorded_otherwise(names: tuple[str, ...]) -> None:
    assert not more_beside_what_records_show_wrong(answer(*names))
