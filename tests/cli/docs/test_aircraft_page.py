"""docs/aircraft.md, followed to the letter: from a new file to a report of another aircraft's flight."""

import json
import tomllib
from pathlib import Path

import pytest

from estimation.aircraft import load_aircraft
from groundstation.flight import AIRCRAFT_FILE, read_flight
from tests.cli.docs.blocks import commands_of, files_of, write_files
from tests.cli.docs.follow import follow
from tests.support.unwritten_figures import unwritten_figures

pytestmark = [pytest.mark.timeout(300)]  # commands of a page, as a reader runs them
PAGE = Path("docs") / "aircraft.md"


@pytest.fixture(scope="module")
def followed(root: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[str]]:
    """The commands of the page in order; after the first two the file is filled in as the page has it."""
    folder = tmp_path_factory.mktemp("aircraft")
    new, empty, *rest = commands_of(root / PAGE)
    printed = [follow(new, folder, root), follow(empty, folder, root, status=1)]
    write_files(files_of(root / PAGE), folder)
    with unwritten_figures():
        return folder, [*printed, *(follow(command, folder, root) for command in rest)]


def test_new_file_is_told_what_it_lacks(followed: tuple[Path, list[str]]) -> None:
    assert "geometry.area" in followed[1][1]
    assert "model lateral: enough" in followed[1][2]


def test_recording_and_flight_carry_the_aircraft(followed: tuple[Path, list[str]]) -> None:
    folder = followed[0]
    for file in ("flight.mcap", "ground/flight.mcap"):
        provenance = read_flight(folder / "first" / file).provenance
        assert provenance.aircraft == "twin"
        assert provenance.detail[AIRCRAFT_FILE] == (folder / "twin.toml").read_text()


def test_its_own_instruments_servos_and_engine_were_flown(followed: tuple[Path, list[str]]) -> None:
    folder = followed[0]
    told = tomllib.loads((folder / "first" / "calibration" / "beta_vane.toml").read_text())
    assert told["vane"]["position"] == [0.2, 0.9, 0.0]
    flight = read_flight(folder / "first" / "flight.mcap")
    assert abs(flight["V"] - 20.0).mean() < 1.5  # its trim speed, not another aircraft's


def test_estimates_are_those_it_flew_with(followed: tuple[Path, list[str]]) -> None:
    folder = followed[0]
    told = json.loads((folder / "first.json").read_text())
    assert told["aircraft"] == "twin"
    truth = load_aircraft(folder / "twin.toml")
    found = told["flights"][0]["methods"]["ml"]["parameters"]
    sure = {n: e for n, e in found.items() if e["identifiable"] and not n.endswith("_0")}
    assert len(sure) >= 10
    for name, e in sure.items():
        prior = truth.prior(name)
        assert prior is not None
        assert e["estimate"] == pytest.approx(prior.value, abs=5.0 * e["std_coloured"] + 0.05 * abs(prior.value)), name
    assert (folder / "report" / "index.html").is_file()
