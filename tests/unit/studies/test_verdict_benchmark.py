"""The verdict over random aeroplanes in thirteen situations: nothing wrong is recommended, plain ones are not refused."""

import pytest

from tests.studies.random_aeroplanes import PLAIN, SITUATIONS, Situation
from tests.studies.verdict_benchmark import METHODS, SIMULATORS, Outcome, outcome

AEROPLANES = 2
SIDE_BY_SIDE = ("own", "other")
REFUSED = 0.1  # of the plain situations

pytestmark = pytest.mark.study


def outcomes(simulator: str, situation: Situation) -> list[Outcome]:
    """One outcome an aeroplane."""
    return [outcome(SIMULATORS[simulator](situation, k), METHODS) for k in range(AEROPLANES)]


@pytest.mark.parametrize("simulator", SIDE_BY_SIDE)
@pytest.mark.parametrize("situation", SITUATIONS, ids=lambda s: s.name)
def test_nothing_wrong_is_recommended(simulator: str, situation: Situation) -> None:
    found = outcomes(simulator, situation)
    assert not [o for o in found if o.wrong]
    refused = [o for o in found if o.recommended == "none"]
    if situation.causes and refused:
        assert any(set(situation.causes) & set(o.named) for o in refused)


@pytest.mark.parametrize("simulator", SIDE_BY_SIDE)
def test_plain_ones_are_not_refused(simulator: str) -> None:
    found = [o for s in SITUATIONS if s.name in PLAIN for o in outcomes(simulator, s)]
    assert sum(o.recommended == "none" for o in found) <= REFUSED * len(found)
