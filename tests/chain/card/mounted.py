"""A forgetting card as a directory: mounted from a process of its own, and told by the test what to do."""

import os
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import pytest

from tests.chain.card.forgetting import CUTS, Cut, Traffic
from tests.chain.card.troubles import Troubles
from tests.support.paths import ROOT

_PATIENCE_S = 30.0


def why_no_card() -> str:
    """What is missing for mounting one here, in words; empty when nothing is."""
    if not os.access("/dev/fuse", os.R_OK | os.W_OK):
        return "/dev/fuse is not there or not open to this user"
    if shutil.which("fusermount3") is None:
        return "FUSE is not installed (Debian: apt-get install fuse3)"
    if find_spec("mfusepy") is None:
        return "mfusepy is not installed (pip install -e '.[dev]')"
    return ""


def need_card() -> None:
    """Skip where no file system can be mounted; in CI that fails."""
    why = why_no_card()
    if why and os.environ.get("CI"):
        pytest.fail(why)
    if why:
        pytest.skip(why)


class MountedCard:
    """The card of one test. path: where it is mounted."""

    def __init__(self, path: Path, orders: Connection) -> None:
        self.path = path
        self._orders = orders

    def cut(self, cut: Cut, seed: int = 0) -> None:
        """The power goes and comes back. Files open at that moment are dead: every use is EIO."""
        self._order("cut", CUTS.index(cut), seed)

    def survivors(self, cut: Cut, into: Path, seed: int = 0) -> Path:
        """Lay what a cut now would leave into a directory; the card goes on. Returns the directory."""
        into.mkdir(parents=True)
        self._order("survivors", CUTS.index(cut), seed, str(into))
        return into

    def trouble(self, troubles: Troubles) -> None:
        """From now on the card is slow, or fails."""
        self._order("trouble", troubles)

    def room(self, size: int | None) -> None:
        """Bytes it takes in all."""
        self._order("room", size)

    @contextmanager
    def stalled(self) -> Iterator[Callable[[], int]]:
        """No sync ends inside; gives a function that tells how many are waiting."""
        self._order("gate", False)
        try:
            yield lambda: int(self._order("waiting"))
        finally:
            self._order("gate", True)

    def trip(self, operations: int | None) -> int:
        """After so many more changes everything fails (None: never); how many there have been since the last call."""
        return int(self._order("trip", operations))

    def secure(self) -> None:
        """Everything written so far goes to the medium, as after half a minute of rest."""
        self._order("secure")

    def traffic(self) -> Traffic:
        """What has gone to the medium so far."""
        return Traffic(**self._order("traffic"))

    def _order(self, name: str, *arguments: object) -> Any:
        self._orders.send((name, arguments))
        done, result = self._orders.recv()
        if not done:
            raise result
        return result


@contextmanager
def mounted(path: Path) -> Iterator[MountedCard]:
    """A fresh card at `path`, unmounted at the end."""
    path.mkdir(parents=True, exist_ok=True)
    ours, theirs = socket.socketpair()
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-m", "tests.chain.card.server", str(path), str(theirs.fileno())]
    process = subprocess.Popen(command, cwd=ROOT, env=environment, pass_fds=[theirs.fileno()])
    theirs.close()
    orders = Connection(ours.detach())
    try:
        _wait_until(lambda: os.path.ismount(path) or process.poll() is not None)
        assert process.poll() is None, "the card's process ended before it was mounted"
        yield MountedCard(path, orders)
    finally:
        subprocess.run(["fusermount3", "-u", "-z", str(path)], check=False, capture_output=True)
        orders.close()
        try:
            process.wait(5.0)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def _wait_until(so: Callable[[], bool]) -> None:
    deadline = time.monotonic() + _PATIENCE_S
    while not so():
        assert time.monotonic() < deadline, "the card was not mounted in time"
        time.sleep(0.01)
