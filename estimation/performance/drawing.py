"""The figure of a performance: polar with its samples, sink and power over speed, bands of 95 %."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from estimation.performance.polar import BOUNDS, Bounded, Polar, PolarPoint
from estimation.performance.samples import Usable
from estimation.report.drawing.figures import MEASURED, Picture, picture, save_figure, styled

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SHOWN = 4000  # samples in the figure: more would be one dark spot
COLOUR = "#0072B2"
SIZE = (6.4, 7.6)  # inches
DPI = 150


def draw_performance(flights: Sequence[Usable], polar: Polar, curve: Sequence[PolarPoint], axes: Any) -> None:
    """Draw on three axes."""
    stretches = [s for f in flights for s in f.stretches]
    CL, CD = (np.concatenate([getattr(s, n) for s in stretches]) for n in ("smooth_CL", "CD"))
    every = max(1, CL.size // SHOWN)
    axes[0].plot(CD[::every], CL[::every], ".", color=MEASURED, markersize=1.5, label="samples")
    lift = np.linspace(*polar.lift, 60)
    drag = polar.values[0] + polar.values[1] * lift**2
    rows = np.column_stack([np.ones(60), lift**2])
    band = BOUNDS * np.sqrt(np.einsum("ij,jk,ik->i", rows, polar.covariance[:2, :2], rows))
    axes[0].fill_betweenx(lift, drag - band, drag + band, color=COLOUR, alpha=0.3, linewidth=0)
    axes[0].plot(drag, lift, color=COLOUR, label="polar")
    axes[0].set_xlabel("CD")
    axes[0].set_ylabel("CL")
    axes[0].legend(loc="lower right")
    for ax, name, label in ((axes[1], "sink", "sink, motor off [m/s]"), (axes[2], "power", "power required [W]")):
        _banded(ax, [p.V for p in curve], [getattr(p, name) for p in curve])
        ax.set_xlabel("airspeed [m/s]")
        ax.set_ylabel(label)


def _banded(ax: Any, speed: Sequence[float], values: Sequence[Bounded]) -> None:
    middle, band = np.array([v.estimate for v in values]), BOUNDS * np.array([v.std for v in values])
    ax.fill_between(speed, middle - band, middle + band, color=COLOUR, alpha=0.3, linewidth=0)
    ax.plot(speed, middle, color=COLOUR)


def _figure(flights: Sequence[Usable], polar: Polar, curve: Sequence[PolarPoint]) -> "Figure":
    from matplotlib.figure import Figure

    figure = Figure(figsize=SIZE, layout="constrained")
    draw_performance(flights, polar, curve, figure.subplots(3))
    return figure


def performance_picture(flights: Sequence[Usable], polar: Polar, curve: Sequence[PolarPoint]) -> Picture:
    """The figure for a page."""
    with styled():
        figure = _figure(flights, polar, curve)
    caption = "Samples of lift and drag with the polar; sink with the motor off and power required; bands hold 95 %."
    return picture(figure, "performance", caption, points=SHOWN)


def write_performance(flights: Sequence[Usable], polar: Polar, curve: Sequence[PolarPoint], path: Path) -> None:
    """The figure as a file."""
    with styled():
        save_figure(_figure(flights, polar, curve), path, DPI)
