"""Alarms: hysteresis, hold time, latching, and configuration that cannot be right is refused."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from groundstation.live.watches import Alarms, AlarmState, Limit

SPEED = Limit(channel="V", low=11.0, high=25.0, hysteresis=0.5, level="ERROR", text="airspeed")


def states(alarms: Alarms, values: list[float]) -> list[AlarmState]:
    return [c.state for i, v in enumerate(values) for c in alarms.update(float(i), {"V": v})]


def test_comes_with_the_limit_and_goes_only_past_the_hysteresis() -> None:
    alarms = Alarms([SPEED])
    assert states(alarms, [15.0, 10.9, 11.1, 11.4, 10.8, 11.6]) == [AlarmState.ACTIVE, AlarmState.LATCHED]


def test_latched_until_acknowledged_and_comes_again() -> None:
    alarms = Alarms([SPEED])
    states(alarms, [26.0, 20.0])
    assert [s for _, s, _ in alarms.in_force()] == [AlarmState.LATCHED]
    assert [c.state for c in alarms.acknowledge(3.0)] == [AlarmState.CLEAR]
    assert alarms.in_force() == []
    assert states(alarms, [26.0]) == [AlarmState.ACTIVE]
    assert alarms.acknowledge(4.0) == []


def test_hold_time_ignores_a_short_excursion() -> None:
    alarms = Alarms([SPEED.model_copy(update={"hold_s": 2.0})])
    assert states(alarms, [30.0, 20.0, 30.0, 30.0]) == []
    assert states(alarms, [20.0, 30.0, 30.0, 30.0]) == [AlarmState.ACTIVE]


def test_not_measured_changes_nothing() -> None:
    alarms = Alarms([SPEED])
    assert states(alarms, [30.0, math.nan, math.nan]) == [AlarmState.ACTIVE]
    assert alarms.update(9.0, {"alpha": 1.0}) == []


@given(st.lists(st.floats(0, 40), max_size=60))
def test_active_alarm_means_the_last_value_was_not_safely_inside(values: list[float]) -> None:
    alarms = Alarms([SPEED])
    states(alarms, values)
    active = any(s is AlarmState.ACTIVE for _, s, _ in alarms.in_force())
    if values and (values[-1] < 11.0 or values[-1] > 25.0):
        assert active
    if values and 11.5 <= values[-1] <= 24.5:
        assert not active


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({}, "give low, high or both"),
        ({"low": 5.0, "high": 3.0}, "not below high"),
        ({"low": 1.0, "hold_s": -1}, "negative"),
    ],
)
def test_senseless_limits_are_refused(fields: dict[str, float], words: str) -> None:
    with pytest.raises(ValidationError, match=words):
        Limit(channel="V", **fields)
