"""True derivatives from a file, to be shown beside estimates."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from daq.utilities.input_files import read_text
from estimation.errors import EstimationError


def read_truth(path: Path, flights: Sequence[str]) -> dict[str, float]:
    """Derivatives by name from a JSON file: {"Cl_p": ...}, {"derivatives": {...}}, a manifest of recordings, or an object whose
    keys are beginnings of flights' names.

    Raises EstimationError for a file that cannot be read, or that has no or different derivatives for these flights.
    """
    try:
        data = json.loads(read_text(path, error=EstimationError))
    except (ValueError, RecursionError):
        raise EstimationError(f'{path}: not JSON; write derivatives by name, like {{"Cl_p": -0.495}}') from None
    truths = [_of_flight(data, name) for name in flights]
    truth = next((f for f in truths if f), None)
    if truth is None:
        raise EstimationError(f"{path}: no derivatives there for {', '.join(flights)}")
    if any(f != truth for f in truths):
        raise EstimationError(f"{path}: the truth of these flights is not one: give flights of one aircraft")
    return truth


def _of_flight(data: Any, flight: str) -> dict[str, float]:
    """Derivatives of one flight by name; empty where the file has none."""
    if not isinstance(data, Mapping):
        return {}
    entry: Any = data
    if isinstance(data.get("recordings"), list):
        entry = next((r for r in data["recordings"] if isinstance(r, Mapping) and r.get("name") == flight), {})
    elif "derivatives" not in data:
        sets = [k for k, v in data.items() if isinstance(v, Mapping) and flight.startswith(k)]
        entry = data[max(sets, key=len)] if sets else data
    table = entry.get("derivatives", entry)
    return {k: float(v) for k, v in table.items() if isinstance(v, int | float) and not isinstance(v, bool)}
