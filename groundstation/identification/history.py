"""The history of live estimates, as it is stored with the finished flight and read from it."""

import math
from array import array
from collections.abc import Mapping, Sequence
from typing import Any

from daq.identification.airframe import DERIVATIVES
from daq.identification.estimates import LiveEstimates

DETAIL = "live_identification"
"""Key of a flight's provenance detail under which the history travels with the flight."""
BELIEVED = "believed"
"""Key of the beliefs stored with the history: derivative -> value, std, source."""
MOST = 7200  # stored entries: two hours at one a second, some 3 MB
DIGITS = 6  # of a stored number: bounds are known to two


class LiveHistory:
    """Estimates over time. Each time MOST entries are exceeded, every other one is dropped and the rate of storing halved."""

    def __init__(self, names: Sequence[str] = DERIVATIVES) -> None:
        self._names = tuple(names)
        # time; estimate and std of each derivative, NaN before it is identified
        self._rows: list[tuple[float, array[float]]] = []
        self._to_skip = self._skipped = 0  # entries between two stored ones

    def __len__(self) -> int:
        return len(self._rows)

    def add(self, time: float, estimates: LiveEstimates) -> None:
        """One entry, at `time` [s] of the flight."""
        if self._skipped < self._to_skip:
            self._skipped += 1
            return
        self._skipped = 0
        derivatives = [estimates.derivatives[n] for n in self._names]
        numbers = [(d.estimate, d.std) if d.told else (math.nan, math.nan) for d in derivatives]
        self._rows.append((time, array("d", [x for pair in numbers for x in pair])))
        if len(self._rows) > MOST:
            self._rows = self._rows[::2]
            self._to_skip = 2 * self._to_skip + 1

    def to_json(self) -> dict[str, Any]:
        """`time` and, by derivative, `estimate` and `std`, null before it is identified, as `estimate --method live` has them."""

        def series(column: int) -> list[float | None]:
            return [_rounded(row[column]) for _, row in self._rows]

        return {
            "time": [round(t, 3) for t, _ in self._rows],
            **{n: {"estimate": series(2 * i), "std": series(2 * i + 1)} for i, n in enumerate(self._names)},
        }


def final_json(estimates: LiveEstimates) -> dict[str, Any]:
    """The last estimates, each with the reason where it is not identified."""
    return {
        n: {"estimate": _finite(d.estimate), "std": _finite(d.std), "told": d.told, "why": d.why}
        for n, d in estimates.derivatives.items()
    }


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _rounded(value: float) -> float | None:
    return float(f"{value:.{DIGITS}g}") if math.isfinite(value) else None


def history_of(detail: Mapping[str, Any]) -> tuple[list[float], dict[str, tuple[list[float], list[float]]]] | None:
    """Times [s] and, by derivative, estimates and bounds (NaN before they were identified) stored with a flight. None where
    there is no history, or a malformed one, which a flight from elsewhere may have."""
    stored = detail.get(DETAIL)
    history = stored.get("history") if isinstance(stored, Mapping) else None
    if not isinstance(history, Mapping):
        return None
    times = _numbers(history.get("time"))
    if not times or not all(math.isfinite(t) for t in times):
        return None
    series_by_name = {}
    for name, series in history.items():
        if isinstance(series, Mapping):
            values, bounds = _numbers(series.get("estimate")), _numbers(series.get("std"))
            if len(values) == len(bounds) == len(times):
                series_by_name[name] = (values, bounds)
    return times, series_by_name


def alarmed(detail: Mapping[str, Any]) -> bool:
    """Whether the gap monitor gave an alarm during the flight."""
    stored = detail.get(DETAIL)
    return isinstance(stored, Mapping) and bool(stored.get("alarms"))


def _numbers(value: Any) -> list[float]:
    """A list of numbers and nulls, as numbers and NaN; empty for anything else."""
    if not isinstance(value, list) or not all(
        v is None or (isinstance(v, int | float) and not isinstance(v, bool)) for v in value
    ):
        return []
    return [math.nan if v is None else float(v) for v in value]
