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


def test_an_alarm_names_its_limit_and_value_in_units_and_which_sensor() -> None:
    limits = [
        SPEED,
        Limit(channel="alpha", high=0.26, text="angle of attack"),
        Limit(channel="link.silence_s", high=3.0, text="no data"),
        Limit(channel="sensors.unusable", high=0.5, text="sensor not usable"),
    ]
    alarms = Alarms(limits)
    values = {"V": 10.5, "alpha": 0.3, "link.silence_s": 4.0, "sensors.unusable": 1.0}
    came = [c.text for c in alarms.update(0.0, values, {"sensors.unusable": "pitot (stuck)"})]
    assert came == [
        "airspeed below 11 m/s: active (10.5 m/s)", "angle of attack above 14.9 deg: active (17.2 deg)",
        "no data above 3 s: active (4 s)", "sensor not usable pitot (stuck): active",
    ]  # fmt: skip
    over = [c.text for c in alarms.update(1.0, {"V": 15.0, "sensors.unusable": 0.0})]
    assert over == ["airspeed below 11 m/s: latched (back to 15 m/s)", "sensor not usable pitot (stuck): latched"]
