"""The page of live identification in headless Chromium.

`python -m tests.web.live_identification` makes docs/pictures/live.png.

A simulated flight as a radio at 11.5 Hz with 5 % lost delivers it, identified scan by scan.
"""

import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import rerun as rr

from daq.contract.recordings.reading import read_recording
from daq.contract.scan import Scan
from daq.identification.movement import ManoeuvreDetector
from groundstation.calibration.apply import Calibrator
from groundstation.calibration.recording import embedded_calibration
from groundstation.identification.alignment import ScanAlignment
from groundstation.identification.session import LiveIdentification, LiveState
from groundstation.live.readouts import banner, readout_line
from groundstation.viewer import entities as e
from groundstation.viewer.blueprint import blueprint, fitted
from groundstation.viewer.scene import Scene
from sideslip.live_aircraft import live_aircraft
from tests.support.paths import ROOT
from tests.web.screenshot import after, take

FLIGHT = ROOT / "recordings" / "cdfp_ld4_raw.mcap"


def identified(recording: Path = FLIGHT) -> Iterator[tuple[Scan, dict[str, float], LiveState | None]]:
    """Each scan that arrives, its columns, and what is identified by then where that is new."""
    found = read_recording(recording)
    calibrator = Calibrator(embedded_calibration(found), found.info.details)
    alignment = ScanAlignment()
    live = LiveIdentification(live_aircraft("cdfp"), calibrator, 0.05, alignment, ManoeuvreDetector(9.0, 2.0))
    scans = list(found.scans())
    sent = np.diff(np.floor(np.arange(len(scans)) * 11.5 / 20.0), prepend=-1.0) > 0
    arrived = sent & (np.random.default_rng(3).uniform(size=len(scans)) > 0.05)
    for scan, there in zip(scans, arrived, strict=True):
        if there:
            alignment.add(scan)
            yield scan, calibrator.sample(scan), live.step()


def recorded(path: Path, recording: Path = FLIGHT) -> None:
    """The live view as a recording of rerun, its identification in front."""
    stream = rr.RecordingStream(
        e.APPLICATION, recording_id="live", batcher_config=rr.ChunkBatcherConfig(flush_tick=30.0)
    )
    page = fitted(blueprint("full", live=True), live=True)
    body = page.root_container.contents[1]
    body.active_tab = 1
    stream.save(str(path), default_blueprint=page)
    scene = Scene(stream)
    for scan, columns, state in identified(recording):
        scene.sample(scan.time, columns)
        scene.readouts(scan.time, readout_line(columns, "link 11 Hz"), *reversed(banner([])))
        if state is not None:
            scene.identification(state)
    stream.flush()
    stream.disconnect()


def main() -> None:
    """Make the picture of the documentation."""
    from groundstation.viewer.live import free_port
    from groundstation.viewer.window import WebPage

    target = ROOT / "docs" / "pictures" / "live.png"
    with tempfile.TemporaryDirectory() as scratch:
        rrd = Path(scratch) / "live.rrd"
        recorded(rrd)
        page = WebPage(rrd, free_port())
        try:
            take(page.url, target, size=(1280, 800), at=0.79, drawn=after(10.0))
        finally:
            page.close()
    print(target)


if __name__ == "__main__":
    main()
