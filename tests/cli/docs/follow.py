"""Following a page: its package installed into a folder of the test, its commands run as a reader would."""

import contextlib
import io
import os
import shlex
import subprocess
import sys
import warnings
from pathlib import Path

from tests.support.unwritten_figures import IN_A_PROCESS

INSTALL = (
    "install -q --no-index --no-deps --no-build-isolation --target site"  # no network, and not into this environment
)

IN_PROCESS = frozenset(
    "aircraft calibrate check design estimate export frequency gap import info match performance reconstruct verify watch".split()
)
"""Verbs that compute and write, and neither start processes nor listen: run here, where all that they import is there already."""


def run_here(words: list[str], folder: Path) -> tuple[int, str]:
    """(exit status, what was printed) of a command line in this process."""
    from sideslip import main

    printed, status = io.StringIO(), 0
    with (
        contextlib.chdir(folder),
        contextlib.redirect_stdout(printed),
        contextlib.redirect_stderr(printed),
        warnings.catch_warnings(),
    ):
        warnings.simplefilter("default")  # as in a process of its own
        try:
            main(words)
        except SystemExit as ended:
            status = int(ended.code or 0)
    return status, printed.getvalue()


def follow(
    command: str, folder: Path, root: Path, *, status: int = 0, limit_s: float = 100.0, figures: bool = True
) -> str:
    """Run one command of a page in `folder`; returns what it printed. It must end with `status` within `limit_s`.

    figures: whether a process of its own writes them.
    """
    program, *rest = shlex.split(command)
    if program == "pip":
        words = [sys.executable, "-m", "pip", *INSTALL.split(), *rest[1:]]
    else:
        assert program == "sideslip", command
        if rest[0] in IN_PROCESS and not (folder / "site").exists() and not list(folder.glob("*.py")):
            done_here, printed = run_here(rest, folder)
            assert done_here == status, f"{command}\n{printed}"
            return printed
        program = "from sideslip import main; main()"
        words = [sys.executable, "-c", program if figures else f"{IN_A_PROCESS}\n{program}", *rest]
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
