"""Predicted bounds against those of a fit, and the verdicts on flights known to lack a manoeuvre."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from estimation.aircraft import Aircraft, PriorDerivative, load_aircraft
from estimation.compatibility.excitation import CHECK, PredictedBound, excitation_findings, predicted_bounds
from estimation.estimators.output_error import output_error
from estimation.models import load_model
from groundstation.flight import Flight, read_flight
from sideslip.verbs.check import check
from tests.support.paths import RECORDINGS
from tests.unit.estimation.truth import STRONG

RUDDER = ("CY_dr", "Cl_dr", "Cn_dr")


def lateral(flight: Flight, aircraft: Aircraft | None = None) -> dict[str, PredictedBound]:
    first = predicted_bounds(flight, aircraft or load_aircraft("cdfp"))[0]
    assert first.model == "lateral"
    assert not first.why
    return {b.name: b for b in first.bounds}


@pytest.fixture(scope="module")
def ordinary() -> Flight:
    return read_flight(RECORDINGS / "foreign" / "ordinary_0.csv")


def test_bounds_agree_with_those_of_the_fit(ordinary: Flight) -> None:
    fit = output_error(load_model("lateral", load_aircraft("cdfp")), ordinary)
    bounds = lateral(ordinary)
    ratio = np.array([bounds[n].bound / fit.std[n] for n in STRONG])
    assert np.all((ratio > 0.45) & (ratio < 2.2)), dict(zip(STRONG, ratio, strict=True))


def test_a_right_prior_predicts_the_bounds_of_the_fit(ordinary: Flight) -> None:
    aircraft = load_aircraft("cdfp")
    fit = output_error(load_model("lateral", aircraft), ordinary)
    right = {**aircraft.derivatives, **{n: PriorDerivative(v) for n, v in fit.values.items()}}
    bounds = lateral(ordinary, replace(aircraft, derivatives=right))
    for name in STRONG:
        assert bounds[name].bound == pytest.approx(fit.std[name], rel=0.25)


def test_a_rudder_almost_held_tells_no_rudder_derivative() -> None:
    flight = read_flight(RECORDINGS / "cdfp_ld1.mcap")
    bounds = lateral(flight)
    for name in RUDDER:
        assert not bounds[name].can_tell
        assert "delta_r moved only" in bounds[name].reason
        assert "rudder doublet" in bounds[name].manoeuvre
    assert bounds["Cl_da"].can_tell
    assert bounds["Cl_p"].can_tell


def test_a_rudder_that_moved_tells_them() -> None:
    bounds = lateral(read_flight(RECORDINGS / "cdfp_ld4.mcap"))
    assert all(bounds[n].can_tell for n in RUDDER)


def test_half_the_flight_tells_less(ordinary: Flight) -> None:
    half = ordinary.part(slice(0, len(ordinary) // 2))
    whole, part = lateral(ordinary), lateral(half)
    assert all(part[n].bound > whole[n].bound for n in STRONG)


def test_a_flight_without_a_rudder_column_gets_a_sentence(ordinary: Flight) -> None:
    columns = {n: v for n, v in ordinary.columns.items() if n != "delta_r"}
    first = predicted_bounds(replace(ordinary, columns=columns), load_aircraft("cdfp"))[0]
    assert not first.bounds
    assert "delta_r" in first.why
    assert "delta_r" in excitation_findings([first])[0].text


def test_beliefs_of_another_aircraft_are_not_used_to_judge(ordinary: Flight) -> None:
    own = load_aircraft("cdfp")
    heavy = replace(own, name="heavy", mass=7500.0, area=31.0, chord=2.4, Iyy=94_000.0)
    _, longitudinal = predicted_bounds(ordinary, heavy)
    assert not longitudinal.bounds
    assert "believed of heavy leaves the measured one" in longitudinal.why
    assert "--aircraft" in excitation_findings([longitudinal])[0].text
    assert predicted_bounds(ordinary, own)[1].bounds


def test_check_prints_and_writes_the_verdicts(tmp_path: Path) -> None:
    target = tmp_path / "c.json"
    flight = str(RECORDINGS / "cdfp_ld1.mcap")
    done = CliRunner().invoke(check, [flight, "--segments", "18:26", "--aircraft", "cdfp", "--json", str(target)])
    assert f"warn {CHECK}: lateral: cannot tell" in done.output
    quality = json.loads(target.read_text())["flights"][0]["quality"]
    texts = [f["text"] for f in quality if f["check"] == CHECK and f["verdict"] == "warn"]
    assert any("CY_dr" in t and "rudder doublet" in t for t in texts)
