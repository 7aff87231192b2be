"""The noise of a recorded control is no effect: flights of the fourth simulator with nothing hidden and a noisy elevator."""

import pytest

from estimation.gap.workflow import Options, run_gap
from estimation.models import load_model
from tests.studies.fourth_simulator import Kind, fly


@pytest.mark.timeout(600)
def test_a_noisy_elevator_is_not_late() -> None:
    """0.21 deg of noise: `elevator_lag` of 12 ms had been named at a score of 6."""
    flights = fly(1, Kind(noise=(("delta_e", 3.0),)), (14.5, 16.5, 19.0, 17.0))
    result = run_gap(load_model("longitudinal", "cdfp"), flights[:3], flights[3:], options=Options(nulls=20))
    assert [s.effect for s in result.steps] == []
