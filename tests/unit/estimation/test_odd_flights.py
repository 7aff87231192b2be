"""Words and numbers of a flight that differs."""

import dataclasses

import numpy as np
import pytest

import sideslip as ss
from estimation.models import load_model
from estimation.prepare.flight_data import Preparation
from estimation.prepare.pipeline import prepare
from estimation.structure.odd_flights import CORRECTION_BOUNDS, OddFlight, attenuations, scale_bounds
from groundstation.flight import Flight
from tests.support.paths import RECORDINGS

ODD = OddFlight("third", "mass or dynamic pressure", 1.25, 1e-9, "Cn_beta", 4.2)


def test_the_flight_its_ratio_and_what_it_moves_are_in_the_sentence_and_in_the_json() -> None:
    for words in ("third differs", "mass or dynamic pressure", "1.25 times", "Cn_beta by 4.2 bounds"):
        assert words in ODD.text
    data = ODD.to_json()
    assert (data["flight"], data["what"], data["ratio"], data["probability"]) == ("third", ODD.what, 1.25, 1e-9)


def test_of_two_flights_neither_is_accused() -> None:
    text = OddFlight("a", "lag of beta", 0.06, 1e-9, "Cn_r", 2.0, "b").text
    assert "a and b differ from one another" in text
    assert "0.06 s" in text


def test_what_a_correction_leaves_open_is_a_share_of_its_factor() -> None:
    flight = ss.open(RECORDINGS / "cdfp_ld4.mcap")
    assert scale_bounds(flight) == {}
    detail = {"compatibility": {"K_beta": 0.8, "dp": 0.001}, CORRECTION_BOUNDS: {"K_beta": 0.02, "dp": 0.0004}}
    corrected = dataclasses.replace(flight, provenance=dataclasses.replace(flight.provenance, detail=detail))
    assert scale_bounds(corrected) == pytest.approx({"beta": 0.025})


@pytest.mark.parametrize(("bound", "factor"), [("x", 1.0), (0.02, 0.0), (float("nan"), 1.0), (0.02, None), ([], {})])
def test_numbers_of_somebody_else_s_provenance_that_are_none_say_nothing(bound: object, factor: object) -> None:
    flight = ss.open(RECORDINGS / "cdfp_ld4.mcap")
    detail = {"compatibility": {"K_beta": factor}, CORRECTION_BOUNDS: {"K_beta": bound}}
    strange = dataclasses.replace(flight, provenance=dataclasses.replace(flight.provenance, detail=detail))
    assert scale_bounds(strange) == {}


def test_noise_of_a_control_takes_its_share_of_the_movement_off_the_derivatives_beside_it() -> None:
    model, rng = load_model("lateral", "cdfp"), np.random.default_rng(8)
    whole = ss.open(RECORDINGS / "cdfp_ld4.mcap")
    quiet = attenuations(model, prepare(model, whole, Preparation()))
    assert max(quiet.values()) < 0.03

    def hardly(values: np.ndarray) -> np.ndarray:
        return 0.02 * values + 0.002 * rng.standard_normal(values.size)

    still: Flight = whole.with_columns(delta_r=hardly(whole["delta_r"]))
    noisy = attenuations(model, prepare(model, still, Preparation()))
    assert noisy["delta_r"] > 0.3
    assert noisy["delta_a"] == pytest.approx(quiet["delta_a"])
