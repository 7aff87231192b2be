"""Sideslip: airborne data acquisition and aircraft identification.

    import sideslip as ss
    flight = ss.open("ld1.mcap")
    result = ss.estimate(flight, "lateral")
    print(result.summary())

Names are imported on first use, so that a light verb or script stays light.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sideslip.api import (
        analyse,
        campaign,
        check,
        check_aircraft,
        design,
        estimate,
        export,
        frequency,
        gap,
        import_log,
        match,
        new_aircraft,
        open,
        performance,
        reconstruct,
        simulate,
        watch,
    )
    from sideslip.api import frequency as frequency_response
    from sideslip.chain import ChainFlight as Flown
    from sideslip.chain import fly_scenario
    from sideslip.cli import software_version
    from sideslip.entry import main
    from sideslip.records import bench, calibrate, info, recover, verify

_HOMES = {
    **dict.fromkeys(("bench", "calibrate", "info", "recover", "verify"), "sideslip.records"),
    "Flown": "sideslip.chain",
    "fly_scenario": "sideslip.chain",
    "main": "sideslip.entry",
    "software_version": "sideslip.cli",
}
_RENAMED = {"frequency_response": "frequency", "Flown": "ChainFlight"}
__all__ = [
    "Flown", "analyse", "bench", "calibrate", "campaign", "check", "check_aircraft", "design", "estimate", "export",
    "fly_scenario", "frequency", "frequency_response", "gap", "import_log", "info", "main", "match", "new_aircraft", "open",
    "performance", "reconstruct", "recover", "simulate", "software_version", "verify", "watch",
]  # fmt: skip


def __getattr__(name: str) -> Any:
    if name in __all__:
        import importlib

        try:
            from daq.utilities.packages import missing
        except ModuleNotFoundError as error:
            raise ImportError(
                "a file or folder daq hides Sideslip's own package; rename it, or start elsewhere"
            ) from error
        try:
            return getattr(importlib.import_module(_HOMES.get(name, "sideslip.api")), _RENAMED.get(name, name))
        except ModuleNotFoundError as error:
            raise missing(error, f"sideslip.{name}") from error
    near = ""
    if not name.startswith("_"):  # tools look for such names and go on without them
        from daq.utilities.plain_words import did_you_mean

        near = did_you_mean(name, __all__)
    raise AttributeError(f"module 'sideslip' has no attribute {name!r}{near}")


def __dir__() -> list[str]:
    return __all__
