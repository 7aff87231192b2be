"""Every command, file and line of Python that a page of docs/ shows can be used as it stands.

Pages that are followed from top to bottom have tests of their own; here all pages are held: verbs and options exist,
configuration files are taken by what reads them, and the Python of the remaining pages runs.
"""

import os
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import click
import pytest

from sideslip.cli import VERBS, cli
from tests.support.paths import ROOT

PAGES = sorted([ROOT / "README.md", *(ROOT / "docs").rglob("*.md")])
BLOCK = re.compile(r"^```(\S*)\n(.*?)^```$", flags=re.M | re.S)
MISTYPED = ("chek",)  # shown on purpose
FROM_A_PACKAGE = ("longest",)  # the verb that docs/extending.md makes


def commands(page: Path) -> set[str]:
    """Command lines of the page: in blocks, and between backticks."""
    text = page.read_text(encoding="utf-8")
    lines = {line.removeprefix("$ ") for _, body in BLOCK.findall(text) for line in body.splitlines()}
    inline = {" ".join(found.split()) for found in re.findall(r"`(sideslip [^`]+)`", BLOCK.sub("", text))}
    return {line.split("  #")[0].strip() for line in lines | inline if re.match(r"sideslip [a-z]", line)}


def wrong(command: str) -> str:
    """What of a command line does not exist; "" when all of it does."""
    # placeholders of usage lines: [optional], choice|choice, ...
    words = [w for w in shlex.split(re.sub(r"[\[\]]|\.\.\.|…", " ", command))[1:] if w]
    verb, rest = words[0], words[1:]
    if verb in (*MISTYPED, *FROM_A_PACKAGE):
        return ""
    if verb not in VERBS:
        return f"no verb {verb}"
    context = click.Context(cli)
    found = cli.get_command(context, verb)
    assert found is not None
    if isinstance(found, click.Group) and rest and not rest[0].startswith("-"):
        found = found.get_command(context, rest[0])
        if found is None:
            return f"no {verb} {rest[0]}"
    known = {name for p in found.params for name in (*p.opts, *p.secondary_opts)} | {"--help", "-h"}
    asked = {w.split("=")[0] for w in rest if re.match(r"--?[a-z]", w)}
    return ", ".join(sorted(asked - known))


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.stem)
def test_verbs_and_options_of_the_page_exist(page: Path) -> None:
    assert not {c: wrong(c) for c in commands(page) if wrong(c)}


def test_a_wrong_option_would_be_found() -> None:
    assert wrong("sideslip estimate ld1.mcap --joined") == "--joined"
    assert wrong("sideslip estimates ld1.mcap") == "no verb estimates"
    assert sum(len(commands(p)) for p in PAGES) > 80


def toml_blocks(name: str) -> list[str]:
    """The TOML that a page shows, in order."""
    text = (ROOT / "docs" / f"{name}.md").read_text(encoding="utf-8")
    return [body for kind, body in BLOCK.findall(text) if kind == "toml"]


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.stem)
def test_configuration_on_the_page_is_toml(page: Path) -> None:
    for kind, body in BLOCK.findall(page.read_text(encoding="utf-8")):
        if kind == "toml":
            tomllib.loads(body)


def test_configuration_of_the_ground_station_is_taken(tmp_path: Path) -> None:
    from groundstation.live.config import load_ground_config

    (file := tmp_path / "ground.toml").write_text(toml_blocks("ground")[0])
    assert load_ground_config(file).link.ports == ("serial:/dev/ttyUSB0:57600",)


def test_effect_of_ones_own_is_taken(tmp_path: Path) -> None:
    from estimation.gap.effects import catalogue

    (file := tmp_path / "own.toml").write_text(toml_blocks("gap")[0])
    assert "Cl_r_abs_r" in {e.name for e in catalogue([file])}


def test_model_in_equations_is_taken(tmp_path: Path) -> None:
    from estimation.models import load_model

    (file := tmp_path / "rates.toml").write_text(toml_blocks("estimation")[0])
    assert load_model(file, None).state_names == ("p", "r")


