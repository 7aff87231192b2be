"""A recorded flight as a rerun recording (.rrd), with the same entities and layout as live."""

import uuid
from collections.abc import Iterable, Mapping
from pathlib import Path

import rerun as rr

from groundstation.flight import Flight
from groundstation.viewer import entities as e
from groundstation.viewer.blueprint import Layout, blueprint
from groundstation.viewer.glyphs import drawable
from groundstation.viewer.live import ViewerError
from groundstation.viewer.scene import LinkSample, Scene

StateHistory = Mapping[str, Iterable[tuple[float, str]]]
Events = Iterable[tuple[float, str, str]]


def write_rrd(
    flight: Flight,
    path: Path,
    *,
    layout: Layout = "full",
    states: StateHistory | None = None,
    events: Events = (),
    link: Iterable[tuple[float, LinkSample]] = (),
    status: str = "",
) -> None:
    """Write a flight as .rrd with its blueprint inside.

    states: sensor group -> (time [s], state in words). events: (time [s], text, level). link: (time [s], quality).
    status: the status page as Markdown.
    Raises ViewerError when the file cannot be written.
    """
    try:
        path.open("wb").close()  # rerun itself would go on without a file
    except OSError as error:
        raise ViewerError(f"{path}: cannot be written ({error.strerror})") from error
    run = f"{drawable(flight.name)}-{uuid.uuid4().hex[:8]}"
    stream = rr.RecordingStream(e.APPLICATION, recording_id=run)
    stream.save(str(path), default_blueprint=blueprint(layout, live=False))
    scene = Scene(stream, tuple(flight.columns))
    scene.flight(flight)
    for group, history in (states or {}).items():
        for time, state in history:
            scene.states(time, {group: state})
    for time, text, level in events:
        scene.event(time, text, level)
    for time, sample in link:
        scene.link(time, sample)
    if status:
        scene.status(float(flight.time[0]), status)
    stream.flush()
    stream.disconnect()
