"""Figures as pictures inside the page. They are vector graphics; only the curves of long records are pixels."""

import base64
import io
import re
import struct
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from daq.utilities.durable import make_directories, whole, write_bytes
from estimation.errors import EstimationError
from estimation.estimators.estimator import Look
from estimation.estimators.registry import estimator_names, find_estimator
from groundstation.flight import Array

if TYPE_CHECKING:
    from matplotlib.figure import Figure


MEASURED = "#9aa3ad"
SPARE = Look("#000000", "P")  # for an estimator without a look; the others have Okabe and Ito's colours
LARGE = 40_000  # points in one figure from which pixels take fewer bytes than vectors
DOTS = 250  # dots of one series from which pixels take fewer bytes: a dot takes a hundred as a vector
CURVES = 2.2  # in matplotlib's drawing order: lines and dots are at 2 and below, letters and axes above
GAP = 4.5  # median sampling intervals, across which no line is drawn
STYLE: dict[str, Any] = {
    "font.size": 8.5, "axes.titlesize": 9.5, "axes.labelsize": 8.5, "axes.grid": True, "grid.alpha": 0.25, "grid.linewidth": 0.6,
    "axes.spines.top": False, "axes.spines.right": False, "axes.linewidth": 0.7, "xtick.major.width": 0.7,
    "ytick.major.width": 0.7, "legend.frameon": False, "legend.fontsize": 8, "svg.hashsalt": "sideslip",
    "lines.linewidth": 1.1, "mathtext.fontset": "dejavusans", "axes.formatter.useoffset": False,
}  # fmt: skip

WIDTH = 11.6  # of a figure as wide as the page [inches]; the margins of a grid's axes follow [inches]
SIDES = (0.82, 0.12)  # left: a name and numbers of five digits; right: half a number
ABOVE_ROWS, BELOW_ROWS = 0.32, 0.5  # a title or a legend; numbers and a name
BETWEEN, BESIDE, BESIDE_SCALES = 0.16, 0.18, 0.72  # between rows; between columns without and with numbers
BESIDE_NUMBERS, BELOW_NUMBERS = 0.58, 0.26  # from axes to names, clear of numbers of five digits

ABOVE: dict[str, Any] = {"loc": "lower right", "bbox_to_anchor": (1.0, 1.0), "borderaxespad": 0.2}
"""Position of a legend above the curves."""


@dataclass(frozen=True, slots=True, repr=False)
class Picture:
    """A figure ready for the page. uri: data URI; width, height: CSS pixels."""

    name: str
    caption: str
    uri: str
    width: int
    height: int

    def save(self, path: str | Path) -> Path:
        """Write the page's figure as an SVG file (PNG where it was made from one); returns its path."""
        path = Path(path)
        kind = self.uri.partition(";")[0].rpartition("/")[2].removesuffix("+xml")
        if path.suffix.lower() != f".{kind}":
            raise EstimationError(f"{path}: this figure is written as {kind.upper()}; end the name in .{kind}")
        write_bytes(path, base64.b64decode(self.uri.partition(",")[2]))
        return path

    def __repr__(self) -> str:
        return f"<Picture {self.name}: {self.caption}>"

    def _repr_html_(self) -> str:
        image = f'<img src="{self.uri}" alt="{escape(self.name)}" style="max-width:100%;height:auto;background:#fff">'
        return f"<figure>{image}<figcaption>{escape(self.caption)}</figcaption></figure>"


def look(method: str) -> Look:
    """Colour and marker of a method, the same in all figures."""
    return (find_estimator(method).look if method in estimator_names() else None) or SPARE


@contextmanager
def styled() -> Iterator[None]:
    """The style of all figures, while one is drawn."""
    import matplotlib as mpl

    with mpl.rc_context(STYLE):
        yield


