"""docs/sensors.md, followed to the letter: a laboratory's package is written, installed, flown and found in the flight."""

import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from groundstation.flight import read_flight
from tests.cli.docs.blocks import commands_of
from tests.cli.docs.follow import follow

pytestmark = [pytest.mark.timeout(300)]  # commands of a page, as a reader runs them
PAGE = Path("docs") / "sensors.md"
EXAMPLE = Path("docs") / "examples" / "lab-humidity"
CALIBRATION = "lab-humidity/lab_humidity/calibration/humidity.toml"


@pytest.fixture(scope="module")
def followed(root: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[str]]:
    """The page's folder copied and its other commands run, without the calibration."""
    folder = tmp_path_factory.mktemp("lab")
    copy, *others = commands_of(root / PAGE)
    assert copy == f"cp -r {EXAMPLE} ."
    shutil.copytree(root / EXAMPLE, folder / "lab-humidity")
    (folder / CALIBRATION).unlink()
    return folder, [follow(command, folder, root) for command in others]


def expected(folder: Path, time: np.ndarray) -> np.ndarray:
    """Relative humidity as `make` of the page has it, from the truth of the flight."""
    truth = np.genfromtxt(folder / "humid" / "truth.csv", delimiter=",", names=True)
    return 0.60 - 0.002 * np.interp(time, truth["time"], truth["altitude_gnss"])


def test_column_of_the_simulated_chip_is_in_the_flight_from_on_board(followed: tuple[Path, list[str]]) -> None:
    folder, printed = followed
    flight = read_flight(folder / "humid" / "flight.mcap")
    humidity = flight["humidity"]
    measured = np.isfinite(humidity)
    assert measured.mean() > 0.9  # read in every fifth scan, brought to all between
    error = humidity[measured] - expected(folder, flight.time[measured])
    assert abs(error.mean()) < 0.0015
    assert 0.001 < error.std() < 0.003  # the chip's noise is 0.002
    assert "humidity" in printed[-1]


def test_column_is_in_the_flight_that_the_radio_brought(followed: tuple[Path, list[str]]) -> None:
    folder, _ = followed
    flight = read_flight(folder / "humid" / "ground" / "flight.mcap")
    measured = np.isfinite(flight["humidity"])
    assert measured.sum() >= 8  # downlink = "slow": about once a second in 20 s
    error = flight["humidity"][measured] - expected(folder, flight.time[measured])
    assert np.abs(error).max() < 0.01


def test_without_the_package_all_else_is_read_and_the_group_is_named(
    followed: tuple[Path, list[str]], root: Path
) -> None:
    folder, _ = followed
    raw = next((folder / "humid" / "onboard").glob("*.mcap"))
    code = f"""
from groundstation.calibration.recording import calibrate_recording
from groundstation.flight import read_flight
bare, whole = calibrate_recording({str(raw)!r}), read_flight({str(folder / "humid" / "flight.mcap")!r})
assert "humidity" not in bare.columns
for name, values in bare.columns.items():
    assert (values == whole[name])[values == values].all(), name
print("\\n".join(map(str, bare.notes)))
"""
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=root, capture_output=True, text=True, timeout=60, check=False
    )
    assert done.returncode == 0, done.stderr
    assert "sensor group humidity is described by no package installed here" in done.stdout


def test_calibration_of_the_package_is_embedded_and_used(followed: tuple[Path, list[str]], root: Path) -> None:
    folder, _ = followed
    (embedded := folder / CALIBRATION.replace("lab-humidity", "site")).parent.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(root / EXAMPLE.parent / CALIBRATION, embedded)
    follow("sideslip fly lab-humidity/humid.toml --out again --no-backfill", folder, root)
    plain, calibrated = (read_flight(folder / name / "flight.mcap") for name in ("humid", "again"))
    np.testing.assert_allclose(calibrated["humidity"], 0.012 + 0.97 * plain["humidity"], rtol=1e-12)
    assert calibrated.provenance.detail["uncertainty"]["humidity"] == pytest.approx(0.01)
