"""Sideslip: airborne data acquisition and aircraft identification.

    import sideslip as ss
    flight = ss.open("ld1.mcap")
    result = ss.estimate(flight, "lateral")
    print(result.summary())

Names are imported on first use, so that a light verb or script stays light.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sideslip.api import check, design, estimate, gap, import_log, match, open, simulate
    from sideslip.chain import Flown, fly_scenario
    from sideslip.cli import software_version
    from sideslip.entry import main
    from sideslip.responses import frequency_response
    from sideslip.watching import watch

_HOMES = {
    **dict.fromkeys(("check", "design", "estimate", "gap", "import_log", "match", "open", "simulate"), "sideslip.api"),
    "Flown": "sideslip.chain",
    "fly_scenario": "sideslip.chain",
    "frequency_response": "sideslip.responses",
    "main": "sideslip.entry",
    "software_version": "sideslip.cli",
    "watch": "sideslip.watching",
}
__all__ = [
    "Flown", "check", "design", "estimate", "fly_scenario", "frequency_response", "gap", "import_log", "main", "match", "open",
    "simulate", "software_version", "watch",
]  # fmt: skip


def __getattr__(name: str) -> Any:
    if name in _HOMES:
        import importlib

        return getattr(importlib.import_module(_HOMES[name]), name)
    raise AttributeError(f"module 'sideslip' has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__
