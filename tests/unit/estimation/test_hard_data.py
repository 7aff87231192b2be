"""Data that a stranger brings: wrong units and signs, stuck sensors, files that cannot be written, models that are none."""

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result

from daq.utilities.errors import UserError
from estimation.aircraft import load_aircraft
from estimation.errors import DataError, ModelError
from estimation.estimators.output_error import output_error
from estimation.models import load_model
from estimation.prepare.flight_data import Preparation
from estimation.prepare.pipeline import prepare
from estimation.prepare.stretches import flights_of_segments, select_segments
from estimation.session import runner
from estimation.session.sanity_checks import DoubtKind
from estimation.session.verdict import NO_METHOD
from groundstation.flight import Flight, MissingColumnError, read_flight, write_flight
from groundstation.flight.contradictions.air import independent_density
from groundstation.flight.findings import finding_texts
from groundstation.flight.quality.repeats import repeats
from sideslip.verbs.estimate import estimate

LATERAL = load_model("lateral", "cdfp")
Change = Callable[[Flight], dict[str, np.ndarray]]


def run(*arguments: object) -> Result:
    return CliRunner().invoke(estimate, [str(a) for a in arguments], standalone_mode=False)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda f: {"V": -f["V"]}, "V is -1"),
        (lambda f: {"V": 0 * f["V"]}, "a dead channel: fill V in"),
        (lambda f: {"rho": np.where(f.time < 3.0, 0.0, f["rho"])}, r"leave that time out \(--segments"),
        (lambda f: {"beta": np.degrees(f["beta"])}, "beta reaches"),
        (lambda f: {"delta_a": np.degrees(f["delta_a"])}, "looks like degrees"),
        (lambda f: {"p": np.degrees(f["p"])}, "p reaches"),
        (lambda f: {"p": np.degrees(f["p"]) / 5.0, "phi": f["phi"] / 5.0}, "times too large beside phi"),
        (lambda f: {"phi": np.degrees(f["phi"])}, "times too large beside p"),
        (lambda f: {"rho": -f["rho"]}, "rho is -"),
    ],
)
def test_another_unit_or_sign_is_refused_before_the_fit(made_flights: list[Flight], change: Change, said: str) -> None:
    flight = made_flights[0]
    with pytest.raises(DataError, match=said):
        prepare(LATERAL, flight.with_columns(**change(flight)))


def test_an_aircraft_that_still_stands_may_be_checked_but_not_divided_by(made_flights: list[Flight]) -> None:
    from estimation.models.kinematic import compatibility_model

    flight = made_flights[0]
    still = np.zeros(len(flight))
    rolling = flight.with_columns(V=np.where(flight.time < 3.0, 0.0, flight["V"]), ax=still, az=still - 9.8, psi=still)
    prepare(compatibility_model(), rolling)
    with pytest.raises(DataError, match="first at t = 0 s"):
        prepare(LATERAL, rolling)


def test_sound_flights_pass_and_own_units_are_not_judged(made_flights: list[Flight], tmp_path: Path) -> None:
    assert not [n for n in prepare(LATERAL, made_flights[0]).notes if "radians" in n.text]
    text = 'equations = ["p_dot = L_p*p + L_a*delta_a"]\nstates = ["p"]\noutputs = ["p"]\ninputs = ["delta_a"]\n'
    (tmp_path / "degrees.toml").write_text(text + 'parameters = ["L_p", "L_a"]\n')
    degrees = {n: np.degrees(made_flights[0][n]) for n in ("p", "delta_a")}
    prepare(load_model(tmp_path / "degrees.toml"), made_flights[0].with_columns(**degrees))


def test_a_stuck_sensor_is_left_out_and_the_answer_stays_right(made_flights: list[Flight]) -> None:
    flight = made_flights[0]
    p = np.where(flight.time > 20.0, flight["p"][400], flight["p"])
    data = prepare(LATERAL, flight.with_columns(p=p))
    assert any("p repeats one value for" in n.text for n in data.notes)
    result, sound = output_error(LATERAL, data), output_error(LATERAL, flight)
    for name in ("Cl_p", "Cl_da", "Cn_beta"):
        assert abs(result.values[name] - sound.values[name]) < 3.0 * result.std_coloured[name]
    quiet = np.zeros(400)  # a channel without noise may stand still
    still = Flight.build("still", np.arange(400) * 0.05, {"quiet": quiet})
    assert not repeats(still, "quiet").stuck.any()


