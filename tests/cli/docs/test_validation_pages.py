"""Pages of validation that need nobody's data: their commands are followed, on fewer or shorter flights of the same form."""

import argparse
import json
import re
import runpy
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from daq.identification.monitor import threshold
from groundstation.flight import write_flight
from tests.cli.docs.blocks import commands_of, files_of, write_files
from tests.cli.docs.follow import follow
from tests.studies import faults
from tests.support.paths import ROOT
from tests.unit.estimation.test_performance import AREA, MASS, glide

PAGES = ROOT / "docs" / "validation"
STUDY = re.compile(r"python -m (tests\.studies\.\w+)([^`#\n]*)")
LONG_S = 600.0  # of a campaign, or a watch with its thresholds, on a busy machine
BY_THEIR_HEAD = {"tests.studies.t38_points"}  # takes one file, and no parser


def studies(page: Path) -> list[tuple[str, list[str]]]:
    """Module and words of every study that a page names, alternatives and what is optional taken once; not those whose words
    stand for others (SEED, MODEL)."""
    found = []
    for module, rest in STUDY.findall(page.read_text(encoding="utf-8")):
        words = re.sub(r"\|[\w-]+", "", re.sub(r"[\[\]]|\.\.\.|…", " ", rest))
        if not re.search(r"\b[A-Z]{4,}\b", words):
            found.append((module, shlex.split(words)))
    return found


