"""The gap report: one self-contained HTML page for a flight-test engineer."""

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

from markupsafe import Markup

from estimation.gap.answer.result import PRIOR_FROZEN, EffectStep, GapResult, GapVerdict
from estimation.gap.answer.shape import NotPredicted, ShapeCurve
from estimation.gap.effects import catalogue
from estimation.gap.effects.base import Effect
from estimation.gap.pages import gap_tables
from estimation.gap.pages.figures import curve_figure, history_figure, residual_maps, score_figure
from estimation.report.drawing.figures import Picture
from estimation.report.flight_tables import collected, notes_table
from estimation.report.page import Page, Part, Section, bullets, paragraph, sentence
from estimation.report.tables import ReportTable

LEADING = 12  # hypotheses on the first screen
SMALLEST = 8  # rows of its table of smallest sizes, where no effect was found
FLY_NEXT = 3  # manoeuvres among the next steps; the table further down has all
TITLES = {
    GapVerdict.NO_GAP: "No gap",
    GapVerdict.GAP_CLOSED: "Gap found and closed",
    GapVerdict.GAP_REDUCED: "Gap found and reduced",
    GapVerdict.UNKNOWN: "A gap nothing in the catalogue explains",
    GapVerdict.CANNOT_TELL: "These flights cannot tell",
}


def write_gap_report(result: GapResult, folder: Path, effects: Sequence[Effect] = ()) -> Path:
    """Write folder/index.html with its pictures inside, and its tables as CSV and LaTeX in folder/tables; returns the page.

    effects: those of the run, for their units; by default the catalogue.
    """
    sizes = gap_tables.sizes_table(result, effects or catalogue(model=result.model_before))
    detail = partial(Section, folded=True)
    places: list[Part] = []
    if result.views:
        places = [_stages(result), residual_maps(result), gap_tables.missing_table(result)]
    repeat = gap_tables.repeat_table(result)
    histories = [history_figure(h, result) for h in result.histories]
    hypotheses: list[Part] = [score_figure(result), sizes, gap_tables.rejected_table(result)]
    limits = [t for t in (gap_tables.ties_table(result), gap_tables.cannot_table(result)) if t is not None]
    seen = paragraph("These flights would show every effect of the catalogue, and tell each from the others.")
    notes = notes_table((_of_flight(n) for n in result.notes), filed=True)
    sections = [
        *_first_screen(result, sizes),
        *(
            detail(f"step{n}", f"{n}. {_step_title(step)}", list(_step_parts(step, result.text)), step.effect)
            for n, step in enumerate(result.steps, start=1)
        ),
        detail("where", "Where the disagreement lives", places, "Where") if places else None,
        detail("repeat", "Repeatability", [repeat]) if repeat else None,
        detail("histories", "Measured, before, after", histories, "Histories"),
        detail("hypotheses", "All hypotheses", hypotheses, "Hypotheses", printed=False),
        detail("limits", "What these flights cannot tell", limits or [seen], "What these flights cannot tell"),
        detail("lineage", "Lineage", [_lineage(result), notes], "Lineage"),
    ]
    # a flight of several stretches has a history for each
    flights = dict.fromkeys(h.flight + (" (held out)" if h.holdout else "") for h in result.histories)
    lead = f"Model {result.model_before.name}; flights: {', '.join(flights)}."
    return Page(TITLES[result.verdict], lead, sections).write(folder / "index.html", folder / "tables")


def gap_figures(result: GapResult) -> dict[str, Callable[[], Picture]]:
    """The function that draws each figure of the page, by name: scores, residual maps, nameless curves, every flight."""
    figures: dict[str, Callable[[], Picture]] = {"scores": partial(score_figure, result)}
    if result.views:
        figures["residual_maps"] = partial(residual_maps, result)
    for step in result.steps:
        if isinstance(step.shape, ShapeCurve):
            figures[f"nameless_{step.shape.output}"] = partial(curve_figure, step.shape)
    return figures | {f"history_{h.flight}": partial(history_figure, h, result) for h in result.histories}


def _first_screen(result: GapResult, sizes: ReportTable) -> list[Section]:
    """Sentence; table beside picture; next steps. sizes: the smallest size of each effect that would have been seen."""
    if result.steps:
        table = gap_tables.found_table(result)
    else:
        table = replace(sizes, name="smallest", rows=sizes.rows[:SMALLEST], filed=False)
    return [
        Section("", "", [paragraph(f"{result.text[:1].upper()}{result.text[1:]}", "verdict-line")]),
        Section("answer", "", [table, score_figure(result, LEADING)], kind="answer"),
        Section("", "", [Markup("<p><b>Next</b></p>"), bullets(next_steps(result)), _meaning(result)]),
    ]


