"""Every command of the README runs, and the README's numbers are those of the recordings."""

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
TEXT = (ROOT / "README.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```\n(.*?)^```", TEXT, flags=re.M | re.S)
COMMANDS = [line for block in BLOCKS for line in block.splitlines() if line.startswith("sideslip ")]

# What a test must add: no window, an end, and fewer simulated nulls. The last value of an option counts.
ADDED = {
    "ground": ["--view", "none", "--duration", "1"],
    "view": ["--view", "none", "--rrd", "view.rrd"],
    "gap": ["--nulls", "20"],
}
ON_HARDWARE = ("preflight", "record")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A working folder with what the README speaks of."""
    path = tmp_path_factory.mktemp("readme")
    (path / "recordings").symlink_to(ROOT / "recordings")
    shutil.copyfile(ROOT / "daq" / "configs" / "cdfp.toml", path / "uav.toml")
    (path / "ground.toml").write_text('[link]\nports = ["udpin:0"]\n')
    return path


def test_the_readme_has_commands() -> None:
    assert len(COMMANDS) >= 8


@pytest.mark.timeout(400)
def test_commands_run_in_order(folder: Path) -> None:
    for command in COMMANDS:
        words = command.split()
        verb = words[1]
        done = subprocess.run(
            [sys.executable, "-m", "sideslip", *words[1:], *ADDED.get(verb, [])],
            cwd=folder, capture_output=True, text=True, timeout=300, check=False,
        )  # fmt: skip
        if verb in ON_HARDWARE and not Path("/dev/i2c-1").exists():
            assert done.returncode == 2, command
            assert "/dev/i2c-1" in done.stderr
        else:
            assert done.returncode in (0, 1), f"{command}\n{done.stderr}"
        assert "Traceback" not in done.stderr, command


def test_links_lead_somewhere() -> None:
    for target in re.findall(r"\]\(([^)#]+)\)", TEXT):
        assert (ROOT / target).exists(), target
