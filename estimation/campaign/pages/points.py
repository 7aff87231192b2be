"""Estimates of the flights as points, and the curves of the database, as arrays for the figures."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from estimation.campaign.aerodynamics.forms import CONDITIONS
from estimation.campaign.groups import label_in
from estimation.campaign.schema import usable_estimates
from estimation.campaign.tasks import Row
from groundstation.flight import Array

if TYPE_CHECKING:
    import pyarrow as pa


@dataclass(frozen=True)
class EstimatePoints:
    """Estimates of one parameter by one method: arrays (flights,), labels of groups, dates. order: rank by date; prior: the prior
    value, where all flights have the same."""

    parameter: str
    order: Array
    y: Array
    std: Array
    groups: tuple[str, ...]
    dates: tuple[str, ...]
    conditions: Mapping[str, Array]
    prior: float | None


@dataclass(frozen=True)
class Faired:
    """A curve of the database along one condition: arrays (points,), NaN outside the range flown. low, high: 95 %."""

    x: Array
    value: Array
    low: Array
    high: Array


def method_stem(method: str) -> str:
    """A method as part of a file's name: `module:NAME` without its colon."""
    return method.replace(":", "_")


def points_of(results: "pa.Table", method: str, keys: Sequence[str]) -> list[EstimatePoints]:
    """Usable estimates by parameter, in order of date and name."""
    columns = ("reference", *CONDITIONS, *keys)
    rows = [r for r in usable_estimates(results, ("estimate",), columns) if r["method"] == method]
    flights = sorted({(r["date"] or "", r["flight"], r["key"]) for r in rows})
    place = {key: i for i, (_, _, key) in enumerate(flights)}
    by_name: dict[str, list[Row]] = {}
    for r in rows:
        by_name.setdefault(r["parameter"], []).append(r)
    return [
        _points(name, sorted(parameter_rows, key=lambda r: place[r["key"]]), place, keys)
        for name, parameter_rows in by_name.items()
    ]


def _points(name: str, rows: Sequence[Row], place: Mapping[str, int], keys: Sequence[str]) -> EstimatePoints:
    def column(key: str) -> Array:
        return np.array([np.nan if r[key] is None else r[key] for r in rows], float)

    groups = tuple(label_in(r, keys) for r in rows)
    order = np.array([place[r["key"]] for r in rows], float)
    priors = {r["reference"] for r in rows} - {None}
    prior = priors.pop() if len(priors) == 1 else None
    conditions = {c: column(c) for c in CONDITIONS}
    dates = tuple(r["date"] or "" for r in rows)
    return EstimatePoints(name, order, column("estimate"), column("std_coloured"), groups, dates, conditions, prior)


def faired(database: Sequence[Row], kind: str, method: str, parameter: str, along: str) -> list[tuple[str, Faired]]:
    """(group, its curve along a condition), one for each side of a step in time, in order of time."""
    rows_by_side: dict[tuple[str, str], list[Row]] = {}
    for r in database:
        if (r["kind"], r["method"], r["parameter"], r["along"]) == (kind, method, parameter, along):
            rows_by_side.setdefault((r["group"], r.get("since") or ""), []).append(r)
    curves = []
    for (group, _), rows in sorted(rows_by_side.items()):
        columns = (np.array([r.get(n, np.nan) for r in rows], float) for n in (along, "estimate", "low", "high"))
        curves.append((group, Faired(*columns)))
    return curves
