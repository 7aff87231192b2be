"""What is taken for lacking, of candidates that serve as well."""

from types import SimpleNamespace

import pytest

from estimation.estimators.result import Estimate
from estimation.models import load_model
from estimation.structure.candidates import Candidate, CandidateKind
from estimation.structure.score_test import Tested, derivative_instead


@pytest.mark.parametrize(("yaw", "instead"), [(-0.02, True), (-0.08, False)])
def test_a_derivative_goes_before_another_inertia_where_an_aeroplane_can_have_it(yaw: float, instead: bool) -> None:
    """Cl_da is -0.17: half of that in yaw is no aileron's."""
    roll = Estimate("Cl_da", -0.17, 0.001, 0.001)
    result = SimpleNamespace(parameters={"Cl_da": roll}, model=load_model("lateral", "cdfp"))
    inertia = Tested(Candidate("Ixz", CandidateKind.INERTIA), 21.0, 0.1, {})
    derivative = Tested(Candidate("Cn_da", CandidateKind.LINEAR), 19.5, yaw, {})
    chosen = derivative_instead([inertia, derivative], 0, [1], result)  # type: ignore[arg-type]
    assert chosen == (1 if instead else None)


def test_a_scale_is_not_replaced_by_a_derivative() -> None:
    result = SimpleNamespace(parameters={}, model=load_model("lateral", "cdfp"))
    scale = Tested(Candidate("scale_beta", CandidateKind.SCALE), 21.0, 1.2, {})
    derivative = Tested(Candidate("Cn_da", CandidateKind.LINEAR), 19.5, -0.02, {})
    assert derivative_instead([scale, derivative], 0, [1], result) is None  # type: ignore[arg-type]
