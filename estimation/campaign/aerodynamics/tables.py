"""The aerodynamic database as rows: from the results of a campaign to curves, surfaces and sentences on outlying flights."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from estimation.campaign.aerodynamics import pooled
from estimation.campaign.aerodynamics.forms import CONDITIONS
from estimation.campaign.aerodynamics.pooled import GroupFlights, PooledCurves
from estimation.campaign.aerodynamics.steps import DateStep, Side, sides, starts_of, with_steps
from estimation.campaign.groups import Starts, label_of
from estimation.campaign.schema import usable_estimates
from estimation.campaign.tasks import Row
from groundstation.flight import Array

if TYPE_CHECKING:
    import pyarrow as pa

GRID = 9  # values of alpha and of V in a surface
ALONG = 25  # points of a curve over one condition
REPLICATES = 100  # of the bootstrap that the bands are compared with: its own error is 7 %
SURFACE = "alpha, V"
LEADING = 3  # parameters named in the sentence on an outlying flight
SMOOTHING = 0.15  # standard deviation of the weights for the other conditions along a curve, over half the range flown
LEAST_WEIGHT = 1e-12  # of a flight, so that the weights never sum to zero

INSTRUMENTS = "check"  # kind and method of the instrument factors: compared between flights, but no aerodynamics

Group = tuple[tuple[str, ...], str]
"""Values of the keys, method."""
ByFlight = dict[tuple[str, str, str], list[dict[str, Any]]]
"""Date, flight, key with manoeuvre -> rows of its estimates."""


@dataclass(frozen=True)
class Curves:
    """One group and method. group_columns: group and method, as columns; rows: of its results by flight; envelope: its curves;
    steps: in time."""

    group_columns: Row
    rows: ByFlight
    envelope: PooledCurves
    steps: tuple[DateStep, ...]


def envelopes(results: "pa.Table", keys: Sequence[str], seed: int) -> list[Curves]:
    """The curves of every group and method with enough flights. Instrument factors of the data checks count as a method."""
    group_curves = []
    for (values, method), flights in sorted(_by_group(results, keys).items()):
        group = dict(zip(keys, values, strict=True))
        curves, steps = with_steps(flights_of_rows(flights), seed)
        if curves is not None:
            group_columns: Row = {
                "group": label_of(group),
                "method": method,
                **{k: v or None for k, v in group.items()},
            }
            group_curves.append(Curves(group_columns, flights, curves, steps))
    return group_curves


def database_rows(curves_by_group: Sequence[Curves], seed: int) -> list[Row]:
    """For each parameter a surface over alpha and V, and a curve along each condition with the others as flown there; one of each
    for either side of a step in time that moved it."""
    rows: list[Row] = []
    for group_curves in curves_by_group:
        curves = group_curves.envelope
        replicates = pooled.bootstrap(curves, REPLICATES, seed)
        for j, name in enumerate(curves.group.parameters):
            if group_curves.group_columns["method"] == INSTRUMENTS:
                continue
            parameter_replicates = replicates[:, curves.design.owner == j]
            for side in sides(curves, group_curves.steps, name):
                common: Row = {
                    **group_curves.group_columns,
                    "kind": "pooled",
                    "parameter": name,
                    "flights": int(curves.group.data.known[curves.sound & side.flights, j].sum()),
                    "between": math.sqrt(curves.fit.tau2[j]),
                    "form": curves.forms[j].words,
                    "formula": curves.formula(j, side.shifts),
                    "since": side.since or None,
                    "until": side.until or None,
                }
                for condition, points in points_of(curves):
                    rows += _rows(curves, j, points, parameter_replicates, {**common, "along": condition}, side)
    return rows


def starts_in(curves_by_group: Sequence[Curves]) -> Starts:
    """The first flights after the steps that moved each parameter."""
    return {
        (group_curves.group_columns["group"], group_curves.group_columns["method"], name): starts
        for group_curves in curves_by_group
        for name in group_curves.envelope.group.parameters
        if (starts := starts_of(group_curves.envelope, group_curves.steps, name))
    }


def flight_rows(curves_by_group: Sequence[Curves]) -> Iterator[Row]:
    """A row with a sentence for each flight whose parameters together are far from the curves of the others."""
    for group_curves in curves_by_group:
        for i in np.flatnonzero(~group_curves.envelope.sound):
            yield _flight_row(group_curves.envelope, int(i), group_curves.group_columns)


def _flight_row(curves: PooledCurves, i: int, group_columns: Row) -> Row:
    group = curves.group
    distances = []
    for j in np.flatnonzero(group.data.known[i]):
        value, std = curves.of_flight(int(j), i)
        spread = math.hypot(std, math.sqrt(group.data.V[i, j, j] + curves.fit.tau2[j]))
        distances.append(((float(group.data.y[i, j]) - value) / spread, group.parameters[j]))
    leading = sorted(distances, key=lambda o: -abs(o[0]))[:LEADING]
    distance, limit = math.sqrt(curves.distance[i]), math.sqrt(curves.limit[i])
    text = (
        f"{group.flights[i]}: its estimates together ({group_columns['method']}) are {distance:.1f} bounds from what the other"
        f" flights of {group_columns['group']} say at its conditions (limit {limit:.1f}); most in "
        + ", ".join(f"{name} ({z:+.1f} bounds)" for z, name in leading)
        + "; left out of the database: look at its record and its page"
    )
    return {
        **group_columns,
        "kind": "outlying flight",
        "flight": group.flights[i],
        "at": group.dates[i] or None,
        "flights": len(group.flights),
        "ratio": distance,
        "text": text,
    }


# ------------------------------------------------------------------------------------------------------ inside


def _by_group(results: "pa.Table", keys: Sequence[str]) -> dict[Group, ByFlight]:
    """Group -> (date, flight, key and manoeuvre) -> rows of usable estimates."""
    groups: dict[Group, ByFlight] = {}
    columns = ("manoeuvre", "place", "covariance", *CONDITIONS, *keys)
    for row in usable_estimates(results, ("estimate", INSTRUMENTS), columns):
        group = (tuple(row[k] or "" for k in keys), row["method"])
        flight = (row["date"] or "", row["flight"], f"{row['key']} {row['manoeuvre'] or ''}")
        groups.setdefault(group, {}).setdefault(flight, []).append(row)
    return groups


def flights_of_rows(flights: ByFlight) -> GroupFlights:
    """The estimates as arrays, flights in order of date and name, parameters of name: no number depends on the order of rows."""
    order = sorted(flights)
    names = sorted({r["parameter"] for rows in flights.values() for r in rows})
    column = {name: j for j, name in enumerate(names)}
    shape = (len(order), len(names))
    values, std = np.full(shape, np.nan), np.full(shape, np.nan)
    correlation = np.broadcast_to(np.eye(len(names)), (*shape, len(names))).copy()
    conditions = np.full((len(order), len(CONDITIONS)), np.nan)
    for i, flight in enumerate(order):
        rows = flights[flight]
        conditions[i] = [np.nan if rows[0][c] is None else rows[0][c] for c in CONDITIONS]
        for r in rows:
            values[i, column[r["parameter"]]], std[i, column[r["parameter"]]] = r["estimate"], r["std_coloured"]
        _correlate(correlation[i], rows, column)
    return pooled.group_flights_of(names, [(d, f) for d, f, _ in order], conditions, values, std, correlation)


def _correlate(correlation: Array, rows: Sequence[Mapping[str, Any]], column: Mapping[str, int]) -> None:
    """Set the correlations (k, k) of one flight's estimates from the rows of its covariance, where its method gives one."""
    placed_rows = [r for r in rows if r["place"] is not None and r["covariance"]]
    places = [r["place"] for r in placed_rows]
    if len(placed_rows) < 2:
        return
    C = np.array([[np.nan if r["covariance"][p] is None else r["covariance"][p] for p in places] for r in placed_rows])
    std = np.sqrt(np.maximum(np.diag(C), 0.0))
    if not np.isfinite(C).all() or not (std > 0.0).all():
        return
    index = [column[r["parameter"]] for r in placed_rows]
    correlation[np.ix_(index, index)] = 0.5 * (C + C.T) / np.outer(std, std)


