"""Flights of one group looked at together: pooled estimates, scatter against bounds, outliers, steps in time, differences."""

import itertools
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from estimation.campaign import pooling
from estimation.campaign.tasks import Row

if TYPE_CHECKING:
    import pyarrow as pa

Array = NDArray[np.float64]

FEWEST_TO_POOL = 2
FEWEST_FOR_OUTLIERS = 5  # below, the median of the others says too little
FEWEST_BEFORE_A_STEP = 3  # flights on either side
NEIGHBOURS = 5  # flights before and after whose medians an estimate may follow
CHANGE_OF_INTEREST = 0.05  # of the estimate: the change whose chance to be found is stated as power


@dataclass(frozen=True)
class Series:
    """One parameter by one method over the flights of a group, in order of date. y, v: (flights,) estimates and variances;
    places: (key, manoeuvre) of each."""

    group: Mapping[str, str]
    label: str
    method: str
    parameter: str
    flights: tuple[str, ...]
    dates: tuple[str, ...]
    places: tuple[tuple[str, str], ...]
    y: Array
    v: Array

    def part(self, keep: NDArray[np.bool_]) -> "Series":
        """Only some of the flights."""
        chosen = [i for i, k in enumerate(keep) if k]
        return Series(
            self.group,
            self.label,
            self.method,
            self.parameter,
            tuple(self.flights[i] for i in chosen),
            tuple(self.dates[i] for i in chosen),
            tuple(self.places[i] for i in chosen),
            self.y[keep],
            self.v[keep],
        )


_Found = tuple[str, str, tuple[str, str], float, float]
"""Date, flight, (key, manoeuvre), estimate, variance."""


def label_of(group: Mapping[str, str]) -> str:
    """`configuration=new rudder, day=2026-03-01`; `all flights` where nothing tells groups apart."""
    return ", ".join(f"{k}={v}" for k, v in group.items() if v) or "all flights"


def series_of(results: "pa.Table", keys: Sequence[str]) -> list[Series]:
    """Every usable estimate of every flight, by group, method and parameter."""
    wanted = (
        "kind",
        "flight",
        "method",
        "parameter",
        "estimate",
        "std_coloured",
        "identifiable",
        "status",
        "date",
        "key",
        "manoeuvre",
    )
    names = list(dict.fromkeys((*wanted, *keys)))
    columns = {name: results[name].to_pylist() for name in names}
    found: dict[tuple[Any, ...], list[_Found]] = {}
    for i in range(results.num_rows):
        std, value = columns["std_coloured"][i], columns["estimate"][i]
        usable = (
            columns["kind"][i] in ("estimate", "check") and columns["status"][i] == "ok" and columns["identifiable"][i]
        )
        if usable and value is not None and std:
            group = tuple(columns[k][i] or "" for k in keys)
            place = (group, columns["method"][i], columns["parameter"][i])
            order = (
                columns["date"][i] or "",
                columns["flight"][i],
                (columns["key"][i], columns["manoeuvre"][i] or ""),
            )
            found.setdefault(place, []).append((*order, value, std**2))
    return [_series(place, rows, keys) for place, rows in sorted(found.items())]


def _series(place: tuple[Any, ...], rows: list[_Found], keys: Sequence[str]) -> Series:
    rows = sorted(rows)
    group = dict(zip(keys, place[0], strict=True))
    dates, flights, places, y, v = zip(*rows, strict=True)
    return Series(group, label_of(group), place[1], place[2], flights, dates, places, np.array(y), np.array(v))


def sound_series(results: "pa.Table", keys: Sequence[str]) -> list[Series]:
    """`series_of` without outliers."""
    return [s.part(~(outlying(s) > _limit(s))) for s in series_of(results, keys)]


