"""The picture of where the disagreement lives: over channel, time, equation and flight regime, stage by stage."""

import base64
import io
from typing import TYPE_CHECKING, Any

import numpy as np

from estimation.gap.answer.result import GapResult, View
from estimation.report.names import literal

if TYPE_CHECKING:
    from matplotlib.axes import Axes

COLOURS = {0: "#b8c4cc", 1: "#c8553d", 2: "#2a6f97"}  # prior frozen, refit, named effects


def residual_maps(result: GapResult) -> str:
    """Base64 PNG: channels and time on top, missing coefficients in the middle, regime before and after below."""
    from matplotlib.figure import Figure

    stages = list(result.views)
    first = 3 - len(stages) if len(stages) < 3 and "prior" not in stages[0].stage else 0
    colours = [COLOURS[first + i] for i in range(len(stages))]
    equations = list(stages[0].equations)
    figure = Figure(figsize=(11, 5.2 + 1.4 * len(equations)), layout="constrained")
    grid = figure.add_gridspec(2 + len(equations), 2, height_ratios=[1.6, *[1.0] * len(equations), 2.2])
    _channels(figure.add_subplot(grid[0, 0]), stages, colours)
    _times(figure.add_subplot(grid[0, 1]), stages, colours)
    for k, name in enumerate(equations):
        _missing(figure.add_subplot(grid[1 + k, :]), name, stages, colours)
    last = stages[-2:]
    highest = max(row["gap"] for view in last for rows in view.regime.values() for row in rows)
    for side, shown in enumerate(last):
        _regime(figure.add_subplot(grid[-1, side]), shown, highest)
    return png(figure)


def _channels(axis: "Axes", stages: list[View], colours: list[str]) -> None:
    names = list(stages[0].channels)
    width = 0.8 / len(stages)
    for i, (view, colour) in enumerate(zip(stages, colours, strict=True)):
        at = np.arange(len(names)) + (i - 0.5 * (len(stages) - 1)) * width
        axis.bar(at, [view.channels[n] for n in names], width, color=colour, label=view.stage)
    axis.set_xticks(range(len(names)), names)
    axis.set_yscale("log")
    axis.axhline(1.0, color="#1c2733", lw=0.6)
    axis.set_title("rms residual / noise by channel", fontsize=9)
    axis.set_ylim(0.8, 3.0 * max(max(v.channels.values()) for v in stages))  # room for the legend
    axis.legend(fontsize=7, loc="upper right")


def _times(axis: "Axes", stages: list[View], colours: list[str]) -> None:
    for view, colour in zip(stages, colours, strict=True):
        axis.step(range(len(view.times)), [g for *_, g in view.times], where="mid", color=colour, lw=1.0)
    names = [n for n, *_ in stages[0].times]
    starts = [i for i, n in enumerate(names) if i == 0 or names[i - 1] != n]
    for i in starts[1:]:
        axis.axvline(i - 0.5, color="#cfd8e0", lw=0.8)
    axis.set_xticks(starts, [literal(names[i]) for i in starts], fontsize=7)
    axis.set_yscale("log")
    _, begin, end, _ = stages[0].times[0]
    axis.set_title(f"over time (windows of {end - begin:.0f} s, flight after flight)", fontsize=9)


def _missing(axis: "Axes", name: str, stages: list[View], colours: list[str]) -> None:
    """What is missing in one coefficient over all training flights, one after the other."""
    for view, colour in zip(stages, colours, strict=True):
        course = np.concatenate([m[name] for m in view.missing])
        axis.plot(np.arange(course.size), course, lw=0.7, color=colour)
    for edge in np.cumsum([m[name].size for m in stages[0].missing])[:-1]:
        axis.axvline(edge, color="#cfd8e0", lw=0.8)
    shown = np.concatenate([m[name] for view in stages[-2:] for m in view.missing])
    limit = 1.3 * float(np.abs(shown).max()) or 1.0
    axis.set_ylim(-limit, limit)  # the frozen prior may run out of the picture: its place is what counts
    axis.set_ylabel(f"missing {name}", fontsize=8)
    axis.set_xticks([])


def _regime(axis: "Axes", view: View, highest: float) -> None:
    """Map of the gap over equally filled bins of every signal, low to high."""
    names = list(view.regime)
    bins = max(len(rows) for rows in view.regime.values())
    table = np.full((len(names), bins), np.nan)
    for k, name in enumerate(names):
        values = [row["gap"] for row in view.regime[name]]
        table[k, : len(values)] = values
    picture = axis.imshow(table, aspect="auto", cmap="YlOrRd", vmin=1.0, vmax=max(highest, 1.1))
    axis.set_yticks(range(len(names)), names, fontsize=7)
    axis.set_xticks([0, bins - 1], [f"lowest 1/{bins}", f"highest 1/{bins}"], fontsize=7)
    axis.set_title(f"by flight regime, {view.stage}", fontsize=9)
    axis.figure.colorbar(picture, ax=axis, shrink=0.8)


def png(figure: Any) -> str:
    """A figure as base64 PNG."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=90)
    return base64.b64encode(buffer.getvalue()).decode()
