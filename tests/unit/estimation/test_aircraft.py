"""Aircraft files: what they say, what they refuse, whose a flight is, and beliefs from the shape."""

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
import tomli_w
from click.testing import CliRunner, Result
from hypothesis import given, settings
from hypothesis import strategies as st

from daq.assembly import recording_info
from daq.config import ConfigError, parse_config
from daq.contract.recordings.recording import AIRCRAFT_ATTACHMENT
from daq.utilities.errors import UserError
from estimation.aircraft import Aircraft, PriorDerivative, built_in_aircraft, load_aircraft, unknown_aircraft
from estimation.aircraft.handbook import HandbookShape, beliefs, flap_effectiveness, lift_slope, wing_moment
from estimation.aircraft.library import aircraft_of
from estimation.aircraft.schema import aircraft_from_text
from estimation.errors import AircraftError, ModelError
from estimation.models import load_model, write_model
from estimation.session.aircraft_review import review_aircraft
from groundstation.cli.import_log import import_
from groundstation.flight import AIRCRAFT_FILE, Flight, Provenance, read_flight
from sideslip.verbs.aircraft import aircraft as verb
from sideslip.verbs.estimate import estimate
from sideslip.verbs.gap import gap
from sideslip.verbs.match import match
from tests.unit.estimation.cessna import CESSNA_172, PUBLISHED, SHAPE

FULL = "[geometry]\nspan = 2.0\narea = 0.5\nchord = 0.26\n[mass]\nmass = 3.0\nIxx = 0.2\nIyy = 0.15\nIzz = 0.3\n"


class AsksForAircraft:
    def __init__(self, aircraft: Aircraft) -> None:
        self.aircraft = aircraft

    states: ClassVar = {"p": "rad/s"}
    measured: ClassVar = {"p": "rad/s"}
    parameters: ClassVar = {}

    def derivatives(self, x: Any, u: Any, p: Any) -> list[Any]:
        return [x.p * self.aircraft.Iyy]

    def outputs(self, x: Any, u: Any, p: Any, xdot: Any) -> list[Any]:
        return [x.p]


def made(text: str = FULL, name: str = "own") -> Aircraft:
    return aircraft_from_text(text, "own.toml", name)


def flight_of(name: str = "", **detail: str) -> Flight:
    provenance = Provenance("imported", aircraft=name, detail=detail)
    return Flight.build("f", np.arange(20) / 10.0, {"p": np.zeros(20)}, provenance=provenance)


# ------------------------------------------------------------------------------------------------------------- the file


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (("span = 2.0", "span = true"), "geometry.span = True is not a number"),
        (("span = 2.0", "span = nan"), "geometry.span = nan must be a finite number"),
        (("span = 2.0", "spam = 2.0"), "unknown key geometry.spam"),
        (("Ixx = 0.2", "Ixx = 0.2\nIxz = 0.9"), "mass: Ixz = 0.9 is impossible"),
        (("[geometry]", "[sensors]\nimu = [1, 2]\n[geometry]"), "sensors.imu"),
        (
            ("[geometry]", "[derivatives]\nCl_p = {value = 1, source = 'hearsay'}\n[geometry]"),
            "derivatives.Cl_p.source",
        ),
        (("[geometry]", "[derivatives]\nCl_p = {std = 1}\n[geometry]"), "derivatives.Cl_p.value is missing"),
        (
            ("[geometry]", "[simulation]\nspeed = 9\nspeed_range = [10, 20]\n[geometry]"),
            "simulation: speed = 9 must lie",
        ),
        (("[geometry]", "[geometry"), "not valid TOML"),
    ],
)
def test_a_wrong_file_is_one_sentence_with_file_and_key(change: tuple[str, str], said: str) -> None:
    with pytest.raises(AircraftError, match=rf"^own\.toml: {said}") as caught:
        made(FULL.replace(*change))
    assert "\n" not in str(caught.value)


