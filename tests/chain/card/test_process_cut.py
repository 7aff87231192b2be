"""The power goes under a logger that runs as a process: its files die in its hands, and the next one starts where it fell."""

from pathlib import Path

import pytest

from tests.chain.card.cuts import next_session
from tests.chain.card.forgetting import CUTS
from tests.chain.card.mounted import MountedCard
from tests.chain.process.test_kill import fly_and_kill


@pytest.mark.parametrize("seed", [5, 6])
def test_the_power_goes_under_a_process(card: MountedCard, seed: int) -> None:
    """What is left verifies, recovers and adds up (`fly_and_kill` sees to that); how much it is depends on the machine's pace."""
    folder = card.path / "flown"
    (folder / "onboard").mkdir(parents=True)  # as it is on an aircraft that has flown before
    card.secure()
    taken, kept = fly_and_kill(folder, seed, at_the_end=lambda: card.cut(CUTS[0]))
    assert 0 < kept <= taken
    assert next_session(Path(card.path)) == []
