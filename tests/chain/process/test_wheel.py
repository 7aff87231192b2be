"""What `pip` builds from a fresh clone: nothing in git is missing from it, and the dialect is in it."""

import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

from tests.support.paths import ROOT


def test_a_wheel_from_a_fresh_clone_holds_the_dialect(tmp_path: Path) -> None:
    clone = tmp_path / "clone"
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, check=True, capture_output=True, text=True).stdout
    for name in (n for n in listed.split("\0") if n and (ROOT / n).is_file()):
        (clone / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, clone / name)
    command = [
        sys.executable,
        "-m",
        "pip",
        "wheel",
        "-q",
        "--no-deps",
        "--no-index",
        "--no-build-isolation",
        "-w",
        tmp_path,
        clone,
    ]
    subprocess.run(command, check=True, capture_output=True, timeout=200)
    (wheel,) = tmp_path.glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        module = archive.read("daq/contract/link/dialect/sideslip_dialect.py").decode()
        assert not [n for n in archive.namelist() if n.startswith(("tests/", "setup.py"))]
    assert "MAVLINK_MSG_ID_LOGGER_STATUS" in module
    assert not (clone / "daq/contract/link/dialect/sideslip_dialect.py").exists()
