"""Servo outputs of a log are commands: they hold, rest without noise, and may have changed up to one record before."""

from pathlib import Path

import numpy as np
import pytest

from groundstation.flight import Flight, Provenance, read_flight, write_flight
from groundstation.flight.flight import CHANNELS
from groundstation.flight.quality.repeats import repeats
from groundstation.importers.columns import flight_columns
from groundstation.importers.mapping import Map
from groundstation.importers.series import Log, TimeSeries, held_at, lagged, without_damaged_times
from groundstation.importers.servos import with_servos

RECORDED = 0.05  # s from one record of an output to the next


def outputs(end: float = 30.0) -> TimeSeries:
    """An output that rests for seconds between two moves."""
    time = np.arange(0.0, end, RECORDED)
    pulse = np.where((time > 9.97) & (time < 11.97), 1700.0, 1500.0)
    return TimeSeries(time, pulse)


def made(time: np.ndarray) -> tuple[np.ndarray, dict[str, object]]:
    text = {
        "servos": {
            "a": {
                "column": "RCOU.C1",
                "trim": 1500,
                "travel": [[1000, -25.0], [2000, 25.0]],
                "unit": "deg",
                "lag": 0.08,
            }
        }
    }
    chosen = Map.model_validate({"format": 1, **text, "columns": {"delta_a": {"column": "servo.a"}}})
    log, _ = with_servos(Log("dataflash", {"RCOU.C1": outputs()}), chosen.servos)
    found = flight_columns(log, chosen, time, True)
    return found.values["delta_a"], found.origins["delta_a"].to_json(50.0)


def test_a_command_holds_from_half_an_interval_before_its_record() -> None:
    time = np.arange(0.0, 29.0, 0.01)
    values, about = made(time)
    begin, stop = 10.0 - RECORDED / 2, 12.0 - RECORDED / 2  # records at 10.00 and 12.00 are the first of their values
    expected = np.radians(10.0) * (1 - np.exp(-np.clip(time - begin, 0, None) / 0.08))
    expected -= np.radians(10.0) * (1 - np.exp(-np.clip(time - stop, 0, None) / 0.08))
    settled = time >= 4 * 0.08  # before, nobody knows where the servo stood
    np.testing.assert_allclose(values[settled], expected[settled], atol=1e-6)
    assert np.isnan(values[time < 4 * 0.08 - RECORDED / 2]).all()
    assert about["held"] is True
    assert about["interval_s"] == pytest.approx(RECORDED)
    assert about["dated_back_s"] == pytest.approx(RECORDED / 2)
    assert about["servo_lag_s"] == 0.08


def test_a_gap_of_the_outputs_is_a_gap_of_the_surface() -> None:
    whole = outputs()
    cut = (whole.time < 15.0) | (whole.time > 20.0)
    values = held_at(TimeSeries(whole.time[cut], whole.values[cut]), np.array([10.5, 17.0, 25.0, 40.0]))
    np.testing.assert_array_equal(np.isnan(values), [False, True, False, True])


def test_a_servo_without_an_earlier_command_stands_where_it_is_told() -> None:
    np.testing.assert_allclose(lagged(np.array([0.0, 1.0]), np.array([0.3, 0.5]), 0.2), [0.3, 0.3])


def test_a_command_that_rests_is_neither_stuck_nor_slow(tmp_path: Path) -> None:
    time = np.arange(0.0, 60.0, 0.02)
    rng = np.random.default_rng(31)
    commands = np.repeat(rng.normal(0.0, 0.1, 1500), 2)
    p = np.convolve(commands, np.ones(5) / 5, "same") + 0.001 * rng.standard_normal(time.size)

    def flight(about: dict[str, object]) -> Flight:
        detail = {CHANNELS: {"delta_a": {"kind": "computed", "from": "servo.a", "rate_hz": 25.0, **about}}}
        return Flight.build("x", time, {"delta_a": commands, "p": p}, provenance=Provenance(detail=detail))

    as_sensor = repeats(flight({}), "delta_a")
    assert as_sensor.slow  # what a sensor that shows this would be
    write_flight(flight({"held": True, "interval_s": 0.04}), tmp_path / "x.mcap")
    read = read_flight(tmp_path / "x.mcap")
    assert read.held("delta_a") == pytest.approx(0.04)
    assert read.held("p") is None
    found = repeats(read, "delta_a")
    assert not found.slow
    assert not found.stuck.any()


def test_a_command_without_its_damaged_times_is_still_a_command() -> None:
    sound = outputs()
    time = sound.time.copy()
    time[100] = 1e9
    series, outliers = without_damaged_times({"out": TimeSeries(time, sound.values, command=True, lag=0.05)})
    assert outliers == 1
    assert series["out"].time.size == time.size - 1
    assert (series["out"].command, series["out"].lag) == (True, 0.05)
