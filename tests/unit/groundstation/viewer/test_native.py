"""rerun's native viewer, headless: every view is there and none reports an error."""

import io
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from groundstation.viewer.live import LiveView, ViewOptions, free_port
from groundstation.viewer.recorded import as_rrd
from groundstation.viewer.window import NativeWindow, rerun_binary
from tests.unit.groundstation.viewer.vulkan import need_vulkan

pytestmark = [pytest.mark.viewer, pytest.mark.timeout(120), pytest.mark.filterwarnings("ignore::DeprecationWarning")]

VIEWS = {
    "Alpha, beta", "Rates", "Controls: potentiometer and PWM", "Specific force", "Attitude", "Track", "Map", "True airspeed",
    "Sensor health", "Events and alarms", "Status", "Read-outs",
}  # fmt: skip


def test_window_listens_on_loopback_only() -> None:
    need_vulkan()
    view = LiveView("t", ViewOptions(layout="light", port=free_port()))
    window = NativeWindow(view.url, headless=True)
    port = int(window.control.rsplit(":", 1)[1].partition("/")[0])
    try:
        local: list[str] = []
        while not local and window.open:
            listening = [row.split() for row in Path("/proc/net/tcp").read_text().splitlines()[1:]]
            local = [row[1] for row in listening if row[3] == "0A" and row[1].endswith(f":{port:04X}")]
    finally:
        window.close()
        view.close()
    assert local == [f"0100007F:{port:04X}"]


def test_recorded_flight_opens_with_every_view_and_no_complaint(root: Path, tmp_path: Path) -> None:
    from rerun.experimental import ViewerClient

    need_vulkan()
    rrd = as_rrd(root / "recordings" / "cdfp_ld4_raw.mcap", tmp_path / "f.rrd")
    viewer = ViewerClient.spawn(
        headless=True, port=free_port(), executable_path=rerun_binary(), hide_welcome_screen=True
    )
    try:
        viewer.open(str(rrd))
        for _ in range(60):
            state = viewer.get_state()
            if state.recordings and len(state.views) >= len(VIEWS) and not state.loading:
                break
            viewer.take_screenshot()
        viewer.set_time("flight_time", duration=10.0)
        picture = viewer.take_screenshot()
        viewer.set_time("flight_time", duration=12.7)  # in a bank of some 30 deg
        banked = viewer.take_screenshot()
    finally:
        viewer.quit()
    assert {v.name for v in state.views} >= VIEWS
    assert not {v.name for v in state.views} & {"Link quality", "Signal, latency"}  # this recording came over no link
    assert {v.name: v.reports for v in state.views if v.reports} == {}
    timeline = next(t for t in state.recordings[0].timelines if t.name == "flight_time")
    assert (timeline.end - timeline.start) * 1e-9 == pytest.approx(29.6, abs=1.0)
    assert len(picture) > 20_000
    aircraft = [drawn(png) for png in (picture, banked)]
    assert min(a.sum() for a in aircraft) > 1500, "no aircraft in the attitude view"
    assert (aircraft[0] ^ aircraft[1]).sum() > 500, "the aircraft does not bank"


def drawn(png: bytes) -> NDArray[np.bool_]:
    """Where the attitude view shows the aircraft's wing."""
    from PIL import Image

    with Image.open(io.BytesIO(png)) as image:
        width, height = image.size
        part = image.convert("RGB").crop((round(0.4 * width), round(0.08 * height), round(0.72 * width), height // 2))
    rgb = np.asarray(part, np.int16)
    red, green, blue = rgb[..., 0], rgb[..., 1], rgb[..., 2]
    return (red > 140) & (green > 150) & (blue > 170) & (blue - red > 15)
