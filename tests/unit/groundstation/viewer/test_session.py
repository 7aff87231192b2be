"""Views of a session: a taken port is named at the start, and costs no more than the picture later; a page comes back."""

import os
import signal
import socket
import subprocess
import sys
import time
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from groundstation.live.config import ViewConfig
from groundstation.viewer.live import ViewerError, free_port
from groundstation.viewer.session import SessionViews
from groundstation.viewer.window import WebPage


@contextmanager
def taken(port: int) -> Iterator[None]:
    """Somebody else listens there."""
    with socket.socket() as other:
        other.bind(("127.0.0.1", port))
        other.listen()
        yield


def config() -> ViewConfig:
    return ViewConfig(layout="light", port=free_port(), web_port=free_port())


@pytest.mark.parametrize("key", ["port", "web_port"])
def test_a_taken_port_is_named_before_anything_is_received(key: str) -> None:
    chosen = config()
    with taken(getattr(chosen, key)), pytest.raises(ViewerError, match=rf"\[view\] {key}: .* is in use"):
        SessionViews(chosen, "web", print)


def test_a_port_taken_later_moves_the_picture_and_a_dead_page_comes_back() -> None:
    said: list[str] = []
    chosen = config()
    views = SessionViews(chosen, "web", said.append)
    try:
        with taken(chosen.port), taken(chosen.web_port):
            view = views.make(1)
            assert view is not None
            (page,) = views._windows
            assert isinstance(page, WebPage)
            assert page.address != f"http://127.0.0.1:{chosen.web_port}/"
            assert said[0].startswith("the page opens with the first aircraft heard, at http://127.0.0.1:")
            assert said[1:] == [f"aircraft 1: {page.url}"]
        page._wait_for_answer(page.address)
        first = page.pid
        os.kill(first, signal.SIGKILL)
        page.wait()
        views.tend()
        assert page.pid != first
        page._wait_for_answer(page.address)
        with urllib.request.urlopen(page.address) as answer:
            assert answer.status == 200
        assert "started anew" in said[-1]
    finally:
        views.close()


def test_no_picture_is_no_reason_to_end(monkeypatch: pytest.MonkeyPatch) -> None:
    said: list[str] = []
    views = SessionViews(config(), "native", said.append)
    monkeypatch.setattr("groundstation.viewer.session.port_is_free", lambda port: False)
    assert views.make(3) is None
    assert "aircraft 3: no picture" in said[0]
    views.close()


def test_a_page_does_not_outlive_a_ground_station_that_is_killed() -> None:
    port = free_port()
    program = (
        "from groundstation.viewer.window import WebPage\n"
        f"page = WebPage('rerun+http://127.0.0.1:9/proxy', {port})\n"
        "print(page.pid, flush=True)\ninput()\n"
    )
    with subprocess.Popen(
        [sys.executable, "-c", program], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as station:
        assert station.stdout is not None
        page = int(station.stdout.readline())
        station.kill()
    deadline = time.monotonic() + 20.0
    while running(page) and time.monotonic() < deadline:
        time.sleep(0.02)
    assert not running(page)


def test_rerun_s_program_is_told_of_no_way_out_of_this_computer() -> None:
    port = free_port()
    page = WebPage("rerun+http://127.0.0.1:9/proxy", port)
    try:
        rows = Path(f"/proc/{page.pid}/environ").read_bytes().decode().split("\0")
        with urllib.request.urlopen(page.address) as answer:
            text, policy = answer.read().decode(), answer.headers["Content-Security-Policy"]
    finally:
        page.close()
    given = dict(row.split("=", 1) for row in rows if "=" in row)
    assert {given[name] for name in ("ALL_PROXY", "HTTPS_PROXY", "HTTP_PROXY", "https_proxy")} == {"http://127.0.0.1:9"}
    assert "default-src 'none'" in policy
    assert f"connect-src 'self' blob: data: http://127.0.0.1:{port};" in policy
    assert "googleapis" not in text
    assert "gstatic" not in text


def running(pid: int) -> bool:
    """Whether a process is there and is no zombie."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(") ")[2][0] != "Z"
    except OSError:
        return False
