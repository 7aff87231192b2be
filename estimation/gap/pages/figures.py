"""The figures of the gap page: where the disagreement is, stage by stage; each flight before and after; curves; scores."""

from typing import TYPE_CHECKING

import numpy as np

from estimation.gap.answer.result import PRIOR_FROZEN, DisagreementView, GapResult, Histories
from estimation.gap.answer.shape import ShapeCurve
from estimation.report.drawing.figures import ABOVE, MEASURED, Picture, broken_at_gaps, grid, picture, styled
from estimation.report.names import axis_label, face, literal, tex

if TYPE_CHECKING:
    from matplotlib.axes import Axes

BEFORE, AFTER, BAND = "#d55e00", "#0072b2", "#9db4c4"
COLOURS = [MEASURED, BEFORE, AFTER]  # prior frozen, refit, named effects


def residual_maps(result: GapResult) -> Picture:
    """Channels and time on top, missing coefficients in the middle, regime before and after below."""
    from matplotlib.figure import Figure

    stages = list(result.views)
    colours = COLOURS[: len(stages)] if stages[0].stage == PRIOR_FROZEN else COLOURS[-len(stages) :]
    equations = list(stages[0].equations)
    with styled():
        figure = Figure(figsize=(11.6, 5.2 + 1.2 * len(equations)), layout="constrained")
        cells = figure.add_gridspec(2 + len(equations), 2, height_ratios=[1.6, *[1.0] * len(equations), 2.2])
        _channels(figure.add_subplot(cells[0, 0]), stages, colours)
        _times(figure.add_subplot(cells[0, 1]), stages, colours)
        figure.legend(*figure.axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=len(stages))
        for row, name in enumerate(equations, start=1):
            _missing(figure.add_subplot(cells[row, :]), name, stages, colours)
        highest = max(b["gap"] for view in stages[-2:] for bins in view.regime.values() for b in bins)
        for side, view in enumerate(stages[-2:]):
            _regime(figure.add_subplot(cells[-1, side]), view, highest)
    caption = (
        "Residuals in units of the measurement noise σ by channel, over time and by flight regime; what is missing in each "
        "coefficient over the training flights, one after the other."
    )
    points = sum(m[n].size for v in stages for m in v.missing for n in equations)
    return picture(figure, "residual_maps", caption, points)


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
        axis.axvline(i - 0.5, color=MEASURED, lw=0.8)
    axis.set_xticks(starts, [literal(names[i]) for i in starts], fontsize=7)
    axis.set_yscale("log")
    _, begin, end, _ = stages[0].times[0]
    axis.set_title(f"rms residual [σ] over time (windows of {end - begin:.0f} s, flight after flight)")


def _missing(axis: "Axes", name: str, stages: list[DisagreementView], colours: list[str]) -> None:
    """The part missing in one coefficient over all training flights, one after the other."""
    courses = [np.concatenate([m[name] for m in view.missing]) for view in stages]
    for course, colour in zip(courses, colours, strict=True):
        axis.plot(np.arange(course.size), course, lw=0.7, color=colour)
    for edge in np.cumsum([m[name].size for m in stages[0].missing])[:-1]:
        axis.axvline(edge, color=MEASURED, lw=0.8)
    # the frozen prior may leave the picture: only where it is large matters
    limit = 1.3 * float(np.abs(np.concatenate(courses[-2:])).max()) or 1.0
    axis.set_ylim(-limit, limit)
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
    image = axis.imshow(table, aspect="auto", cmap="YlOrRd", vmin=1.0, vmax=max(highest, 1.1))
    axis.set_yticks(range(len(names)), names, fontsize=7)
    axis.set_xticks([0, bins - 1], [f"lowest 1/{bins}", f"highest 1/{bins}"], fontsize=7)
    axis.set_title(f"by flight regime [σ], {view.stage}")
    axis.grid(visible=False)
    axis.figure.colorbar(image, ax=axis, shrink=0.8)


