"""The noise of a recorded control is no effect: flights of the fourth simulator with nothing hidden and a noisy elevator."""

import numpy as np
import pytest

from estimation.gap.significance.omnibus import TermScores, less_given
from estimation.gap.workflow import Options, run_gap
from estimation.models import load_model
from tests.studies.fourth_simulator import Kind, fly


@pytest.mark.long
@pytest.mark.timeout(600)
def test_a_noisy_elevator_is_not_late() -> None:
    """0.21 deg of noise: `elevator_lag` of 12 ms had been named at a score of 6."""
    flights = fly(1, Kind(noise=(("delta_e", 3.0),)), (14.5, 16.5, 19.0, 17.0))
    result = run_gap(load_model("longitudinal", "cdfp"), flights[:3], flights[3:], options=Options(nulls=60))
    assert [s.effect for s in result.steps] == []


def test_a_nameless_term_keeps_what_the_noise_of_the_controls_does_not_give_it() -> None:
    """Six of which four are given anyway: a third is left. What points the other way takes nothing."""
    assert less_given(np.array([6.0, -6.0, 6.0, 3.0]), np.array([4.0, -4.0, -4.0, 5.0])) == pytest.approx(
        [1 / 3, 1 / 3, 1, 0]
    )
    scores = TermScores([("q_dot", "q", "rate")], {"q_dot": "q_dot"}, np.array([[6.0, 1.0]]), np.array([[4.0, 0.7]]))
    ((raw,), (own,)) = scores.signals(), scores.signals(np.array([4.5]))
    assert (raw.score, own.score) == pytest.approx((4.0, 1.0))
    assert raw.gain == own.gain == 36.0
