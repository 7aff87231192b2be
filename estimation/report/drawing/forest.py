"""The answer in two figures: every derivative with its bound and its belief, and the fit in a strip for each channel."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from daq.utilities.constants import NORMAL_95
from estimation.report.drawing.figures import MEASURED, Picture, broken_at_gaps, grid, picture, styled
from estimation.report.names import axis_label, face, literal, tex

if TYPE_CHECKING:
    from estimation.estimators.result import Result
    from estimation.report.answer import AnswerRow

INK, TRUTH = "#0b5c8e", "#1d7a46"
REACH = 1.0  # largest relative distance of a mark from its estimate; farther marks are arrows at the edge
MARKS = (
    ("prior", "D", "0.35", "before flying"),
    ("published", "s", "#a35a00", "published"),
    ("truth", "*", TRUTH, "truth"),
)
STRIP, ROW = 0.46, 0.25  # height of a channel, and of a derivative [inches]
BESIDE_FEW = 0.38  # inches from axes to names, clear of numbers of three digits
BESIDE_STRIP = (1.15, 0.62)  # margins [inches] for a channel's horizontal name and for its r2


def draw_forest(axis: Any, rows: "Sequence[AnswerRow]") -> Any:
    """Draw each derivative on a line: the estimate at zero with its 95 % interval, other values by their distance from it in per
    cent of the estimate; for one that is not identifiable only "cannot tell". Returns the axes."""
    identifiable = [(y, row) for y, row in enumerate(rows) if row.identifiable and row.value]
    for key, marker, colour, label in MARKS:
        others = [(y, row, getattr(row, key)) for y, row in identifiable]
        pairs = [(y, (other - row.value) / abs(row.value)) for y, row, other in others if other is not None]
        inside = [(d, y) for y, d in pairs if abs(d) <= REACH]
        if pairs:
            positions = [100 * d for d, _ in inside], [y for _, y in inside]
            axis.plot(*positions, marker, color=colour, ms=5, mfc="none", label=label)
        for y, d in pairs:
            if abs(d) > REACH:
                axis.plot(100 * REACH * np.sign(d), y, ">" if d > 0 else "<", color=colour, ms=5, mfc="none")
    bounded = [(y, row) for y, row in identifiable if np.isfinite(row.bound)]
    bars = [100 * min(NORMAL_95 * abs(row.bound / row.value), REACH) for _, row in bounded]
    axis.errorbar(
        np.zeros(len(bounded)),
        [y for y, _ in bounded],
        xerr=bars,
        fmt="o",
        color=INK,
        ms=4,
        capsize=2.5,
        label="estimate",
    )
    for y, row in enumerate(rows):
        if not row.identifiable:
            axis.text(0, y, "cannot tell", ha="center", va="center", color="0.45", style="italic", fontsize=7.5)
    axis.axvline(0, color="0.6", lw=0.7)
    axis.set_xlim(-105 * REACH, 105 * REACH)
    axis.set_yticks(range(len(rows)), [f"${tex(row.name)}$" for row in rows])
    axis.set_ylim(len(rows) - 0.4, -0.6)
    axis.set_xlabel("from the estimate [% of it]; bars: 95 %; arrows: beyond")
    axis.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=4, handletextpad=0.3, columnspacing=1.0)
    return axis


def forest_figure(rows: "Sequence[AnswerRow]") -> Picture | None:
    """`draw_forest` as a picture; None without derivatives."""
    from matplotlib.figure import Figure

    if not rows:
        return None
    with styled():
        figure = Figure(figsize=(4.8, ROW * len(rows) + 1.0), layout="constrained")
        draw_forest(figure.subplots(), rows)
    caption = "Each estimate with its 95 % interval, and how far from it other numbers lie: where a bar covers a mark they agree."
    return picture(figure, "forest", caption)


def strips_figure(result: "Result") -> Picture | None:
    """Measured and estimated motion of a result's first flight, a strip for each channel with its r2; None without outputs."""
    fit, outputs = result.flights[0], result.model.outputs
    if not outputs:
        return None
    with styled():
        figure, axes = grid(len(outputs), 1, STRIP, sides=BESIDE_STRIP, beside=BESIDE_FEW, sharex=True)
        axes = axes[:, 0]
        for i, (axis, signal) in enumerate(zip(axes, outputs, strict=True)):
            factor, unit = face(signal.name, signal.unit)
            axis.plot(fit.time, factor * fit.measured[:, i], ".", color=MEASURED, ms=2.0)
            axis.plot(fit.time, broken_at_gaps(fit.time, factor * fit.outputs[:, i]), color=INK, lw=1.0)
            axis.set_ylabel(axis_label(signal.name, unit), rotation=0, ha="right", va="center")
            axis.locator_params(axis="y", nbins=3)
            match = fit.fit.get(signal.name)
            text = "" if match is None or not np.isfinite(match.r2) else f"$r^2$ {match.r2:.3f}"
            axis.text(1.005, 0.5, text, transform=axis.transAxes, va="center", fontsize=8)
        axes[-1].set_xlabel("time [s]")
    caption = f"{literal(fit.name)}: measured (dots) and estimated motion by {result.method}."
    return picture(figure, "strips", caption, 2 * fit.time.size * len(outputs))
