"""What is taken for lacking, of candidates that serve as well."""

from types import SimpleNamespace

import pytest

from estimation.estimators.result import Estimate
from estimation.models import load_model
from estimation.session.lack_sentences import lack_text
from estimation.structure import score_test
from estimation.structure.candidates import Candidate, CandidateKind


@pytest.mark.parametrize(("yaw", "instead"), [(-0.02, True), (-0.08, False)])
def test_a_derivative_goes_before_another_inertia_where_an_aeroplane_can_have_it(yaw: float, instead: bool) -> None:
    """Cl_da is -0.17: half of that in yaw is no aileron's."""
    roll = Estimate("Cl_da", -0.17, 0.001, 0.001)
    result = SimpleNamespace(parameters={"Cl_da": roll}, model=load_model("lateral", "cdfp"))
    inertia = score_test.Tested(Candidate("Ixz", CandidateKind.INERTIA), 21.0, 0.1, {})
    derivative = score_test.Tested(Candidate("Cn_da", CandidateKind.LINEAR), 19.5, yaw, {})
    chosen = score_test.derivative_instead([inertia, derivative], 0, [1], result)  # type: ignore[arg-type]
    assert chosen == (1 if instead else None)


def test_a_scale_is_not_replaced_by_a_derivative() -> None:
    result = SimpleNamespace(parameters={}, model=load_model("lateral", "cdfp"))
    scale = score_test.Tested(Candidate("scale_beta", CandidateKind.SCALE), 21.0, 1.2, {})
    derivative = score_test.Tested(Candidate("Cn_da", CandidateKind.LINEAR), 19.5, -0.02, {})
    assert score_test.derivative_instead([scale, derivative], 0, [1], result) is None  # type: ignore[arg-type]


LATE_RUDDER = Candidate("delay_delta_r", CandidateKind.LATE_CONTROL, channel="delta_r", phrase="a lag of delta_r")
NOSE = Candidate("x_imu", CandidateKind.PLACE, channel="ay", term="r_dot", phrase="an accelerometer off the CG along x")
CUBE = Candidate("Cl_da3", CandidateKind.NONLINEAR, line="Cl", term="delta_a^3", phrase="Cl_da3")
LIFT = Candidate("CL_alpha3", CandidateKind.NONLINEAR, line="CL", term="alpha^3", phrase="CL_alpha3")


@pytest.mark.parametrize(
    ("candidate", "value", "possible"),
    [
        (LATE_RUDDER, -0.05, True), (LATE_RUDDER, 0.2, True), (LATE_RUDDER, 8.0, False),
        (NOSE, 0.9, True), (NOSE, -54.0, False),  # of a span of 1.5 m
        (CUBE, -2.0, True), (CUBE, 2730.0, False), (LIFT, -60.0, True), (LIFT, 400.0, False),
    ],
)  # fmt: skip
def test_what_no_aeroplane_has_of_that_size_is_not_named_as_the_cause(
    candidate: Candidate, value: float, possible: bool
) -> None:
    result = SimpleNamespace(parameters={}, model=load_model("lateral", "cdfp"))
    tested = score_test.Tested(candidate, 9.0, value, {"Cn_r": 4.0})
    assert score_test._possible(tested, result) == possible  # type: ignore[arg-type]
    text = lack_text(score_test.Lack(tested, possible=possible))
    assert text.startswith("the model lacks" if possible else "something is left out that is none of what was tested")
    assert ("below zero" in text) == (candidate is LATE_RUDDER and value < 0.0)