def points_of(curves: PooledCurves) -> Iterator[tuple[str, Array]]:
    """(varied condition, (points, 4) conditions); one point where no condition changed between flights."""
    flights = curves.group.conditions[curves.sound]
    middle, scale = np.median(flights, axis=0), curves.scale
    changed = [c for c, is_changed in zip(CONDITIONS, scale.changed, strict=True) if is_changed]
    if not changed:
        yield "", middle[None, :]
        return
    if "alpha" in changed and "V" in changed:
        a, v = (np.linspace(scale.centre[i] - scale.half[i], scale.centre[i] + scale.half[i], GRID) for i in (0, 1))
        grid = np.tile(middle, (GRID * GRID, 1))
        grid[:, 0], grid[:, 1] = np.repeat(a, GRID), np.tile(v, GRID)
        nearest = np.abs((grid[:, None, :2] - flights[None, :, :2]) / scale.half[:2]).max(axis=2).argmin(axis=1)
        grid[:, 2:] = flights[nearest, 2:]  # as in the nearest flight: a combination that nobody flew has no value
        yield SURFACE, grid
    for name in changed:
        c = CONDITIONS.index(name)
        condition_values = np.linspace(scale.centre[c] - scale.half[c], scale.centre[c] + scale.half[c], ALONG)
        yield name, _as_flown(condition_values, c, flights, scale.half)


def _as_flown(values: Array, condition: int, flights: Array, half: Array) -> Array:
    """(points, 4) conditions: one at `values`, the others at the weighted means of the flights near by."""
    distance = (values[:, None] - flights[None, :, condition]) / (SMOOTHING * half[condition])
    flight_weights = np.exp(-0.5 * distance**2) + LEAST_WEIGHT
    points: Array = flight_weights @ np.nan_to_num(flights) / flight_weights.sum(axis=1, keepdims=True)
    points[:, condition] = values
    return points


def _rows(curves: PooledCurves, parameter: int, points: Array, replicates: Array, common: Row, side: Side) -> list[Row]:
    value, std = curves.at(parameter, points, side.shifts)
    half = curves.half_band(parameter, std)
    columns = curves.columns(parameter, points, side.shifts)
    spread = np.std(replicates @ columns.T, axis=0, ddof=1) if len(replicates) > 1 else None
    rows = []
    for i, was_flown in enumerate(curves.flown(points, side.flights)):
        condition_values = {
            n: float(x) if math.isfinite(x) else None for n, x in zip(CONDITIONS, points[i], strict=True)
        }
        row: Row = {**common, **condition_values, "flown": bool(was_flown)}
        if was_flown:
            numbers = {"estimate": value[i], "std": std[i], "low": value[i] - half[i], "high": value[i] + half[i]}
            row |= {n: float(x) for n, x in numbers.items()}
            row["bootstrap_std"] = None if spread is None else float(spread[i])
        rows.append(row)
    return rows