def panels(count: int, across: int, height: float, margin: float) -> "tuple[Figure, list[Any]]":
    """(figure, axes of `count` panels), `across` in a row. height: of a row, margin: in addition to all rows [inches]."""
    from matplotlib.figure import Figure

    rows = -(-count // across)
    figure = Figure(figsize=(WIDTH, height * rows + margin), layout="constrained")
    axes = figure.subplots(rows, across, squeeze=False).ravel().tolist()
    for spare in axes[count:]:
        spare.set_visible(False)
    return figure, axes[:count]


def grid(
    rows: int,
    columns: int,
    height: float,
    *,
    own_scales: bool = False,
    sides: tuple[float, float] = SIDES,
    beside: float = BESIDE_NUMBERS,
    **shared: Any,
) -> "tuple[Figure, Any]":
    """(figure, (rows, columns) axes) a page wide. height: of a row [inches]; own_scales: each axes has its own ordinate numbers,
    else only the first of a row; sides: margins left and right, beside: from axes to names [inches]; shared: of `subplots`.

    Margins and positions of names are fixed lengths. Matplotlib's automatic layouts draw every letter three times, half of the
    time of a report, and an automatic position of a name measures every number of every row.
    """
    from matplotlib.figure import Figure
    from matplotlib.transforms import ScaledTranslation

    size = WIDTH, rows * height + ABOVE_ROWS + BELOW_ROWS
    across, down = BESIDE_SCALES if own_scales else BESIDE, BETWEEN
    width = (size[0] - sum(sides) - (columns - 1) * across) / columns
    figure = Figure(figsize=size)
    figure.subplots_adjust(
        left=sides[0] / size[0], right=1.0 - sides[1] / size[0], bottom=BELOW_ROWS / size[1], top=1.0 - ABOVE_ROWS / size[1],
        wspace=across / width, hspace=down / (height - down * (rows - 1) / rows),
    )  # fmt: skip
    axes = figure.subplots(rows, columns, squeeze=False, **shared)
    for axis in axes.flat:
        axis.set_title("", y=1.0)
        for name, place, x, y in (
            (axis.xaxis, (0.5, 0.0), 0.0, -BELOW_NUMBERS),
            (axis.yaxis, (0.0, 0.5), -beside, 0.0),
        ):
            name.set_label_coords(*place, axis.transAxes + ScaledTranslation(x, y, figure.dpi_scale_trans))
    return figure, axes


def legend_above(figure: "Figure", axes: Iterable[Any], columns: int) -> None:
    """A legend above all panels, with each label once."""
    handles = {label: h for axis in axes for h, label in zip(*axis.get_legend_handles_labels(), strict=True)}
    if handles:
        figure.legend(handles.values(), handles.keys(), loc="outside upper center", ncols=columns)


def save_figure(figure: "Figure", path: Path, dpi: int) -> None:
    """Write a figure in the format of the name's ending, completely or not at all; its folder is created.

    Raises EstimationError for an ending without a format in matplotlib.
    """
    kind = path.suffix.lower().removeprefix(".")
    formats = figure.canvas.get_supported_filetypes()
    if kind not in formats:
        raise EstimationError(
            f"{path}: no known format of a figure; end the name in one of {' '.join('.' + k for k in formats)}"
        )
    make_directories(path.parent)
    with whole(path) as new:
        figure.savefig(new, dpi=dpi, format=kind)


def picture(figure: "Figure", name: str, caption: str, points: int = 0) -> Picture:
    """The figure as a picture. points: number of points that it contains."""
    buffer = io.BytesIO()
    width, height = (round(96 * float(inches)) for inches in figure.get_size_inches())
    for axis in figure.axes:
        if points > LARGE:
            axis.set_rasterization_zorder(CURVES)
        for line in axis.lines:
            if line.get_marker() not in ("None", None) and np.size(line.get_xdata()) > DOTS:
                line.set_rasterized(True)
    with styled():  # its hash salt makes equal figures equal in bytes
        figure.savefig(buffer, format="svg", metadata={"Date": None}, transparent=True, dpi=150)
    uri = f"data:image/svg+xml;base64,{base64.b64encode(buffer.getvalue()).decode()}"
    return Picture(name, caption, uri, width, height)


def broken_at_gaps(time: Array, values: Array) -> Array:
    """Values (N,) with NaN after each gap in time (N,), so that no line is drawn across it."""
    finite = np.isfinite(time)
    if finite.sum() < 3:
        return values
    steps = np.diff(time, prepend=time[:1])
    gaps = steps > GAP * np.nanmedian(steps[1:])
    return np.where(gaps, np.nan, values)


def file_picture(path: Path, name: str, caption: str) -> Picture:
    """A PNG or SVG file as a picture of the page."""
    data = path.read_bytes()
    svg = path.suffix.lower() == ".svg"
    width, height = _svg_size(data) if svg else struct.unpack(">II", data[16:24])
    kind = "svg+xml" if svg else "png"
    return Picture(name, caption, f"data:image/{kind};base64,{base64.b64encode(data).decode()}", width, height)


def _svg_size(data: bytes) -> tuple[int, int]:
    """Width and height [CSS pixels] of an SVG file, whose head has them in points."""
    side_matches = [re.search(rb'\b%s="([0-9.]+)pt"' % side, data[:2000]) for side in (b"width", b"height")]
    width, height = (round(float(f.group(1)) * 96 / 72) if f else 0 for f in side_matches)
    return width, height
