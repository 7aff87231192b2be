"""The picture of the disagreement over channel, time, equation and flight regime, stage by stage."""

from typing import TYPE_CHECKING

import numpy as np

from estimation.gap.answer.result import PRIOR_FROZEN, DisagreementView, GapResult
from estimation.report.drawing.figures import Picture, picture, styled
from estimation.report.names import literal, tex

if TYPE_CHECKING:
    from matplotlib.axes import Axes

BEFORE, AFTER, EDGE = "#d55e00", "#0072b2", "#9aa3ad"
COLOURS = [EDGE, BEFORE, AFTER]  # prior frozen, refit, named effects


def residual_maps(result: GapResult) -> Picture:
    """Channels and time on top, missing coefficients in the middle, regime before and after below."""
    from matplotlib.figure import Figure

    stages = list(result.views)
    colours = COLOURS[: len(stages)] if stages[0].stage == PRIOR_FROZEN else COLOURS[-len(stages) :]
    equations = list(stages[0].equations)
    with styled():
        figure = Figure(figsize=(11.6, 5.2 + 1.2 * len(equations)), layout="constrained")
        grid = figure.add_gridspec(2 + len(equations), 2, height_ratios=[1.6, *[1.0] * len(equations), 2.2])
        _channels(figure.add_subplot(grid[0, 0]), stages, colours)
        _times(figure.add_subplot(grid[0, 1]), stages, colours)
        figure.legend(*figure.axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=len(stages))
        for k, name in enumerate(equations):
            _missing(figure.add_subplot(grid[1 + k, :]), name, stages, colours)
        last = stages[-2:]
        highest = max(row["gap"] for view in last for rows in view.regime.values() for row in rows)
        for side, shown in enumerate(last):
            _regime(figure.add_subplot(grid[-1, side]), shown, highest)
    caption = "Residuals in units of the measurement noise σ by channel, over time and by flight regime; what is missing in each "
    points = sum(m[n].size for v in stages for m in v.missing for n in equations)
    return picture(
        figure, "residual_maps", caption + "coefficient over the training flights, one after the other.", points
    )


def _channels(axis: "Axes", stages: list[DisagreementView], colours: list[str]) -> None:
    names = list(stages[0].channels)
    width = 0.8 / len(stages)
    for i, (view, colour) in enumerate(zip(stages, colours, strict=True)):
        positions = np.arange(len(names)) + (i - 0.5 * (len(stages) - 1)) * width
        axis.bar(positions, [view.channels[n] for n in names], width, color=colour, label=view.stage)
    axis.set_xticks(range(len(names)), names)
    axis.set_yscale("log")
    axis.axhline(1.0, color="k", lw=0.6)
    axis.set_title("rms residual [σ] by channel")
    axis.grid(axis="x", visible=False)
    axis.set_ylim(0.8, 1.3 * max(max(v.channels.values()) for v in stages))


def _times(axis: "Axes", stages: list[DisagreementView], colours: list[str]) -> None:
    for view, colour in zip(stages, colours, strict=True):
        axis.step(range(len(view.times)), [g for *_, g in view.times], where="mid", color=colour, lw=1.0)
    names = [n for n, *_ in stages[0].times]
    starts = [i for i, n in enumerate(names) if i == 0 or names[i - 1] != n]
    for i in starts[1:]:
        axis.axvline(i - 0.5, color=EDGE, lw=0.8)
    axis.set_xticks(starts, [literal(names[i]) for i in starts], fontsize=7)
    axis.set_yscale("log")
    _, begin, end, _ = stages[0].times[0]
    axis.set_title(f"rms residual [σ] over time (windows of {end - begin:.0f} s, flight after flight)")


def _missing(axis: "Axes", name: str, stages: list[DisagreementView], colours: list[str]) -> None:
    """The part missing in one coefficient over all training flights, one after the other."""
    for view, colour in zip(stages, colours, strict=True):
        course = np.concatenate([m[name] for m in view.missing])
        axis.plot(np.arange(course.size), course, lw=0.7, color=colour)
    for edge in np.cumsum([m[name].size for m in stages[0].missing])[:-1]:
        axis.axvline(edge, color=EDGE, lw=0.8)
    visible = np.concatenate([m[name] for view in stages[-2:] for m in view.missing])
    limit = 1.3 * float(np.abs(visible).max()) or 1.0
    axis.set_ylim(-limit, limit)  # the frozen prior may leave the picture: only where it is large matters
    unit = "" if name.endswith("_dot") else " [1]"  # the rate of a state has that of its state
    axis.set_ylabel(f"missing ${tex(name)}${unit}", fontsize=8)
    axis.set_xticks([])


def _regime(axis: "Axes", view: DisagreementView, highest: float) -> None:
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
    axis.set_title(f"by flight regime [σ], {view.stage}")
    axis.grid(visible=False)
    axis.figure.colorbar(picture, ax=axis, shrink=0.8)
