"""rerun's native viewer, headless: every view is there and none reports an error."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest

from groundstation.viewer.live import free_port
from groundstation.viewer.recorded import as_rrd
from groundstation.viewer.window import rerun_binary

pytestmark = [pytest.mark.viewer, pytest.mark.timeout(120), pytest.mark.filterwarnings("ignore::DeprecationWarning")]

VIEWS = {
    "Alpha, beta", "Rates", "Controls: potentiometer and PWM", "Specific force", "Attitude", "Track", "Map", "True airspeed",
    "Sensor health", "Link quality", "Events and alarms", "Status",
}  # fmt: skip


def vulkan() -> None:
    listed = subprocess.run(
        [shutil.which("ldconfig") or "/sbin/ldconfig", "-p"], capture_output=True, text=True, check=False
    )
    if "libvulkan" not in listed.stdout:
        why = "no Vulkan driver (Debian: apt-get install mesa-vulkan-drivers libvulkan1)"
        if os.environ.get("CI"):
            pytest.fail(why)
        pytest.skip(why)


def test_recorded_flight_opens_with_every_view_and_no_complaint(root: Path, tmp_path: Path) -> None:
    from rerun.experimental import ViewerClient

    vulkan()
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
        picture = viewer.take_screenshot()
    finally:
        viewer.quit()
    assert {v.name for v in state.views} >= VIEWS
    assert {v.name: v.reports for v in state.views if v.reports} == {}
    timeline = next(t for t in state.recordings[0].timelines if t.name == "flight_time")
    assert (timeline.end - timeline.start) * 1e-9 == pytest.approx(29.6, abs=1.0)
    assert len(picture) > 20_000
