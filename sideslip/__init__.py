"""Sideslip: airborne data acquisition and aircraft identification.

Names are imported on first use, so that a light verb or script stays light.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sideslip.chain import Flown, fly_scenario
    from sideslip.cli import software_version
    from sideslip.entry import main

_HOMES = {
    "Flown": "sideslip.chain",
    "fly_scenario": "sideslip.chain",
    "main": "sideslip.entry",
    "software_version": "sideslip.cli",
}
__all__ = ["Flown", "fly_scenario", "main", "software_version"]


def __getattr__(name: str) -> Any:
    if name in _HOMES:
        import importlib

        return getattr(importlib.import_module(_HOMES[name]), name)
    raise AttributeError(f"module 'sideslip' has no attribute {name!r}")
