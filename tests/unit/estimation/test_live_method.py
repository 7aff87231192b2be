"""`--method live`: the recursive estimator over a file, through the command and the library."""

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from daq.identification.live import LiveEstimator
from estimation.aircraft.library import load_aircraft
from estimation.errors import EstimationError
from estimation.estimators.linear_terms import linear_terms
from estimation.estimators.recursive import airframe_of, estimate_recursively, samples_of
from estimation.models import load_model
from estimation.models.base import Model, Parameter, joint_model
from estimation.session import runner
from firmware_sim.runs.direct import direct_flights
from firmware_sim.world.scenario import load_scenario
from firmware_sim.world.simulation import derivatives_of
from groundstation.flight import Flight, read_flight
from groundstation.flight.errors import MissingColumnError
from sideslip.verbs.estimate import estimate
from tests.studies.live_foreign import aircraft_of
from tests.studies.random_aeroplanes import DEG, Aeroplane, Situation, fly
from tests.support.paths import RECORDINGS

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
        assert bound == pytest.approx(found["parameters"][name]["std_coloured"], rel=1e-12)
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
        (lambda m: m.plus(terms={"Cn": "Cn_b3*beta^3"}, parameters=[Parameter("Cn_b3")]), "Cn_b3 is none of them"),
        (lambda m: m.with_biases("beta"), "bias_beta is none of them"),
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


def pitching_flight() -> tuple[Flight, Mapping[str, float]]:
    """Half a minute of elevator and throttle manoeuvres, and the derivatives it was flown with."""
    scenario = load_scenario("longitudinal")
    (columns,) = direct_flights([scenario], [3])
    flight = Flight.build("pitch", columns.pop("time"), columns)
    return flight, derivatives_of(scenario, 3)


def test_the_pitching_plane_and_both_at_once() -> None:
    flight, truth = pitching_flight()
    craft = load_aircraft("cdfp")
    alone = estimate_recursively(load_model("longitudinal", craft), [flight], craft)
    assert alone.history is not None
    assert set(alone.history.estimate) == set(alone.parameters)
    for name in ("CL_alpha", "CD_0", "CD_k", "Cm_alpha", "Cm_q", "Cm_de"):
        found = alone.parameters[name]
        assert found.identifiable
        assert abs(found.estimate - truth[name]) < 3.5 * found.std_coloured < 0.4 * abs(truth[name])
    both = estimate_recursively(load_model("six-dof", craft), [flight], craft)
    assert both.parameters["Cm_de"].estimate == alone.parameters["Cm_de"].estimate
    assert not both.parameters["Cl_da"].identifiable  # neither aileron nor rudder was flown


def test_the_pitching_plane_does_without_the_lateral_motion() -> None:
    flight, _ = pitching_flight()
    craft = load_aircraft("cdfp")
    lateral = ("beta", "p", "r", "phi", "ay", "delta_a", "delta_r")
    bare = replace(flight, columns={k: v for k, v in flight.columns.items() if k not in lateral})
    found = estimate_recursively(load_model("longitudinal", craft), [bare], craft).parameters["Cm_de"]
    there = estimate_recursively(load_model("longitudinal", craft), [flight], craft).parameters["Cm_de"]
    assert abs(found.estimate - there.estimate) < there.std_coloured
    empty = flight.with_columns(**{n: np.full(len(flight), np.nan) for n in lateral})
    unmeasured = estimate_recursively(load_model("longitudinal", craft), [empty], craft).parameters["Cm_de"]
    assert unmeasured.estimate == found.estimate


@pytest.mark.parametrize("which", ["lateral", "lateral-simple", "longitudinal", "six-dof"])
def test_terms_of_the_built_in_models_are_found_from_their_text(which: str) -> None:
    model = load_model(which, "cdfp")
    assert dict(linear_terms(model).names) == {n: n for n in model.parameter_names}


def test_a_term_of_ones_own_is_estimated_by_its_place(flight: Flight, model: Model) -> None:
    """Whatever it is called; a term that the model lacks is left out."""
    own = model.plus(terms={"Cn": "yaw_by_aileron*delta_a"}, parameters=[Parameter("yaw_by_aileron", "1/rad")])
    terms = linear_terms(own)
    assert terms.names["yaw_by_aileron"] == "Cn_da"
    craft = load_aircraft("cdfp")
    found = estimate_recursively(own, [flight], craft).parameters["yaw_by_aileron"]
    assert abs(found.estimate) < 3.5 * found.std_coloured < 0.01  # it flew without


@pytest.mark.parametrize("late", [0.0, 0.05])
def test_gusts_are_not_taken_for_what_the_model_lacks(late: float) -> None:
    """In gusts of a degree output error scores 6.1 for a rudder that is not late, which would move `Cn_beta` by five of these
    bounds; an aileron that is late stays named."""
    rng = np.random.default_rng([47, 112])
    craft = Aeroplane.drawn(rng)
    (gusty,) = fly(craft, Situation("", gust=DEG, aileron_late=late), rng, flights=1)
    aircraft = aircraft_of(craft, rng, 0.2, 0.035)
    (estimates,) = runner.estimate(load_model("lateral", aircraft), [gusty], aircraft, ("live",)).flights
    assert estimates.structure is not None
    assert estimates.verdict is not None
    assert [lack.names[0] for lack in estimates.structure.lacks] == ["delay_delta_a"] * (late > 0.0)
    assert estimates.verdict.recommended.method == ("none" if late else "live")


def test_an_aircraft_of_which_nothing_is_believed_is_refused(flight: Flight) -> None:
    """Its instruments would be simulated with nothing, and each number told to need more flying."""
    bare = replace(load_aircraft("cdfp"), derivatives={})
    with pytest.raises(EstimationError, match="needs a rough value of each derivative"):
        estimate_recursively(load_model("lateral", bare), [flight], bare)
