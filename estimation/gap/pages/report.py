"""The gap report: one self-contained HTML page that tells the story to a flight-test engineer."""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from estimation.gap.answer.result import EffectStep, GapResult, Histories
from estimation.gap.answer.shape import ShapeCurve
from estimation.gap.effects import catalogue
from estimation.gap.effects.base import Effect
from estimation.gap.pages import gap_tables
from estimation.gap.pages.figures import AFTER, BEFORE, residual_maps
from estimation.report.drawing.figures import ABOVE, MEASURED, Picture, broken_at_gaps, picture, styled
from estimation.report.markup.html import write_page
from estimation.report.names import axis_label, face
from estimation.report.notes import notes_table
from estimation.report.tables import ReportTable, write_all

if TYPE_CHECKING:
    from markupsafe import Markup

HERE = Path(__file__).parent
BAND = "#9db4c4"
TITLES = {
    "no_gap": "No gap",
    "gap_closed": "Gap found and closed",
    "gap_reduced": "Gap found and reduced",
    "unknown_effect": "A gap nothing in the catalogue explains",
    "cannot_tell": "These flights cannot tell",
}


@dataclass(frozen=True)
class Told:
    """A step as the page shows it."""

    step: EffectStep
    tables: tuple[ReportTable, ...]
    equation: "Markup | None"
    curve: Picture | None = None


def write_gap_report(result: GapResult, folder: Path, effects: Sequence[Effect] = ()) -> Path:
    """Write folder/index.html with its pictures inside, and its tables as CSV and LaTeX in folder/tables; returns the page.

    effects: those that were asked for, for their units; by default the catalogue.
    """
    steps = [_told(s) for s in result.steps]
    tables: dict[str, ReportTable | None] = {
        "missing": gap_tables.missing_table(result) if result.views else None,
        "repeat": gap_tables.repeat_table(result),
        "ties": gap_tables.ties_table(result),
        "cannot": gap_tables.cannot_table(result),
        "rejected": gap_tables.rejected_table(result),
        "sizes": gap_tables.sizes_table(result, effects or catalogue(model=result.model_before)),
        "notes": notes_table(_of_flight(n) for n in result.notes),
    }
    write_all(
        [*(t for s in steps for t in s.tables), *(t for t in tables.values() if t is not None)], folder / "tables"
    )
    # a flight of several stretches has a history for each
    flights = dict.fromkeys(h.flight + (" (held out)" if h.holdout else "") for h in result.histories)
    return write_page(
        folder / "index.html",
        "report.html.j2",
        templates=HERE,
        title=TITLES[result.verdict.value],
        lead=f"Model {result.model_before.name}; flights: {', '.join(flights)}.",
        r=result,
        steps=steps,
        tables=tables,
        gate=result.details["kinematic_gate"],
        histories=[history_figure(h, result) for h in result.histories],
        bars=score_figure(result),
        places=residual_maps(result) if result.views else None,
    )


def gap_figures(result: GapResult) -> dict[str, Callable[[], Picture]]:
    """What draws each figure of the page, by name: scores, where the disagreement lives, every flight before and after."""
    figures: dict[str, Callable[[], Picture]] = {"scores": partial(score_figure, result)}
    if result.views:
        figures["residual_maps"] = partial(residual_maps, result)
    for step in result.steps:
        if isinstance(step.shape, ShapeCurve):
            figures[f"nameless_{step.shape.output}"] = partial(curve_figure, step.shape)
    return figures | {f"history_{h.flight}": partial(history_figure, h, result) for h in result.histories}


def _of_flight(note: str) -> tuple[str, str]:
    """(flight, sentence) of a note; one of no flight is of all."""
    flight, separator, text = note.partition(": ")
    return (flight, text) if separator else ("all", note)


def _told(step: EffectStep) -> Told:
    tables = (
        gap_tables.step_gap(step),
        gap_tables.step_parameters(step),
        gap_tables.step_members(step),
        gap_tables.step_migrated(step),
        gap_tables.step_formulas(step),
    )
    curve = curve_figure(step.shape) if isinstance(step.shape, ShapeCurve) else None
    filled = tuple(t for t in tables if t is not None)
    return Told(step, filled, typeset(step.equation) if step.equation else None, curve)


def typeset(equation: str) -> "Markup":
    """C_nβ and the like with their subscripts lowered."""
    from markupsafe import Markup

    return Markup(re.sub(r"_([^\s_()|*+−=,;/]+)", r"<sub>\1</sub>", str(Markup.escape(equation))))


def history_figure(h: Histories, result: GapResult) -> Picture:
    """Measured, before and after of every channel of one flight, and what is left."""
    from matplotlib.figure import Figure

    units = {s.name: s.unit for s in result.model_before.outputs}
    with styled():
        figure = Figure(figsize=(11.6, 1.45 * len(result.outputs) + 0.6), layout="constrained")
        axes = figure.subplots(len(result.outputs), 2, sharex=True, squeeze=False)
        for c, name in enumerate(result.outputs):
            k, unit = face(name, units[name])
            courses_axis, residual_axis = axes[c]
            courses_axis.plot(h.time, k * h.measured[:, c], ".", ms=2, color=MEASURED, label="measured")
            for course, colour, label in ((h.before, BEFORE, "before"), (h.after, AFTER, "after")):
                courses_axis.plot(h.time, broken_at_gaps(h.time, k * course[:, c]), lw=0.9, color=colour, label=label)
                residual_axis.plot(
                    h.time, broken_at_gaps(h.time, k * (h.measured - course)[:, c]), lw=0.6, color=colour
                )
            courses_axis.set_ylabel(axis_label(name, unit))
            residual_axis.axhspan(-k * h.floor[c], k * h.floor[c], color=BAND, alpha=0.35, lw=0, label="floor ± 1σ")
        for axis, title in zip(axes[0], ("measured and model", "residuals"), strict=True):
            axis.legend(ncols=3, **ABOVE)
            axis.set_title(title, loc="left")
        for axis in axes[-1]:
            axis.set_xlabel("time [s]")
        figure.align_ylabels()
    suffix = ", held out" if h.holdout else ""
    points = 5 * h.time.size * len(result.outputs)
    return picture(
        figure,
        f"history_{h.flight}",
        f"{h.flight}{suffix}: measured, model before and model after, and what is left.",
        points,
    )


def curve_figure(curve: ShapeCurve) -> Picture:
    """A nameless part of a coefficient with its band, two standard deviations to either side, over the range flown."""
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
    return picture(
        figure,
        f"nameless_{curve.output}_{variable}",
        f"The part of {output} without a name, by {variable}, with two standard deviations to either side; constant and slope "
        "are the base model's where it has them.",
    )


def score_figure(result: GapResult) -> Picture:
    """Scores of all hypotheses and the threshold that simulated nulls set."""
    from matplotlib.figure import Figure

    names = list(result.scores)
    effects = {s.effect for s in result.steps}
    colours = [AFTER if n in effects else MEASURED for n in names]
    with styled():
        figure = Figure(figsize=(9, 0.18 * len(names) + 1), layout="constrained")
        axis = figure.subplots()
        axis.barh(range(len(names)), [max(result.scores[n], 1e-3) for n in names], color=colours)
        axis.set_yticks(range(len(names)), names, fontsize=7)
        axis.invert_yaxis()
        axis.margins(y=0.01)
        axis.axvline(result.threshold, color=BEFORE, lw=1, label=f"null threshold {result.threshold:.2f}")
        axis.set_xlabel("score in units of its scatter on the nulls")
        axis.legend(loc="lower right")
    return picture(figure, "scores", "Every hypothesis of the catalogue with its score; in colour what is named.")
