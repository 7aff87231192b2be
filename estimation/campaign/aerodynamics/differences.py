"""Differences between two groups at the same conditions: did the new rudder change Cn_dr, and which change could be found?

Both groups share the curves over the conditions and the variances between flights; the difference is a shift of each parameter.
So another speed is not mistaken for another rudder; where only one group flew at a condition, the bound grows.
"""

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimation.campaign import pooling
from estimation.campaign.aerodynamics.pooled import GroupFlights, PooledCurves, envelope
from estimation.campaign.aerodynamics.steps import DateStep, ParameterStep
from estimation.campaign.aerodynamics.tables import Curves, flights_of_rows
from estimation.campaign.tasks import Row


@dataclass(frozen=True)
class Difference:
    """Second group less first. value: of the first group at its median conditions; between: standard deviation between flights;
    tests: parameters compared; form: of the curve."""

    parameter: str
    flights: int
    value: float
    value_std: float
    change: float
    std: float
    freedom: int
    between: float
    tests: int
    form: str

    @property
    def probability(self) -> float:
        """Of a difference this large by chance in any of the parameters compared."""
        return min(1.0, pooling.two_sided(self.change / self.std, self.freedom) * self.tests)

    @property
    def detectable(self) -> float:
        """The least difference that is found in these flights four times in five."""
        return pooling.detectable(self.std, self.freedom, self.tests)

    @property
    def interval(self) -> tuple[float, float]:
        """95 % interval, of this parameter alone."""
        half = pooling.t_quantile(1.0 - pooling.LEVEL / 2.0, self.freedom) * self.std
        return self.change - half, self.change + half

    def power(self, share: float) -> float:
        """Probability that a change by this share of the value is found."""
        return pooling.power(share * self.value, self.std, self.freedom, self.tests)


def differences(group_flights: GroupFlights, second: NDArray[np.bool_]) -> tuple[Difference, ...]:
    """The difference of every parameter of both groups. group_flights: of both; second: (flights,) true for the second group."""
    curves = envelope(group_flights, second.astype(float)[:, None])
    if curves is None:
        return ()
    compared_parameters = [(j, s) for j in range(len(curves.group.parameters)) if (s := curves.shift(j, 0)) is not None]
    return tuple(
        _difference(curves, j, change, std, len(compared_parameters)) for j, (change, std) in compared_parameters
    )


def _difference(curves: PooledCurves, j: int, change: float, std: float, tests: int) -> Difference:
    first = curves.shifts[:, 0] <= 0.0
    usual_conditions = np.median(np.nan_to_num(curves.group.conditions[first]), axis=0)[None, :]
    value, value_std = curves.at(j, usual_conditions)
    lowest = float(curves.shifts[:, 0].min())
    freedom = int(curves.fit.freedom[j])
    return Difference(
        curves.group.parameters[j],
        int(curves.group.data.known[curves.sound, j].sum()),
        float(value[0]) + lowest * change,
        float(value_std[0]),
        change,
        std,
        freedom,
        float(np.sqrt(curves.fit.tau2[j])),
        tests,
        curves.forms[j].words,
    )


CHANGE_OF_INTEREST = 0.05  # of the estimate: the change for which the power is stated
LEAST_RATIO = 3.0  # of value to bound, from which a change is also stated as a share


def step_rows(curves_by_group: Sequence[Curves]) -> Iterator[Row]:
    """A row for each parameter that a step in time moved; a row without a parameter where none moved clearly by itself."""
    for curves in curves_by_group:
        for step in curves.steps:
            moved_parameters = [m for m in step.moved if m.probability <= pooling.LEVEL]
            if not moved_parameters:
                yield _step_row(curves, step, None, ())
            for m in moved_parameters:
                yield _step_row(curves, step, m, [o.parameter for o in moved_parameters if o is not m])


def _step_row(curves: Curves, step: DateStep, m: ParameterStep | None, others: Sequence[str]) -> Row:
    group_flights = curves.envelope.group
    first, last = step.dates
    date_text = f"with {group_flights.flights[step.first]} of {group_flights.dates[step.first]} (95 %: after {first}, by {last})"
    row: Row = {
        **curves.group_columns,
        "kind": "step",
        "flights": len(group_flights.flights),
        "at": group_flights.dates[step.first],
        "flight": group_flights.flights[step.first],
        "probability": step.probability,
    }
    if m is None:
        text = f"{row['group']} ({row['method']}): the parameters together change {date_text}, none clearly by itself"
        return {**row, "text": f"{text}: look what was done to the aircraft or its sensors before it"}
    half = pooling.t_quantile(1.0 - pooling.LEVEL / 2.0, step.freedom) * m.std
    low, high = m.change - half, m.change + half
    other_parameters = f", together with {', '.join(others)}" if others else ""
    text = (
        f"{m.parameter} ({row['method']}) of {row['group']} changes by {m.change:+.4g} (95 % {low:.4g} to {high:.4g}) {date_text}"
        f"{other_parameters}: look what was done to the aircraft or its sensors before it"
    )
    numbers = {"parameter": m.parameter, "estimate": m.change, "std": m.std, "low": low, "high": high}
    return {**row, **numbers, "text": text}


def difference_rows(curves_by_group: Sequence[Curves], keys: Sequence[str]) -> Iterator[Row]:
    """Rows on pairs of groups that differ in one of `keys` alone. Days are not compared: changes in time are steps."""
    compared = [k for k in keys if k != "day"]
    for a, b in itertools.combinations(curves_by_group, 2):
        first, second = a.group_columns, b.group_columns
        differing_keys = [k for k in keys if first[k] != second[k]]
        if first["method"] == second["method"] and len(differing_keys) == 1 and differing_keys[0] in compared:
            all_rows = {**a.rows, **b.rows}
            in_second = np.array([flight in b.rows for flight in sorted(all_rows)])
            for d in differences(flights_of_rows(all_rows), in_second):
                yield _difference_row(a, b, d)


def _difference_row(a: Curves, b: Curves, d: Difference) -> Row:
    low, high = d.interval
    chance = d.power(CHANGE_OF_INTEREST)
    share_known = abs(d.value) > LEAST_RATIO * d.value_std
    share = f" ({d.change / d.value:+.1%})" if share_known else ""
    conditions_note = "" if d.form == "1" else f", at the same conditions (over {d.form})"
    first, second = a.group_columns, b.group_columns
    text = (
        f"{d.parameter} ({first['method']}): {second['group']} less {first['group']} is {d.change:+.4g}{share}"
        f"{conditions_note}, 95 % {low:.4g} to {high:.4g}: "
        + ("they differ" if d.probability <= pooling.LEVEL else "no difference found")
        + f"; a change of {CHANGE_OF_INTEREST:.0%} would be found with probability {chance:.2f}, one of {d.detectable:.2g} four"
        " times in five"
    )
    return {
        **first,
        "kind": "difference",
        "other": second["group"],
        "parameter": d.parameter,
        "flights": d.flights,
        "estimate": d.change,
        "std": d.std,
        "low": low,
        "high": high,
        "between": d.between,
        "probability": d.probability,
        "power": chance,
        "detectable": d.detectable,
        "text": text,
    }
