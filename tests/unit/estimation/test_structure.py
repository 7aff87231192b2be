"""What a model lacks, told beside the fit: a hidden derivative, a lag, a scale, a flight that differs; nothing where nothing
lacks."""

from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest

from estimation.aircraft import Aircraft, PriorDerivative
from estimation.models import load_model
from estimation.session import runner
from estimation.session.sanity_checks import DoubtKind
from estimation.session.session import EstimationSession
from estimation.session.structured import StructureWish
from estimation.structure.candidates import GRAVITY_OFF, Candidate, CandidateKind, structure_candidates
from estimation.structure.score_test import Tested as Score
from estimation.structure.score_test import _possible
from groundstation.flight import Flight
from tests.studies.random_aeroplanes import Aeroplane, Situation, fly

SEED = 4711


def craft_and_file(**file: float) -> tuple[Aeroplane, Aircraft]:
    """An aeroplane of some kilograms and its aircraft file."""
    rng = np.random.default_rng(SEED)
    craft = replace(Aeroplane.drawn(rng), derivatives=Aeroplane.drawn(np.random.default_rng(SEED + 1)).derivatives)
    Ixx, Iyy, Izz, Ixz = craft.inertia
    return craft, replace(
        Aircraft("drawn", craft.span, craft.area, craft.chord, craft.mass, Ixx, Iyy, Izz, Ixz), **file
    )


def flown(situation: Situation, flights: int = 1) -> tuple[list[Flight], Aircraft, Mapping[str, float]]:
    craft, aircraft = craft_and_file()
    asked = repr((situation, flights))
    if asked not in FLOWN:
        FLOWN[asked] = fly(craft, situation, np.random.default_rng(SEED + 2), flights)
    return list(FLOWN[asked]), aircraft, craft.derivatives


def estimated(
    flights: list[Flight], aircraft: Aircraft, wish: StructureWish = StructureWish.TEST, model: str = "lateral"
) -> EstimationSession:
    joint = len(flights) > 1
    return runner.estimate(load_model(model, aircraft), flights, aircraft, ("ml",), joint=joint, structure=wish)


FLOWN: dict[str, list[Flight]] = {}
"""Flights by their situation and number, each flown once for all tests."""

YAWING = Situation("adverse yaw", hidden={"Cn_da": 0.014})


@cache
def yawing(wish: StructureWish = StructureWish.TEST) -> EstimationSession:
    """One flight with a hidden yaw by aileron, estimated once for all tests."""
    flights, aircraft, _ = flown(YAWING)
    return estimated(flights, aircraft, wish)


def test_nothing_is_found_lacking_where_nothing_lacks() -> None:
    flights, aircraft, _ = flown(Situation("plain"))
    found = estimated(flights, aircraft).flights[0]
    assert found.structure is not None
    assert len(found.structure.tested) > 15
    assert not found.structure.lacks
    assert not found.structure.added
    assert found.verdict is not None
    assert found.verdict.recommended.method == "ml"
    assert max(abs(t.score) for t in found.structure.tested) < 4.5


def test_yaw_by_aileron_is_added_to_the_linear_model_and_its_double_is_named() -> None:
    truth = craft_and_file()[0].derivatives
    found = yawing().flights[0]
    assert found.structure is not None
    assert found.verdict is not None
    assert found.structure.added == ("Cn_da",)
    e = found.results["ml"].parameters["Cn_da"]
    assert abs(e.estimate - 0.014) < 3.0 * e.std_coloured
    assert any("another Ixz" in d.text and "Cn_da" in d.text for d in found.verdict.doubts)
    assert found.verdict.recommended.method == "ml"
    assert not e.identifiable
    assert e.std_coloured >= abs(e.estimate)
    for name in ("Cn_beta", "Cl_p", "Cl_da"):
        told = found.results["ml"].parameters[name]
        assert told.identifiable
        assert abs(told.estimate - truth[name]) < 3.0 * told.std_coloured, name
    before = yawing(StructureWish.OFF).flights[0].results["ml"].parameters["Cn_beta"].std_coloured
    assert found.results["ml"].parameters["Cn_beta"].std_coloured > before
    data = found.structure.to_json()
    assert data["added"] == ["Cn_da"]
    assert set(data["tested"][0]) >= {"term", "score", "threshold", "significant", "moves"}


