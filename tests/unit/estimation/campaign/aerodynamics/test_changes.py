"""Steps in time and differences between groups: found with their size and date, and not where another thing explains them."""

import numpy as np

from estimation.campaign.aerodynamics.differences import differences
from estimation.campaign.aerodynamics.pooled import GroupFlights, group_flights_of
from estimation.campaign.aerodynamics.steps import DateStep, with_steps
from tests.unit.estimation.campaign.aerodynamics.test_envelope_curves import CORRELATION, NAMES, SLOPES, STD, estimates

BOUND = np.array([STD[n] for n in NAMES])


def in_days(at: np.ndarray, values: np.ndarray, std: np.ndarray) -> GroupFlights:
    """A flight a day."""
    flights = [(str(np.datetime64("2026-03-01") + i), f"f{i:03d}") for i in range(len(at))]
    return group_flights_of(NAMES, flights, at, values, std, np.tile(CORRELATION, (len(at), 1, 1)))


def steps(rng: np.random.Generator, flights: int, change: np.ndarray, first: int) -> tuple[DateStep, ...]:
    at, values, std, _ = estimates(rng, flights, SLOPES)
    values[first:] += change
    return with_steps(in_days(at, values, std), 0)[1]


def test_a_step_is_found_with_size_and_date_beside_trends_over_conditions() -> None:
    rng = np.random.default_rng(1)
    change = np.array([0.0, 0.0, 3.0]) * BOUND
    sizes, dates = [], 0
    for _ in range(8):
        (step,) = steps(rng, 40, change, 22)
        told = {m.parameter: m for m in step.moved}
        assert told["Cn_beta"].probability < 0.05
        sizes.append((told["Cn_beta"].change - change[2]) / told["Cn_beta"].std)
        dates += step.dates[0] < "2026-03-23" <= step.dates[1]
    assert dates >= 6  # of 8 intervals of 95 %
    assert np.sqrt(np.mean(np.square(sizes))) < 2.0


def test_no_step_is_told_where_there_is_none() -> None:
    rng = np.random.default_rng(2)
    assert sum(bool(steps(rng, 30, np.zeros(3), 10)) for _ in range(20)) <= 3


def test_two_parameters_that_err_together_tell_a_step_that_neither_tells_alone() -> None:
    """Cl_beta and Cl_p are correlated 0.9: a step of one against the other is seen in their difference."""
    rng = np.random.default_rng(3)
    change = np.array([0.7, -0.7, 0.0]) * BOUND
    found = []
    for _ in range(8):
        at, values, std, _ = estimates(rng, 40, {}, between=0.05)
        values[20:] += change
        found.append(with_steps(in_days(at, values, std), 0)[1])
        alone = [with_steps(one(in_days(at, values, std), j), 0)[1] for j in (0, 1)]
        assert found[-1] or not any(alone)
    assert sum(bool(f) for f in found) >= 7


def one(of: GroupFlights, j: int) -> GroupFlights:
    return GroupFlights((of.parameters[j],), of.flights, of.dates, of.conditions, of.data.one(j))


def test_two_steps_are_both_found() -> None:
    rng = np.random.default_rng(4)
    at, values, std, _ = estimates(rng, 60, {})
    values[20:, 0] += 3.0 * BOUND[0]
    values[40:, 2] -= 3.0 * BOUND[2]
    _, found = with_steps(in_days(at, values, std), 0)
    assert sorted((s.first, [m.parameter for m in s.moved if m.probability < 0.01]) for s in found) == [
        (20, ["Cl_beta"]),
        (40, ["Cn_beta"]),
    ]


def test_bad_flights_beside_a_step_are_left_out_and_hide_nothing() -> None:
    rng = np.random.default_rng(5)
    at, values, std, _ = estimates(rng, 40, SLOPES)
    values[20:, 2] += 4.0 * BOUND[2]
    for i in (5, 18, 33):
        values[i, 0] -= 9.0 * std[i, 0]
    curves, found = with_steps(in_days(at, values, std), 0)
    assert curves is not None
    assert np.flatnonzero(~curves.sound).tolist() == [5, 18, 33]
    assert [s.first for s in found] == [20]


def test_flights_without_dates_have_no_steps(rng: np.random.Generator) -> None:
    at, values, std, _ = estimates(rng, 20, {})
    values[10:] += 5.0 * BOUND
    of = group_flights_of(NAMES, [("", f"f{i}") for i in range(20)], at, values, std, np.tile(CORRELATION, (20, 1, 1)))
    assert with_steps(of, 0)[1] == ()


def two_groups(rng: np.random.Generator, change: np.ndarray) -> tuple[GroupFlights, np.ndarray]:
    """The second group flew faster, at lower incidence; every derivative has its trend."""
    at, values, std, _ = estimates(rng, 80, SLOPES)
    order = np.argsort(at[:, 1] + 1.5 * rng.standard_normal(80))
    second = np.zeros(80, bool)
    second[order[40:]] = True
    values[second] += change
    return in_days(at, values, std), second


def test_another_speed_is_not_taken_for_another_rudder() -> None:
    rng = np.random.default_rng(6)
    wrong, naive = 0, 0
    for _ in range(10):
        both, second = two_groups(rng, np.zeros(3))
        wrong += sum(d.probability < 0.05 for d in differences(both, second))
        y = both.data.y[:, 1]
        scatter = np.hypot(y[second].std(), y[~second].std()) / np.sqrt(40)
        naive += abs(y[second].mean() - y[~second].mean()) > 3.0 * scatter
    assert naive == 10  # Cl_p over V: means of the groups differ for certain
    assert wrong <= 2


def test_a_difference_is_found_with_its_size_and_stated_power_is_what_happens() -> None:
    """A change of the size called detectable is found four times in five."""
    rng = np.random.default_rng(7)
    found, off = 0, []
    for _ in range(20):
        both, second = two_groups(rng, np.array([0.0, 0.0, 0.75 * BOUND[2]]))
        d = next(d for d in differences(both, second) if d.parameter == "Cn_beta")
        found += d.probability < 0.05
        off.append((d.change - 0.75 * BOUND[2]) / d.std)
        expected = d.power(0.75 * BOUND[2] / d.value)
    assert np.sqrt(np.mean(np.square(off))) < 1.4
    assert abs(found / 20 - expected) < 0.25
    assert d.interval[0] < d.change < d.interval[1]
