"""`--method live`: the recursive estimator over a file, through the command and the library."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from daq.identification.live import LiveEstimator
from estimation.aircraft.library import load_aircraft
from estimation.errors import EstimationError
from estimation.estimators.recursive import airframe_of, estimate_recursively, samples_of
from estimation.models import load_model
from estimation.models.base import Model, joint_model
from groundstation.flight import Flight, read_flight
from groundstation.flight.errors import MissingColumnError
from sideslip.verbs.estimate import estimate

RECORDINGS = Path(__file__).parents[2] / "recordings"
TRUE = {"Cl_beta": -0.0894, "Cl_p": -0.4951, "Cl_da": -0.0948, "Cn_beta": 0.0263, "Cn_r": -0.0472, "Cn_p": 0.0245}
"""Those that the recorded flight was simulated with, estimation/aircraft/cdfp.toml."""


@pytest.fixture(scope="module")
def flight() -> Flight:
    return read_flight(RECORDINGS / "cdfp_ld1.mcap")


@pytest.fixture
def model() -> Model:
    return load_model("lateral", "cdfp")


def test_the_command_writes_the_history(tmp_path: Path) -> None:
    path = tmp_path / "out.json"
    answer = CliRunner().invoke(
        estimate, [str(RECORDINGS / "cdfp_ld1.mcap"), "--method", "live", "--json", str(path)], standalone_mode=False
    )
    assert answer.exception is None, answer.output
    found = json.loads(path.read_text())["flights"][0]["methods"]["live"]
    history = found["history"]
    assert set(history) == {"time", *found["parameters"]}
    times = np.array(history["time"])
    assert np.all(np.diff(times) >= 0)
    for name, true in TRUE.items():
        series = {k: np.array(v, float) for k, v in history[name].items()}  # null becomes NaN
        assert set(series) == {"estimate", "std"}
        assert all(v.shape == times.shape for v in series.values())
        assert np.isnan(series["estimate"][0])
        last, bound = series["estimate"][-1], series["std"][-1]
        assert last == found["parameters"][name]["estimate"]
        assert bound == found["parameters"][name]["std_coloured"]
        assert abs(last - true) < 3.0 * bound < abs(true)
        told = np.isfinite(series["std"])
        assert series["std"][told][-1] < series["std"][told][0]


def test_it_is_the_estimator_that_flies(flight: Flight, model: Model) -> None:
    """The same numbers, digit by digit, as scans fed one after the other."""
    craft = load_aircraft("cdfp")
    estimator = LiveEstimator(airframe_of(model, craft))
    for part in flight.segments:
        for sample in samples_of(flight, part):
            estimator.add(sample)
    known = estimator.estimates().derivatives
    result = estimate_recursively(model, [flight], craft)
    for name in ("CY_beta", "Cl_p", "Cn_beta"):
        assert result.parameters[name].estimate == known[name].estimate
        assert result.parameters[name].std_coloured == known[name].std


def test_several_flights_are_one_aircraft_with_constants_of_their_own(flight: Flight, model: Model) -> None:
    craft = load_aircraft("cdfp")
    offset = flight.with_columns(ay=flight["ay"] + 0.2)
    alone = estimate_recursively(model, [flight], craft)
    both = estimate_recursively(joint_model(model), [flight, replace(offset, name="offset")], craft)
    assert both.history is None
    assert both.parameters["Cl_p"].std_coloured < alone.parameters["Cl_p"].std_coloured
    first, second = (f.local["CY_0"].estimate for f in both.flights)
    pressure = np.nanmean(0.5 * 1.2 * flight["V"] ** 2)
    assert second - first == pytest.approx(0.2 * craft.mass / (pressure * craft.area), rel=0.1)
    assert "CY_0" not in both.parameters


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda m: load_model("longitudinal", "cdfp"), "knows the derivatives of model lateral only"),
        (lambda m: m.fixed("Cl_dr"), "holds no parameter"),
        (lambda m: replace(m, constants={**m.constants, "Ixx": -0.2}), "Ixx is -0.2"),
        (lambda m: replace(m, constants={k: v for k, v in m.constants.items() if k != "Ixx"}), "Ixx"),
    ],
)
def test_what_it_cannot_do_is_said(flight: Flight, model: Model, change, words: str) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(EstimationError, match=words):
        airframe_of(change(model), load_aircraft("cdfp"))


def test_a_missing_column_is_named(flight: Flight, model: Model) -> None:
    without = replace(flight, columns={k: v for k, v in flight.columns.items() if k != "alpha"})
    with pytest.raises(MissingColumnError, match="alpha"):
        estimate_recursively(model, [without], load_aircraft("cdfp"))