def test_the_paper_s_model_stays_as_it_is_and_says_what_it_lacks() -> None:
    flights, aircraft, _ = flown(YAWING)
    found = estimated(flights, aircraft, model="lateral-simple").flights[0]
    assert "Cn_da" not in found.results["ml"].parameters
    assert found.structure is not None
    assert not found.structure.added


def test_a_term_of_the_aircraft_file_is_estimated_from_the_start() -> None:
    flights, aircraft, _ = flown(YAWING)
    stated = replace(aircraft, derivatives={"Cn_da": PriorDerivative(0.01, 0.01)})
    found = estimated(flights, stated).flights[0]
    e = found.results["ml"].parameters["Cn_da"]
    assert abs(e.estimate - 0.014) < 3.0 * e.std_coloured
    assert found.verdict is not None
    assert found.verdict.recommended.method == "ml"


@pytest.mark.parametrize(
    ("situation", "term"),
    [
        (Situation("late aileron", aileron_late=0.04), "delay_delta_a"),
        (Situation("vane reads too much", vane_scale=1.2), "scale_beta"),
        (Situation("vane lags", vane_lag=0.07), "delay_beta"),
    ],
)
def test_a_lag_or_a_scale_is_named_and_auto_brings_the_estimates_back(situation: Situation, term: str) -> None:
    flights, aircraft, truth = flown(situation)
    found = estimated(flights, aircraft).flights[0]
    assert found.verdict is not None
    assert found.verdict.recommended.method == "none"
    assert term in found.verdict.recommended.lacks
    assert "--structure auto" in found.verdict.recommended.why
    auto = estimated(flights, aircraft, StructureWish.AUTO).flights[0]
    assert auto.structure is not None
    assert term in auto.structure.added
    told = auto.results["ml"].parameters
    for name in ("Cl_p", "Cl_da", "Cn_beta", "Cn_r"):
        assert abs(told[name].estimate - truth[name]) < 3.5 * told[name].std_coloured, name


def test_a_large_yaw_by_aileron_may_stand_beside_another_ixz() -> None:
    """A rolling tail yaws by half of its roll: unlikely enough not to lead, likely enough to be named as a rival."""
    fit = SimpleNamespace(parameters={"Cl_da": SimpleNamespace(estimate=-0.1)}, model=SimpleNamespace(constants={}))
    yaw = Score(Candidate("Cn_da", CandidateKind.LINEAR), -49.0, -0.05, {})
    assert not _possible(yaw, fit)  # type: ignore[arg-type]
    assert _possible(yaw, fit, as_rival=True)  # type: ignore[arg-type]
    assert _possible(replace(yaw, value=-0.02), fit)  # type: ignore[arg-type]


@pytest.mark.parametrize(("scale", "lacking"), [(1.003, False), (1.06, True)])
def test_gravity_is_no_scale_of_an_accelerometer(scale: float, lacking: bool) -> None:
    """0.3 % is what gravity differs by at 10 km; 6 % is a calibration."""
    candidate = Candidate("scale_az", CandidateKind.SCALE, null=1.0, channel="az", least=GRAVITY_OFF["az"])
    assert Score(candidate, -12.0, scale, {}).significant is lacking
    (offered,) = [
        c for c in structure_candidates(load_model("longitudinal", craft_and_file()[1])) if c.name == "scale_az"
    ]
    assert offered.least == candidate.least


