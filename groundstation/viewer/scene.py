"""Turns calibrated samples, states and events into rerun entities, for live data and for recorded flights.

Time is the flight's own time [s] on the timeline `flight_time`. Nothing here opens a socket or a file: the caller gives the
`RecordingStream` with its sinks.
"""

import math
from collections import deque
from collections.abc import Mapping

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from daq.utilities.constants import ROUND_EARTH_RADIUS
from groundstation.flight import Flight
from groundstation.identification.session import LiveState
from groundstation.live.readouts import READOUTS, FreshValues, readout_line
from groundstation.viewer import entities as e
from groundstation.viewer.derivatives import DerivativeCurves, send_scalars
from groundstation.viewer.entities import LinkSample, airframe_mesh, drawable

TRACK_POINTS = 400  # drawn at most, the latest live, evenly spaced of a recorded flight
TRACK_SCALE = 12.0  # of the aircraft on its track, where it would be too small to be seen
AXIS_LENGTH = 0.7  # m, of the drawn body axes
TRACK_PERIOD_S = 2.0  # between two drawings of the track
READOUT_PERIOD_S = 0.5  # between read-outs of a recorded flight
READOUTS_OF_A_FLIGHT = 4000  # some 400 kB; half an hour at the period above


def quaternion_xyzw(phi: float, theta: float, psi: float) -> tuple[float, float, float, float]:
    """Rotation body to NED from Euler angles [rad], as x, y, z, w (3-2-1 sequence)."""
    cr, sr = math.cos(phi / 2), math.sin(phi / 2)
    cp, sp = math.cos(theta / 2), math.sin(theta / 2)
    cy, sy = math.cos(psi / 2), math.sin(psi / 2)
    return (
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
        cr * cp * cy + sr * sp * sy,
    )


def _state_colors(colors: Mapping[str, int]) -> rr.StateConfiguration:
    """The colours of a timeline of states."""
    names = list(colors)
    return rr.StateConfiguration(values=names, labels=names, colors=np.array(list(colors.values()), np.uint32))