def test_missing_and_unreadable_files_are_said(tmp_path: Path) -> None:
    with pytest.raises(AircraftError, match=r"no such file and no built-in of that name \(built in: cdfp\)"):
        load_aircraft("glider")
    (tmp_path / "a.toml").write_bytes(b"\xff\xfe")
    with pytest.raises(AircraftError, match="cannot be read as a text file"):
        load_aircraft(tmp_path / "a.toml")


TABLES = "name title geometry mass sensors shape derivatives servos engine simulation".split()
VALUES = st.recursive(
    st.booleans() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text("abIxz_span", max_size=4), inner, max_size=3),
    max_leaves=6,
)


@given(st.dictionaries(st.sampled_from(TABLES), VALUES))
@settings(max_examples=100, deadline=None)
def test_whatever_a_file_says_it_is_read_or_refused_in_one_sentence(table: dict[str, object]) -> None:
    try:
        said = made(tomli_w.dumps(table)).name
    except AircraftError as error:
        said = str(error)
    assert len(said.splitlines()) <= 1 or said == table.get("name")


def test_what_a_file_lacks_is_refused_only_where_it_is_needed() -> None:
    without_pitch = made(FULL.replace("Iyy = 0.15\n", "").replace("chord = 0.26\n", ""))
    assert load_model("lateral-simple", without_pitch).constants.keys().isdisjoint({"Iyy", "c"})
    with pytest.raises(AircraftError, match=r"aircraft own: mass\.Iyy is missing, and model lateral cannot do without"):
        load_model("lateral", without_pitch)
    with pytest.raises(AircraftError, match=r"mass\.Iyy, geometry\.chord are missing, and model longitudinal"):
        load_model("longitudinal", without_pitch)


def test_no_aircraft_is_ever_assumed() -> None:
    with pytest.raises(ModelError, match="was given none; name a built-in one"):
        load_model("lateral")
    with pytest.raises(ModelError, match="asks for an aircraft and was given none"):
        load_model(AsksForAircraft)


def test_a_number_the_aircraft_lacks_does_not_get_into_equations_of_a_class() -> None:
    assert "0.15" in load_model(AsksForAircraft, made()).equations[0]
    with pytest.raises(ModelError, match="not finite; does the aircraft's file lack it"):
        load_model(AsksForAircraft, made(FULL.replace("Iyy = 0.15\n", "")))


# ----------------------------------------------------------------------------------------------------------- of a flight


def test_a_flight_is_of_the_aircraft_asked_for_then_carried_then_built_in() -> None:
    assert aircraft_of([flight_of("cdfp")]).name == "cdfp"
    carried = flight_of("own", **{AIRCRAFT_FILE: FULL})
    assert aircraft_of([carried, carried]).span == 2.0
    assert aircraft_of([carried], "cdfp").name == "cdfp"


@pytest.mark.parametrize(
    ("flights", "said"),
    [
        ([flight_of()], "f names no aircraft; say which with --aircraft NAME or FILE .* sideslip aircraft new NAME"),
        ([flight_of("cdfp"), flight_of()], "f names no aircraft"),
        (
            [flight_of("glider")],
            "f is of aircraft 'glider', which is not built in .* give it with --aircraft glider.toml",
        ),
        ([flight_of("cdfp"), flight_of("own", **{AIRCRAFT_FILE: FULL})], r"different aircraft \(cdfp, own\)"),
        (
            [flight_of("own", **{AIRCRAFT_FILE: FULL}), flight_of("own", **{AIRCRAFT_FILE: FULL + "\n"})],
            "different files",
        ),
        ([flight_of("own", **{AIRCRAFT_FILE: "span"})], "aircraft carried by f: not valid TOML"),
    ],
)
def test_a_flight_whose_aircraft_is_not_known_is_refused_with_the_way_out(flights: list[Flight], said: str) -> None:
    with pytest.raises(AircraftError, match=said):
        aircraft_of(flights)