def history_figure(h: Histories, result: GapResult) -> Picture:
    """Measured and modelled values of every channel of one flight, before and after, with the residuals."""
    units = {s.name: s.unit for s in result.model_before.outputs}
    with styled():
        figure, axes = grid(len(result.outputs), 2, 1.45, own_scales=True, sharex=True)
        for c, name in enumerate(result.outputs):
            k, unit = face(name, units[name])
            values, residuals = axes[c]
            values.plot(h.time, k * h.measured[:, c], ".", ms=2, color=MEASURED, label="measured")
            for course, colour, label in ((h.before, BEFORE, "before"), (h.after, AFTER, "after")):
                values.plot(h.time, broken_at_gaps(h.time, k * course[:, c]), lw=0.9, color=colour, label=label)
                rest = k * (h.measured - course)[:, c]
                residuals.plot(h.time, broken_at_gaps(h.time, rest), lw=0.6, color=colour)
            values.set_ylabel(axis_label(name, unit))
            residuals.axhspan(-k * h.floor[c], k * h.floor[c], color=BAND, alpha=0.35, lw=0, label="floor ± 1σ")
        for axis, title in zip(axes[0], ("measured and model", "residuals"), strict=True):
            axis.legend(ncols=3, **ABOVE)
            axis.set_title(title, loc="left")
        for axis in axes[-1]:
            axis.set_xlabel("time [s]")
    flight = f"{h.flight}{', held out' if h.holdout else ''}"
    caption = f"{flight}: measured, model before and model after, and what is left."
    return picture(figure, f"history_{h.flight}", caption, 5 * h.time.size * len(result.outputs))


def curve_figure(curve: ShapeCurve) -> Picture:
    """A nameless part of a coefficient over the range flown, with a band of two standard deviations to either side."""
    from matplotlib.figure import Figure

    variable, *multiplier = curve.variables
    k, unit = face(variable, curve.unit)
    output = f"{curve.output} per {multiplier[0]}" if multiplier else curve.output
    with styled():
        figure = Figure(figsize=(6.4, 3.2), layout="constrained")
        axis = figure.subplots()
        x = k * curve.grid
        axis.fill_between(x, curve.value - 2 * curve.std, curve.value + 2 * curve.std, color=BAND, alpha=0.35, lw=0)
        axis.plot(x, curve.value, color=AFTER)
        axis.axhline(0.0, color=MEASURED, lw=0.6)
        axis.set_xlabel(axis_label(variable, unit))
        axis.set_ylabel(f"nameless part of {output}")
    caption = (
        f"The part of {output} without a name, by {variable}, with two standard deviations to either side; constant and slope "
        "are the base model's where it has them."
    )
    return picture(figure, f"nameless_{curve.output}_{variable}", caption)


def score_figure(result: GapResult, most: int | None = None) -> Picture:
    """Scores of the hypotheses (of the `most` leading ones), and the threshold from simulated nulls."""
    from matplotlib.figure import Figure

    names = sorted(result.scores, key=lambda name: -result.scores[name])[:most]
    effects = {s.effect for s in result.steps}
    if most is None:
        name, what, size, font = (
            "scores",
            "Every hypothesis of the catalogue with its score",
            (9.0, 0.18 * len(names) + 1),
            7,
        )
    else:
        what = f"The {len(names)} leading hypotheses with their scores"
        name, size, font = "leading", (5.6, 0.28 * len(names) + 1), 9
    with styled():
        figure = Figure(figsize=size, layout="constrained")
        axis = figure.subplots()
        colours = [AFTER if n in effects else MEASURED for n in names]
        axis.barh(range(len(names)), [max(result.scores[n], 1e-3) for n in names], color=colours)
        axis.set_yticks(range(len(names)), names, fontsize=font)
        axis.invert_yaxis()
        axis.margins(y=0.01)
        axis.axvline(result.threshold, color=BEFORE, lw=1, label=f"null threshold {result.threshold:.2f}")
        axis.set_xlabel("score in units of its scatter on the nulls")
        axis.legend(loc="lower right")
    return picture(figure, name, f"{what}; in colour what is named.")
