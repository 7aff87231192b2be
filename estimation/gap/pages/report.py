"""The gap report: one self-contained HTML page for a flight-test engineer."""

import re
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

from markupsafe import Markup

from estimation.gap.answer.result import PRIOR_FROZEN, EffectStep, GapResult, Histories
from estimation.gap.answer.shape import ShapeCurve
from estimation.gap.effects import catalogue
from estimation.gap.effects.base import Effect
from estimation.gap.pages import gap_tables
from estimation.gap.pages.figures import AFTER, BEFORE, residual_maps
from estimation.gap.pages.first_screen import first_screen
from estimation.report.drawing.figures import ABOVE, MEASURED, Picture, broken_at_gaps, grid, picture, styled
from estimation.report.flight_tables import notes_table
from estimation.report.names import axis_label, face
from estimation.report.page import Page, Part, Section, paragraph

BAND = "#9db4c4"
LEADING = 12  # hypotheses on the first screen
TITLES = {
    "no_gap": "No gap",
    "gap_closed": "Gap found and closed",
    "gap_reduced": "Gap found and reduced",
    "unknown_effect": "A gap nothing in the catalogue explains",
    "cannot_tell": "These flights cannot tell",
}


def write_gap_report(result: GapResult, folder: Path, effects: Sequence[Effect] = ()) -> Path:
    """Write folder/index.html with its pictures inside, and its tables as CSV and LaTeX in folder/tables; returns the page.

    effects: those of the run, for their units; by default the catalogue.
    """
    places: list[Part] = []
    if result.views:
        places = [_stages(result), residual_maps(result), gap_tables.missing_table(result)]
    repeat = gap_tables.repeat_table(result)
    histories = [history_figure(h, result) for h in result.histories]
    sizes = gap_tables.sizes_table(result, effects or catalogue(model=result.model_before))
    limits = [t for t in (gap_tables.ties_table(result), gap_tables.cannot_table(result)) if t is not None]
    seen = paragraph("These flights would show every effect of the catalogue, and tell each from the others.")
    notes = notes_table((_of_flight(n) for n in result.notes), filed=True)
    detail = partial(Section, folded=True)
    sections = [
        *first_screen(result, sizes, score_figure(result, LEADING), _meaning(result)),
        *(
            detail(f"step{n}", _step_title(n, step), _step_parts(step, result.text), step.effect)
            for n, step in enumerate(result.steps, start=1)
        ),
        detail("where", "Where the disagreement lives", places, "Where") if places else None,
        detail("repeat", "Repeatability", [repeat]) if repeat else None,
        detail("histories", "Measured, before, after", histories, "Histories"),
        detail(
            "hypotheses",
            "All hypotheses",
            [score_figure(result), sizes, gap_tables.rejected_table(result)],
            "Hypotheses",
            printed=False,
        ),
        detail("limits", "What these flights cannot tell", limits or [seen], "What these flights cannot tell"),
        detail("lineage", "Lineage", [_lineage(result), notes], "Lineage"),
    ]
    # a flight of several stretches has a history for each
    flights = dict.fromkeys(h.flight + (" (held out)" if h.holdout else "") for h in result.histories)
    lead = f"Model {result.model_before.name}; flights: {', '.join(flights)}."
    return Page(TITLES[result.verdict.value], lead, sections).write(folder / "index.html", folder / "tables")


def _meaning(result: GapResult) -> Markup:
    """The meaning of the numbers on the first screen."""
    gate = result.details["kinematic_gate"]
    instrument = ""
    if gate["best"]:
        scored = f"score {gate['score']} against {gate['threshold']}"
        instrument = f" (best instrument error {gate['best']}, {scored}: {gate['why']})"
    return paragraph(
        "Gaps are rms residuals in units of the measurement noise σ, over all outputs; the floor is their median over"
        f" {result.details['nulls']} simulated nulls (seed {result.details['seed']}). Family-wise threshold of the scores"
        f" {result.threshold:.2f} (nominal {result.nominal_threshold:.2f}). Kinematic check: {gate['origin']}{instrument}.",
        "note",
    )


def _step_title(number: int, step: EffectStep) -> str:
    return f"{number}. {step.title[0].upper()}{step.title[1:]} ({step.effect})"