@pytest.mark.parametrize(
    ("command", "more"),
    [(estimate, []), (estimate, ["--model", "own.toml", "--method", "ngn"]), (gap, ["--nulls", "20"])],
    ids=["estimate", "neural", "gap"],
)
def test_verbs_refuse_a_flight_without_aircraft(
    command: object, more: list[str], root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_model(load_model("lateral", "cdfp"), tmp_path / "own.toml")
    monkeypatch.chdir(tmp_path)
    flight = root / "recordings" / "foreign" / "ordinary_0.csv"
    done = CliRunner().invoke(command, [str(flight), *more])  # type: ignore[arg-type]
    assert isinstance(done.exception, AircraftError)
    assert "ordinary_0 names no aircraft" in str(done.exception)


def test_match_with_a_built_in_model_refuses_too(root: Path) -> None:
    done = CliRunner().invoke(match, ["lateral", str(root / "recordings" / "foreign" / "ordinary_0.csv")])
    assert isinstance(done.exception, AircraftError)


# ------------------------------------------------------------------------------------------------------------- the verbs


def run(*words: object) -> Result:
    return CliRunner().invoke(verb, [str(w) for w in words], standalone_mode=False)


def test_new_file_is_read_as_it_is_and_with_every_key_filled_in(tmp_path: Path) -> None:
    """Each commented key is one the reader knows: uncommenting them all gives a file that is read."""
    file = tmp_path / "glider.toml"
    assert run("new", "glider", "-o", file).exit_code == 0
    text = file.read_text()
    assert made(text).name == "glider"
    keys = [
        line
        for line in text.splitlines()
        if line.startswith(("# [", "# ")) and (" = " in line or line.startswith("# ["))
    ]
    filled = "\n".join(line.removeprefix("# ") if line in keys else line for line in text.splitlines())
    filled = (
        filled.replace("speed_range = [0.0, 0.0]", "speed_range = [0.5, 2.0]")
        .replace(" = 0.0 ", " = 0.7 ")
        .replace("Ixz = 0.7", "Ixz = 0.0")
    )
    whole = made(filled)
    assert whole.servos is not None
    assert whole.engine is not None
    assert whole.simulation is not None
    assert set(whole.sensors) == {"imu", "alpha_vane", "beta_vane", "pitot", "gps"}
    assert len(whole.derivatives) > 20


def test_new_replaces_nothing_and_wants_a_name_and_toml(tmp_path: Path) -> None:
    (tmp_path / "a.toml").write_text("mine")
    for words in (["a", "-o", tmp_path / "a.toml"], ["a/b"], [" "], ["a", "-o", tmp_path / "a.json"]):
        assert isinstance(run("new", *words).exception, AircraftError)
    assert (tmp_path / "a.toml").read_text() == "mine"


def test_check_says_what_is_enough_for_what(tmp_path: Path) -> None:
    file, told = tmp_path / "own.toml", tmp_path / "own.json"
    file.write_text(FULL.replace("Iyy = 0.15\n", ""))
    done = run("check", file, "--json", told)
    assert done.return_value == 0  # lateral-simple can be used
    notes = {n["check"]: n for n in json.loads(told.read_text())["notes"]}
    assert notes["model lateral-simple"]["verdict"] == "ok"
    assert "they start from zero" in notes["model lateral-simple"]["text"]
    assert notes["model lateral"]["verdict"] == "fail"
    assert "mass.Iyy" in notes["model lateral"]["text"]
    assert run("check", "cdfp").return_value == 0


def test_check_of_an_empty_or_impossible_file_fails(tmp_path: Path) -> None:
    file = tmp_path / "own.toml"
    for text in ("", FULL.replace("Izz = 0.3", "Izz = 0.9")):
        file.write_text(text)
        assert run("check", file).return_value == 1


@pytest.mark.parametrize(
    ("change", "check", "said"),
    [
        ({"chord": 0.026}, "geometry", "another unit"),
        ({"mass": 3000.0}, "mass", "kg/m2 of wing"),
        ({"Ixx": 20.0, "Iyy": 20.0, "Izz": 20.0}, "inertia", "Ixx: radius of gyration"),
        ({"derivatives": {"Cl_p": PriorDerivative(0.4, 0.1)}}, "beliefs", "Cl_p = 0.4 has an unusual sign"),
        ({"derivatives": {"Cl_p": PriorDerivative(-0.4)}}, "beliefs", "no standard deviation stated for Cl_p"),
        ({"sensors": {"gps": (50.0, 0.0, 0.0)}}, "sensors", "more than two spans"),
    ],
)
def test_doubtful_numbers_are_warned_of(change: dict[str, object], check: str, said: str) -> None:
    sound = replace(made(), sensors={"imu": (0.0, 0.0, 0.0)})
    assert not [n for n in review_aircraft(sound) if n.verdict == "warn"]
    warned = [n for n in review_aircraft(replace(sound, **change)) if n.verdict == "warn"]  # type: ignore[arg-type]
    assert any(n.check == check and said in n.text for n in warned)


def test_an_indoor_model_of_fifty_grams_is_an_aeroplane() -> None:
    inertia = {n: 0.05 * (k * 0.95) ** 2 for n, k in (("Ixx", 0.12), ("Iyy", 0.13), ("Izz", 0.17))}
    indoor = Aircraft("indoor", span=0.95, area=0.23, chord=0.25, mass=0.05, Ixz=0.0, **inertia)
    assert not [n for n in review_aircraft(indoor) if n.verdict != "ok"]


def test_a_fuselage_longer_than_the_wing_is_usual() -> None:
    """An X-15: 6.8 m of span, 15 m of length; a yaw inertia 20 times too large is not."""
    craft = Aircraft("x", 6.8, 18.6, 3.1, 6600.0, 5000.0, 108000.0, 111000.0, 800.0)
    assert not [n for n in review_aircraft(craft) if "Izz" in n.text]
    wrong = replace(craft, Iyy=2.2e6, Izz=2.2e6)
    assert [n for n in review_aircraft(wrong) if "Izz" in n.text]


def test_built_in_aircraft_are_beyond_doubt() -> None:
    for name in built_in_aircraft():
        assert {n.verdict for n in review_aircraft(load_aircraft(name))} == {"ok"}


# ------------------------------------------------------------------------------------------------ beliefs from the shape


def test_beliefs_hold_against_published_derivatives_of_a_light_aircraft() -> None:
    found = beliefs(CESSNA_172, SHAPE)
    for name, value in PUBLISHED.items():
        assert found[name].value * value > 0, name
        assert abs(found[name].value - value) < 2.0 * (found[name].std or 0.0), name


def test_table_of_the_page_is_what_the_methods_give(root: Path) -> None:
    table = (root / "docs" / "handbook-cessna172.csv").read_text()
    for name, belief in beliefs(CESSNA_172, SHAPE).items():
        if name in PUBLISHED:
            assert f"\n{name},{PUBLISHED[name]:g},{belief.value:.3f},{belief.std:.3f}\n" in table


def test_lifting_line_against_closed_forms() -> None:
    """An elliptic wing rolls against pi A / (4 (A + 4)) (Glauert); a straight taper of 0.45 is nearly elliptic."""
    aspect = 8.0
    line_slope = 2.0 * math.pi / (1.0 + 2.0 / aspect)
    rolling = wing_moment(aspect, 0.45, line_slope, lambda y: y)
    assert rolling == pytest.approx(math.pi * aspect / (4.0 * (aspect + 4.0)), rel=0.06)
    assert wing_moment(aspect, 0.45, 2.0 * line_slope, lambda y: y) == pytest.approx(2.0 * rolling)


def test_slopes_and_flaps_at_their_limits() -> None:
    assert lift_slope(1e6) == pytest.approx(2.0 * math.pi, rel=1e-4)  # a wing without ends
    assert lift_slope(0.01) == pytest.approx(0.5 * math.pi * 0.01, rel=1e-3)  # Jones: slender wings, pi A / 2
    assert flap_effectiveness(1.0) == pytest.approx(1.0)
    assert flap_effectiveness(0.25) == pytest.approx(0.609, abs=1e-3)  # Glauert


def test_beliefs_stated_go_before_those_computed_and_need_geometry() -> None:
    shape = "[shape]\nspeed = 20.0\ntail_area = 0.1\ntail_arm = 0.8\n"
    found = made(FULL + shape + "[derivatives]\nCl_p = { value = -0.3, std = 0.1, source = 'flight' }\n").derivatives
    assert found["Cl_p"].source == "flight"
    assert found["Cm_q"].source == "handbook"
    assert "Cn_dr" not in found  # no fin, no rudder
    with pytest.raises(AircraftError, match=r"geometry\.span, .*\[shape\] cannot do without"):
        made(shape)
    assert (
        beliefs(CESSNA_172, HandbookShape(speed=50.0))["Cm_alpha"].value == 0.0
    )  # a wing alone on its aerodynamic centre


def test_an_aircraft_of_which_nothing_is_known_has_no_number() -> None:
    assert all(math.isnan(v) for k, v in unknown_aircraft("x").constants().items() if k != "g")


# ------------------------------------------------------------------------------------------------------ how it is carried


def test_an_imported_flight_carries_the_file_it_was_given(root: Path, tmp_path: Path) -> None:
    file, flight = tmp_path / "own.toml", tmp_path / "f.mcap"
    file.write_text('name = "mine"\n' + FULL)
    log = root / "recordings" / "foreign" / "ordinary_0.csv"
    done = CliRunner().invoke(import_, [str(log), "-o", str(flight), "--aircraft", str(file)], standalone_mode=False)
    assert done.exception is None
    found = aircraft_of([read_flight(flight)])
    assert (found.name, found.span) == ("mine", 2.0)
    CliRunner().invoke(import_, [str(log), "-o", str(flight), "--aircraft", "cdfp"], standalone_mode=False)
    assert aircraft_of([read_flight(flight)]).name == "cdfp"


def test_a_csv_says_that_it_cannot_carry_the_aircraft(root: Path, tmp_path: Path) -> None:
    words = [
        str(root / "recordings" / "foreign" / "ordinary_0.csv"),
        "-o",
        str(tmp_path / "f.csv"),
        "--aircraft",
        "cdfp",
    ]
    done = CliRunner().invoke(import_, words, standalone_mode=False)
    assert "a CSV cannot carry its aircraft: give --aircraft cdfp to each verb" in done.output


def test_an_aircraft_file_that_cannot_be_carried_is_refused_at_import(root: Path, tmp_path: Path) -> None:
    (tmp_path / "odd.toml").write_text("span = ")
    for name, why in {"odd.toml": "not valid TOML", "none.toml": "no such aircraft file"}.items():
        words = [str(root / "recordings" / "foreign" / "ordinary_0.csv"), "-o", str(tmp_path / "f.mcap")]
        done = CliRunner().invoke(import_, [*words, "--aircraft", str(tmp_path / name)], standalone_mode=False)
        assert isinstance(done.exception, UserError)
        assert f"{name}: {why}" in str(done.exception)


def test_a_recording_carries_the_file_that_its_configuration_names(tmp_path: Path) -> None:
    (tmp_path / "own.toml").write_text(FULL)
    text = '[aircraft]\nname = "own"\nfile = "{}"\n[sensors]\n'
    config = parse_config(text.format("own.toml"), tmp_path / "uav.toml")
    info = recording_info(config, "", "s", "real", 0)
    assert info.attachments[AIRCRAFT_ATTACHMENT].decode() == FULL
    with pytest.raises(ConfigError, match=r"none\.toml: the aircraft's file cannot be read .* key aircraft.file"):
        recording_info(parse_config(text.format("none.toml"), tmp_path / "uav.toml"), "", "s", "real", 0)


def test_a_configuration_that_names_no_aircraft_gives_recordings_of_none(tmp_path: Path) -> None:
    config = parse_config("[sensors]\n", tmp_path / "uav.toml")
    assert recording_info(config, "", "s", "real", 0).aircraft == ""
