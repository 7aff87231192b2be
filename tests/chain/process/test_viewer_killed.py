"""A viewer that is killed or hangs in flight costs the reception nothing: the short form of the link endurance study."""

import time
from pathlib import Path

import pytest

from tests.studies.link_endurance import Reception, Viewers
from tests.unit.groundstation.viewer.vulkan import need_vulkan

pytestmark = [pytest.mark.viewer, pytest.mark.timeout(120)]


def shows(viewers: Viewers, time_s: float) -> bool:
    """Whether the viewer comes to show data of that flight time; it takes some in with every picture it draws."""
    return any(viewers.latest_s() > time_s for _ in range(30))


def test_viewer_killed_and_hanging_in_flight(tmp_path: Path) -> None:
    need_vulkan()
    reception = Reception(tmp_path)
    viewers = Viewers(reception.view.url)
    try:
        reception.fly(300)
        assert shows(viewers, 11.0), "the viewer shows nothing"
        viewers.kill_and_restart()
        with viewers.hanging():
            reception.fly(300)
        reception.fly(300)
        deadline = time.monotonic() + 30.0
        while not reception.view._queue.empty():
            assert time.monotonic() < deadline, "the view does not draw what it was given"
            time.sleep(0.01)
        assert shows(viewers, 41.0), "the viewer started anew shows nothing of what came since"
        reception.fly(
            1000, scan=False
        )  # a scan that was lost is asked for again every few seconds, and may be lost again
        assert "all fetched; log and recording complete" in reception.check()
    finally:
        viewers.close()
        reception.close()
