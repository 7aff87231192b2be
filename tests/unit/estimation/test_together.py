"""Controls that move together: derivatives that no number of flights can tell apart are said to be so."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from estimation.estimators.output_error import output_error
from estimation.estimators.together import moving_together
from estimation.models import load_model
from estimation.prepare.pipeline import prepare
from groundstation.flight import Flight
from tests.unit.estimation.truth import NOISE, Case, fly

LATERAL = load_model("lateral", "cdfp")


def with_rudder(flight: Flight, course: Callable[[Flight], np.ndarray]) -> Flight:
    """The record with another rudder, recorded with noise of its own."""
    rng = np.random.default_rng(3)
    noise = NOISE["delta_r"] * rng.standard_normal(len(flight))
    return replace(flight, columns={**flight.columns, "delta_r": course(flight) + noise})


@pytest.fixture(scope="module")
def flights() -> list[Flight]:
    return fly(Case(noise=NOISE, rudder=0.0), np.random.default_rng(31), 2)[0]


def test_a_rudder_geared_to_the_aileron_is_not_told_from_it_in_any_number_of_flights(flights: list[Flight]) -> None:
    geared = [with_rudder(f, lambda g: 0.7 * g["delta_a"]) for f in flights]
    found = output_error(LATERAL, geared).parameters
    for name in ("Cl_da", "Cl_dr", "Cn_dr"):
        assert not found[name].identifiable
        assert "together with" in found[name].why
    assert found["Cl_beta"].identifiable


def test_one_flight_in_which_it_moves_by_itself_is_enough(flights: list[Flight]) -> None:
    geared = prepare(LATERAL, with_rudder(flights[0], lambda g: 0.7 * g["delta_a"]))
    apart = prepare(LATERAL, fly(Case(noise=NOISE), np.random.default_rng(32))[0][0])
    assert moving_together(LATERAL, [geared])["delta_r"] == ("delta_a",)
    assert not moving_together(LATERAL, [geared, apart])


def test_a_rudder_made_of_three_things_is_found_and_they_are_named(flights: list[Flight]) -> None:
    follows = lambda g: 0.5 * g["delta_a"] + 0.4 * g["r"] - 0.3 * g["beta"]  # noqa: E731
    found = moving_together(LATERAL, [prepare(LATERAL, with_rudder(flights[0], follows))])
    assert set(found["delta_r"]) >= {"delta_a", "r", "beta"}
