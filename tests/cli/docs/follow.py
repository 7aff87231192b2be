"""Following a page: its package installed into a folder of the test, its commands run as a reader would."""

import os
import shlex
import subprocess
import sys
from pathlib import Path

INSTALL = (
    "install -q --no-index --no-deps --no-build-isolation --target site"  # no network, and not into this environment
)


def follow(command: str, folder: Path, root: Path, *, status: int = 0, limit_s: float = 100.0) -> str:
    """Run one command of a page in `folder`; returns what it printed. It must end with `status` within `limit_s`."""
    program, *rest = shlex.split(command)
    if program == "pip":
        words = [sys.executable, "-m", "pip", *INSTALL.split(), *rest[1:]]
    else:
        assert program == "sideslip", command
        words = [sys.executable, "-c", "from sideslip import main; main()", *rest]
    path = os.pathsep.join([str(folder / "site"), str(root)])
    done = subprocess.run(
        words,
        cwd=folder,
        env={**os.environ, "PYTHONPATH": path},
        capture_output=True,
        text=True,
        timeout=limit_s,
        check=False,
    )
    assert done.returncode == status, f"{command}\n{done.stdout}{done.stderr}"
    return done.stdout + done.stderr