def group_rows(results: "pa.Table", keys: Sequence[str]) -> list[Row]:
    """All rows of the table of groups."""
    every = series_of(results, keys)
    count: dict[tuple[str, str], int] = {}
    for s in every:
        count[s.label, s.method] = count.get((s.label, s.method), 0) + 1
    rows: list[Row] = []
    sound: list[Series] = []
    for s in every:
        far = outlying(s)
        rows += outlier_rows(s, far)
        kept = s.part(~(far > _limit(s)))
        rows += step_rows(kept, count[s.label, s.method])
        rows += pooled_rows(kept)
        sound.append(kept)
    return [*rows, *difference_rows(sound, [k for k in keys if k != "day"])]


# ------------------------------------------------------------------------------------------- within a group


def outlying(s: Series) -> Array:
    """(flights,) distance from the nearer of the medians of the flights before and after, in widened bounds.

    So a step in time makes no outliers. Without dates, and with few flights, all are compared with one median.
    """
    if s.y.size < FEWEST_FOR_OUTLIERS:
        return np.zeros(s.y.size)
    if len(set(s.dates)) < 2 or s.y.size <= 2 * NEIGHBOURS:
        return pooling.outliers(s.y, s.v)
    away = np.full(s.y.size, np.inf)
    for i in range(s.y.size):
        for near in (s.y[max(0, i - NEIGHBOURS) : i], s.y[i + 1 : i + 1 + NEIGHBOURS]):
            if near.size >= FEWEST_BEFORE_A_STEP:
                away[i] = min(away[i], abs(s.y[i] - float(np.median(near))))
    z = away / np.sqrt(s.v)
    widened: Array = z / max(1.0, pooling.ROBUST * float(np.median(z)))
    return widened


def _limit(s: Series) -> float:
    return pooling.outlier_limit(s.y.size)


def outlier_rows(s: Series, distance: Array) -> Iterator[Row]:
    """A sentence on each flight that is far from the others of its group."""
    for i in np.flatnonzero(distance > _limit(s)):
        text = (
            f"{s.flights[i]}: {s.parameter} ({s.method}) is {s.y[i]:.4g}, {distance[i]:.1f} widened bounds from the flights"
            f" beside it (limit {_limit(s):.1f}); left out of what is said of {s.label}"
        )
        yield {
            **_about(s),
            "kind": "outlier",
            "flight": s.flights[i],
            "at": s.dates[i] or None,
            "estimate": float(s.y[i]),
            "std": float(np.sqrt(s.v[i])),
            "ratio": float(distance[i]),
            "text": text,
        }


def step_rows(s: Series, tests: int) -> Iterator[Row]:
    """The date from which a parameter is another, where one is found among `tests` parameters at the usual level."""
    places = _places(s)
    if not places:
        return
    k = _largest_step(s, places)
    fit = _split(s, k)
    p = min(1.0, fit.probability(1) * len(places))
    if p * tests > pooling.LEVEL:
        return
    low, high = fit.interval(1)
    text = (
        f"{s.parameter} ({s.method}) of {s.label} changes by {fit.b[1]:+.4g} (95 % {low:.4g} to {high:.4g}) with"
        f" {s.flights[k]} of {s.dates[k]}: look what was done to the aircraft or its sensors before it"
    )
    yield {
        **_about(s),
        "kind": "step",
        "at": s.dates[k],
        "flight": s.flights[k],
        "estimate": float(fit.b[1]),
        "std": float(fit.std[1]),
        "low": low,
        "high": high,
        "probability": p,
        "text": text,
    }


def _places(s: Series) -> list[int]:
    """First flights of a later date with enough flights on either side."""
    first, last = FEWEST_BEFORE_A_STEP, s.y.size - FEWEST_BEFORE_A_STEP
    return [k for k in range(first, last + 1) if s.dates[k - 1] and s.dates[k] != s.dates[k - 1]]


def _largest_step(s: Series, places: Sequence[int]) -> int:
    """The place of the largest difference in its own bound, with the variance between flights of no step at all."""
    w = 1.0 / (s.v + pooling.pool(s.y, s.v).tau2)
    weight, top = np.cumsum(w), np.cumsum(w * s.y)
    at = np.array(places) - 1
    before, after = weight[at], weight[-1] - weight[at]
    difference = (top[-1] - top[at]) / after - top[at] / before
    return places[int(np.argmax(np.abs(difference) / np.sqrt(1.0 / before + 1.0 / after)))]


