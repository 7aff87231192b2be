"""Lateral estimates of flights without a sideslip vane or a side accelerometer, against made truth."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from estimation.aircraft import load_aircraft
from estimation.estimators.result import Result
from estimation.models import load_model
from estimation.session import runner
from estimation.session.session import EstimationSession
from estimation.session.structured import StructureWish
from estimation.session.without_sensor import without_sensor
from groundstation.flight import Flight, MissingColumnError
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
