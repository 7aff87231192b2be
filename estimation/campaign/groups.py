"""The flights of a group, parameter by parameter: pooled estimates, scatter against bounds, outliers."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from daq.utilities.plain_words import file_name
from estimation.campaign import pooling
from estimation.campaign.pooling import LEVEL
from estimation.campaign.schema import usable_estimates
from estimation.campaign.tasks import Row
from groundstation.flight import Array

if TYPE_CHECKING:
    import pyarrow as pa

FEWEST_TO_POOL = 2  # flights
FEWEST_FOR_OUTLIERS = 5  # flights: the median of fewer is no measure of an outlier
FEWEST_NEIGHBOURS = 3  # flights on one side from which their median is taken
NEIGHBOURS = 5  # flights before and after with whose medians an estimate is compared
TOO_MUCH_SCATTER = 0.01  # probability of the scatter by the bounds alone, below which a warning is given

Starts = Mapping[tuple[str, str, str], Sequence[tuple[str, str]]]
"""Group, method, parameter -> date and name of the first flight after each step that moved it, in order of time."""


@dataclass(frozen=True)
class ParameterSeries:
    """One parameter by one method over the flights of a group, in order of date. group: column -> value; places: (key, manoeuvre)
    of each flight; y, v: (flights,) estimates and their variances."""

    group: Mapping[str, str]
    label: str
    method: str
    parameter: str
    flights: tuple[str, ...]
    dates: tuple[str, ...]
    places: tuple[tuple[str, str], ...]
    y: Array
    v: Array

    def part(self, keep: NDArray[np.bool_]) -> "ParameterSeries":
        """The flights where `keep` (flights,) is true."""
        indices = [i for i, k in enumerate(keep) if k]
        return replace(
            self,
            flights=tuple(self.flights[i] for i in indices),
            dates=tuple(self.dates[i] for i in indices),
            places=tuple(self.places[i] for i in indices),
            y=self.y[keep],
            v=self.v[keep],
        )


def label_of(group: Mapping[str, str]) -> str:
    """`configuration=new rudder, day=2026-03-01`; `all flights` where the plan has no groups."""
    return ", ".join(f"{k}={v}" for k, v in group.items() if v) or "all flights"


def label_in(row: Row, keys: Sequence[str]) -> str:
    """Label of the group of a row."""
    return label_of({key: row[key] or "" for key in keys})


def stem_of(*labels: str) -> str:
    """Stem of a file for a group, method and the like."""
    return file_name("_".join(labels).replace(", ", "_").replace(" ", "_"))


def series_of(results: "pa.Table", keys: Sequence[str]) -> list[ParameterSeries]:
    """The usable estimates of all flights, one series for each group, method and parameter. keys: columns that make groups."""
    places: dict[tuple[Any, ...], list[tuple[Any, ...]]] = {}
    for row in usable_estimates(results, ("estimate", "check"), ("manoeuvre", *keys)):
        place = (tuple(row[k] or "" for k in keys), row["method"], row["parameter"])
        flight = (row["date"] or "", row["flight"], (row["key"], row["manoeuvre"] or ""))
        places.setdefault(place, []).append((*flight, row["estimate"], row["std_coloured"] ** 2))
    series = []
    for (values, method, parameter), rows in sorted(places.items()):
        group = dict(zip(keys, values, strict=True))
        dates, flights, pieces, y, v = zip(*sorted(rows), strict=True)
        label = label_of(group)
        series.append(
            ParameterSeries(group, label, method, parameter, flights, dates, pieces, np.array(y), np.array(v))
        )
    return series


def group_rows(results: "pa.Table", keys: Sequence[str], starts: Starts = MappingProxyType({})) -> list[Row]:
    """For each parameter of each group its outliers, and the pooled value of the other flights.

    starts: first flights after steps in time; each side of a step is pooled by itself.
    """
    rows: list[Row] = []
    for s in series_of(results, keys):
        distances = distances_from_neighbours(s)
        rows += outlier_rows(s, distances)
        inliers = s.part(~(distances > _limit(s)))
        for side in _sides(inliers, starts.get((s.label, s.method, s.parameter), ())):
            rows += pooled_rows(side, one_side=side is not inliers)
    return rows


def _sides(s: ParameterSeries, starts: Sequence[tuple[str, str]]) -> Iterator[ParameterSeries]:
    """The flights between steps. starts: date and name of the first flight after each step, in order."""
    if not starts:
        yield s
        return
    side = np.array([sum(start <= flight for start in starts) for flight in zip(s.dates, s.flights, strict=True)])
    for number in range(len(starts) + 1):
        yield s.part(side == number)


# ------------------------------------------------------------------------------------------- within a group


def distances_from_neighbours(s: ParameterSeries) -> Array:
    """(flights,) distance from the nearer of the medians of the flights before and after, in bounds widened to the scatter.

    A step in time so makes no outliers. Without dates, and with few flights, all are compared with one median.
    """
    if s.y.size < FEWEST_FOR_OUTLIERS:
        return np.zeros(s.y.size)
    if len(set(s.dates)) < 2 or s.y.size <= 2 * NEIGHBOURS:
        return pooling.outliers(s.y, s.v)
    distances = np.full(s.y.size, np.inf)
    for i in range(s.y.size):
        for neighbours in (s.y[max(0, i - NEIGHBOURS) : i], s.y[i + 1 : i + 1 + NEIGHBOURS]):
            if neighbours.size >= FEWEST_NEIGHBOURS:
                distances[i] = min(distances[i], abs(s.y[i] - float(np.median(neighbours))))
    z = distances / np.sqrt(s.v)
    widened: Array = z / max(1.0, pooling.ROBUST * float(np.median(z)))
    return widened


def _limit(s: ParameterSeries) -> float:
    return pooling.outlier_limit(s.y.size)


def outlier_rows(s: ParameterSeries, distance: Array) -> Iterator[Row]:
    """A row with a sentence for each outlier. distance: (flights,) from `distances_from_neighbours`."""
    for i in np.flatnonzero(distance > _limit(s)):
        text = (
            f"{s.flights[i]}: {s.parameter} ({s.method}) is {s.y[i]:.4g}, {distance[i]:.1f} widened bounds from the flights"
            f" beside it (limit {_limit(s):.1f}); excluded from the results of {s.label}"
        )
        yield {
            **_group_columns(s),
            "kind": "outlier",
            "flight": s.flights[i],
            "at": s.dates[i] or None,
            "estimate": float(s.y[i]),
            "std": float(np.sqrt(s.v[i])),
            "ratio": float(distance[i]),
            "text": text,
        }


def pooled_rows(s: ParameterSeries, *, one_side: bool = False) -> Iterator[Row]:
    """The pooled estimate with the scatter of the flights against their bounds. one_side: of a step."""
    if s.y.size < FEWEST_TO_POOL:
        return
    fit = pooling.pool(s.y, s.v)
    low, high = fit.interval()
    scatter, bound = float(np.std(s.y, ddof=1)), float(np.sqrt(np.mean(s.v)))
    text = ""
    if fit.p < TOO_MUCH_SCATTER:
        text = f"scatter is {scatter / bound:.1f} times the bounds: these are too small, or the flights differ"
    yield {
        **_group_columns(s),
        "since": s.dates[0] if one_side else None,
        "until": s.dates[-1] if one_side else None,
        "kind": "pooled",
        "estimate": float(fit.b[0]),
        "std": float(fit.std[0]),
        "low": low,
        "high": high,
        "between": math.sqrt(fit.tau2),
        "scatter": scatter,
        "bound": bound,
        "ratio": scatter / bound,
        "probability": fit.p,
        "text": text,
    }


def _group_columns(s: ParameterSeries) -> Row:
    group = {key: value or None for key, value in s.group.items()}
    return {"group": s.label, "method": s.method, "parameter": s.parameter, "flights": s.y.size, **group}


CLAIMS = ("difference", "step", "envelope", "outlying flight", "outlier")
"""Kinds of rows that a person should read: first those about the aircraft, then those about single flights."""


def claims_of(groups: Sequence[Row]) -> list[Row]:
    """The rows that a person must read, the most important first. A flight that is off as a whole is reported once, not for each
    of its parameters."""
    outlying_flights = {(r["group"], r["method"], r["flight"]) for r in groups if r["kind"] == "outlying flight"}
    claims = [
        r
        for r in groups
        if r["kind"] in CLAIMS
        and (r["kind"] != "difference" or r["probability"] <= LEVEL)
        and (r["kind"] != "outlier" or (r["group"], r["method"], r["flight"]) not in outlying_flights)
    ]
    return sorted(claims, key=lambda r: CLAIMS.index(r["kind"]))
