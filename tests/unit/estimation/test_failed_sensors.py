"""What an analysis and an estimate make of a flight in which a sensor failed."""

import numpy as np
import pytest

from estimation.analysis.choice import without_failures
from estimation.analysis.outcome import Analysis
from estimation.session.recipe import recipe
from estimation.session.runner import contradicted_columns
from groundstation.flight import Flight
from tests.unit.groundstation.turning import turning_flight


def flight_with(name: str, begin: float, end: float) -> Flight:
    columns = turning_flight(6, seconds=40.0, sway=0.25)
    time = columns.pop("time")
    rows = (time >= begin) & (time <= end)
    for column in name.split():
        columns[column][rows] = columns[column][rows][0]
    return Flight.build("f", time, columns)


def test_the_times_of_a_failed_sensor_are_left_out_and_stop_nothing() -> None:
    flight, contradicted = without_failures(flight_with("p q r", 12.0, 19.0))
    assert ((flight.time < 12.0) | (flight.time > 19.0)).all()
    assert len(flight.segments) == 2
    assert [c.stops for c in contradicted] == [False]
    assert contradicted[0].text.endswith("(left out here)")


def test_where_next_to_nothing_is_left_the_flight_stays_and_is_stopped() -> None:
    whole = flight_with("p q r", 3.0, 39.9)
    flight, contradicted = without_failures(whole)
    assert flight is whole
    assert any(c.stops for c in contradicted)


@pytest.mark.parametrize(("columns", "stopped"), [({"p", "phi"}, False), ({"p", "V"}, True)])
def test_what_fails_stops_only_a_model_that_uses_it(columns: set[str], stopped: bool) -> None:
    flight = flight_with("V", 12.0, 19.0)
    texts = contradicted_columns(columns, flight)
    assert bool(texts) == stopped
    assert np.isfinite(flight["V"]).all()


@pytest.mark.parametrize(("name", "bound", "words"), [
    ("Cl_beta", 0.03, "known to 30% only"), ("Cl_beta", 0.02, ""), ("Cl_0", 0.9, ""), ("delay_ay", 0.9, ""),
])  # fmt: skip
def test_a_derivative_that_is_known_roughly_is_said_to_be(name: str, bound: float, words: str) -> None:
    parameter = {"estimate": -0.1, "std_coloured": bound, "identifiable": True}
    content = {"estimate": {"flights": [{"methods": {"ml": {"parameters": {name: parameter}}}}]}}
    assert [row[3] for row in Analysis(content, {}, ()).derivatives()] == [words]


@pytest.mark.parametrize(("lacking", "able"), [((), True), (("beta",), True), (("ay",), True), (("beta", "ay"), False)])
def test_a_recipe_offers_what_an_estimate_takes(lacking: tuple[str, ...], able: bool) -> None:
    columns = turning_flight(6, seconds=20.0)
    time = columns.pop("time")
    columns |= dict.fromkeys(("delta_a", "delta_r", "alpha", "beta"), 0.05 * np.sin(time))
    some = {n: v for n, v in columns.items() if n not in (*lacking, "vn", "ve", "vd")}
    models = {m.model: m for m in recipe(Flight.build("f", time, some)).models}
    assert models["lateral"].able == able
    assert set(lacking) <= {*models["lateral"].silent, *models["lateral"].missing}