def _split(s: Series, k: int) -> pooling.Pooled:
    later = (np.arange(s.y.size) >= k).astype(float)
    return pooling.pool(s.y, s.v, np.column_stack([np.ones(s.y.size), later]))


def pooled_rows(s: Series) -> Iterator[Row]:
    """The group's estimate, its scatter and what that says of the bounds."""
    if s.y.size < FEWEST_TO_POOL:
        return
    fit = pooling.pool(s.y, s.v)
    low, high = fit.interval()
    scatter, bound = float(np.std(s.y, ddof=1)), float(np.sqrt(np.mean(s.v)))
    text = ""
    if fit.p < 0.01:  # as the mean over flights of sideslip estimate says it
        text = f"scatter is {scatter / bound:.1f} times the bounds: these are too small, or the flights differ"
    yield {
        **_about(s),
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


def _about(s: Series) -> Row:
    return {"group": s.label, "method": s.method, "parameter": s.parameter, "flights": s.y.size, **_group(s.group)}


def _group(group: Mapping[str, str]) -> Row:
    return {key: value or None for key, value in group.items()}


# ------------------------------------------------------------------------------------------ between groups


def difference_rows(series: Sequence[Series], keys: Sequence[str]) -> Iterator[Row]:
    """Groups that differ in one of `keys` alone, parameter by parameter."""
    by_test: dict[tuple[str, str], list[Series]] = {}
    for s in series:
        if s.y.size >= FEWEST_TO_POOL:
            by_test.setdefault((s.method, s.parameter), []).append(s)
    pairs = [pair for same in by_test.values() for pair in itertools.combinations(same, 2) if _one_apart(pair, keys)]
    tests: dict[tuple[str, str, str], int] = {}
    for a, b in pairs:
        tests[a.label, b.label, a.method] = tests.get((a.label, b.label, a.method), 0) + 1
    for a, b in pairs:
        yield _difference(a, b, tests[a.label, b.label, a.method])


def _one_apart(pair: Iterable[Series], keys: Sequence[str]) -> bool:
    a, b = (s.group for s in pair)
    return sum(a[k] != b[k] for k in a) == 1 and any(a[k] != b[k] for k in keys)


def _difference(a: Series, b: Series, tests: int) -> Row:
    """b less a. Both share one variance between flights; `probability` is of the one test, the verdict heeds all of them."""
    second = np.concatenate([np.zeros(a.y.size), np.ones(b.y.size)])
    y, v = np.concatenate([a.y, b.y]), np.concatenate([a.v, b.v])
    fit = pooling.pool(y, v, np.column_stack([np.ones(y.size), second]))
    low, high = fit.interval(1)
    std, p = float(fit.std[1]), fit.probability(1)
    chance = pooling.power(CHANGE_OF_INTEREST * float(fit.b[0]), std, fit.freedom)
    differs = p * tests <= pooling.LEVEL
    told = abs(fit.b[0]) > 3.0 * fit.std[0]  # a share of what may be zero says nothing
    share = f" ({fit.b[1] / fit.b[0]:+.1%})" if told else ""
    text = (
        f"{a.parameter} ({a.method}): {b.label} less {a.label} is {fit.b[1]:+.4g}{share}, "
        f"95 % {low:.4g} to {high:.4g}: "
        + ("they differ" if differs else "no difference found")
        + f"; a change of {CHANGE_OF_INTEREST:.0%} would be found with probability {chance:.2f}"
    )
    return {
        **_about(a),
        "kind": "difference",
        "other": b.label,
        "flights": y.size,
        "estimate": float(fit.b[1]),
        "std": std,
        "low": low,
        "high": high,
        "between": math.sqrt(fit.tau2),
        "probability": min(1.0, p * tests),
        "power": chance,
        "detectable": pooling.detectable(std, fit.freedom),
        "text": text,
    }
