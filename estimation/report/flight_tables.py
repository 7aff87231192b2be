"""Tables of flights for any page: the flight card (mass, CG, speeds, weather, configuration), provenance, notes."""

import hashlib
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from datetime import UTC, datetime
from typing import TYPE_CHECKING

import numpy as np

from daq.utilities.constants import ZERO_CELSIUS
from estimation.aircraft.library import aircraft_of
from estimation.errors import AircraftError
from estimation.report.tables import ReportTable, number
from groundstation.flight import Array

if TYPE_CHECKING:
    from estimation.aircraft import Aircraft
    from groundstation.flight import Flight

UTC_KEY = "utc_offset_s"  # in a flight's provenance: UTC less the flight's time [s]
LATEST = 1e11  # seconds since 1970: later times exceed the calendar
DIGEST_LENGTH = 16  # digits of a SHA-256 that are shown
SURFACES = {"delta_e": "e", "delta_a": "a", "delta_r": "r"}
HEAD = (
    "flight",
    "date, time [UTC]",
    "mass [kg]",
    "CG from nose [m]",
    "V [m/s]",
    "height [m]",
    "α [deg]",
    "pressure [hPa]",
    "temperature [°C]",
    "density [kg/m³]",
    "wind [m/s]",
    "surfaces e/a/r moved [deg rms]",
    "configuration",
)


def flight_card(flights: Sequence["Flight"], aircraft: "Aircraft | None" = None) -> ReportTable:
    """One row a flight. aircraft: of all flights; by default the one that each flight carries or names, if any."""
    return ReportTable(
        "flight_card",
        "Aircraft, speeds, height, weather and configuration",
        HEAD,
        tuple(_row(f, aircraft or _aircraft_of_flight(f)) for f in flights),
        symbols=False,
        texts=(12,),
        note="Speeds, heights and angles: median (lowest to highest) over the samples used. Mass and CG: as in the aircraft's "
        "file. Wind: mean of ground less air velocity, and whence it blows. Empty: not measured or not stated.",
    )


def _aircraft_of_flight(flight: "Flight") -> "Aircraft | None":
    try:
        return aircraft_of([flight])
    except AircraftError:
        return None


def _row(flight: "Flight", aircraft: "Aircraft | None") -> tuple[str, ...]:
    return (
        flight.name,
        _date(flight),
        "" if aircraft is None or not math.isfinite(aircraft.mass) else f"{aircraft.mass:.4g}",
        "" if aircraft is None or aircraft.cg_from_nose is None else f"{aircraft.cg_from_nose:.4g}",
        _range(flight, "V", 1.0, 1),
        _range(flight, "altitude", 1.0, 0),
        _range(flight, "alpha", float(np.degrees(1.0)), 1),
        number(_median(flight, "p_static", 0.01), 1),
        number(_median(flight, "temperature", 1.0, -ZERO_CELSIUS), 1),
        number(_median(flight, "rho", 1.0), 3),
        _wind_text(flight),
        _surfaces(flight),
        str(flight.provenance.detail.get("configuration", "")),
    )


def _date(flight: "Flight") -> str:
    """UTC of the first sample; empty where the recording does not know it."""
    offset = flight.provenance.detail.get(UTC_KEY)
    if not isinstance(offset, int | float) or not 0.0 < offset + float(flight.time[0]) < LATEST:
        return ""
    return datetime.fromtimestamp(offset + float(flight.time[0]), UTC).strftime("%Y-%m-%d %H:%M")


def _finite_values(flight: "Flight", column: str) -> Array:
    values = flight[column] if flight.measured(column) else np.zeros(0)
    return values[np.isfinite(values)]


def _median(flight: "Flight", column: str, factor: float, shift: float = 0.0) -> float | None:
    values = _finite_values(flight, column)
    return factor * float(np.median(values)) + shift if values.size else None


def _range(flight: "Flight", column: str, factor: float, digits: int) -> str:
    values = factor * _finite_values(flight, column)
    if not values.size:
        return ""
    return f"{np.median(values):.{digits}f} ({values.min():.{digits}f} to {values.max():.{digits}f})"


def _surfaces(flight: "Flight") -> str:
    """Standard deviations of the surfaces [deg], a dash for one that is not measured; empty without any."""
    deflections = [float(np.degrees(_finite_values(flight, s).std())) if flight.measured(s) else None for s in SURFACES]
    if all(m is None for m in deflections):
        return ""
    return " / ".join("–" if m is None else f"{m:.1f}" for m in deflections)


