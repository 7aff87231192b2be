"""Figures as pictures inside the page: vector where that is small, pixels where a record is long."""

import base64
import io
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from estimation.estimators.estimator import Look
from estimation.estimators.registry import find, names

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

MEASURED = "#9aa3ad"
SPARE = Look("#000000", "P")  # of an estimator that brings none; Okabe and Ito's colours are told apart by all readers
LARGE = 40_000  # points in one figure from which pixels are smaller than lines
STYLE: dict[str, Any] = {
    "font.size": 8.5, "axes.titlesize": 9.5, "axes.labelsize": 8.5, "axes.grid": True, "grid.alpha": 0.25, "grid.linewidth": 0.6,
    "axes.spines.top": False, "axes.spines.right": False, "axes.linewidth": 0.7, "xtick.major.width": 0.7,
    "ytick.major.width": 0.7, "legend.frameon": False, "legend.fontsize": 8, "svg.hashsalt": "sideslip",
    "lines.linewidth": 1.1, "mathtext.fontset": "dejavusans", "axes.formatter.useoffset": False,
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Picture:
    """A figure ready for the page. uri: data URI; width, height: CSS pixels."""

    name: str
    caption: str
    uri: str
    width: int
    height: int


def look(method: str) -> Look:
    """Colour and marker of a method, the same in every figure."""
    return (find(method).look if method in names() else None) or SPARE


@contextmanager
def styled() -> Iterator[None]:
    """The look of every figure, for the time of drawing it."""
    import matplotlib as mpl

    with mpl.rc_context(STYLE):
        yield


def picture(figure: "Figure", name: str, caption: str, points: int = 0) -> Picture:
    """Draw a figure. points: how many it holds."""
    buffer = io.BytesIO()
    width, height = (round(96 * float(inches)) for inches in figure.get_size_inches())
    if points > LARGE:
        figure.savefig(buffer, format="png", dpi=150)
        kind = "image/png"
    else:
        figure.savefig(buffer, format="svg", metadata={"Date": None})
        kind = "image/svg+xml"
    uri = f"data:{kind};base64,{base64.b64encode(buffer.getvalue()).decode()}"
    return Picture(name, caption, uri, width, height)


def broken_at_gaps(time: Array, values: Array) -> Array:
    """Values with NaN after each gap, so that no line is drawn across it."""
    known = np.isfinite(time)
    if known.sum() < 3:
        return values
    steps = np.diff(time, prepend=time[:1])
    gaps = steps > 4.5 * np.nanmedian(steps[1:])
    return np.where(gaps, np.nan, values)


def file_picture(path: "Any", name: str, caption: str) -> Picture:
    """A PNG file as a picture of the page."""
    import struct

    data = path.read_bytes()
    width, height = struct.unpack(">II", data[16:24])
    uri = f"data:image/png;base64,{base64.b64encode(data).decode()}"
    return Picture(name, caption, uri, width, height)
