"""UTC stamps of a flight, and its track for maps as KML (Google Earth) and GPX."""

import xml.etree.ElementTree as ET
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from daq.utilities.durable import whole
from groundstation.flight import Array, Flight, FlightError
from groundstation.flight.tables import ColumnTable, TableColumn
from groundstation.flight.writing import provenance_utc_offset, utc_stamps


def utc_offset(flight: Flight) -> float | None:
    """UTC minus flight time [s]; None where the flight does not know UTC."""
    return provenance_utc_offset(flight.provenance.detail)


def stamps_ns(flight: Flight) -> NDArray[np.int64]:
    """(N,) nanoseconds: UTC since 1970 where known, else flight time; never negative, rising with the samples."""
    return utc_stamps(flight.time, utc_offset(flight))


UTC_COLUMN = "utc_time"


def with_utc(table: ColumnTable, flight: Flight) -> ColumnTable:
    """The table with a last column `utc_time` [s since 1970, to the microsecond] where the flight knows UTC."""
    offset = utc_offset(flight)
    if offset is None or any(c.name == UTC_COLUMN for c in table.columns):
        return table
    stamped = np.round(flight.time + offset, 6)
    column = TableColumn(UTC_COLUMN, stamped, "s", "UTC since 1970-01-01 00:00, leap seconds not counted")
    return replace(table, columns=(*table.columns, column))


def iso(stamp_ns: int) -> str:
    """A UTC stamp as ISO 8601 with milliseconds, for KML and GPX."""
    return datetime.fromtimestamp(stamp_ns / 1e9, UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")


KML = "http://www.opengis.net/kml/2.2"
GX = "http://www.google.com/kml/ext/2.2"
GPX = "http://www.topografix.com/GPX/1/1"
_HEIGHTS = ("altitude_gnss", "altitude")


@dataclass(frozen=True)
class Track:
    """Fixes of a flight: rows with a position.

    latitude, longitude: (M,) [deg]. height: (M,) above mean sea level [m], NaN where not measured. stamps: (M,) UTC [ns],
    or None where the flight does not know UTC. segment: (M,) stretches without a gap.
    """

    latitude: Array
    longitude: Array
    height: Array
    stamps: list[int] | None
    segment: NDArray[np.int64]


def height_above_sea(flight: Flight) -> Array:
    """(N,) height above mean sea level [m]: by GNSS where measured, else by pressure, else NaN."""
    source = next((name for name in _HEIGHTS if flight.measured(name)), None)
    return flight[source] if source else np.full(len(flight), np.nan)


def track_of(flight: Flight) -> Track:
    """The fixes of a flight. Raises FlightError where it has none."""
    if not (flight.measured("latitude") and flight.measured("longitude")):
        raise FlightError(
            f"{flight.name}: no latitude and longitude, so there is no track to write; export a table instead"
        )
    keep = np.isfinite(flight["latitude"]) & np.isfinite(flight["longitude"])
    height = height_above_sea(flight)
    stamps = stamps_ns(flight)[keep].tolist() if utc_offset(flight) is not None else None
    return Track(flight["latitude"][keep], flight["longitude"][keep], height[keep], stamps, flight.segment[keep])


def write_gpx(flight: Flight, path: Path) -> None:
    """GPX 1.1: one track, a segment for each stretch without a gap; times where the flight knows UTC."""
    track = track_of(flight)
    root = ET.Element("gpx", {"version": "1.1", "creator": "Sideslip", "xmlns": GPX})
    body = ET.SubElement(root, "trk")
    ET.SubElement(body, "name").text = _printable(flight.name)
    for part in np.unique(track.segment):
        points = ET.SubElement(body, "trkseg")
        for i in np.flatnonzero(track.segment == part):
            position = {"lat": f"{track.latitude[i]:.9f}", "lon": f"{track.longitude[i]:.9f}"}
            point = ET.SubElement(points, "trkpt", position)
            if np.isfinite(track.height[i]):
                ET.SubElement(point, "ele").text = f"{track.height[i]:.3f}"
            if track.stamps is not None:
                ET.SubElement(point, "time").text = iso(track.stamps[i])
    _write(root, path)


def write_kml(flight: Flight, path: Path) -> None:
    """KML 2.2: a track with times where the flight knows UTC, else a line; height above sea level."""
    track = track_of(flight)
    ET.register_namespace("gx", GX)
    root = ET.Element("kml", {"xmlns": KML})
    mark = ET.SubElement(ET.SubElement(root, "Document"), "Placemark")
    ET.SubElement(mark, "name").text = _printable(flight.name)
    height = np.nan_to_num(track.height)
    mode = "absolute" if np.isfinite(track.height).any() else "clampToGround"
    if track.stamps is None:
        line = ET.SubElement(mark, "LineString")
        ET.SubElement(line, "altitudeMode").text = mode
        rows = zip(track.longitude, track.latitude, height, strict=True)
        ET.SubElement(line, "coordinates").text = " ".join(f"{a:.9f},{b:.9f},{h:.3f}" for a, b, h in rows)
    else:
        moving_track = ET.SubElement(mark, f"{{{GX}}}Track")
        ET.SubElement(moving_track, "altitudeMode").text = mode
        for stamp in track.stamps:
            ET.SubElement(moving_track, "when").text = iso(stamp)
        for a, b, h in zip(track.longitude, track.latitude, height, strict=True):
            ET.SubElement(moving_track, f"{{{GX}}}coord").text = f"{a:.9f} {b:.9f} {h:.3f}"
    _write(root, path)


def _write(root: ET.Element, path: Path) -> None:
    ET.indent(root)
    with whole(path) as new:
        ET.ElementTree(root).write(new, encoding="utf-8", xml_declaration=True)


def _printable(text: str) -> str:
    """Text that XML can carry: control characters, which it forbids even escaped, are dropped."""
    return "".join(c for c in text if c.isprintable() or c == " ")
