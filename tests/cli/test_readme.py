"""Every command of the README and of the pages that are followed from top to bottom runs, in their order."""

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.cli.docs.follow import IN_PROCESS, run_here
from tests.support.paths import ROOT

PAGES = ("README.md", "docs/tutorial.md", "docs/export.md", "docs/design.md")


def commands_of(page: str) -> list[str]:
    """The lines of unnamed blocks that call `sideslip`."""
    text = (ROOT / page).read_text(encoding="utf-8")
    blocks = re.findall(r"^```(\w*)\n(.*?)^```$", text, flags=re.M | re.S)
    return [line for name, block in blocks if not name for line in block.splitlines() if line.startswith("sideslip ")]


# What a test must add: no window, an end, fewer simulated nulls, shorter manoeuvres. The last value of an option counts.
ADDED = {
    "design": ["--time", "6"],
    "ground": ["--view", "none", "--duration", "1"],
    "view": ["--view", "none", "--rrd", "view.rrd"],
    "gap": ["--nulls", "20"],
}
ON_HARDWARE = ("preflight", "record")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A working folder with what the pages speak of."""
    (tmp_path / "recordings").symlink_to(ROOT / "recordings")
    shutil.copyfile(ROOT / "recordings" / "cdfp_ld4.mcap", tmp_path / "ld4.mcap")
    shutil.copyfile(ROOT / "daq" / "configs" / "cdfp.toml", tmp_path / "uav.toml")
    (tmp_path / "ground.toml").write_text('[link]\nports = ["udpin:0"]\n')
    return tmp_path


@pytest.mark.parametrize("page", PAGES)
def test_the_page_has_commands(page: str) -> None:
    assert len(commands_of(page)) >= (8 if page == "README.md" else 2)


@pytest.mark.timeout(900)
@pytest.mark.parametrize("page", PAGES)
def test_commands_run_in_order(page: str, folder: Path) -> None:
    elsewhere = commands_of("README.md") if page != "README.md" else []
    for command in commands_of(page):
        if command in elsewhere:  # run there
            continue
        words = command.split()
        verb = words[1]
        if verb in IN_PROCESS:
            status, printed = run_here([*words[1:], *ADDED.get(verb, [])], folder)
            assert status in (0, 1), f"{command}\n{printed}"
            continue
        done = subprocess.run(
            [sys.executable, "-m", "sideslip", *words[1:], *ADDED.get(verb, [])],
            cwd=folder,
            capture_output=True,
            text=True,
            timeout=300,
            check=False,
        )
        if verb in ON_HARDWARE and not Path("/dev/i2c-1").exists():
            assert done.returncode == (1 if verb == "preflight" else 2), command
            assert "/dev/i2c-1" in done.stdout + done.stderr
        else:
            assert done.returncode in (0, 1), f"{command}\n{done.stderr}"
        assert "Traceback" not in done.stderr, command


def test_links_lead_somewhere() -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    for target in re.findall(r"\]\(([^)#]+)\)", text):
        assert (ROOT / target).exists(), target


def test_python_of_the_readme_says_what_it_prints(folder: Path) -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    ((code, said),) = re.findall(r"^```python\n(.*?)^```\n\n```\n(.*?)^```$", text, flags=re.M | re.S)
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=folder, capture_output=True, text=True, timeout=300, check=False
    )
    assert (done.returncode, done.stdout) == (0, said), done.stderr
