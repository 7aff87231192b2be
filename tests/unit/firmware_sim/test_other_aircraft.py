"""A simulated aircraft flies with what its own file says, or not at all."""

from pathlib import Path

import numpy as np
import pytest

from estimation.aircraft import Aircraft, load_aircraft
from estimation.errors import AircraftError
from firmware_sim.hardware.sensing.aircraft_instruments import calibration_of, placed
from firmware_sim.hardware.sensing.sensor_models import SensorModels, parse_sensors
from firmware_sim.physics.aerodynamics import LATERAL, true_derivatives
from firmware_sim.physics.atmosphere import Site
from firmware_sim.physics.maths import FLOATS
from firmware_sim.physics.plant import ARMS, THRUST, Plant
from firmware_sim.tables import ScenarioError
from firmware_sim.world.scenario import scenario_from
from firmware_sim.world.world import World
from groundstation.calibration.calibration_set import NOMINAL_DIRECTORY, load_calibration
from tests.cli.docs.blocks import files_of
from tests.unit.firmware_sim.plants import QUIET, level_state


@pytest.fixture
def twin(root: Path, tmp_path: Path) -> Path:
    """The aircraft of docs/aircraft.md."""
    path = tmp_path / "twin.toml"
    path.write_text(files_of(root / "docs" / "aircraft.md")["twin.toml"])
    return path


def changed(path: Path, old: str, new: str) -> Aircraft:
    path.write_text(path.read_text().replace(old, new))
    return load_aircraft(path)


def plant_of(aircraft: Aircraft) -> Plant:
    return Plant(aircraft, true_derivatives(aircraft, {}), Site(), FLOATS, generators=[np.random.default_rng(1)])


def rates(plant: Plant, left: float, throttle: float) -> list[float]:
    x, commands, _ = level_state(plant, 20.0)
    dx = [0.0] * plant.size
    x[ARMS], x[THRUST] = 0.0, 0.0
    plant.evaluate(0.0, x, type(commands)(left, 0.0, 0.0, throttle), QUIET, dx)
    return dx


def test_servos_and_engine_are_those_of_the_file(twin: Path) -> None:
    """First-order lag below the fastest rate, the rate beyond it; thrust at full throttle over the engine's lag."""
    dx = rates(plant_of(load_aircraft(twin)), 0.1, 1.0)
    assert dx[ARMS] == pytest.approx(0.1 / 0.05)
    assert dx[THRUST] == pytest.approx((25.0 - 0.5 * 20.0) / 0.3)
    assert rates(plant_of(load_aircraft(twin)), 0.4, 1.0)[ARMS] == pytest.approx(5.0)
    slow = changed(twin, "lag = 0.05\nrate = 5.0", "lag = 0.2\nrate = 1.0")
    assert rates(plant_of(slow), 0.1, 1.0)[ARMS] == pytest.approx(0.5)
    assert rates(plant_of(slow), 0.4, 1.0)[ARMS] == pytest.approx(1.0)


def test_derivatives_are_those_of_the_file_and_no_others(twin: Path) -> None:
    aircraft = load_aircraft(twin)
    flown = true_derivatives(aircraft, {"Cl_p": -0.6})
    assert flown["Cl_p"] == -0.6
    for name in LATERAL:
        prior = aircraft.prior(name)
        assert prior is not None
        assert name == "Cl_p" or flown[name] == prior.value
    other = changed(
        twin, "speed_range = [14.0, 35.0]", "speed_range = [14.0, 35.0]\n[simulation.derivatives]\nCn_r = -0.2"
    )
    assert true_derivatives(other, {})["Cn_r"] == -0.2


def test_sticks_stop_where_the_servos_do(twin: Path) -> None:
    text = twin.read_text().replace("rudder_limit = 0.4", "rudder_limit = 0.01")
    twin.write_text(text)
    big = {"axis": "rudder", "shape": "doublet", "start_s": 0.5, "amplitude": 8.0, "width_s": 0.5}
    world = World(scenario_from({"flight": {"aircraft": str(twin), "duration_s": 2.0}, "manoeuvre": [big]}, "t"))
    rudder = [world.advance(k * 0.05).columns()["cmd_r"] for k in range(40)]
    assert max(map(abs, rudder)) == pytest.approx(0.01, rel=0.02)


def test_a_flight_is_flown_at_the_trim_speed_of_its_aircraft(twin: Path) -> None:
    assert scenario_from({"flight": {"aircraft": str(twin)}}, "t").flight.speed_m_s == 20.0
    assert scenario_from({}, "t").flight.speed_m_s == 17.0
    with pytest.raises(
        ScenarioError, match=r"scenario t: flight.speed_m_s = 40 is outside the 14 to 35 m/s .* aircraft twin"
    ):
        scenario_from({"flight": {"aircraft": str(twin), "speed_m_s": 40.0}}, "t")


@pytest.mark.parametrize(
    ("table", "said"),
    [
        ("servos", r"its file has no \[servos\]; add it"),
        ("engine", r"its file has no \[engine\]; add it"),
        ("simulation", r"its file has no \[simulation\]; add it"),
        ("shape", "derivative .* missing, needed to fly it"),
    ],
)
def test_what_the_file_lacks_is_never_taken_from_another_aircraft(twin: Path, table: str, said: str) -> None:
    before, after = twin.read_text().split(f"[{table}]\n")
    rest = after[after.index("\n[") + 1 :] if "\n[" in after else ""
    twin.write_text(before + rest)
    with pytest.raises(ScenarioError, match=rf"aircraft 'twin'.*{said}"):
        World(scenario_from({"flight": {"aircraft": str(twin)}}, "t"))


def test_an_aircraft_without_inertia_is_not_flown(twin: Path) -> None:
    changed(twin, "Iyy = 0.6\n", "")
    with pytest.raises(AircraftError, match=r"mass\.Iyy is missing, and a simulated flight cannot do without"):
        World(scenario_from({"flight": {"aircraft": str(twin)}}, "t"))


def test_instruments_sit_where_the_file_says_in_the_world_and_in_its_calibration(twin: Path, tmp_path: Path) -> None:
    aircraft = load_aircraft(twin)
    models = parse_sensors(placed(aircraft), "t")
    assert models.imu.position == (0.05, 0.0, 0.01)
    assert models.beta_vane.position == (0.2, 0.9, 0.0)
    assert models.gnss.position == SensorModels().gnss.position  # not in the file
    made = load_calibration(calibration_of(aircraft, NOMINAL_DIRECTORY / "cdfp", tmp_path))
    accelerometer, vane = made.instruments["accelerometer"], made.instruments["beta_vane"]
    assert accelerometer.mount is not None
    assert vane.vane is not None
    assert (accelerometer.mount.position, vane.vane.position) == ((0.05, 0.0, 0.01), (0.2, 0.9, 0.0))
    assert made.instruments["pitot"] == load_calibration("cdfp").instruments["pitot"]


def test_the_built_in_aircraft_agrees_with_its_calibration_and_its_models(tmp_path: Path) -> None:
    aircraft = load_aircraft("cdfp")
    assert calibration_of(aircraft, NOMINAL_DIRECTORY / "cdfp", tmp_path) == NOMINAL_DIRECTORY / "cdfp"
    assert parse_sensors(placed(aircraft), "t") == SensorModels()
