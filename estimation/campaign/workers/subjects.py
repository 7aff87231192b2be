"""From a piece of work to its flight, aircraft and model; and the conditions that the flight was flown in."""

import hashlib
import tempfile
import tomllib
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path

import numpy as np

from estimation.aircraft import Aircraft
from estimation.campaign.tasks import CampaignError, FlightSource, Row, Subject, Work
from estimation.estimators.registry import find_estimator
from estimation.models import Model, load_model
from estimation.resolve import which_aircraft
from groundstation.flight import Array, Flight, read_flight

CHECK = "check"  # name of the data check among the pieces of work, which are methods otherwise
STATISTICS: dict[str, tuple[str, Callable[[Array], float]]] = {
    "V": ("V", lambda v: float(v.mean())),
    "V_min": ("V", lambda v: float(v.min())),
    "V_max": ("V", lambda v: float(v.max())),
    "alpha": ("alpha", lambda v: float(v.mean())),
    "alpha_min": ("alpha", lambda v: float(v.min())),
    "alpha_max": ("alpha", lambda v: float(v.max())),
    "beta": ("beta", lambda v: float(v.mean())),
    "beta_max": ("beta", lambda v: float(np.abs(v).max())),
    "delta_e": ("delta_e", lambda v: float(v.mean())),
    "delta_a_max": ("delta_a", lambda v: float(np.abs(v).max())),
    "delta_r_max": ("delta_r", lambda v: float(np.abs(v).max())),
    "altitude": ("altitude", lambda v: float(v.mean())),
    "rho": ("rho", lambda v: float(v.mean())),
}
"""Column of the result tables -> column of the flight, statistic over its measured samples."""


def measured(flight: Flight) -> Row:
    """Number of samples, duration [s], means and ranges of motion and air, SI; None where not measured."""
    row: Row = {"samples": len(flight), "duration": float(flight.time[-1] - flight.time[0])}
    for name, (column, statistic) in STATISTICS.items():
        values = flight[column] if flight.measured(column) else None
        row[name] = None if values is None else statistic(values[np.isfinite(values)])
    pressure_known = row["V"] is not None and row["rho"] is not None
    row["dynamic_pressure"] = 0.5 * float(np.nanmean(flight["rho"] * flight["V"] ** 2)) if pressure_known else None
    return row


def read_subject(subject: Subject) -> Flight:
    """The flight with its stretches as segments. CampaignError where its file changed since the plan was read."""
    from estimation.prepare.stretches import select_segments

    source = subject.source
    if source.path and source.data is None:
        flight = read_flight(source.path)
        _refuse_changed(source, flight.provenance.sha256)
    else:
        flight = _from_bytes(source)
    return select_segments(flight, subject.segments or None)


def _refuse_changed(source: FlightSource, sha256: str) -> None:
    if sha256 != source.sha256:
        raise CampaignError(f"{source.location}: changed while the campaign ran; run it again")


def _from_bytes(source: FlightSource) -> Flight:
    with tempfile.TemporaryDirectory(prefix="sideslip-") as folder:
        path = Path(folder) / f"{source.name}{source.suffix}"
        path.write_bytes(bytes_of(source))
        return read_flight(path)


def bytes_of(source: FlightSource) -> bytes:
    """The bytes sent along, flown by the simulator, or fetched from the URL. CampaignError where the latter changed."""
    if source.data is not None:
        return source.data
    if source.made is not None and source.maker is not None:
        return source.maker(source.made)
    from estimation.campaign.sources import fetched

    data = fetched(source.url)
    _refuse_changed(source, hashlib.sha256(data).hexdigest())
    return data


def aircraft_of_subject(subject: Subject, flight: Flight, work: Work) -> Aircraft:
    """The aircraft that the plan states for a flight, else the one that the flight names; with the mass that the plan states."""
    stated_aircraft = aircraft_from_text(subject.aircraft_text, subject.aircraft) if subject.aircraft_text else None
    required = not subject.model_text or any(find_estimator(m).needs_aircraft for m in work.pieces if m != CHECK)
    aircraft = which_aircraft([flight], stated_aircraft, needed=required)
    return aircraft if subject.mass is None else aircraft.with_values(mass=subject.mass)


@lru_cache(maxsize=32)
def aircraft_from_text(text: str, name: str) -> Aircraft:
    """The aircraft of a file's text; parsed once for all flights of a worker."""
    from estimation.aircraft import schema

    return schema.aircraft_from_text(text, f"aircraft {name}", name)


def model_of(subject: Subject, aircraft: Aircraft) -> Model:
    """The model of the text, or the built-in one with the aircraft's constants."""
    if subject.model_text:
        return Model.from_dict(tomllib.loads(subject.model_text))
    return load_model(subject.model, aircraft)
