"""A flight before a person's eyes: a small table for notebooks, and histories."""

import html
from collections.abc import Sequence
from typing import Any

import numpy as np

from daq.contract.channels import COLUMN_BY_NAME
from daq.contract.constants import RADIAN
from groundstation.flight.errors import FlightError, MissingColumnError
from groundstation.flight.tables import FlightView

_USUAL = ("V", "alpha", "beta", "p", "q", "r", "phi", "theta", "ay", "az", "delta_e", "delta_a", "delta_r")


def _measured(flight: FlightView) -> list[str]:
    return [name for name, values in flight.columns.items() if np.isfinite(values).any()]


def flight_html(flight: FlightView) -> str:
    """Name, length and the range of every measured column, as an HTML table; text is escaped."""
    rows = []
    for name in _measured(flight):
        values, known = flight.columns[name], COLUMN_BY_NAME.get(name)
        unit, meaning = (known.unit, known.meaning) if known else ("", "")
        cells = (name, unit, f"{np.nanmin(values):.4g}", f"{np.nanmax(values):.4g}", meaning)
        rows.append("<tr>" + "".join(f"<td>{html.escape(c)}</td>" for c in cells) + "</tr>")
    head = "".join(f"<th>{c}</th>" for c in ("column", "unit", "least", "most", "meaning"))
    notes = "".join(f"<li>{html.escape(n.text)}</li>" for n in flight.notes)
    return (
        f"<div><p>{html.escape(repr(flight).strip('<>'))}</p><table><thead><tr>{head}</tr></thead>"
        f"<tbody>{''.join(rows)}</tbody></table><ul>{notes}</ul></div>"
    )


def plot_flight(flight: FlightView, columns: Sequence[str], ax: Any = None) -> Any:
    """Draw columns over time, one axes each; segments are not joined. Gives the array of axes; never shows it.

    Raises FlightError where there is nothing to draw or `ax` does not match, MissingColumnError for an unknown column.
    """
    names = list(columns) or [c for c in _USUAL if c in _measured(flight)]
    if not names:
        raise FlightError(f"{flight.name}: none of the usual columns is measured; name the ones to draw")
    missing = [c for c in names if c not in _measured(flight)]
    if missing:
        raise MissingColumnError(flight.name, missing, "a plot")
    if ax is None:
        from matplotlib import pyplot as plt

        _, ax = plt.subplots(len(names), 1, sharex=True, squeeze=False, figsize=(7.0, 1.1 * len(names) + 0.6))
    axes = np.atleast_1d(np.asarray(ax, dtype=object)).ravel()
    if axes.size != len(names):
        raise FlightError(f"{axes.size} axes for {len(names)} columns; give one for each, or none")
    for each, name in zip(axes, names, strict=True):
        known = COLUMN_BY_NAME.get(name)
        unit = known.unit if known else ""
        factor, shown = (RADIAN, unit.replace("rad", "deg")) if "rad" in unit else (1.0, unit)
        for rows in flight.segments:
            each.plot(flight.time[rows], factor * flight.columns[name][rows], color="C0", linewidth=1.0)
        each.set_ylabel(f"{name} [{shown}]" if shown else name)
    axes[-1].set_xlabel("time [s]")
    return axes
