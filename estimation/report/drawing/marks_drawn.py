"""Flight modes, events and messages of a log over a figure's panels, and two flights aligned in time."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from estimation.report.drawing.figures import ABOVE, MEASURED, Picture, broken_at_gaps, panels, picture, styled
from estimation.report.names import axis_label, face, literal
from groundstation.flight import Flight
from groundstation.flight.beside import BESIDE, beside
from groundstation.flight.marks import marks_of

MOST_NAMED = 12
"""Modes, events or messages up to which their names are written: more would overlap."""
MOST_LINES = 60
"""Events and messages up to which they are drawn: more would hide the curves."""
LONGEST_TEXT = 24  # characters of a name
SHADES = ("#f0e442", "#56b4e9")  # of modes
SECOND = "#0072B2"  # colour of the second flight
COMPARED = ("delta_e", "delta_a", "delta_r", "V", "alpha", "beta", "p", "q", "r", "phi", "theta", "psi")
"""Columns in which two flights are compared, where both measure them."""


def draw_marks(axes: Sequence[Any], flight: Flight) -> None:
    """Shade each mode and draw a line for each event and message on panels that share the flight's time; names on the first."""
    start, stop = float(flight.time[0]), float(flight.time[-1])
    marks = marks_of(flight)
    modes = [m for m in marks.modes if m.stop > start and m.start < stop]
    names = sorted({m.name for m in modes})
    for mode in modes if len(names) > 1 else ():
        begin, end = max(mode.start, start), min(mode.stop, stop)
        for axis in axes:
            axis.axvspan(begin, end, color=SHADES[names.index(mode.name) % len(SHADES)], alpha=0.13, lw=0, zorder=0)
        if len(modes) <= MOST_NAMED:
            _name(axes[0], begin, mode.name)
    if len(names) == 1:
        _name(axes[0], start, names[0])
    lines = [m for m in (*marks.events, *marks.messages) if start <= m.time <= stop]
    for mark in lines if len(lines) <= MOST_LINES else ():
        for axis in axes:
            axis.axvline(mark.time, color="0.6", lw=0.5, ls=":", zorder=0)
        if len(lines) <= MOST_NAMED:
            _name(axes[-1], mark.time, mark.text)


def _name(axis: Any, time: float, text: str) -> None:
    style = {"fontsize": 6.5, "color": "0.35", "va": "bottom", "ha": "left", "clip_on": True}
    axis.text(time, 0.02, literal(text[:LONGEST_TEXT]), transform=axis.get_xaxis_transform(), **style)


def aligned_figures(flights: Sequence[Flight], by: str) -> list[Picture]:
    """Each further flight aligned with the first in time, with a panel for each column that both measure.

    by: how, as in `groundstation.flight.beside.beside`. Raises FlightError where two flights cannot be aligned.
    """
    return [_aligned(flights[0], other, by, i) for i, other in enumerate(flights[1:], start=1)]


def _aligned(first: Flight, second: Flight, by: str, number: int) -> Picture:
    pair = beside(first, second, by)
    names = [
        n for n in COMPARED if first.measured(n) and np.isfinite(pair.flight.columns.get(n + BESIDE, np.nan)).any()
    ]
    with styled():
        figure, axes = panels(len(names), 2, 1.35, 0.7)
        for axis, name in zip(axes, names, strict=True):
            factor, unit = face(name, "m/s" if name == "V" else "rad/s" if name in "pqr" else "rad")
            for column, colour, flight in ((name, MEASURED, first), (name + BESIDE, SECOND, second)):
                values = broken_at_gaps(first.time, factor * pair.flight[column])
                axis.plot(first.time, values, color=colour, lw=0.9, label=literal(flight.name))
            axis.set_ylabel(axis_label(name, unit))
        draw_marks(axes, first)
        axes[0].legend(ncols=2, **ABOVE)
    caption = f"{second.name} laid on {first.name}, in the time of {first.name}: {pair.text}."
    return picture(figure, f"aligned_{number}", caption, 2 * len(names) * len(first))