@pytest.mark.parametrize("page", ["simulator", "simulated-hardware"])
def test_scenarios_are_taken(page: str, tmp_path: Path) -> None:
    from firmware_sim.world.scenario import load_scenario

    (file := tmp_path / "scenario.toml").write_text(toml_blocks(page)[0])
    load_scenario(str(file))


def python_of(name: str, number: int = 0) -> str:
    """The number-th block of Python on a page."""
    text = (ROOT / "docs" / f"{name}.md").read_text(encoding="utf-8")
    return [body for kind, body in BLOCK.findall(text) if kind == "python"][number]


def test_python_of_the_estimation_page_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for i in (1, 2):
        shutil.copyfile(ROOT / "recordings" / f"cdfp_ld{i}.mcap", f"ld{i}.mcap")
    names: dict[str, object] = {}
    exec(python_of("estimation"), names)  # noqa: S102
    assert names["result"].parameters["Cl_p"].estimate == pytest.approx(-0.5, abs=0.1)  # type: ignore[attr-defined]


def test_python_of_the_live_page_runs() -> None:
    """With an airframe and one sample, which the page leaves to the reader; of one sample nothing can be told."""
    from daq.identification.airframe import Airframe
    from daq.identification.rows import Sample
    from estimation.aircraft import load_aircraft

    c = load_aircraft("cdfp")
    airframe = Airframe(c.span, c.area, c.mass, c.Ixx, c.Iyy, c.Izz, c.Ixz)
    sample = Sample(0.0, 0.01, 0.1, 0.0, 0.0, 0.0, 0.08, 0.08, 16.0, 0.1, 0.02, 0.0, 1.17)
    names: dict[str, object] = {"airframe": airframe, "sample": sample}
    exec(python_of("live"), names)  # noqa: S102
    assert not names["live"].estimates().derivatives["Cl_p"].told  # type: ignore[attr-defined]


def test_python_of_the_simulator_page_runs() -> None:
    """With two flights in place of sixty-four."""
    names: dict[str, object] = {}
    exec(python_of("simulator").replace("64", "2"), names)  # noqa: S102
    assert len(names["flights"]) == 2  # type: ignore[arg-type]


def test_python_of_the_hardware_page_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With the shortest built-in flight, and a ground station that hears nothing."""
    monkeypatch.chdir(tmp_path)
    shutil.copytree(ROOT / "groundstation" / "calibration" / "files" / "cdfp", "calibration")

    class Receiver:
        polled = 0

        def poll(self) -> None:
            self.polled += 1

    receiver = Receiver()
    names: dict[str, object] = {"receiver": receiver, "backfill_done": lambda: True}
    exec(python_of("simulated-hardware").replace('"rich"', '"cdfp_ld4"'), names)  # noqa: S102
    assert receiver.polled > 500
    assert list((tmp_path / "out" / "onboard").glob("*.mcap"))


def test_completion_scripts_come_as_the_page_says() -> None:
    text = (ROOT / "docs" / "command-line.md").read_text(encoding="utf-8")
    shells = re.findall(r"`sideslip completion (\w+) >", text)
    assert shells == ["bash", "fish"]
    for shell in [*shells, "zsh"]:
        environment = {**os.environ, "PYTHONPATH": str(ROOT)}
        code = f"from sideslip import main; main(['completion', {shell!r}])"
        done = subprocess.run(
            [sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=False
        )
        assert f"_SIDESLIP_COMPLETE={shell}_complete" in done.stdout, done.stderr


def test_what_the_page_shows_of_a_mistyped_verb_is_what_one_reads(capsys: pytest.CaptureFixture[str]) -> None:
    import sideslip

    (body,) = [
        b for _, b in BLOCK.findall((ROOT / "docs" / "command-line.md").read_text()) if b.startswith("$ sideslip")
    ]
    command, said = body.splitlines()
    with pytest.raises(SystemExit):
        sideslip.main(shlex.split(command)[2:])
    assert capsys.readouterr().err.strip() == said
