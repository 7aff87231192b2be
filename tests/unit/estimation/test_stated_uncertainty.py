"""What an aircraft file is unsure of widens the bounds of derivatives, by as much as another file moves the estimates."""

from dataclasses import replace

import numpy as np
import pytest

from estimation.aircraft.schema import aircraft_from_text
from estimation.errors import AircraftError
from estimation.models import load_model
from estimation.session import runner
from estimation.session.stated_uncertainty import airspeed_share, share
from estimation.session.structured import StructureWish
from tests.studies.random_aeroplanes import Situation, fly
from tests.unit.estimation.test_structure import craft_and_file


def test_shares_are_those_of_the_dimensions() -> None:
    _, craft = craft_and_file()
    craft = replace(
        craft, uncertainty={"mass": 0.03, "area": 0.04, "Iyy": 0.12, "chord": 0.05, "span": 0.01, "Ixx": 0.06}
    )
    assert share("CY_beta", craft) == pytest.approx(0.05)
    assert share("Cm_alpha", craft) == pytest.approx(np.sqrt(0.12**2 + 0.04**2 + 0.05**2))
    assert share("Cm_q", craft) == pytest.approx(np.sqrt(0.12**2 + 0.04**2 + 0.10**2))
    assert share("Cl_p", craft) == pytest.approx(np.sqrt(0.06**2 + 0.04**2 + 0.02**2))
    assert share("Cn_beta", craft) == pytest.approx(np.sqrt(0.04**2 + 0.01**2))  # nothing said of Izz
    assert share("bias_p", craft) == 0.0


def test_another_inertia_moves_estimates_within_the_bounds() -> None:
    """One flight, a file whose Ixx is 15 % too large and says that it may be: Cl_p is 15 % off, and its bound says so."""
    craft, right = craft_and_file()
    flights = fly(craft, Situation("plain"), np.random.default_rng(90), 1)
    wrong = replace(right, Ixx=1.15 * right.Ixx)
    found = {}
    for name, file in (("right", right), ("wrong", wrong), ("unsure", replace(wrong, uncertainty={"Ixx": 0.15}))):
        session = runner.estimate(load_model("lateral", file), flights, file, ("ml",), structure=StructureWish.OFF)
        found[name] = session.flights[0].results["ml"].parameters
    for derivative in ("Cl_p", "Cl_da", "Cl_beta"):
        right_one, wrong_one, unsure = (found[k][derivative] for k in ("right", "wrong", "unsure"))
        assert wrong_one.estimate == pytest.approx(1.15 * right_one.estimate, rel=0.03)
        assert unsure.estimate == pytest.approx(wrong_one.estimate)
        moved = abs(wrong_one.estimate - right_one.estimate)
        assert unsure.std_coloured == pytest.approx(np.hypot(wrong_one.std_coloured, 0.15 * abs(wrong_one.estimate)))
        assert wrong_one.std_coloured < moved < 1.1 * unsure.std_coloured
    assert found["unsure"]["CY_beta"].std_coloured == found["wrong"]["CY_beta"].std_coloured


def test_a_file_says_it_in_shares() -> None:
    text = "[geometry]\nspan = 2.0\n[uncertainty]\nIyy = 0.1\nmass = 0.02\n"
    assert aircraft_from_text(text, "own.toml", "own").uncertainty == {"mass": 0.02, "Iyy": 0.1}
    for line in ("Iyy = 4000.0", "Iyy = -0.1", "Ixz = 0.1"):
        with pytest.raises(AircraftError, match=f"uncertainty.{line[:3]}"):
            aircraft_from_text(f"[uncertainty]\n{line}\n", "own.toml", "own")


def test_the_calibration_of_a_measured_airspeed_is_in_the_bounds() -> None:
    """A pitot that may be 3 % off moves each derivative by 6 %: measured or reconstructed, the bounds say so; a reconstructed
    airspeed has counted its own already."""
    craft, file = craft_and_file()
    flights = fly(craft, Situation("plain"), np.random.default_rng(91), 1)
    speed = float(np.nanmedian(flights[0]["V"]))
    stated = {"uncertainty": {"V": 0.03 * speed}}
    sure, unsure = (replace(f, provenance=replace(f.provenance, detail=d)) for f in flights for d in ({}, stated))
    assert airspeed_share(sure) == 0.0
    assert airspeed_share(unsure) == pytest.approx(0.06)
    by_others = {**stated, "reconstructed": {"columns": ["V"], "std": {"V": 0.1}}}
    assert airspeed_share(replace(unsure, provenance=replace(unsure.provenance, detail=by_others))) == 0.0
    found = [
        runner.estimate(load_model("lateral", file), [f], file, ("ml",), structure=StructureWish.OFF).flights[0]
        for f in (sure, unsure)
    ]
    one, other = (f.results["ml"].parameters["Cl_p"] for f in found)
    assert other.estimate == pytest.approx(one.estimate)
    assert other.std_coloured == pytest.approx(np.hypot(one.std_coloured, 0.06 * abs(one.estimate)))
