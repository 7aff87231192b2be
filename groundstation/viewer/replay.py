"""A recorded flight as a rerun recording (.rrd), with the same entities and layout as live."""

import uuid
from collections.abc import Iterable, Mapping
from pathlib import Path

import rerun as rr

from groundstation.flight import Flight
from groundstation.viewer import entities as e
from groundstation.viewer.blueprint import Layout, blueprint
from groundstation.viewer.live import ViewerError
from groundstation.viewer.scene import Scene

StateHistory = Mapping[str, Iterable[tuple[float, str]]]
Events = Iterable[tuple[float, str, str]]


def write_rrd(
    flight: Flight, path: Path, *, layout: Layout = "full", states: StateHistory | None = None, events: Events = ()
) -> None:
    """Write a flight as .rrd with its blueprint inside.

    states: sensor group -> (time [s], state in words). events: (time [s], text, level).
    Raises ViewerError when the file cannot be written.
    """
    run = f"{flight.name}-{uuid.uuid4().hex[:8]}"
    stream = rr.RecordingStream(e.APPLICATION, recording_id=run)
    try:
        stream.save(str(path), default_blueprint=blueprint(layout, live=False))
    except (OSError, RuntimeError) as error:
        raise ViewerError(f"{path}: cannot be written ({error})") from error
    scene = Scene(stream, tuple(flight.columns))
    scene.flight(flight)
    for group, history in (states or {}).items():
        for time, state in history:
            scene.states(time, {group: state})
    for time, text, level in events:
        scene.event(time, text, level)
    stream.flush()
    stream.disconnect()
