"""`sideslip watch` over flights of the project's simulator: quiet where the model holds, loud where an aircraft fails."""

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import sideslip
from daq.identification.monitor import FALSE_ALARMS, threshold
from daq.identification.monitor.bank import LATERAL_PLANE, MonitoredPlane
from daq.identification.monitor.nulls import NullConditions
from daq.identification.monitor.threshold import Calibration
from daq.utilities.errors import UserError
from estimation.aircraft import load_aircraft
from estimation.errors import EstimationError
from estimation.estimators.recursive import values_of
from estimation.models import load_model
from estimation.models.base import Parameter
from estimation.models.load import write_model
from estimation.watch import over_file
from estimation.watch.over_file import Watched, conditions_of, watch
from firmware_sim.physics.effects.sudden import BEGINS_S
from firmware_sim.runs.direct import ORDINARY_NOISE, direct_flights, write_csv
from firmware_sim.world.scenario import load_scenario
from firmware_sim.world.simulation import derivatives_of
from groundstation.flight import Flight, read_flight

pytestmark = [pytest.mark.usefixtures("unwritten_figures")]

HOURS = 0.2  # of simulated manoeuvring: one batch, and less than the verb would take
EFFECTS = ("none", "mass_shift", "elevon_stuck")


@pytest.fixture(scope="module", autouse=True)
def few() -> Iterator[None]:
    """Thresholds from fewer flights than anybody would trust."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(threshold, "AT_ONCE", 24)
        patch.setattr(threshold, "FLIGHT_S", 40.0)
        yield


@pytest.fixture(scope="module")
def flights(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """52 s each, the last 32 with a failure; and the model that the aircraft had before."""
    folder = tmp_path_factory.mktemp("sudden")
    base = load_scenario("rich").altered(flight={"duration_s": 52.0})
    scenarios = [base if n == "none" else base.altered(hidden=[{"name": n}]) for n in EFFECTS]
    flown = direct_flights(scenarios, [3] * len(EFFECTS))
    found = {}
    for name, columns in zip(EFFECTS, flown, strict=True):
        found[name] = folder / f"{name}.csv"
        write_csv(found[name], columns)
    aircraft = load_aircraft("cdfp")
    found["model"] = folder / "model.toml"
    before = {k: v for k, v in derivatives_of(base, 3).items() if k[:2] in ("CY", "Cl", "Cn")}
    model = load_model("lateral", aircraft).with_starts(before)
    write_model(model, found["model"])
    return found


@pytest.fixture(scope="module")
def quiet(flights: dict[str, Path]) -> Watched:
    """The flight in which nothing fails, with thresholds of its own air and instruments."""
    aircraft = load_aircraft("cdfp")
    return watch(load_model(str(flights["model"]), aircraft), read_flight(flights["none"]), aircraft, hours=HOURS)


@pytest.fixture
def known_thresholds(quiet: Watched, monkeypatch: pytest.MonkeyPatch) -> None:
    """All three flights have the same air and instruments: the thresholds of one do for the others."""

    def known(
        *asked: object, rng: np.random.Generator, hours: float, rate: float, plane: MonitoredPlane
    ) -> Calibration:
        conditions = next(a for a in asked if isinstance(a, NullConditions))
        assert (conditions.rate, hours, rate, plane) == (pytest.approx(20.0), 1.0, FALSE_ALARMS, LATERAL_PLANE)
        assert conditions.beta == pytest.approx(ORDINARY_NOISE.beta, rel=0.2)
        return quiet.calibration

    monkeypatch.setattr(over_file, "calibrated", known)


def answered(flights: dict[str, Path], name: str, tmp_path: Path) -> tuple[object, dict[str, object]]:
    command = ["watch", str(flights[name]), "--model", str(flights["model"]), "--aircraft", "cdfp", "--hours", "1"]
    command += [
        "--json",
        str(tmp_path / "w.json"),
        "--report",
        str(tmp_path / "page"),
        "--stretch",
        str(tmp_path / "s.mcap"),
    ]
    with pytest.raises(SystemExit) as end:
        sideslip.main(command)
    found: dict[str, object] = json.loads((tmp_path / "w.json").read_text())
    return end.value.code, found


@pytest.mark.usefixtures("known_thresholds")
def test_nothing_is_said_of_a_flight_that_the_model_describes(
    flights: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, found = answered(flights, "none", tmp_path)
    assert code == 0
    assert found["alarms"] == []
    assert found["next"] is None
    assert 42.0 < float(str(found["watched_s"])) <= float(str(found["duration_s"]))
    assert "no alarm" in capsys.readouterr().out
    assert not (tmp_path / "s.mcap").exists()


# A bias of a vane and a rolling trim that shifts are told from each other in few flights: where is what counts.
@pytest.mark.usefixtures("known_thresholds")
@pytest.mark.parametrize(
    ("name", "right"),
    [
        ("mass_shift", {"Cl_0", "Cl_r", "Cl_beta", "beta_bias"}),
        ("elevon_stuck", {"Cl_da"}),
    ],
)
def test_a_failure_in_the_air_is_noticed_after_it_begins(
    name: str, right: set[str], flights: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, found = answered(flights, name, tmp_path)
    assert code == 1
    alarms = found["alarms"]
    assert isinstance(alarms, list)
    first = alarms[0]
    assert BEGINS_S < first["time"] < BEGINS_S + 12.0
    assert first["score"] > first["threshold"]
    assert right & {n for a in alarms for n in a["leading"]}
    out = capsys.readouterr().out
    assert f"next: sideslip gap {tmp_path / 's.mcap'} --model {flights['model']} --aircraft cdfp" in out
    assert read_flight(tmp_path / "s.mcap").time[-1] <= first["time"] + 20.1
    page = (tmp_path / "page" / "index.html").read_text()
    assert first["equation"] in page
    assert "sideslip gap" in page


def test_thresholds_are_those_of_the_hours_asked_for(quiet: Watched) -> None:
    assert quiet.calibration.hours == pytest.approx(
        24 * 37.0 / 3600.0
    )  # a batch, less the seconds in which windows fill
    assert quiet.alarms == ()
    assert 0.0 < max(w.score for w in quiet.history) < 1.0


def test_noise_and_rate_are_those_of_the_flight(flights: dict[str, Path]) -> None:
    found = conditions_of(read_flight(flights["none"]), LATERAL_PLANE)
    assert found.rate == pytest.approx(20.0, rel=0.01)
    assert found.beta == pytest.approx(ORDINARY_NOISE.beta, rel=0.2)
    assert found.ay == pytest.approx(ORDINARY_NOISE.ay, rel=0.2)


def test_what_a_model_states_of_itself_is_used() -> None:
    aircraft = load_aircraft("cdfp")
    model = load_model("lateral", aircraft)
    _, believed = values_of(model)
    assert believed["Cl_p"] == 0.09
    moved, stated = values_of(model.with_starts({"Cl_p": -0.5}).with_prior(Cn_r=(-0.05, 0.002)))
    assert moved["Cl_p"] == -0.5
    assert "Cl_p" not in stated  # it was estimated, and nobody says how well
    assert stated["Cn_r"] == 0.002


def test_a_flight_without_manoeuvres_is_refused_before_anything_is_simulated(
    flights: dict[str, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delattr(over_file, "calibrated")
    flight = read_flight(flights["none"])
    still = {n: np.zeros(len(flight)) if n.startswith("delta") else v for n, v in flight.columns.items()}
    aircraft = load_aircraft("cdfp")
    with pytest.raises(EstimationError, match="only 0 s of manoeuvring"):
        watch(load_model("lateral", aircraft), Flight.build("still", flight.time, still), aircraft, hours=1.0)


@pytest.mark.usefixtures("known_thresholds")
def test_the_notebook_says_what_the_verb_says(flights: dict[str, Path], tmp_path: Path) -> None:
    _, verb = answered(flights, "elevon_stuck", tmp_path)
    found = sideslip.watch(flights["elevon_stuck"], flights["model"], aircraft="cdfp", hours=1.0)
    saved = json.loads(found.save(tmp_path / "notebook.json").read_text())
    assert saved.keys() == verb.keys()
    assert all(saved[k] == verb[k] for k in verb if k != "next")  # the verb's reads the stretch that its report wrote
    assert f"{len(found.alarms)} alarm" in repr(found)
    assert found.summary().count("t = ") == len(found.alarms) == found._repr_html_().count("<tr><td>")
    frame = found.to_pandas()
    assert frame["score"].max() > 1.0
    assert frame["time"].is_monotonic_increasing
    stretch = found.stretch()
    assert stretch is not None
    assert stretch.time[-1] <= found.alarms[0].time + 20.1
    assert len(found.plot().lines) == 2 + len(found.alarms)
    assert "svg" in found.figures()["watch_history"].uri[:20]
    with pytest.raises(UserError, match=r"end the name in one of \.json"):
        found.save(tmp_path / "notebook.csv")


@pytest.mark.usefixtures("known_thresholds")
def test_a_quiet_flight_in_the_notebook_has_no_stretch(flights: dict[str, Path]) -> None:
    found = sideslip.watch(read_flight(flights["none"]), flights["model"], aircraft="cdfp", hours=1.0)
    assert found.alarms == ()
    assert found.stretch() is None
    assert "no alarm" in repr(found)


def test_both_planes_are_watched_at_once_and_what_cannot_be_predicted_is_named(
    flights: dict[str, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A six-dof model: each plane with half of the allowed false alarms. A term that no motion has is refused by its name."""
    aircraft, planes = load_aircraft("cdfp"), list[tuple[str, float]]()

    def flat(*_: object, rng: np.random.Generator, hours: float, rate: float, plane: MonitoredPlane) -> Calibration:
        planes.append((plane.name, rate))
        raise ValueError("nothing is simulated here")

    monkeypatch.setattr(over_file, "calibrated", flat)
    flight = read_flight(flights["none"])
    with pytest.raises(EstimationError, match="only 0 s of manoeuvring"):  # its elevator rests
        watch(load_model("longitudinal", aircraft), flight, aircraft, hours=1.0)
    with pytest.raises(EstimationError, match="nothing is simulated here"):
        watch(load_model("six-dof", aircraft), flight, aircraft, hours=1.0)
    assert planes == [("lateral", FALSE_ALARMS / 2.0)]
    with pytest.raises(EstimationError, match="does not know CD_de of model"):
        strange = load_model("longitudinal", aircraft).plus(
            terms={"CD": "CD_de * delta_e"}, parameters=[Parameter("CD_de", 0.0)]
        )
        watch(strange, flight, aircraft, hours=1.0)