def test_a_channel_that_is_not_explained_is_named(made_flights: list[Flight]) -> None:
    flight = made_flights[0].with_columns(r=-made_flights[0]["r"])
    session = runner.estimate(LATERAL, [flight], load_aircraft("cdfp"))
    assert any("is not explained by the model" in n for n in session.flights[0].notes)
    assert {d.kind for d in session.flights[0].doubts} == {DoubtKind.UNEXPLAINED, DoubtKind.CHANNEL_SIGN}
    assert any(n.startswith("r: moves against what the other channels make of it") for n in session.flights[0].notes)
    turned = made_flights[0].with_columns(delta_a=-made_flights[0]["delta_a"])
    session = runner.estimate(LATERAL, [turned], load_aircraft("cdfp"))
    assert any("check the sign of delta_a" in n for n in session.flights[0].notes)
    doubt = next(d for d in session.flights[0].doubts if d.kind is DoubtKind.SIGN)
    assert doubt.to_json() == {"kind": "sign of a control", "text": doubt.text}
    assert doubt.text in session.flights[0].notes
    session = runner.estimate(LATERAL, [made_flights[0]], load_aircraft("cdfp"))
    assert not any("check" in n for n in session.flights[0].notes)


def test_a_left_handed_roll_is_told_by_the_record_itself(root: Path) -> None:
    """Bank and rate agree with each other, and the fit runs nowhere that would tell which channel it is."""
    one, other = (read_flight(root / "recordings" / "foreign" / f"ordinary_{i}.csv") for i in range(2))
    left = one.with_columns(p=-one["p"], phi=-one["phi"])
    session = runner.estimate(LATERAL, [left, other], load_aircraft("cdfp"), joint=True)
    verdicts = [v for v in (*(f.verdict for f in session.flights), session.verdict) if v is not None]
    assert [v.recommended.method for v in verdicts] == [NO_METHOD, "ml", NO_METHOD]
    odd = [[d.to_json() for d in v.doubts if d.kind is DoubtKind.CHANNEL] for v in verdicts]
    assert odd[0][0]["kind"] == "unit or sign of a channel"
    assert odd[0][0]["text"].startswith("phi, p: turned, it would agree with the sideways motion")
    assert not odd[1]
    assert odd[2] == [odd[0][0] | {"text": f"{left.name}: {odd[0][0]['text']}"}]


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--figure", "f.xyz"], "no known kind of picture"),
        (["--figure", "f"], "no known kind of picture"),
        (["--save-model", "m.json"], "end the name in .toml"),
        (["--json", "."], "that is a folder"),
        (["--json", "flight.csv/x.json"], "is a file, not a folder"),
        (["--report", "flight.csv"], "is a file, not a folder"),
        (["--histories", "flight.csv/x"], "is a file, not a folder"),
        (["--method", ""], "no method given"),
        (["--model", ":"], "module:Class"),
        (["--model", ".x:Y"], "module:Class"),
        (["--model", "nowhere_at_all:Y"], "cannot import"),
    ],
)
def test_options_are_looked_at_before_any_work(
    options: list[str], said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, made_flights: list[Flight]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(runner, "_fit_each", lambda *_, **__: pytest.fail("the fit had begun"))
    write_flight(made_flights[0], "flight.csv")
    result = run("flight.csv", "--aircraft", "cdfp", *options)
    assert isinstance(result.exception, UserError)
    assert said in str(result.exception)
    assert result.output == ""


def test_outputs_that_can_be_written_leave_nothing_behind(tmp_path: Path) -> None:
    written = ["--json", tmp_path / "a" / "b.json", "--report", tmp_path / "report", "--figure", tmp_path / "f.PNG"]
    result = run(tmp_path / "none.csv", *written)
    assert "none.csv" in str(result.exception)
    assert list(tmp_path.iterdir()) == []


def test_segments_say_what_is_wrong_with_them(made_flights: list[Flight]) -> None:
    for text, said in (("2:2.1", "only 3 samples"), ("2:12,10:20", "overlaps"), ("50:60", "it runs from")):
        with pytest.raises(UserError, match=said):
            select_segments(made_flights[0], text)


def test_each_segment_becomes_a_flight(made_flights: list[Flight]) -> None:
    flight = select_segments(made_flights[0], "1:14,15:29")
    first, second = flights_of_segments(flight)
    assert (first.name, second.name) == (f"{flight.name}.1", f"{flight.name}.2")
    assert len(first) + len(second) == len(flight)
    assert flights_of_segments(made_flights[0]) == [made_flights[0]]


def test_raw_inputs_are_taken_as_measured(made_flights: list[Flight]) -> None:
    data = prepare(LATERAL, made_flights[0], Preparation(denoise=False))
    column = LATERAL.input_names.index("delta_a")
    assert np.array_equal(data.segments[0].u[:, column], made_flights[0]["delta_a"])
    assert data.noise["delta_a"][0] > 0.0
    assert "measured inputs taken with their noise" in finding_texts(data.notes)


def test_noise_left_in_inputs_is_in_the_corrected_bound(made_flights: list[Flight]) -> None:
    """Draws of the level that the signal shows, and nothing for inputs without noise."""
    data = prepare(LATERAL, made_flights[0], Preparation(denoise=False))
    assert data.errors is not None
    for i, signal in enumerate(LATERAL.inputs):
        if signal.name in data.noise:
            drawn = float(np.sqrt(np.mean(data.errors[:, i] ** 2)))
            assert drawn == pytest.approx(data.noise[signal.name][0], rel=0.05)
    assert prepare(LATERAL, made_flights[0], Preparation(denoise=False, draws=0)).errors is None


SMALL = {"states": "['p']", "outputs": "['p']", "inputs": "['delta_a']", "parameters": "['L_p']"}


@pytest.mark.parametrize(
    ("changes", "rate", "said"),
    [
        ({"states": "'p'"}, "L_p*p", "must be a list"),
        ({"constants": "3"}, "L_p*p", "must be a table"),
        ({"outputs": "['p', 'p']"}, "L_p*p", "listed twice"),
        ({"parameters": "[{name=3}]"}, "L_p*p", "must be text"),
        ({"parameters": "[{name='L_p', unit=2020-01-01}]"}, "L_p*p", "unit = .* must be text"),
        ({"inputs": "[{name='delta_a', control='yes'}]"}, "L_p*p", "must be true or false"),
        ({"transforms": "[{kind='delay', input='delta_a', parameters='T'}]"}, "L_p*p", "must be a list of names"),
        ({}, "L_p*p + 1e999", "no number to calculate with"),
        ({}, "L_p*p + 1/0", "no number to calculate with"),
    ],
)
def test_model_files_with_mistakes_are_told_in_words(
    changes: dict[str, str], rate: str, said: str, tmp_path: Path
) -> None:
    from estimation.engine.trace import trace

    keys = {**SMALL, **changes, "equations": f"['p_dot = {rate}']"}
    (tmp_path / "own.toml").write_text("".join(f"{k} = {v}\n" for k, v in keys.items()))
    with pytest.raises(ModelError, match=said):
        trace(load_model(tmp_path / "own.toml").structure)


MISTAKES = {
    "syntax": "class Roll:\n    states = {",
    "name": "class Roll:\n    states = {'p': unit}\n",
    "equations": (
        "class Roll:\n    states = {'p': '1'}\n    measured = {'p': '1'}\n    parameters = {'a': '1'}\n"
        "    def derivatives(self, x, u, p):\n        return [x.p[3]]\n"
        "    def outputs(self, x, u, p, xdot):\n        return [x.p]\n"
    ),
}


@pytest.mark.parametrize("kind", MISTAKES)
def test_mistakes_in_an_own_class_are_told_with_their_place(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / f"own_{kind}.py").write_text(MISTAKES[kind])
    with pytest.raises(ModelError, match=r"line \d+"):
        load_model(f"own_{kind}:Roll")


def test_flights_with_histories_open_in_the_viewer(made_flights: list[Flight], tmp_path: Path) -> None:
    """The model's columns beside the measured ones, under the names that `sideslip view` draws."""
    from groundstation.viewer.entities import model_groups

    write_flight(made_flights[0], tmp_path / "flight.mcap")
    result = run(tmp_path / "flight.mcap", "--aircraft", "cdfp", "--histories", tmp_path / "shown")
    assert result.exception is None
    assert "sideslip view" in result.output
    shown = read_flight(tmp_path / "shown" / "flight.mcap")
    for name in LATERAL.output_names:
        assert np.isfinite(shown[f"{name}_model"]).all()
    assert np.std(shown["p_model"] - shown["p"]) < 0.02
    drawn = {c for group in model_groups(shown.columns) for c in group.columns}
    assert {"beta_model", "p_model", "r_model", "phi_model", "ay_model"} <= drawn
    shutil.rmtree(tmp_path / "shown")


def density_found(flight: Flight, **columns: np.ndarray) -> tuple[np.ndarray, list[str]]:
    """The density with which a flight without that column would be fitted, and the notes."""
    air = ("rho", "altitude", "p_dynamic", "p_static", "temperature")
    rest = {n: v for n, v in flight.columns.items() if n not in air}
    data = prepare(LATERAL, Flight.build("climb", flight.time, {**rest, **columns}))
    return np.concatenate([s.u[:, LATERAL.input_names.index("rho")] for s in data.segments]), finding_texts(data.notes)


def test_density_comes_from_pressure_and_temperature_before_the_standard_atmosphere(made_flights: list[Flight]) -> None:
    flight = made_flights[0]
    true = 0.8 - 0.04 * flight.time / flight.time[-1]
    warm = np.full(len(flight), 271.0)
    pressure = true * 287.05287 * warm
    height = np.full(len(flight), 4000.0)
    found, notes = density_found(flight, p_static=pressure, temperature=warm, altitude=height)
    assert np.abs(found / true - 1.0).max() < 0.01
    assert "rho derived from p_static and temperature" in notes
    found, notes = density_found(flight, p_static=pressure, altitude=height)
    assert np.abs(found / true - 1.0).max() < 0.05
    assert "rho derived from p_static" in notes
    found, notes = density_found(flight, altitude=height)
    assert found == pytest.approx(0.81913, abs=3e-5)  # ICAO Doc 7488, geopotential height
    assert "rho derived from altitude" in notes
    found, notes = density_found(flight, altitude=height, rho=np.full(len(flight), np.nan))
    assert found == pytest.approx(0.81913, abs=3e-5)  # an empty column counts as absent


def test_the_temperature_of_a_warm_board_is_not_taken_for_that_of_the_air(made_flights: list[Flight]) -> None:
    flight = made_flights[0]
    found, notes = density_found(
        flight, p_static=np.full(len(flight), 70108.5), temperature=np.full(len(flight), 319.0)
    )
    assert found == pytest.approx(0.90912, abs=1e-4)  # ICAO Doc 7488 at 3000 m
    assert "rho derived from p_static" in notes


@pytest.mark.parametrize("outside", [238.0, 300.0])
@pytest.mark.parametrize("height", ["altitude", "altitude_gnss"])
def test_estimates_and_contradictions_have_one_density_on_cold_and_warm_days(
    made_flights: list[Flight], outside: float, height: str
) -> None:
    flight = made_flights[0]
    columns = {height: np.full(len(flight), 1000.0), "temperature": np.full(len(flight), outside)}
    by_estimate, _ = density_found(flight, **columns)
    by_contradictions = independent_density(columns)
    assert by_contradictions is not None
    assert by_estimate == pytest.approx(89874.6 / (287.05287 * outside), rel=1e-4)  # ICAO Doc 7488, pressure at 1000 m
    assert np.unique(by_contradictions.values) == pytest.approx(np.unique(by_estimate))


def test_density_never_comes_from_an_airspeed_and_the_pressure_it_was_made_from(made_flights: list[Flight]) -> None:
    flight = made_flights[0]
    pitot = 0.41 * flight["V"] ** 2
    found, _ = density_found(flight, p_dynamic=pitot, altitude=np.full(len(flight), 4000.0))
    assert found == pytest.approx(0.81913, abs=3e-5)
    with pytest.raises(MissingColumnError, match="p_static or altitude or altitude_gnss to derive it from"):
        density_found(flight, p_dynamic=pitot)


def test_a_density_that_cannot_be_is_refused_with_its_origin(made_flights: list[Flight]) -> None:
    flight = made_flights[0]
    with pytest.raises(DataError, match=r"climb: rho derived from p_static would be .*check their units"):
        density_found(flight, p_static=np.full(len(flight), 1013.0))
