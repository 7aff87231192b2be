"""The test floor: nothing may leak threads or processes, nothing may leave this machine, seeds are printed."""

import contextlib
import multiprocessing
import os
import signal
import socket
import threading
from collections import Counter
from collections.abc import Generator, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import settings

from tests.support.long_tests import long_tests
from tests.support.paths import ROOT
from tests.support.unwritten_figures import unwritten_figures

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("MPLBACKEND", "Agg")
os.environ.setdefault("SIDESLIP_TRACEBACK", "1")  # a mistake of ours is to be seen whole

# In CI the same examples every time, so that a change is what turns it red; a person's run draws new ones.
settings.register_profile("ci", derandomize=True, print_blob=True)
if os.environ.get("CI"):
    settings.load_profile("ci")

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN and threading.current_thread() is threading.main_thread():
    # A shell starts what runs in its background with SIGINT ignored, and children inherit that: Ctrl-C could not be tried.
    signal.signal(signal.SIGINT, signal.default_int_handler)
if signal.getsignal(signal.SIGHUP) is signal.SIG_IGN and threading.current_thread() is threading.main_thread():
    signal.signal(signal.SIGHUP, signal.SIG_DFL)  # so does nohup with a hang-up

LOCAL_FAMILIES = {socket.AF_UNIX}

# Pools that libraries keep for the life of the process, by the prefix of their thread names.
LIBRARY_THREADS = (
    "pytest_timeout",
    "fsspecIO",
    "execnet",
    "tokio",
    "rerun",
    "asyncio_",
    "ThreadPoolExecutor-rerun",
    "Dummy-",
)


@pytest.hookimpl(wrapper=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> Generator[None]:
    """Mark what was long when all tests ran last, before those that -m does not want are left out. In one of several processes
    put files with most of that first: a long file that is begun last would keep one core busy and the others waiting."""
    known = long_tests()
    for item in items:
        if item.nodeid in known:
            item.add_marker(pytest.mark.long)
    yield
    if hasattr(config, "workerinput"):
        long = Counter(item.path for item in items if item.get_closest_marker("long"))
        count = Counter(item.path for item in items)
        items.sort(key=lambda item: (-long[item.path], -count[item.path]))


@pytest.fixture(scope="session", autouse=True)
def loopback_only() -> Iterator[None]:
    """Connecting to, or listening on, anything but loopback fails the test."""
    connect, bind = socket.socket.connect, socket.socket.bind

    def local(sock: socket.socket, address: Any) -> None:
        if sock.family in LOCAL_FAMILIES or not isinstance(address, tuple):
            return
        host = str(address[0])
        if not (host.startswith("127.") or host in ("localhost", "::1")):
            raise RuntimeError(f"a test reached for {address}: only loopback is allowed")

    def guarded_connect(self: socket.socket, address: Any) -> None:
        local(self, address)
        connect(self, address)

    def guarded_bind(self: socket.socket, address: Any) -> None:
        local(self, address)
        bind(self, address)

    patch = pytest.MonkeyPatch()
    patch.setattr(socket.socket, "connect", guarded_connect)
    patch.setattr(socket.socket, "bind", guarded_bind)
    yield
    patch.undo()


def _threads() -> set[threading.Thread]:
    return {t for t in threading.enumerate() if t.is_alive() and not t.name.startswith(LIBRARY_THREADS)}


def _children() -> set[int]:
    found: set[int] = set()
    for task in Path("/proc/self/task").glob("*/children"):
        with contextlib.suppress(OSError):  # a thread that ended between listing and reading
            found.update(int(pid) for pid in task.read_text().split())
    return found


@pytest.fixture(autouse=True)
def nothing_leaks() -> Iterator[None]:
    """Threads and child processes started by a test must be gone when it ends."""
    threads, children = _threads(), _children()
    yield
    left = _threads() - threads
    for thread in left:
        thread.join(timeout=2.0)
    left = {t for t in left if t.is_alive()}
    if left:
        pytest.fail(f"test left threads running: {sorted(t.name for t in left)}")
    multiprocessing.active_children()  # reaps finished ones
    leaked = {pid for pid in _children() - children if _running(pid)}
    if leaked:
        pytest.fail(f"test left processes running: {sorted(leaked)}")


def _running(pid: int) -> bool:
    try:
        stat = Path(f"/proc/{pid}/stat").read_text()
    except OSError:
        return False
    if stat.rsplit(")", 1)[1].split()[0] == "Z":
        return False
    return "resource_tracker" not in Path(f"/proc/{pid}/cmdline").read_text()


@pytest.fixture
def rng(request: pytest.FixtureRequest) -> np.random.Generator:
    """A generator whose seed is fixed by the test's name, so that a failure can be repeated."""
    seed = sum(ord(c) * 31**i for i, c in enumerate(request.node.name)) % 2**32
    print(f"seed {seed}")
    return np.random.default_rng(seed)


@pytest.fixture(name="unwritten_figures")
def _unwritten_figures() -> Iterator[None]:
    """Figures are made and not written: for tests that look at the rest of a page."""
    with unwritten_figures():
        yield


@pytest.fixture(scope="session")
def root() -> Path:
    """The project's root folder."""
    return ROOT
