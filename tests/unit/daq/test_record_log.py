"""`record` keeps its words in a file of its own, and nobody waits for those who read them."""

import logging
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from daq.utilities.record_log import RECORD_LOG, logged
from daq.utilities.rotating_log import RotatingLog
from tests.conftest import ROOT

_LOG = logging.getLogger("sideslip.trial")


def test_lines_stand_in_the_file_with_their_time_and_without_control_characters(tmp_path: Path) -> None:
    with logged(tmp_path / "later"):
        _LOG.info("radio is %s", "away\x1b[2J")
    words = (tmp_path / "later" / RECORD_LOG).read_text()
    assert words.split(" ", 1)[1] == "INFO sideslip.trial: radio is away\\u001b[2J\n"
    assert words.startswith("20")
    assert not logging.getLogger().handlers or logging.getLogger().level != logging.INFO


def test_a_card_that_does_not_answer_holds_nobody_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    answers = threading.Event()
    monkeypatch.setattr(RotatingLog, "write", lambda *_: answers.wait(30.0))
    begun = time.monotonic()
    with logged(tmp_path):
        for n in range(5000):
            _LOG.warning("line %d", n)
    assert time.monotonic() - begun < 20.0  # 30 s and more where it waits
    answers.set()


def test_a_folder_that_cannot_be_made_is_no_fault(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with logged(tmp_path / "file" / "below"):
        _LOG.error("nobody keeps this")


@pytest.mark.parametrize("reader", ["none", "full"])
def test_recording_goes_on_and_is_logged_when_nobody_reads(tmp_path: Path, reader: str) -> None:
    (tmp_path / "c.toml").write_text('[recorder]\ndirectories = ["rec"]\n[scan]\nrate_hz = 20\n[sensors]\n')
    ours, theirs = os.pipe()
    if reader == "none":
        os.close(ours)
    with open("/dev/full", "wb") as full:
        stream = full if reader == "full" else theirs
        command = [sys.executable, "-m", "sideslip", "record", "c.toml", "--skip-preflight", "--json", "j.json"]
        logger = subprocess.Popen(
            command, cwd=tmp_path, stdout=stream, stderr=stream, env={**os.environ, "PYTHONPATH": str(ROOT)}
        )
    until = time.monotonic() + 60.0
    while not list(tmp_path.glob("rec/*/*.mcap*")) and time.monotonic() < until:
        time.sleep(0.1)
    time.sleep(1.0)
    assert logger.poll() is None
    logger.send_signal(signal.SIGTERM)
    status = logger.wait(60.0)
    os.close(theirs)
    assert status == (2 if reader == "full" else 0)  # full: the work is done, its words are lost
    assert '"dropped": 0' in (tmp_path / "j.json").read_text()
    assert "scans written" in (tmp_path / "rec" / RECORD_LOG).read_text()