def test_the_flight_of_another_weight_is_named_with_its_ratio() -> None:
    craft, aircraft = craft_and_file()
    light = fly(craft, Situation("light"), np.random.default_rng(SEED + 3), 3)
    inertia = tuple(1.3 * v for v in craft.inertia)
    heavier = replace(craft, mass=1.3 * craft.mass, inertia=inertia)  # type: ignore[arg-type]
    heavy = fly(heavier, Situation("heavy"), np.random.default_rng(SEED + 4), 1)[0]
    session = estimated([*light, replace(heavy, name="heavy")], aircraft)
    assert [o.flight for o in session.odd] == ["heavy"]
    assert session.odd[0].what == "mass or dynamic pressure"
    assert session.odd[0].ratio == pytest.approx(1.3, rel=0.1)
    assert session.odd[0].probability < 1e-4
    assert session.verdict is not None
    assert session.verdict.recommended.method == "none"
    assert "heavy" in session.verdict.recommended.why
    assert session.to_json()["odd"][0]["flight"] == "heavy"


def test_flights_of_one_aeroplane_are_not_odd() -> None:
    flights, aircraft, _ = flown(Situation("plain"), 3)
    session = estimated(flights, aircraft)
    assert not session.odd
    assert session.verdict is not None
    assert session.verdict.recommended.method == "ml"


def test_an_aircraft_file_in_grams_is_not_believed() -> None:
    flights, aircraft, _ = flown(Situation("plain"))
    found = estimated(flights, replace(aircraft, mass=1000.0 * aircraft.mass)).flights[0]
    assert found.verdict is not None
    assert found.verdict.recommended.method == "none"
    assert "aircraft check" in found.verdict.recommended.why
    assert DoubtKind.AIRCRAFT in {d.kind for d in found.verdict.doubts}


def test_a_rudder_of_the_other_sign_is_no_aeroplane_s() -> None:
    flights, aircraft, _ = flown(Situation("plain"))
    turned = replace(flights[0], columns={**flights[0].columns, "delta_r": -flights[0]["delta_r"]})
    found = estimated([turned], aircraft).flights[0]
    assert found.verdict is not None
    assert found.verdict.recommended.method == "none"
    assert "sign of delta_r" in found.verdict.recommended.why


def test_off_tests_nothing() -> None:
    found = yawing(StructureWish.OFF)
    assert found.flights[0].structure is None
    assert "structure" not in found.to_json()["flights"][0]


def test_a_damper_that_moves_the_rudder_behind_its_record_is_named_and_added() -> None:
    situation = Situation("damper", damper=0.3, washout=2.0)
    flights, aircraft, truth = flown(situation, 2)
    found = estimated(flights, aircraft)
    assert found.verdict is not None
    recommended = found.verdict.recommended
    assert (recommended.method, recommended.lacks[:1]) == ("none", ("damper_delta_r",))
    assert "moves delta_r with r behind its record" in recommended.why
    assert abs(found.joint["ml"].parameters["Cn_r"].estimate / truth["Cn_r"] - 1.0) > 0.5
    added = estimated(flights, aircraft, StructureWish.AUTO)
    assert added.verdict is not None
    assert added.verdict.recommended.method == "ml"
    parameters = added.joint["ml"].parameters
    for name, true in {**truth, "damper_delta_r": 0.3, "washout_delta_r": 2.0}.items():
        if name in parameters and parameters[name].identifiable:
            assert abs(parameters[name].estimate - true) < 3.0 * parameters[name].std_coloured, name


def test_in_rough_air_yaw_by_aileron_is_estimated_though_it_is_not_significant() -> None:
    """A hidden `Cn_da` of 2.7 standard deviations moved the filter's `Cn_beta` by sixteen bounds, and was recommended."""
    rough = Situation("rough", gust=np.radians(1.2), hidden={"Cn_da": -0.010})
    rng = np.random.default_rng([78, 503])
    craft = Aeroplane.drawn(rng)
    aircraft = Aircraft("drawn", craft.span, craft.area, craft.chord, craft.mass, *craft.inertia)
    flights = fly(craft, rough, rng)
    session = runner.estimate(load_model("lateral", aircraft), flights, aircraft, ["ml", "fem"], joint=True)
    assert session.structure is not None
    assert "Cn_da" in session.structure.added
    for name in ("Cn_beta", "Cn_r", "Cn_dr"):
        e = session.joint["fem"].parameters[name]
        assert abs(e.estimate - craft.derivatives[name]) < 3.0 * e.std_coloured, name
