"""docs/install-companion.md as a recipe: which of its commands are for installing, and which for the computer that has booted."""

import shlex
import subprocess
from pathlib import Path

from tests.cli.docs.blocks import commands_in
from tests.support.paths import ROOT

PAGE = ROOT / "docs" / "install-companion.md"
HOME = "/root/sideslip"
"""Where the reader stands: a folder with the checkout, `wheels` and `calibration`."""
_BOOTED = "## 8. "  # from this section on the computer has been restarted
CARD = "/dev/sda1"
"""The card on the page."""


def installing(page: Path) -> list[str]:
    """Commands to be carried out before the restart, in order; making the card's file system is `card_commands`."""
    return [c for c in commands_in(page.read_text(encoding="utf-8").split(_BOOTED)[0]) if CARD not in c]


def card_commands(page: Path) -> list[str]:
    """Commands that name the card."""
    return [c for c in commands_in(page.read_text(encoding="utf-8")) if CARD in c]


def booted(page: Path) -> list[str]:
    """Commands to be carried out after the restart, in order."""
    _, found, after = page.read_text(encoding="utf-8").partition(_BOOTED)
    assert found, f"{page} has no section {_BOOTED.strip()}"
    return commands_in(after)


def make_card(page: Path, image: Path, size_mb: int) -> Path:
    """A new card as an image, its file system made by the page's command."""
    with image.open("wb") as file:
        file.truncate(size_mb * 1_000_000)
    for command in card_commands(page):
        words = shlex.split(command.removeprefix("sudo "))
        subprocess.run([str(image) if w == CARD else w for w in words], check=True)
    return image
