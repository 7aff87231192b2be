"""Ground station and analysis on Windows and macOS: nothing that only Linux has stands on their way."""

import os
import re
import subprocess
import sys
import tomllib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

from groundstation.live.config import usual_ports
from tests.support import unwritten_figures
from tests.support.paths import RECORDINGS, ROOT

WITHOUT = """
import builtins, os, signal, sys
class Refused:
    def find_spec(self, name, path=None, target=None):
        frame = sys._getframe(1)
        while frame is not None and "importlib" in frame.f_code.co_filename:
            frame = frame.f_back
        asked_by = "" if frame is None else frame.f_globals.get("__name__", "").partition(".")[0]
        # libraries such as psutil have a variant for each system, and take Linux's here
        ours = asked_by in ("daq", "groundstation", "estimation", "sideslip", "__main__")
        if ours and name in ("fcntl", "termios", "resource", "grp", "pwd"):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
sys.meta_path.insert(0, Refused())
for module, names in ((signal, ("SIGHUP",)), (os, (
    "O_DIRECTORY", "O_NOFOLLOW", "O_NONBLOCK", "O_CLOEXEC", "tcgetpgrp", "getpgrp", "fchmod", "sched_getaffinity",
))):
    for name in names:
        if hasattr(module, name):
            delattr(module, name)
"""


def run(folder: Path, *words: object, typed: str = "") -> subprocess.CompletedProcess[str]:
    """A command in a Python without what only POSIX has; its children are such Pythons too."""
    (folder / "site").mkdir(exist_ok=True)
    (folder / "site" / "sitecustomize.py").write_text(WITHOUT)
    environment = {**os.environ, "PYTHONPATH": str(folder / "site"), "SIDESLIP_TRACEBACK": "1"}
    command = [sys.executable, "-m", "sideslip", "--quiet", *map(str, words)]
    return subprocess.run(
        command, cwd=folder, env=environment, input=typed, capture_output=True, text=True, timeout=200, check=False
    )


def test_the_support_takes_away_what_it_says(tmp_path: Path) -> None:
    run(tmp_path, "--version")
    code = "import os, signal, importlib.util as u\nprint(hasattr(os, 'O_DIRECTORY'), hasattr(signal, 'SIGHUP'))"
    environment = {**os.environ, "PYTHONPATH": str(tmp_path / "site")}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
    assert done.stdout == "False False\n"


def test_the_program_starts_where_python_keeps_compiled_modules(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As it does unless somebody has switched that off."""
    monkeypatch.delenv("PYTHONDONTWRITEBYTECODE", raising=False)
    monkeypatch.setenv("PYTHONPYCACHEPREFIX", str(tmp_path / "compiled"))
    done = run(tmp_path, "--version")
    assert (done.returncode, done.stderr) == (0, "")
    assert any((tmp_path / "compiled").rglob("cli.*.pyc"))


RAW, OTHER = RECORDINGS / "cdfp_ld4_raw.mcap", RECORDINGS / "cdfp_ld3.mcap"
VERBS = (
    ("import", "log.mat", "-o", "own.mcap"),
    ("info", RAW),
    ("verify", RAW),
    ("recover", RAW, "-o", "recovered.mcap"),
    ("calibrate", RAW, "-o", "ld4.mcap"),
    ("view", "ld4.mcap", "--view", "none", "--rrd", "view.rrd"),
    ("check", "ld4.mcap", "--factors", "dax,day", "--write", "right"),
    ("estimate", "ld4.mcap", "--method", "ls", "--json", "e.json", "--report", "report", "--save-model", "m.toml"),
    ("match", "m.toml", OTHER, "--free", "CY_0,Cl_0,Cn_0", "--limit", "2"),
    ("frequency", "ld4.mcap", "--input", "delta_a", "--output", "p"),
    ("performance", "ld4.mcap", "--aircraft", "cdfp"),
    ("aircraft", "new", "glider"),
    ("aircraft", "check", "cdfp"),
    ("export", "ld4.mcap", "-o", "ld4.csv"),
    ("export", "e.json", "-o", "e.tex"),
    ("campaign", "ld4.mcap", "--out", "c", "--method", "ls", "--serial", "--check", "none", "--no-report"),
    ("completion", "bash"),
    ("doctor",),
)
IN_A_ROW = """
import sideslip
{}
for words in {}:
    try:
        sideslip.main(["--quiet", *words])
    except SystemExit as ended:
        assert not ended.code, words
"""


def test_the_verbs_of_ground_and_analysis(tmp_path: Path) -> None:
    """In one process, which starts once. Not here, being long: gap, watch, design, reconstruct, analyse."""
    time = np.arange(0, 10, 0.05)
    savemat(tmp_path / "log.mat", {"time": time, "p": np.sin(time), "V": 15 + 0 * time})
    run(tmp_path, "--version")
    environment = {**os.environ, "PYTHONPATH": f"{tmp_path / 'site'}{os.pathsep}{ROOT}", "SIDESLIP_TRACEBACK": "1"}
    program = IN_A_ROW.format(unwritten_figures.IN_A_PROCESS, [[*map(str, words)] for words in VERBS])
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "report" / "index.html").is_file()


def test_the_ground_station_replays_listens_and_obeys(tmp_path: Path) -> None:
    done = run(tmp_path, "ground", "--replay", RECORDINGS / "cdfp_ld4_raw.mcap", "--speed", "max", "--out", "s")
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "s" / "flight.mcap").is_file()
    (tmp_path / "g.toml").write_text('[link]\nports = ["udpin:14977"]\n')
    done = run(tmp_path, "ground", "g.toml", "--duration", "30", "--out", "t", typed="help\nquit\n")
    assert done.returncode == 0, done.stderr
    assert "fetch NUMBER" in done.stdout


@dataclass
class Device:
    device: str
    vid: int | None
    pid: int | None


def test_radios_go_by_the_names_of_both_systems() -> None:
    devices = [
        Device("COM7", 0x10C4, 0xEA60),
        Device("/dev/cu.usbserial-0001", 0x0403, 0x6015),
        Device("COM1", None, None),
    ]
    assert usual_ports(devices)[1:] == ("serial:/dev/cu.usbserial-0001:57600", "serial:COM7:57600")


@pytest.mark.parametrize("extras", ["", "estimation,ground", "campaign"])
def test_the_build_line_of_the_container_installs_what_is_asked_for(extras: str, tmp_path: Path) -> None:
    """The line as the container's shell reads it, with a pip that prints what it is to install."""
    text = (ROOT / "Containerfile").read_text(encoding="utf-8")
    (tmp_path / "pip").write_text('#!/bin/sh\nprintf "%s\\n" "$@"\n')
    (tmp_path / "pip").chmod(0o755)
    (line,) = re.findall(r"^RUN (pip install .*?) && rm -rf", text, flags=re.M)
    environment = {"PATH": f"{tmp_path}:/usr/bin:/bin", "FOR": extras}
    done = subprocess.run(["sh", "-c", line], env=environment, capture_output=True, text=True, check=True)
    words = done.stdout.split()
    declared = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["optional-dependencies"]
    assert words[-1] == (f"/src[{extras}]" if extras else "/src")
    assert {*extras.split(",")} - {""} <= {*declared}
    kept_out = (ROOT / ".dockerignore").read_text(encoding="utf-8").split()
    needed = ["pyproject.toml", "setup.py", "README.md", "LICENSE", words[words.index("-c") + 1].removeprefix("/src/")]
    assert all((ROOT / name).is_file() and name not in kept_out for name in needed)