def _step_parts(step: EffectStep, verdict: str) -> list[Part]:
    """A step: equation, description, place, curve where it has no name, tables. verdict: text that the page has already."""
    parts: list[Part] = [paragraph(typeset(step.equation), "eq")] if step.equation else []
    if step.text != verdict:
        parts.append(paragraph(step.text))
    where = f"Score {step.score:.1f} against the threshold of {step.threshold:.1f}. Where: {step.where.equation}"
    if step.where.channels:
        where += f"; channels {', '.join(step.where.channels)}"
    if step.where.regime:
        where += f"; {step.where.regime}"
    if step.where.segments:
        where += f"; mostly at {', '.join(f'{a:.1f} to {b:.1f} s' for a, b in step.where.segments)}"
    parts.append(paragraph(f"{where}."))
    if step.practical:
        practical = step.practical if step.practical.startswith("matters") else f"is {step.practical}"
        parts.append(paragraph(f"In flight-simulator tolerances it {practical}."))
    if step.absorbed is not None:
        takeover = Markup("The base's own derivatives can take over {} % of its signature.")
        parts.append(paragraph(takeover.format(f"{100 * step.absorbed:.0f}")))
    if isinstance(step.shape, ShapeCurve):
        parts.append(curve_figure(step.shape))
    return [
        *parts,
        gap_tables.step_gap(step),
        gap_tables.step_parameters(step),
        gap_tables.step_members(step),
        gap_tables.step_migrated(step),
        gap_tables.step_formulas(step),
    ]


def _stages(result: GapResult) -> Markup:
    stages = "; ".join(f"{view.stage}: {view.gap:.2f}" for view in result.views)
    frozen = (
        " Frozen at what was believed before the flights the disagreement stands where it arises; a refit hides most of it in "
        "the derivatives."
    )
    return paragraph(
        f"{stages} times the measurement noise.{frozen if any(v.stage == PRIOR_FROZEN for v in result.views) else ''}"
    )


def _lineage(result: GapResult) -> Markup:
    before, after = result.model_before, result.model_after
    line = Markup("{} (<code>{}</code>) &rarr; {} (<code>{}</code>)")
    return paragraph(line.format(before.name, before.digest, after.name, after.digest))


def gap_figures(result: GapResult) -> dict[str, Callable[[], Picture]]:
    """The function that draws each figure of the page, by name: scores, residual maps, nameless curves, every flight."""
    figures: dict[str, Callable[[], Picture]] = {"scores": partial(score_figure, result)}
    if result.views:
        figures["residual_maps"] = partial(residual_maps, result)
    for step in result.steps:
        if isinstance(step.shape, ShapeCurve):
            figures[f"nameless_{step.shape.output}"] = partial(curve_figure, step.shape)
    return figures | {f"history_{h.flight}": partial(history_figure, h, result) for h in result.histories}


def _of_flight(note: str) -> tuple[str, str]:
    """(flight, sentence) of a note; flight is "all" where the note names none."""
    flight, separator, text = note.partition(": ")
    return (flight, text) if separator else ("all", note)


def typeset(equation: str) -> Markup:
    """C_nβ and the like with their subscripts lowered."""
    return Markup(re.sub(r"_([^\s_()|*+−=,;/]+)", r"<sub>\1</sub>", str(Markup.escape(equation))))


def history_figure(h: Histories, result: GapResult) -> Picture:
    """Measured and modelled values of every channel of one flight, before and after, with the residuals."""
    units = {s.name: s.unit for s in result.model_before.outputs}
    with styled():
        figure, axes = grid(len(result.outputs), 2, 1.45, own_scales=True, sharex=True)
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
    suffix = ", held out" if h.holdout else ""
    points = 5 * h.time.size * len(result.outputs)
    return picture(
        figure,
        f"history_{h.flight}",
        f"{h.flight}{suffix}: measured, model before and model after, and what is left.",
        points,
    )


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
    return picture(
        figure,
        f"nameless_{curve.output}_{variable}",
        f"The part of {output} without a name, by {variable}, with two standard deviations to either side; constant and slope "
        "are the base model's where it has them.",
    )


def score_figure(result: GapResult, most: int | None = None) -> Picture:
    """Scores of the hypotheses (of the `most` leading ones), and the threshold from simulated nulls."""
    from matplotlib.figure import Figure

    names = sorted(result.scores, key=lambda name: -result.scores[name])[:most]
    effects = {s.effect for s in result.steps}
    colours = [AFTER if n in effects else MEASURED for n in names]
    size = (9, 0.18 * len(names) + 1) if most is None else (5.6, 0.28 * len(names) + 1)
    with styled():
        figure = Figure(figsize=size, layout="constrained")
        axis = figure.subplots()
        axis.barh(range(len(names)), [max(result.scores[n], 1e-3) for n in names], color=colours)
        axis.set_yticks(range(len(names)), names, fontsize=7 if most is None else 9)
        axis.invert_yaxis()
        axis.margins(y=0.01)
        axis.axvline(result.threshold, color=BEFORE, lw=1, label=f"null threshold {result.threshold:.2f}")
        axis.set_xlabel("score in units of its scatter on the nulls")
        axis.legend(loc="lower right")
    if most is None:
        return picture(figure, "scores", "Every hypothesis of the catalogue with its score; in colour what is named.")
    return picture(
        figure, "leading", f"The {len(names)} leading hypotheses with their scores; in colour what is named."
    )