def next_steps(result: GapResult) -> list[str]:
    """What to do after this answer."""
    steps = [
        f"Fly {step.separate_by}: it would tell {' from '.join(m.effect for m in step.members)}."
        for step in result.steps
        if step.separate_by and len(step.members) > 1
    ]
    if result.verdict in (GapVerdict.GAP_CLOSED, GapVerdict.GAP_REDUCED):
        if not any(h.holdout for h in result.histories):
            steps.append("Hold a flight out, gap FLIGHT... --holdout FLIGHT: only it shows that an effect is real.")
        child = f"models/{Path(result.files[1]).name}" if result.files[1] else "MODEL.toml"
        steps.append(f"Predict a flight that was not used: match {child} FLIGHT.")
    if result.verdict in (GapVerdict.NO_GAP, GapVerdict.CANNOT_TELL):
        manoeuvres = collected(
            (c["separate_by"], c["effect"]) for c in result.details["cannot_tell"] if c["separate_by"]
        )
        steps += [f"Fly {fly}: it would show {', '.join(names)}." for fly, names in list(manoeuvres.items())[:FLY_NEXT]]
    if result.verdict is GapVerdict.NO_GAP:
        steps.append("Watch the next flights with this model: watch FLIGHT --model MODEL.toml.")
    unlike = [sentence(step.separate_by) for step in result.steps if isinstance(step.shape, NotPredicted)]
    steps += unlike
    if result.verdict is GapVerdict.UNKNOWN and not unlike:
        steps.append("Fly the same manoeuvre again: what is real comes back; then look where it lives, below.")
    return steps or ["Fly more of the motion that the model is to predict, and ask again."]


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


def _step_title(step: EffectStep) -> str:
    return f"{step.title[0].upper()}{step.title[1:]} ({step.effect})"


def _step_parts(step: EffectStep, verdict: str) -> Iterator[Part]:
    """A step: equation, description, place, curve where it has no name, tables. verdict: text that the page has already."""
    if step.equation:
        yield paragraph(typeset(step.equation), "eq")
    if step.text != verdict:
        yield paragraph(step.text)
    where = step.where
    details = [
        f"channels {', '.join(where.channels)}" if where.channels else "",
        where.regime,
        f"mostly at {', '.join(f'{a:.1f} to {b:.1f} s' for a, b in where.segments)}" if where.segments else "",
    ]
    place = "; ".join([where.equation, *filter(None, details)])
    yield paragraph(f"Score {step.score:.1f} against the threshold of {step.threshold:.1f}. Where: {place}.")
    if step.practical:
        practical = step.practical if step.practical.startswith("matters") else f"is {step.practical}"
        yield paragraph(f"In flight-simulator tolerances it {practical}.")
    if step.absorbed is not None:
        share = f"{100 * step.absorbed:.0f} %"
        yield paragraph(Markup(f"The base's own derivatives can take over {share} of its signature."))
    if isinstance(step.shape, ShapeCurve):
        yield curve_figure(step.shape)
    yield gap_tables.step_gap(step)
    yield gap_tables.step_parameters(step)
    yield gap_tables.step_members(step)
    yield gap_tables.step_migrated(step)
    yield gap_tables.step_formulas(step)


def _stages(result: GapResult) -> Markup:
    text = "; ".join(f"{view.stage}: {view.gap:.2f}" for view in result.views) + " times the measurement noise."
    if any(view.stage == PRIOR_FROZEN for view in result.views):
        text += (
            " Frozen at what was believed before the flights the disagreement stands where it arises; a refit hides most of it "
            "in the derivatives."
        )
    return paragraph(text)


def _lineage(result: GapResult) -> Markup:
    before, after = result.model_before, result.model_after
    line = Markup("{} (<code>{}</code>) &rarr; {} (<code>{}</code>)")
    return paragraph(line.format(before.name, before.digest, after.name, after.digest))


def _of_flight(note: str) -> tuple[str, str]:
    """(flight, sentence) of a note; flight is "all" where the note names none."""
    flight, separator, text = note.partition(": ")
    return (flight, text) if separator else ("all", note)


def typeset(equation: str) -> Markup:
    """C_nβ and the like with their subscripts lowered."""
    return Markup(re.sub(r"_([^\s_()|*+−=,;/]+)", r"<sub>\1</sub>", str(Markup.escape(equation))))