def _wind_text(flight: "Flight") -> str:
    wind = mean_wind(flight)
    if wind is None:
        return ""
    speed, direction = wind
    return f"{speed:.1f} from {math.degrees(direction) % 360.0:.0f}°"


def mean_wind(flight: "Flight") -> tuple[float, float] | None:
    """(speed [m/s], direction it blows from [rad, clockwise from north]): mean ground velocity minus the air velocity from V,
    alpha, beta and attitude; None where these and vn, ve are never measured together."""
    columns = ("V", "alpha", "beta", "phi", "theta", "psi", "vn", "ve")
    if not all(flight.measured(c) for c in columns):
        return None
    c: Mapping[str, Array] = {n: flight[n] for n in columns}
    north, east = _air_velocity(c)
    with np.errstate(invalid="ignore"):
        wind_north, wind_east = c["vn"] - north, c["ve"] - east
    finite = np.isfinite(wind_north) & np.isfinite(wind_east)
    if not finite.any():
        return None
    n, e = float(wind_north[finite].mean()), float(wind_east[finite].mean())
    return math.hypot(n, e), math.atan2(-e, -n)


def _air_velocity(c: Mapping[str, Array]) -> tuple[Array, Array]:
    """North and east components of the velocity through the air: body components rotated by yaw, pitch and roll."""
    u = c["V"] * np.cos(c["alpha"]) * np.cos(c["beta"])
    v = c["V"] * np.sin(c["beta"])
    w = c["V"] * np.sin(c["alpha"]) * np.cos(c["beta"])
    sf, cf = np.sin(c["phi"]), np.cos(c["phi"])
    st, ct = np.sin(c["theta"]), np.cos(c["theta"])
    forward_speed = u * ct + (v * sf + w * cf) * st  # along the heading, level
    sideways_speed = v * cf - w * sf
    sp, cp = np.sin(c["psi"]), np.cos(c["psi"])
    return forward_speed * cp - sideways_speed * sp, forward_speed * sp + sideways_speed * cp


def provenance_table(flights: Sequence["Flight"]) -> ReportTable:
    """One row a flight: file and its hash, hashes of the raw recording and of the calibration, the program."""
    rows = []
    for flight in flights:
        p = flight.provenance
        raw = p.detail.get("derived_from")
        raw_hash = str(raw.get("sha256", "")) if isinstance(raw, dict) else ""
        digests = (p.sha256[:DIGEST_LENGTH], raw_hash[:DIGEST_LENGTH], calibration_digest(flight))
        duration = f"{flight.time[-1] - flight.time[0]:.1f}"
        rows.append((flight.name, p.source, p.path or "in memory", *digests, p.software, str(len(flight)), duration))
    return ReportTable(
        "provenance", "Where the flights come from",
        ("flight", "source", "file", "sha-256 of file", "of raw recording", "of calibration", "calibrated by", "samples",
         "duration [s]"), tuple(rows), symbols=False, texts=(2,),
        note="First 16 digits of each SHA-256; that of the calibration is over all its files' names and hashes together.",
    )  # fmt: skip


def calibration_digest(flight: "Flight") -> str:
    """First 16 digits of the SHA-256 over the calibration files' names and hashes; empty where none is stated."""
    files = dict(flight.provenance.calibration)
    if not files:
        return ""
    return hashlib.sha256(json.dumps(files, sort_keys=True).encode()).hexdigest()[:DIGEST_LENGTH]


def simulated(flights: Sequence["Flight"]) -> bool:
    """Whether any of the flights was made by a simulator."""
    return any(f.provenance.source == "simulated" for f in flights)


def notes_table(notes: Iterable[tuple[str, str]], *, filed: bool = False) -> ReportTable | None:
    """A table of notes, given as (flight, sentence); None where there are none. filed: whether it is also written as a file."""
    flights_by_note = collected((text, flight) for flight, text in notes)
    if not flights_by_note:
        return None
    rows = tuple((text, ", ".join(flights)) for text, flights in flights_by_note.items())
    return ReportTable(
        "notes", "Notes on the flights", ("note", "flights"), rows, symbols=False, texts=(0, 1), filed=filed
    )


def collected(pairs: Iterable[tuple[str, str]]) -> dict[str, list[str]]:
    """First members of pairs -> their second members, each once, in order."""
    values_by_key: dict[str, dict[str, None]] = {}
    for key, value in pairs:
        values_by_key.setdefault(key, {})[value] = None
    return {key: list(values) for key, values in values_by_key.items()}
