"""The conditions a flight was flown under, from its own columns: what derivatives are looked at over."""

from collections.abc import Callable

import numpy as np

from estimation.campaign.tasks import Row
from groundstation.flight import Array, Flight

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
"""Column of the result tables -> column of the flight, and what is taken of its measured samples."""


def measured(flight: Flight) -> Row:
    """Samples, duration [s], and means and ranges of motion and air; None for what was not measured."""
    row: Row = {"samples": len(flight), "duration": float(flight.time[-1] - flight.time[0])}
    for name, (column, statistic) in STATISTICS.items():
        row[name] = statistic(_known(flight[column])) if flight.measured(column) else None
    known = row["V"] is not None and row["rho"] is not None
    row["dynamic_pressure"] = 0.5 * float(np.nanmean(flight["rho"] * flight["V"] ** 2)) if known else None
    return row


def _known(values: Array) -> Array:
    return values[np.isfinite(values)]
