"""A recorded flight as a rerun recording (.rrd), with the same entities and layout as live."""

import math
import uuid
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np
import rerun as rr

from daq.identification.airframe import EQUATIONS
from groundstation.flight import Flight
from groundstation.flight.writing import rerun_file
from groundstation.identification.history import history_of
from groundstation.live.readouts import READOUTS
from groundstation.viewer import entities as e
from groundstation.viewer.blueprint import Layout, blueprint
from groundstation.viewer.derivatives import entity as curves_of
from groundstation.viewer.glyphs import drawable
from groundstation.viewer.live import ViewerError
from groundstation.viewer.panes import fitted
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
    whose: str = "model",
) -> None:
    """Write a flight as .rrd with its blueprint inside. whose: what the columns `<name>_model` are of.

    states: sensor group -> (time [s], state in words). events: (time [s], text, level). link: (time [s], quality).
    status: the status page as Markdown.
    Raises ViewerError when the file cannot be written.
    """
    run = f"{drawable(flight.name)}-{uuid.uuid4().hex[:8]}"
    stream = rr.RecordingStream(e.APPLICATION, recording_id=run)
    said, heard = list(events), list(link)
    lanes = {group: list(history) for group, history in (states or {}).items()}
    filled = filled_entities(flight, lanes, said, heard, status)
    page = blueprint(layout, live=False, identified=any(f.startswith(e.IDENTIFICATION) for f in filled))
    try:
        with rerun_file(stream, path, fitted(page, live=False, filled=filled)):
            scene = Scene(stream, tuple(flight.columns), whose)
            scene.flight(flight)
            _show(scene, flight, lanes, said, heard, status)
    except OSError as error:
        raise ViewerError(f"{path}: cannot be written ({error.strerror or error})") from error


def _show(
    scene: Scene,
    flight: Flight,
    lanes: Mapping[str, Sequence[tuple[float, str]]],
    said: Sequence[tuple[float, str, str]],
    heard: Sequence[tuple[float, LinkSample]],
    status: str,
) -> None:
    """What goes with the flight's columns."""
    for group, history in lanes.items():
        for time, state in history:
            scene.states(time, {group: state})
    for time, text, level in said:
        scene.event(time, text, level)
    for time, sample in heard:
        scene.link(time, sample)
    if status:
        scene.status(float(flight.time[0]), status)


def filled_entities(
    flight: Flight,
    states: Mapping[str, Sequence[tuple[float, str]]],
    events: Sequence[tuple[float, str, str]],
    link: Sequence[tuple[float, LinkSample]],
    status: str,
) -> set[str]:
    """Entities of the layout that this flight has something to show in; a pane of none of them stays away."""
    columns = [c for c in flight.columns if flight.measured(c)]
    filled = {group.entity for group in (*e.series_groups(columns), *e.model_groups(columns))}
    fixed = [np.isfinite(flight[c]) for c in ("latitude", "longitude") if c in flight]
    heard = {
        e.LINK_LOSS: [s.loss_percent for _, s in link],
        e.LINK_RATE: [s.rate_hz for _, s in link],
        e.LINK_SIGNAL: [s.signal_dbm for _, s in link],
        e.LINK_LATENCY: [s.latency_s for _, s in link],
    }
    there = {
        e.CHASED: {"phi", "theta", "psi"} <= set(columns),
        e.TRACK: len(fixed) == 2 and bool(np.any(fixed[0] & fixed[1])),
        e.READOUTS: any(r.column in columns for r in READOUTS),
        e.EVENTS: bool(events or flight.notes),
        e.HEALTH: any(states.values()),
        e.STATUS: bool(status),
        **{entity: any(map(math.isfinite, values)) for entity, values in heard.items()},
    }
    kept = history_of(flight.provenance.detail)
    filled |= {curves_of(c) for c in EQUATIONS} if kept is not None and kept[1] else set()
    there[e.MAP_TRACK] = there[e.TRACK]
    return filled | {entity for entity, some in there.items() if some}
