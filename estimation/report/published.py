"""The published numbers of the CDFP aircraft, shown beside ours.

Source: The Aeronautical Journal (2018), pp 889-912, doi 10.1017/aer.2018.36: wind tunnel, maximum-likelihood and Neural
Gauss-Newton estimates with Cramer-Rao bounds of UFP_LD1..4, their means, and the data-compatibility factors of Table 2.
The flight records themselves were never published.
"""

import json
import re
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

SOURCE = "The Aeronautical Journal (2018), pp 889–912, doi 10.1017/aer.2018.36"
COMPARISON = (
    f"Published columns: {SOURCE}. Its flight records were never published: the flights here are others, so the columns "
    "may be compared but need not agree."
)


@lru_cache(maxsize=1)
def _data() -> Mapping[str, Any]:
    path = Path(__file__).with_name("cdfp_2018.json")
    data: Mapping[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return data


def is_of(aircraft: str) -> bool:
    """Whether the published numbers are of the named aircraft."""
    return bool(_data()["aircraft"] == aircraft)


def wind_tunnel(name: str) -> float | None:
    """Wind-tunnel value of a derivative [1/rad], None where there is none."""
    value = _data()["wind_tunnel"].get(name)
    return None if value is None else float(value)


def published_flights() -> tuple[str, ...]:
    """Names of the published flights."""
    return tuple(_data()["estimates"])


def counterpart(flight: str) -> str | None:
    """The published flight of the same number, for a flight named like `cdfp_ld2`."""
    match = re.search(r"ld([1-4])(?!\d)", flight, re.IGNORECASE)
    return f"UFP_LD{match.group(1)}" if match else None


def estimate(flight: str, method: str, name: str) -> tuple[float, float] | None:
    """(estimate, Cramer-Rao bound) of a published flight; method: ml or ngn."""
    entry = _data()["estimates"][flight].get(method, {}).get(name)
    return None if entry is None else (float(entry["estimate"]), float(entry["crb"]))


def mean(method: str, name: str) -> tuple[float, float] | None:
    """(mean, standard deviation) over the four published flights; method: ml or ngn."""
    entry = _data()["mean_std"].get(method, {}).get(name)
    return None if entry is None else (float(entry["mean"]), float(entry["std"]))


def compatibility_factor(flight: str, name: str) -> tuple[float, float] | None:
    """(estimate, Cramer-Rao bound) of a factor in Table 2."""
    entry = _data()["data_compatibility"][flight].get(name)
    return None if entry is None else (float(entry["estimate"]), float(entry["crb"]))