@pytest.mark.parametrize("page", sorted(PAGES.glob("*.md")), ids=lambda p: p.stem)
def test_studies_that_the_page_names_take_its_words(page: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Parsed(Exception):
        """Words were taken; the study itself is not run."""

    parse = argparse.ArgumentParser.parse_args

    def only_parsed(self: argparse.ArgumentParser, *words: list[str]) -> None:
        parse(self, *words)
        raise Parsed

    monkeypatch.setattr(argparse.ArgumentParser, "parse_args", only_parsed)
    for module, words in studies(page):
        if module in BY_THEIR_HEAD:
            continue
        monkeypatch.setattr(sys, "argv", [module, *words])
        monkeypatch.delitem(sys.modules, module, raising=False)  # as if nothing had imported it
        with pytest.raises(Parsed):
            runpy.run_module(module, run_name="__main__")


def test_studies_are_found_on_pages() -> None:
    assert ("tests.studies.jsbsim_aircraft", ["T38", "c172p"]) in studies(PAGES / "jsbsim.md")
    assert sum(len(studies(p)) for p in PAGES.glob("*.md")) > 8


@pytest.mark.timeout(2 * LONG_S)
def test_the_fleet_of_the_page_with_two_aircraft(tmp_path: Path) -> None:
    """Numbers 1 and 3 for four: ailerons that do 45 % less are told."""
    shutil.copytree(PAGES / "fleet", tmp_path / "docs" / "validation" / "fleet")
    plan = tmp_path / "docs" / "validation" / "fleet" / "fleet.toml"
    head, *aircraft = plan.read_text().split("[[simulate]]\n")
    assert len(aircraft) == 4
    text = "[[simulate]]\n".join([head, *(a for a in aircraft if "number 1" in a or "number 3" in a)])
    plan.write_text(text.replace("-0.0853", "-0.052").replace("25.0", "18.0"))
    (command,) = commands_of(PAGES / "fleet.md")
    printed = follow(command, tmp_path, ROOT, limit_s=LONG_S, figures=False)
    differing = re.findall(r"^\s*(\w+) \(ml\): .*?number (\d) less .*?number (\d) .*they differ", printed, flags=re.M)
    assert ("Cl_da", "3", "1") in differing, printed
    assert (tmp_path / "fleet" / "report" / "index.html").is_file()
    (picture,) = re.findall(r"`python (docs/validation/fleet/picture\.py .*?)`", (PAGES / "fleet.md").read_text())
    subprocess.run([sys.executable, *shlex.split(picture)], cwd=tmp_path, check=True)
    assert (tmp_path / "fleet.png").stat().st_size > 10_000


@pytest.mark.timeout(2 * LONG_S)
@pytest.mark.usefixtures("unwritten_figures")
def test_a_fault_of_the_page_is_found_by_its_commands(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Three flights before it, and one whose right elevon sticks after 20 s; of 32 s, where the study flies 52, and with
    thresholds from a sixth of an hour."""
    monkeypatch.setattr(faults, "FLIGHT_S", 32.0)
    for constant, value in (("HOUR_S", 600.0), ("AT_ONCE", 24), ("FLIGHT_S", 25.0)):
        monkeypatch.setattr(threshold, constant, value)
    for number, path in enumerate(faults.flown("none", faults.BEFORE, "lateral", tmp_path), 1):
        path.rename(tmp_path / f"before_{number}.csv")
    (path,) = faults.flown("elevon_stuck", [5], "lateral", tmp_path)
    path.rename(tmp_path / "flight.csv")
    estimate, watch = commands_of(PAGES / "faults.md")
    follow(estimate, tmp_path, ROOT, limit_s=LONG_S)
    printed = follow(f"{watch} --hours 1", tmp_path, ROOT, status=1, limit_s=LONG_S)
    assert "the model no longer holds" in printed
    alarms = json.loads((tmp_path / "watch.json").read_text())["alarms"]
    assert faults.BEGINS_S < alarms[0]["time"] < faults.BEGINS_S + 10.0
    assert {"time", "equation", "leading"} <= set(alarms[0])


def poses(rng: np.random.Generator, damping: float, control: float, speed: float) -> list[str]:
    """12 s of rolling turns as a hall records them at 100 Hz: position, quaternion, command; pitch and height are constant."""
    step, theta = 0.001, 0.08
    phi = p = psi = north = east = command = 0.0
    lines = ["time,x,y,z,qw,qx,qy,qz,aileron"]
    for k in range(12_000):
        t = k * step
        if k % 10 == 0:
            c, s = np.cos(0.5 * np.array([phi, theta, psi])), np.sin(0.5 * np.array([phi, theta, psi]))
            pose = [
                north, east, -1.5, c[0] * c[1] * c[2] + s[0] * s[1] * s[2], s[0] * c[1] * c[2] - c[0] * s[1] * s[2],
                c[0] * s[1] * c[2] + s[0] * c[1] * s[2], c[0] * c[1] * s[2] - s[0] * s[1] * c[2],
            ]  # fmt: skip
            seen = np.array(pose) + 5e-4 * rng.standard_normal(7)
            lines.append(",".join(f"{v:.6f}" for v in (t, *seen, command)))
        wanted = 0.12 * (1 if t % 2.4 < 0.6 else -1 if t % 2.4 < 1.2 else 0) * (-1 if int(t / 2.4) % 2 else 1)
        command += step * (wanted - command) / 0.05
        p_dot = damping * p + control * command
        psi, north, east = (
            psi + step * 9.80665 / speed * np.tan(phi), north + step * speed * np.cos(psi), east + step * speed * np.sin(psi)
        )  # fmt: skip
        phi, p = phi + step * p, p + step * p_dot
    return lines


def test_poses_of_ones_own(tmp_path: Path, rng: np.random.Generator) -> None:
    """Positions and quaternions alone, at 3 m/s."""
    truth = {"L_p": -8.0, "L_da": 52.0, "V": 3.1}
    (tmp_path / "poses.csv").write_text("\n".join(poses(rng, *truth.values())) + "\n")
    write_files(files_of(PAGES / "sportcub.md"), tmp_path)
    for command in commands_of(PAGES / "sportcub.md"):
        follow(command, tmp_path, ROOT)
    told = json.loads((tmp_path / "poses.json").read_text())["flights"][0]["methods"]["ml"]["parameters"]
    for name, value in truth.items():
        assert abs(told[name]["estimate"] - value) < 4 * told[name]["std_coloured"] + 1e-3 * abs(value), name
        assert told[name]["std_coloured"] < 0.03 * abs(value), name


def test_performance_of_the_page(tmp_path: Path) -> None:
    """Glides of a known polar, and the recordings, which print what the page shows."""
    page = ROOT / "docs" / "performance.md"
    for i in (1, 2):
        flight = glide(60 + i)
        write_flight(flight.with_columns(throttle=np.zeros(len(flight))), tmp_path / f"glide{i}.mcap")
    (tmp_path / "mine.toml").write_text(f'name = "mine"\n[geometry]\narea = {AREA}\n[mass]\nmass = {MASS}\n')
    (tmp_path / "recordings").symlink_to(ROOT / "recordings")
    glides, recordings = (follow(command, tmp_path, ROOT) for command in commands_of(page))
    assert "throttle closed" in glides
    assert (tmp_path / "polar.png").stat().st_size > 10_000
    (shown,) = re.findall(r"^```text\n(.*?)^```$", page.read_text(encoding="utf-8"), flags=re.M | re.S)
    for line in shown.splitlines():
        assert line == "[...]" or line in recordings, line
