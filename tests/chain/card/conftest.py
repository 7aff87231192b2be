"""The card that forgets, freshly mounted for each test."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.chain.card.mounted import MountedCard, mounted, need_card


@pytest.fixture
def card(tmp_path: Path) -> Iterator[MountedCard]:
    """An empty card that forgets what was not synced."""
    need_card()
    with mounted(tmp_path / "card") as made:
        yield made