class Scene:
    """Logs one aircraft into a recording stream. Not thread-safe: one thread logs."""

    def __init__(
        self, stream: rr.RecordingStream, columns: tuple[str, ...] | None = None, whose: str = "model"
    ) -> None:
        self._stream = stream
        self._groups = (*e.series_groups(columns), *e.model_groups(columns or (), whose))
        self._states: dict[str, str] = {}
        self._alarm: tuple[str, str] | None = None
        self._origin: tuple[float, float] | None = None
        self._track: deque[tuple[float, float, float, float, float]] = deque(maxlen=TRACK_POINTS)
        self._next_track = -math.inf
        self._derivatives = DerivativeCurves(stream)
        self._log_statics()

    def _log_statics(self) -> None:
        """Log what does not change: names, colours, the aircraft's mesh."""
        rec = self._stream
        rec.log("/world", rr.ViewCoordinates.FRD, static=True)
        for group in self._groups:
            rec.log(group.entity, rr.SeriesLines(names=list(group.labels), colors=group.colors), static=True)
        vertices, triangles, colors = airframe_mesh()
        mesh = rr.Mesh3D(vertex_positions=vertices, triangle_indices=triangles, vertex_colors=colors)
        rec.log(e.ATTITUDE, rr.ViewCoordinates.FRD, static=True)
        rec.log(f"{e.CHASED}/airframe", mesh, static=True)
        rec.log(f"{e.AIRCRAFT}/airframe", mesh, rr.Transform3D(scale=TRACK_SCALE), static=True)
        axes = rr.Arrows3D(
            vectors=np.eye(3, dtype=np.float32) * AXIS_LENGTH,
            colors=np.array([0xD55E00FF, 0x009E73FF, 0x56B4E9FF], np.uint32),
            labels=["x", "y", "z"],
            show_labels=False,
        )
        rec.log(f"{e.CHASED}/axes", axes, static=True)
        rec.log(e.ALARM, _state_colors(e.ALARM_COLORS), static=True)
        for sensor in e.HEALTH_TITLES:
            rec.log(e.health_entity(sensor), _state_colors(e.STATE_COLORS), static=True)
        for entity, label, color in e.LINK_SERIES:
            rec.log(entity, rr.SeriesLines(names=[label], colors=np.array([color], np.uint32)), static=True)

    # ------------------------------------------------------------------------------------------------ live
    def sample(self, time: float, values: Mapping[str, float]) -> None:
        """One calibrated sample. Columns not given are not measured."""
        rec = self._stream
        rec.set_time(e.TIMELINE, duration=time)
        for group in self._groups:
            row = np.array([values.get(c, math.nan) for c in group.columns])
            if np.isfinite(row).any():
                rec.log(group.entity, rr.Scalars(group.shown(row)))
        angles = [values.get(k, math.nan) for k in ("phi", "theta", "psi")]
        if all(math.isfinite(a) for a in angles):
            self._pose(angles)
        self._position(time, values)

    def _pose(self, angles: list[float]) -> None:
        """Log the aircraft's attitude on its track, and as seen from behind: bank and pitch without heading."""
        translation = self._track[-1][2:] if self._track else (0.0, 0.0, 0.0)
        attitude = rr.Quaternion(xyzw=quaternion_xyzw(*angles))
        chased = rr.Quaternion(xyzw=quaternion_xyzw(angles[0], angles[1], 0.0))
        self._stream.log(e.AIRCRAFT, rr.Transform3D(quaternion=attitude, translation=translation))
        self._stream.log(e.CHASED, rr.Transform3D(quaternion=chased))

    def _position(self, time: float, values: Mapping[str, float]) -> None:
        latitude, longitude = values.get("latitude", math.nan), values.get("longitude", math.nan)
        if not (math.isfinite(latitude) and math.isfinite(longitude)) or (latitude == 0 and longitude == 0):
            return
        altitude = values.get("altitude_gnss", values.get("altitude", math.nan))
        north, east = self._local(latitude, longitude)
        down = -altitude if math.isfinite(altitude) else 0.0
        self._track.append((latitude, longitude, north, east, down))
        self._stream.log(e.MAP_POSITION, rr.GeoPoints(lat_lon=[(latitude, longitude)], radii=rr.Radius.ui_points(7.0)))
        if time < self._next_track:
            return
        self._next_track = time + TRACK_PERIOD_S
        points = np.array(self._track)
        self._stream.log(e.TRACK, rr.LineStrips3D([points[:, 2:]], colors=np.array([e.PALETTE[0]], np.uint32)))
        self._stream.log(e.MAP_TRACK, rr.GeoLineStrings(lat_lon=[points[:, :2]]))

    def _local(self, latitude: float, longitude: float) -> tuple[float, float]:
        """North and east [m] of the first fix."""
        if self._origin is None:
            self._origin = (latitude, longitude)
        lat0, lon0 = self._origin
        north = math.radians(latitude - lat0) * ROUND_EARTH_RADIUS
        return north, math.radians(longitude - lon0) * ROUND_EARTH_RADIUS * math.cos(math.radians(lat0))

    def states(self, time: float, states: Mapping[str, str]) -> None:
        """State of each sensor group in words; only changes are logged."""
        changed = {g: s for g, s in states.items() if self._states.get(g) != s}
        if not changed:
            return
        self._stream.set_time(e.TIMELINE, duration=time)
        for group, state in changed.items():
            self._stream.log(e.health_entity(group), rr.StateChange(state=drawable(state)))
        self._states.update(changed)

    def event(self, time: float, text: str, level: str = "INFO") -> None:
        """An event or alarm in the log; level INFO, WARN, ERROR or CRITICAL."""
        self._stream.set_time(e.TIMELINE, duration=time)
        self._stream.log(e.EVENTS, rr.TextLog(drawable(text), level=level))

    def status(self, time: float, markdown: str) -> None:
        """The status page: recorder, link, alarms in force."""
        self._stream.set_time(e.TIMELINE, duration=time)
        self._document(e.STATUS, markdown)

    def readouts(self, time: float, numbers: str, alarms: str, level: str) -> None:
        """The digital read-outs, and the alarms where they have changed; level: the highest in force, "" for none."""
        self._stream.set_time(e.TIMELINE, duration=time)
        self._document(e.READOUTS, numbers)
        if (alarms, level) != self._alarm:
            self._alarm = (alarms, level)
            self._document(e.ALARM_WORDS, alarms)
            self._stream.log(e.ALARM, rr.StateChange(state=level or e.NO_ALARM))

    def identification(self, state: LiveState) -> None:
        self._derivatives.show(state)

    def _document(self, entity: str, markdown: str) -> None:
        self._stream.log(entity, rr.TextDocument(drawable(markdown), media_type=rr.MediaType.MARKDOWN))

    def link(self, time: float, link: LinkSample) -> None:
        self._stream.set_time(e.TIMELINE, duration=time)
        for entity, value in link.by_entity().items():
            if math.isfinite(value):
                self._stream.log(entity, rr.Scalars([value]))

    # ------------------------------------------------------------------------------------------------ whole flight
    def flight(self, flight: Flight) -> None:
        """A whole recorded flight in a few column batches."""
        for group in self._groups:
            table = np.column_stack(
                [flight[c] if c in flight else np.full(len(flight), math.nan) for c in group.columns]
            )
            keep = np.isfinite(table).any(axis=1)
            if keep.any():
                send_scalars(self._stream, group.entity, flight.time[keep], group.shown(table[keep]))
        self._flight_pose(flight)
        self._flight_readouts(flight)
        self._derivatives.show_history(flight.provenance.detail)
        for note in flight.notes:
            self.event(float(flight.time[0]), note.text, "WARN")

    def _flight_pose(self, flight: Flight) -> None:
        position: Mapping[str, NDArray[np.float64]] = {
            k: flight[k] for k in ("latitude", "longitude", "altitude_gnss", "altitude") if k in flight
        }
        if "latitude" in position and "longitude" in position:
            fixes = np.flatnonzero(np.isfinite(position["latitude"]) & np.isfinite(position["longitude"]))
            step = max(1, fixes.size // TRACK_POINTS)
            for i in fixes[::step]:
                self._stream.set_time(e.TIMELINE, duration=float(flight.time[i]))
                self._position(float(flight.time[i]), {k: float(v[i]) for k, v in position.items()})
        if not all(c in flight for c in ("phi", "theta", "psi")):
            return
        angles = np.column_stack([flight[c] for c in ("phi", "theta", "psi")])
        keep = np.flatnonzero(np.isfinite(angles).all(axis=1))
        if not keep.size:
            return
        index = rr.TimeColumn(e.TIMELINE, duration=flight.time[keep])
        attitudes = [quaternion_xyzw(*row) for row in angles[keep]]
        pose = rr.Transform3D.columns(quaternion=attitudes, translation=self._translations(flight, keep))
        self._stream.send_columns(e.AIRCRAFT, indexes=[index], columns=pose)
        attitudes_ahead = [quaternion_xyzw(phi, theta, 0.0) for phi, theta, _ in angles[keep]]
        self._stream.send_columns(e.CHASED, indexes=[index], columns=rr.Transform3D.columns(quaternion=attitudes_ahead))

    def _flight_readouts(self, flight: Flight) -> None:
        """Log the read-outs of a recorded flight, at most READOUTS_OF_A_FLIGHT; the viewer shows those at its cursor."""
        columns = {r.column: flight[r.column] for r in READOUTS if flight.measured(r.column)}
        if not columns:
            return
        period = max(READOUT_PERIOD_S, float(flight.time[-1] - flight.time[0]) / READOUTS_OF_A_FLIGHT)
        rows = np.unique(np.searchsorted(flight.time, np.arange(flight.time[0], flight.time[-1], period)))
        fresh, texts, begin = FreshValues(), [], 0
        for i in rows:
            for row in range(begin, int(i) + 1):
                fresh.update(float(flight.time[row]), {c: float(v[row]) for c, v in columns.items()})
            begin = int(i) + 1
            texts.append(drawable(readout_line(fresh.at(float(flight.time[i])))))
        index = rr.TimeColumn(e.TIMELINE, duration=flight.time[rows])
        documents = rr.TextDocument.columns(text=texts, media_type=[rr.MediaType.MARKDOWN] * len(texts))
        self._stream.send_columns(e.READOUTS, indexes=[index], columns=documents)

    def _translations(self, flight: Flight, rows: NDArray[np.intp]) -> NDArray[np.float64]:
        """(rows, 3) position of the aircraft on its track at some samples, north, east, down [m]; zeros without fixes."""
        if not all(c in flight for c in ("latitude", "longitude")):
            return np.zeros((rows.size, 3))
        height = flight["altitude_gnss"] if "altitude_gnss" in flight else flight["latitude"] * math.nan
        if not np.isfinite(height).any() and "altitude" in flight:
            height = flight["altitude"]
        fixes = np.flatnonzero(np.isfinite(flight["latitude"]) & np.isfinite(flight["longitude"]))
        if not fixes.size:
            return np.zeros((rows.size, 3))
        local = [self._local(flight["latitude"][i], flight["longitude"][i]) for i in fixes]
        table = np.column_stack([np.array(local), -np.nan_to_num(height[fixes])])
        sample_times, times = flight.time[rows], flight.time[fixes]
        return np.column_stack([np.interp(sample_times, times, table[:, i]) for i in range(3)])
