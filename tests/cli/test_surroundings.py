"""What the surroundings refuse a verb is one sentence with what to do, and no mistake of the program."""

import errno
import os
import subprocess
import sys
from pathlib import Path

import pytest

import sideslip.cli
from sideslip.surroundings import refusal

REFUSED = {
    "memory": (MemoryError("Unable to allocate 7 TiB"), "memory"),
    "open files": (OSError(errno.EMFILE, "Too many open files"), "ulimit -n"),
    "open files, one of them": (OSError(errno.EMFILE, "Too many open files", "a.mcap"), "a.mcap: Too many open files; "),
    "processes": (BlockingIOError(errno.EAGAIN, "Resource temporarily unavailable"), "ulimit -u"),
    "threads": (RuntimeError("can't start new thread"), "ulimit -u"),
    "temporary files": (FileNotFoundError(errno.ENOENT, "No usable temporary directory found in ['/tmp']"), "TMPDIR"),
    "working folder": (FileNotFoundError(errno.ENOENT, "No such file or directory"), "working folder is gone"),
    "disk": (OSError(errno.ENOSPC, "No space left on device"), "a file: cannot be read or written (No space"),
}  # fmt: skip


@pytest.mark.parametrize("what", REFUSED)
def test_a_refusal_is_a_sentence_and_status_2(
    what: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    error, words = REFUSED[what]

    def refused(*_: object, **__: object) -> int:
        raise error

    monkeypatch.setattr(sideslip.cli.cli, "main", refused)
    assert sideslip.cli._status(["info"]) == 2
    said = capsys.readouterr().err
    assert words in said
    assert "mistake" not in said
    assert len(said.splitlines()) == 1


def test_what_is_a_mistake_is_called_one() -> None:
    assert refusal(RuntimeError("dictionary changed size")) is None
    assert refusal(ConnectionResetError(errno.ECONNRESET, "Connection reset by peer")) is None


def test_a_working_folder_that_is_gone(tmp_path: Path) -> None:
    gone = f"import os; os.chdir({str(tmp_path)!r}); os.rmdir({str(tmp_path)!r})"
    program = f"{gone}; import sideslip.cli; sideslip.cli.run(['doctor'], None)"
    root = str(Path(sideslip.cli.__file__).parents[1])
    environment = {**os.environ, "PYTHONPATH": root}
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=root, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 2
    assert done.stderr == "sideslip: the working folder is gone; change into one that is there\n"
