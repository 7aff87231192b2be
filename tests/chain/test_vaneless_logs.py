"""From logs of ArduPilot and PX4 without vanes to estimates with honest bounds, by the commands of docs/import.md."""

import io
import json
from pathlib import Path

import numpy as np
import pytest

import sideslip
from estimation.aircraft import load_aircraft
from estimation.compatibility.air_data import reconstruct_air, with_air
from firmware_sim.physics.aerodynamics import LATERAL, true_derivatives
from firmware_sim.world.scenario import load_scenario
from firmware_sim.world.world import simulate_many
from groundstation.flight import read_flight
from groundstation.importers.endings import ULOG_MAGIC
from groundstation.importers.run import import_data
from tests.chain.autopilot_logs import BOOT, dataflash, ulog
from tests.cli.docs.blocks import commands_of, files_of, write_files

pytestmark = pytest.mark.timeout(300)  # commands of a page, as a reader runs them
PAGE = Path("docs") / "import.md"
PX4 = {
    "RCOU.C1": "actuator_outputs.output[0]",
    "RCOU.C2": "actuator_outputs.output[1]",
    "RCOU.C4": "actuator_outputs.output[3]",
}


@pytest.fixture(scope="module")
def followed(root: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, np.ndarray], str]:
    """The page's commands on two logs of one flight in 5 m/s of wind; gives the folder, the truth, and what was printed."""
    folder = tmp_path_factory.mktemp("logs")
    scenario = load_scenario("rich").altered(wind={"gust_deg": 0.1, "speed_m_s": 5.0, "from_deg": 70.0})
    truth = simulate_many([scenario], [1], 50.0)[0]
    (folder / "log.bin").write_bytes(dataflash(truth, np.random.default_rng(1)))
    (folder / "log.ulg").write_bytes(by_pyulog(ulog(truth, np.random.default_rng(2))))
    files = files_of(root / PAGE)
    px4 = files["surfaces.toml"]
    for theirs, ours in PX4.items():
        px4 = px4.replace(theirs, ours)
    write_files({**files, "surfaces_px4.toml": px4}, folder)
    said = io.StringIO()
    with pytest.MonkeyPatch.context() as patched:
        patched.chdir(folder)
        patched.setattr("sys.stdout", said)
        for command in commands_of(root / PAGE):
            words = command.split()
            assert words[0] == "sideslip"
            with pytest.raises(SystemExit) as ended:
                sideslip.main(words[1:])
            assert not ended.value.code, command
    return folder, truth, said.getvalue()


def by_pyulog(data: bytes) -> bytes:
    """The log written anew by PX4's own package, which also reads what we have put together."""
    from pyulog import ULog

    stream = io.BytesIO()
    ULog(io.BytesIO(data)).write_ulog(stream)
    assert stream.getvalue().startswith(ULOG_MAGIC)
    return stream.getvalue()


def test_dfreader_reads_the_same_log(followed: tuple[Path, dict[str, np.ndarray], str]) -> None:
    """ArduPilot's own reader finds the servo outputs and fixes where they were put."""
    from pymavlink import DFReader

    reader = DFReader.DFReader_binary(str(followed[0] / "log.bin"), zero_time_base=True)
    counted: dict[str, int] = {}
    while (message := reader.recv_msg()) is not None:
        counted[message.get_type()] = counted.get(message.get_type(), 0) + 1
    reader.close()
    samples = followed[1]["time"].size
    assert counted["RCOU"] == counted["IMU"] == samples
    assert counted["GPS"] == -(-samples // 10)


def test_recipe_says_what_is_possible_and_what_is_missing(followed: tuple[Path, dict[str, np.ndarray], str]) -> None:
    said = followed[2]
    assert "lateral: not possible: delta_a, delta_r missing" in said
    assert (
        "one more: surface positions, or servo outputs with trim and travel in a mapping would make possible: lateral"
        in said
    )
    assert "servo output RCOU.C1: " in said
    assert "'sideslip reconstruct' makes V, alpha, beta and wind" in said


@pytest.mark.parametrize("name", ["flight", "flight_px4"])
def test_surfaces_and_air_data_are_those_flown(followed: tuple[Path, dict[str, np.ndarray], str], name: str) -> None:
    folder, truth, _ = followed
    flight = read_flight(folder / f"{name}.mcap")
    at = flight.time - BOOT
    left, right = truth["sensed_arm_left"], truth["sensed_arm_right"]
    surfaces = {"delta_e": 0.5 * (left + right), "delta_a": 0.5 * (right - left), "delta_r": truth["sensed_arm_r"]}
    for column, flown in surfaces.items():
        error = flight[column] - np.interp(at, truth["time"], flown)
        assert np.sqrt(np.nanmean(error**2)) < np.radians(0.05), column
    for column in ("alpha", "beta", "V"):
        error = flight[column] - np.interp(at, truth["time"], truth[column])
        stated = flight[f"{column}_std"]
        assert np.nanmean(np.abs(error) < 2.0 * stated) > 0.95, column
        assert np.nanmax(stated) < {"alpha": 0.04, "beta": 0.04, "V": 0.8}[column]


@pytest.mark.parametrize("name", ["estimate", "estimate_px4"])
def test_estimates_are_within_their_bounds(followed: tuple[Path, dict[str, np.ndarray], str], name: str) -> None:
    found = json.loads((followed[0] / f"{name}.json").read_text())["flights"][0]["methods"]["ml"]["parameters"]
    truth = true_derivatives(load_aircraft("cdfp"), {})
    derivatives = [n for n in LATERAL if not n.endswith("_0")]
    away = np.array([(found[n]["estimate"] - truth[n]) / found[n]["std_coloured"] for n in derivatives])
    assert np.mean(np.abs(away) < 3.0) >= 0.9
    assert np.abs(away).max() < 5.0
    assert found["Cl_p"]["std_coloured"] < 0.1 * abs(truth["Cl_p"])
    assert found["Cn_beta"]["std_coloured"] < 0.1 * abs(truth["Cn_beta"])


def test_a_grid_finer_than_the_log_adds_no_information(
    followed: tuple[Path, dict[str, np.ndarray], str],
) -> None:
    """The log has motion at 50 Hz, attitude at 25, air data at 10, velocity at 5: bounds at 50 and 100 Hz are the same."""
    folder, bounds = followed[0], []
    for rate in (50.0, 100.0):
        flight = import_data(folder / "log.bin", folder / "surfaces.toml", rate_hz=rate)
        flight = with_air(flight, reconstruct_air(flight))
        answer = sideslip.estimate(flight, "lateral", aircraft="cdfp", method="ml").to_json()
        found = answer["flights"][0]["methods"]["ml"]["parameters"]
        bounds.append({n: found[n] for n in LATERAL if not n.endswith("_0")})
    coarse, fine = bounds
    for kind in ("std", "std_coloured"):
        ratios = np.array([fine[n][kind] / coarse[n][kind] for n in coarse])
        assert np.abs(np.log(ratios)).max() < 0.1, dict(zip(coarse, ratios, strict=True))
