"""Estimates of flights without a sideslip vane, a side accelerometer or thrust, and without states, against made truth."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from estimation.aircraft import Aircraft, load_aircraft
from estimation.errors import DataError
from estimation.estimators.result import Result
from estimation.models import load_model
from estimation.report.answer import leading_answer, next_steps
from estimation.session import runner
from estimation.session.session import EstimationSession
from estimation.session.structured import StructureWish
from estimation.session.without_sensor import without_sensor
from groundstation.flight import Flight, MissingColumnError
from tests.studies import random_aeroplanes
from tests.unit.estimation.truth import NOISE, STRONG, TRUE, Case, fly

LATERAL = load_model("lateral", "cdfp")


def made(seed: int, *lacking: str, count: int = 1) -> list[Flight]:
    flights, _ = fly(Case(seconds=20.0, noise=NOISE), np.random.default_rng(seed), count)
    return [f.with_columns(**{n: np.full(len(f), np.nan) for n in lacking}) for f in flights]


def estimated(
    flights: Sequence[Flight], methods: Sequence[str] = ("ml",), structure: StructureWish = StructureWish.OFF
) -> EstimationSession:
    return runner.estimate(
        LATERAL, flights, load_aircraft("cdfp"), methods, structure=structure, joint=len(flights) > 1
    )


def misses(result: Result) -> np.ndarray:
    found = result.parameters
    return np.array([(found[n].estimate - TRUE[n]) / found[n].std_coloured for n in STRONG])


@pytest.mark.parametrize(("lacking", "said"), [("beta", "CY_0, Cl_0 and Cn_0 cannot be told"), ("ay", "several times")])
def test_one_sensor_may_be_lacking_and_what_that_costs_is_said(lacking: str, said: str) -> None:
    session = estimated(made(31, lacking))
    result = session.flights[0].results["ml"]
    assert result.converged
    assert lacking not in result.model.output_names
    assert all(result.parameters[n].identifiable for n in STRONG)
    assert np.abs(misses(result)).max() < 4.0
    assert any(said in n.text for n in result.flights[0].notes)
    session.to_json()


def test_the_bounds_show_what_the_vane_and_the_accelerometer_are_worth() -> None:
    whole, *others = (estimated(made(32, *n)).flights[0].results["ml"].std_coloured for n in ((), ("beta",), ("ay",)))
    assert others[0]["CY_0"] > 5.0 * whole["CY_0"]
    assert others[1]["CY_beta"] > 2.0 * whole["CY_beta"]


def test_flights_with_and_without_a_vane_together() -> None:
    session = estimated([*made(33), *made(34, "beta")])
    assert np.abs(misses(session.joint["ml"])).max() < 4.0
    assert "beta" in session.joint["ml"].model.output_names
    told = [any("beta not measured" in n.text for n in f.results["ml"].flights[0].notes) for f in session.flights]
    assert told == [False, True]


@pytest.mark.parametrize("lacking", ["beta", "ay"])
def test_every_method_and_the_structure_test_end_in_a_result_or_a_sentence(lacking: str) -> None:
    session = estimated(made(35, lacking), ("ml", "ls", "ngn-improved"), StructureWish.TEST)
    (flight,) = session.flights
    assert flight.results["ml"].converged
    assert set(flight.results) | set(flight.failures) == {"ml", "ls", "ngn-improved"}
    assert flight.verdict is not None
    session.to_json()


def test_an_aircraft_of_which_nothing_is_believed_has_starts_from_the_kinematics() -> None:
    flights = made(37, "beta")
    blank = LATERAL.with_starts(dict.fromkeys(LATERAL.free_names, 0.0))
    unknown = replace(blank, parameters=tuple(replace(p, reference=None) for p in blank.parameters))
    model, _ = without_sensor(unknown, flights)
    start = model.starts()
    assert all(start[n] * TRUE[n] > 0.0 for n in ("CY_beta", "Cl_beta", "Cl_p", "Cl_da", "Cn_beta", "Cn_dr"))
    session = runner.estimate(unknown, flights, load_aircraft("cdfp"), ["ml"], structure=StructureWish.OFF)
    assert np.abs(misses(session.flights[0].results["ml"])).max() < 4.0


def test_both_lacking_is_refused() -> None:
    with pytest.raises(MissingColumnError, match="of beta and ay one would do"):
        estimated(made(36, "beta", "ay"))


def pitching(seed: int, *lacking: str) -> tuple[list[Flight], Aircraft, Mapping[str, float]]:
    rng = np.random.default_rng([641, seed])
    craft = random_aeroplanes.Aeroplane.drawn(rng)
    flights = random_aeroplanes.fly(craft, random_aeroplanes.Situation("plain", pitch=True), rng, 2, 12.0)
    aircraft = Aircraft("drawn", craft.span, craft.area, craft.chord, craft.mass, *craft.inertia)
    blind = [f.with_columns(**{n: np.full(len(f), np.nan) for n in lacking}) for f in flights]
    return blind, aircraft, craft.derivatives


PITCH_TOLD = ("CL_alpha", "CD_k", "Cm_alpha", "Cm_q", "Cm_de")


@pytest.mark.parametrize("lacking", [("thrust",), ("thrust", "ax")])
def test_pitching_motion_without_thrust_tells_all_but_the_drag_at_no_lift(lacking: tuple[str, ...]) -> None:
    flights, aircraft, truth = pitching(1, *lacking)
    model = load_model("longitudinal", aircraft)
    methods = ["ml", "ls"] if len(lacking) == 1 else ["ml"]
    session = runner.estimate(model, flights, aircraft, methods, joint=True, structure=StructureWish.OFF)
    result = session.joint["ml"]
    told = {n: result.parameters[n] for n in PITCH_TOLD}
    assert max(abs(e.estimate - truth[n]) / e.std_coloured for n, e in told.items()) < 4.0
    assert all(told[n].identifiable for n in ("CL_alpha", "Cm_alpha", "Cm_q", "Cm_de"))
    for fitted in session.joint.values():
        assert not fitted.parameters["CD_0"].identifiable
        assert "thrust less drag" in fitted.parameters["CD_0"].why
    assert any("thrust not measured" in n.text for n in result.flights[0].notes)
    assert any(s.startswith("Fly with a record of thrust") for s in next_steps(session, leading_answer(session)))
    session.to_json()


def test_thrust_that_is_measured_is_used_and_one_that_moves_unseen_is_refused() -> None:
    flights, aircraft, truth = pitching(2)
    model = load_model("longitudinal", aircraft)
    result = runner.estimate(model, flights[:1], aircraft, ["ml"], structure=StructureWish.OFF).flights[0].results["ml"]
    assert "thrust" not in result.parameters
    assert abs(result.parameters["CD_0"].estimate - truth["CD_0"]) < 4.0 * result.parameters["CD_0"].std_coloured
    blind = [f.with_columns(thrust=np.full(len(f), np.nan), throttle=np.linspace(0.2, 0.8, len(f))) for f in flights]
    with pytest.raises(DataError, match="throttle moves"):
        without_sensor(model, blind)
    steady = [f.with_columns(throttle=np.full(len(f), 0.4)) for f in blind]
    assert "thrust" in without_sensor(load_model("six-dof", aircraft), steady)[0].parameter_names
    mixed, noted = without_sensor(model, [flights[0], steady[1]])
    assert "thrust" not in mixed.input_names
    assert "thrust is not used" in noted[0].notes[-1].text


SIDE_FORCE = """
name = "side-force"
equations = ["ay = 0.5*rho*V^2*S/m*(CY_0 + CY_beta*beta + CY_p*p*b/(2*V) + CY_r*r*b/(2*V) + CY_dr*delta_r)"]
inputs = [{name = "beta", unit = "rad"}, {name = "V", unit = "m/s"}, {name = "rho", unit = "kg/m3"},
          {name = "p", unit = "rad/s"}, {name = "r", unit = "rad/s"}, {name = "delta_r", unit = "rad"}]
outputs = [{name = "ay", unit = "m/s2"}]
parameters = [{name = "CY_0"}, {name = "CY_beta"}, {name = "CY_p"}, {name = "CY_r"}, {name = "CY_dr"}]
"""


def test_a_regression_needs_no_states(tmp_path: Path) -> None:
    (flight,), aircraft = made(38), load_aircraft("cdfp")
    constants = {n: aircraft.constants()[n] for n in ("S", "b", "m")}
    table = "".join(f"{n} = {v}\n" for n, v in constants.items())
    (tmp_path / "side.toml").write_text(f"{SIDE_FORCE}[constants]\n{table}")
    model = load_model(tmp_path / "side.toml", aircraft)
    session = runner.estimate(model, [flight], aircraft, ["ml", "ls", "fem", "ml-frequency"])
    (answer,) = session.flights
    assert model.states == ()
    for result in answer.results.values():
        e = result.parameters["CY_dr"]
        assert abs(e.estimate - TRUE["CY_dr"]) < 4.0 * e.std_coloured
    assert set(answer.failures) == {"fem", "ml-frequency"}
    assert all("no states" in text for text in answer.failures.values())
