"""Every book closes on a link that damages one frame in ten: the short form of the damaged link study."""

from pathlib import Path

import pytest

from tests.studies.damaged_link import KINDS, fly


@pytest.mark.parametrize("kind", KINDS)
def test_exactly_the_damaged_frames_are_lost_and_backfill_makes_the_flight_whole(tmp_path: Path, kind: str) -> None:
    outcome = fly(kind, 0.1, 500, seed=3, folder=tmp_path)
    assert outcome.exact(), outcome
    assert outcome.damaged > 50
    assert outcome.scans_lost > 10
