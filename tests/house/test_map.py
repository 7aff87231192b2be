"""The map in CONTRIBUTING.md is the tree: every path it names is there, and every room of the tree is on it."""

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
TEXT = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")


def test_every_path_that_is_named_exists() -> None:
    named = set(re.findall(r"`((?:daq|groundstation|estimation|firmware_sim|sideslip|tests|docs)/[\w/.-]*)`", TEXT))
    named |= set(re.findall(r"\]\(([\w/.-]+)\)", TEXT))
    missing = sorted(
        path for path in named if not (ROOT / path).exists() and not (ROOT / "estimation/estimators" / path).exists()
    )
    assert len(named) > 30
    assert not missing


def test_every_room_is_on_the_map() -> None:
    rooms = {
        f"{package}/{path.name}"
        for package in ("daq", "groundstation", "estimation")
        for path in (ROOT / package).iterdir()
        if (path / "__init__.py").is_file()
    }
    assert not sorted(room for room in rooms if f"`{room}/" not in TEXT)


def test_every_room_says_what_it_is() -> None:
    for package in ("daq", "groundstation", "estimation", "firmware_sim", "sideslip"):
        for init in (ROOT / package).rglob("__init__.py"):
            assert init.read_text(encoding="utf-8").startswith('"""'), init
