"""docs/extending.md, followed to the letter: a model, an importer and a verb from a package of one's own."""

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lsim

from groundstation.flight import read_flight
from tests.cli.docs.blocks import commands_of, files_of, write_files
from tests.cli.docs.follow import follow

pytestmark = pytest.mark.timeout(300)  # commands of a page, as a reader runs them
PAGE = Path("docs") / "extending.md"
TRUE = {"L_p": -6.0, "L_da": -31.0}


def roll_file() -> bytes:
    """Ten seconds of aileron doublets on a rig of known rolling mode, exact for an aileron straight between samples."""
    rng = np.random.default_rng(5)
    time = np.arange(501) / 50.0
    aileron = np.interp(time, np.arange(0.0, 10.1, 0.5), np.radians(4.0) * rng.choice([-1.0, 0.0, 1.0], 21))
    rate = lsim(([[TRUE["L_p"]]], [[TRUE["L_da"]]], [[1.0]], [[0.0]]), aileron, time)[1] + 0.002 * rng.normal(size=501)
    return np.column_stack([time, np.degrees(rate), np.degrees(aileron)]).astype("<f4").tobytes()


@pytest.fixture(scope="module")
def followed(root: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[str]]:
    folder = tmp_path_factory.mktemp("tools")
    write_files({**files_of(root / PAGE), "lab-tools/lab_tools/__init__.py": ""}, folder)
    (folder / "rig.roll").write_bytes(roll_file())
    return folder, [follow(command, folder, root) for command in commands_of(root / PAGE)]


def test_importer_of_the_page_gives_a_flight_in_si(followed: tuple[Path, list[str]]) -> None:
    flight = read_flight(followed[0] / "rig.mcap")
    raw = np.frombuffer((followed[0] / "rig.roll").read_bytes(), "<f4").reshape(-1, 3).astype(float)
    np.testing.assert_allclose(flight["p"], np.radians(raw[:, 1]), rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(flight["delta_a"], np.radians(raw[:, 2]), rtol=1e-6, atol=1e-9)
    assert flight.provenance.detail["format"] == "rolling rig"


def test_verb_of_the_page_is_a_verb(followed: tuple[Path, list[str]], root: Path) -> None:
    assert "longest stretch 10.00 s of 1" in followed[1][2]
    assert "longest" in follow("sideslip --help", followed[0], root)


def test_model_of_the_page_finds_the_rolling_mode(followed: tuple[Path, list[str]]) -> None:
    """Without an aircraft: the model asks for none."""
    told = json.loads((followed[0] / "rig.json").read_text())
    found = told["flights"][0]["methods"]["ml"]["parameters"]
    for name, value in TRUE.items():
        assert found[name]["estimate"] == pytest.approx(value, abs=4 * found[name]["std_coloured"], rel=0.03)
    assert told["aircraft"] == "not stated"


def test_what_a_package_promises_and_has_not_is_one_sentence(followed: tuple[Path, list[str]], root: Path) -> None:
    info = followed[0] / "site" / "broken-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: broken\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(
        "[sideslip.verbs]\nlost = lab_tools.verb:lost\n[sideslip.importers]\nlost = lab_tools.nowhere:read\n"
    )
    (followed[0] / "a.lost").write_bytes(b"x")
    for command, what in (("lost a.lost", "no command there"), ("import a.lost -o a.mcap", "no reader there")):
        said = follow(f"sideslip {command}", followed[0], root, status=2)
        assert what in said
        assert len(said.splitlines()) == 1


def test_a_file_that_is_not_what_it_says_is_one_sentence(followed: tuple[Path, list[str]], root: Path) -> None:
    (followed[0] / "odd.roll").write_bytes(b"12345")
    said = follow("sideslip import odd.roll -o odd.mcap", followed[0], root, status=2)
    assert said == "sideslip: odd.roll: 5 bytes are no whole samples of 12 bytes; is it a .roll file?\n"
    (followed[0] / "odd.unheard").write_bytes(b"12345")
    said = follow("sideslip import odd.unheard -o odd.mcap", followed[0], root, status=2)
    assert ".roll" in said
    assert len(said.splitlines()) == 1
