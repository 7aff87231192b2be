"""The ground station under a hostile sender at full loopback speed: short runs of the study, kind by kind."""

from pathlib import Path

import pytest

from tests.studies.hostile_sender import KINDS, run

pytestmark = [pytest.mark.study, pytest.mark.timeout(180)]


@pytest.mark.parametrize("key", [False, True], ids=["no key", "key"])
@pytest.mark.parametrize("kind", KINDS)
def test_a_flood_costs_at_most_one_frame_in_a_hundred_and_none_uncounted(tmp_path: Path, kind: str, key: bool) -> None:
    result = run(kind, 30.0, tmp_path, key=key)
    assert result.sent - result.received <= 0.01 * result.sent
    assert result.uncounted == 0
    assert result.ended_s < 5.0
    assert result.files < 100