@pytest.mark.parametrize(
    ("step", "grid", "rate"),
    [(0.1, 0.05, 10.0), (1 / 12, 1 / 24, 12.0), (0.05, 0.05, 20.0), (0.02, 0.04, 25.0), (0.01, 0.05, 20.0)],
)
def test_simulated_scans_come_as_those_of_the_flight(step: float, grid: float, rate: float) -> None:
    """Even scans at any rate; a tenth of them lost is a tenth lost, and a decimated link is none of these."""
    time = step * np.arange(600)
    columns = {n: np.zeros(600) for n in (*LATERAL_PLANE.channels, "delta_a", "delta_r")} | {"V": np.full(600, 16.0)}
    whole = conditions_of(Flight.build("even", time, columns), LATERAL_PLANE)
    assert (whole.grid, whole.rate, whole.loss) == (
        pytest.approx(grid),
        pytest.approx(rate),
        pytest.approx(0.0, abs=1e-3),
    )
    there = np.arange(600) % 10 != 4
    lossy = conditions_of(Flight.build("lossy", time[there], {n: v[there] for n, v in columns.items()}), LATERAL_PLANE)
    assert lossy.grid == pytest.approx(grid)
    assert lossy.rate * (1.0 - lossy.loss) == pytest.approx(min(0.9 / step, rate), rel=0.02)


def test_scans_of_a_decimated_link_lie_on_the_grid_on_board() -> None:
    sent = np.diff(np.floor(np.arange(800) * 0.575), prepend=-1.0) > 0
    time = 0.05 * np.flatnonzero(sent)
    columns = {n: np.zeros(time.size) for n in (*LATERAL_PLANE.channels, "V", "delta_a", "delta_r")}
    found = conditions_of(Flight.build("link", time, columns), LATERAL_PLANE)
    assert (found.grid, found.rate, found.loss) == (0.05, pytest.approx(11.5, rel=0.01), 0.0)
