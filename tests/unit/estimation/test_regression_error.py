"""Bounds of a regression count what noise, sampling and smoothing of the measured motion do to it."""

from dataclasses import replace

import numpy as np

from estimation.estimators.equation_error import equation_error
from estimation.estimators.regression_error import BOUNDS_LEAVE_OUT, with_regression_errors
from estimation.estimators.result import Result
from estimation.models import load_model
from estimation.prepare.flight_data import FOR_REGRESSION
from estimation.prepare.pipeline import prepare_all
from groundstation.flight import Flight
from tests.studies.random_aeroplanes import MAIN, Situation, fly
from tests.unit.estimation.test_structure import craft_and_file


def misses(result: Result, truth: dict[str, float]) -> np.ndarray:
    return np.array([(result.parameters[n].estimate - truth[n]) / result.parameters[n].std_coloured for n in MAIN])


def test_noisy_motion_widens_the_bounds_to_what_they_have_to_be() -> None:
    craft, file = craft_and_file()
    model = load_model("lateral", file)
    before, after, widened = [], [], []
    for flight in fly(craft, Situation("noisy", noise=3.0), np.random.default_rng(4501), 4):
        data = prepare_all(model, flight, FOR_REGRESSION)
        bare = equation_error(model, data)
        honest = with_regression_errors(bare, data)
        assert honest.values == bare.values
        assert honest.std == bare.std
        before.append(misses(bare, craft.derivatives))
        after.append(misses(honest, craft.derivatives))
        widened.append([honest.std_coloured[n] / bare.std_coloured[n] for n in MAIN])
    assert np.sqrt(np.mean(np.square(before))) > 2.0
    assert np.mean(np.abs(after) < 1.96) > 0.85
    assert np.min(widened) >= 1.0


def test_where_the_answer_cannot_be_flown_the_bounds_are_said_to_be_none() -> None:
    craft, file = craft_and_file()
    model = load_model("lateral", file)
    (flight,) = fly(craft, Situation("plain"), np.random.default_rng(4502), 1, 14.0)
    data = prepare_all(model, flight, FOR_REGRESSION)
    bare = equation_error(model, data)
    runaway = replace(bare, flights=tuple(replace(f, outputs=np.full_like(f.outputs, np.inf)) for f in bare.flights))
    assert BOUNDS_LEAVE_OUT in with_regression_errors(runaway, data).text


def test_a_sensor_that_is_stuck_throughout_a_stretch_leaves_that_stretch_out() -> None:
    craft, file = craft_and_file()
    model = load_model("lateral", file)
    (flight,) = fly(craft, Situation("plain"), np.random.default_rng(4503), 1, 14.0)
    stuck = np.arange(len(flight)) >= len(flight) - 60
    bank = np.where(stuck, flight["phi"][-60], flight["phi"])
    data = prepare_all(
        model,
        Flight.build("stuck", flight.time, {**flight.columns, "phi": bank}, segment=stuck.astype(int)),
        FOR_REGRESSION,
    )
    assert not np.isfinite(data[0].segments[1].z[:, model.output_names.index("phi")]).any()
    bare = equation_error(model, data)
    assert BOUNDS_LEAVE_OUT not in with_regression_errors(bare, data).text
