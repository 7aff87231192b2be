"""Progress: plain lines in a log, a bar with the time left on a terminal."""

import os
import pty
import subprocess
import sys
from pathlib import Path

import pytest

from sideslip.verbs.delivery import Progress

CODE = """
from sideslip.verbs.delivery import Progress
with Progress("flying") as tell:
    for i in range(101):
        tell(i / 100)
"""


def test_a_log_gets_a_line_at_the_start_and_each_quarter(capsys: pytest.CaptureFixture[str]) -> None:
    with Progress("flying") as tell:
        for i in range(1001):
            tell(i / 1000)
    assert capsys.readouterr().err.splitlines() == [f"flying: {p}%" for p in (0, 25, 50, 75, 100)]


def test_words_stand_for_the_title_and_a_log_has_no_lines_without_a_share(capsys: pytest.CaptureFixture[str]) -> None:
    with Progress() as tell:
        tell("flight one: maximum likelihood")
        tell("nulls", 0.3)
        tell("nulls", 0.35)
        tell("done", 1.2)
    said = capsys.readouterr().err.splitlines()
    assert said == ["nulls: 30%", "done: 100%"]


def test_an_error_passes_and_leaves_no_bar_behind(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(ZeroDivisionError), Progress("flying") as tell:
        tell(1 / 0)
    assert capsys.readouterr().err == ""


def on_a_terminal(code: str, root: Path) -> str:
    """What a terminal gets on standard error from a program that ends well."""
    near, far = pty.openpty()
    environment = {**os.environ, "TERM": "xterm", "PYTHONPATH": str(root), "COLUMNS": "100"}
    done = subprocess.run([sys.executable, "-c", code], stderr=far, env=environment, timeout=60, check=False)
    os.close(far)
    shown = os.read(near, 65536).decode(errors="replace")
    os.close(near)
    assert done.returncode == 0
    return shown


def test_a_terminal_gets_a_bar_with_the_time_left(root: Path) -> None:
    shown = on_a_terminal(CODE, root)
    assert "flying" in shown
    assert "100 %" in shown
    assert "0:00:00" in shown  # the time left
    assert "flying: 25%" not in shown


def test_the_bar_is_drawn_and_words_of_strangers_are_not_obeyed(root: Path) -> None:
    """As the command has it: its streams show control characters instead of passing them on."""
    code = f"""
import contextlib, sys
from daq.utilities.plain_words import VisibleStream
with contextlib.redirect_stderr(VisibleStream(sys.stderr)):
    {CODE.strip().replace(chr(10), chr(10) + "    ").replace("tell(i / 100)", "tell('[red]f' + chr(27) + '[2J', i / 100)")}
"""
    shown = on_a_terminal(code, root)
    assert "\\u001b[2K" not in shown  # of the bar
    assert "\x1b[2K" in shown
    assert "[red]f\\u001b[2J" in shown  # of the stranger
    assert "\x1b[2J" not in shown
