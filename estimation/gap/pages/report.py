"""The gap report: one self-contained HTML page for a flight-test engineer, and its tables, each with heads and units."""

import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

from markupsafe import Markup

from estimation.gap.answer.result import PRIOR_FROZEN, EffectStep, GapResult, GapVerdict
from estimation.gap.answer.shape import NotPredicted, ShapeCurve
from estimation.gap.effects import catalogue
from estimation.gap.effects.base import Effect
from estimation.gap.pages.figures import curve_figure, history_figure, residual_maps, score_figure
from estimation.report.drawing.figures import Picture
from estimation.report.flight_tables import collected, notes_table
from estimation.report.page import Page, Part, Section, bullets, paragraph, sentence
from estimation.report.tables import ReportTable, number, significant, value_and_bound

LEADING = 12  # hypotheses on the first screen
SMALLEST = 8  # rows of its table of smallest sizes, where no effect was found
FLY_NEXT = 3  # manoeuvres among the next steps; the table further down has all
LISTED = 16  # closest pairs in the table of ties; the JSON file has all
SHARED = (
    (r"^fits \d+% of its usual size", "fits only a small part of its usual size"),
    (r"^closes only \d+% of the gap", "closes too little of the gap"),
)
"""Reasons that come back in many rounds with other numbers, and their common wording."""
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
    sizes = sizes_table(result, effects or catalogue(model=result.model_before))
    detail = partial(Section, folded=True)
    places: list[Part] = []
    if result.views:
        places = [_stages(result), residual_maps(result), missing_table(result)]
    repeat = repeat_table(result)
    histories = [history_figure(h, result) for h in result.histories]
    hypotheses: list[Part] = [score_figure(result), sizes, rejected_table(result)]
    limits = [t for t in (ties_table(result), cannot_table(result)) if t is not None]
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
        table = found_table(result)
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
    yield step_gap(step)
    yield step_parameters(step)
    yield step_members(step)
    yield step_migrated(step)
    yield step_formulas(step)


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


# ---- tables
def _table(
    name: str,
    caption: str,
    head: tuple[str, ...],
    rows: Iterable[tuple[str, ...]],
    texts: tuple[int, ...] = (),
    note: str = "",
    symbols: bool = False,
) -> ReportTable | None:
    """A table; None without rows."""
    cells = tuple(rows)
    return ReportTable(name, caption, head, cells, symbols=symbols, texts=texts, note=note) if cells else None


def found_table(result: GapResult) -> ReportTable:
    """Each parameter of each effect, and the share of the gap that the effect closes."""
    head = ("", "estimate", "± bound", "score", "threshold", "closed", "held out")
    caption = (
        "What was found; bound: one standard deviation; closed: of the gap, on the flights fitted and on those held out"
    )
    rows = tuple(row for step in result.steps for row in _found_rows(step))
    return ReportTable("found", caption, head, rows, filed=False)


def _found_rows(step: EffectStep) -> list[tuple[str, ...]]:
    """A row for each parameter; what the whole effect has stands in the first."""
    rows = []
    for name, estimate in step.estimates.items():
        value, bound = value_and_bound(*estimate)
        rows.append((name, value, f"{bound} {step.units.get(name, '')}".rstrip()))
    first, *others = rows or [(step.effect, "", "")]
    held_out = "" if step.holdout is None else step.holdout.share
    whole = (number(step.score, 1), number(step.threshold, 1), step.gap.share, held_out)
    return [(*first, *whole), *((*row, "", "", "", "") for row in others)]


def step_gap(step: EffectStep) -> ReportTable | None:
    """The disagreement before and after a step, on the flights it was found on and on those held out."""
    gaps = [("training flights", step.gap), ("held-out flights", step.holdout)]
    rows = (
        (flights, number(gap.before, 3), number(gap.after, 3), number(gap.floor, 3), gap.share.removesuffix("%"))
        for flights, gap in gaps
        if gap is not None
    )
    head = ("", "before [σ]", "after [σ]", "floor [σ]", "closed [%]")
    return _table(f"gap_{step.effect}", "Disagreement of model and flight", head, rows)


def step_parameters(step: EffectStep) -> ReportTable | None:
    """What was estimated of the effect."""
    rows = ((n, *value_and_bound(*e), step.units.get(n, "") or "1") for n, e in step.estimates.items())
    head = ("", "estimate", "bound", "unit")
    return _table(f"parameters_{step.effect}", "Estimate of the effect", head, rows, symbols=True)


def step_members(step: EffectStep) -> ReportTable | None:
    """Effects that explain the disagreement about as well, where there are any."""
    members = step.members if len(step.members) > 1 else ()
    rows = ((m.effect, m.title, number(m.weight, 2), m.separate_by) for m in members)
    head = ("effect", "what it is", "weight", "what would separate it")
    note = "Weights add to one over the effects that explain the disagreement about as well."
    return _table(f"members_{step.effect}", "What it could be", head, rows, (1, 3), note)


def step_migrated(step: EffectStep) -> ReportTable | None:
    """Derivatives of the base that had absorbed the effect."""
    rows = ((n, number(m.before), number(m.after), number(m.bounds, 1)) for n, m in step.migrated.items())
    head = ("", "from [1/rad]", "to [1/rad]", "moved by [bounds]")
    return _table(f"migrated_{step.effect}", "Derivatives that had absorbed it", head, rows, symbols=True)


def step_formulas(step: EffectStep) -> ReportTable | None:
    """Plain formulas tried in place of a nameless curve."""
    candidates = step.shape.candidates if isinstance(step.shape, ShapeCurve) else ()
    rows = []
    for formula, estimates, closed, as_good in candidates:
        unknowns = ", ".join(f"{n} = {v:.4g} ± {s:.2g}" for n, (v, s) in estimates.items())
        rows.append((formula, unknowns, f"{100 * closed:.0f}", "as good as the curve" if as_good else "worse"))
    head = ("formula", "unknowns", "closed [%]", "")
    note = "Share of the whitened energy above the nulls' that is gone on the held-out flights, or on the training flights."
    return _table("formulas", "Plain formulas in place of the curve", head, rows, (1, 3), note)


def missing_table(result: GapResult) -> ReportTable:
    """The part missing in each coefficient, stage by stage."""
    rows = tuple((n, *(significant(v.equations[n], 2) for v in result.views)) for n in result.views[0].equations)
    head = ("coefficient", *(v.stage for v in result.views))
    return ReportTable("missing", "Missing in each coefficient, rms [1]", head, rows, symbols=False)


def repeat_table(result: GapResult) -> ReportTable | None:
    """Whether the flights repeat each other; those beyond the limit are in red."""
    entries = result.details["repeatability"]
    if not entries:
        return None
    words = {True: "FAIL: unlike the others", False: "pass"}
    return ReportTable(
        "repeatability",
        "Do the flights repeat each other?",
        ("flight", "fitted alone instead of together gains [χ²]", "usual [χ²]", "limit [χ²]", "verdict"),
        tuple((f["flight"], str(f["chi2"]), str(f["usual"]), str(f["limit"]), words[f["odd"]]) for f in entries),
        symbols=False,
        texts=(4,),
        failed=frozenset((i, c) for i, f in enumerate(entries) if f["odd"] for c in (1, 4)),
        note="Red: beyond the limit. Usual and limit: simulated nulls.",
    )


def ties_table(result: GapResult) -> ReportTable | None:
    """Pairs of effects with nearly the same signature."""
    rows = ((t.first, t.second, number(t.cosine, 3)) for t in result.ties[:LISTED])
    omitted = len(result.ties) - LISTED
    note = "|cos| of their signatures in the residuals, 1: the same."
    if omitted > 0:
        note += f" {omitted} pairs that are told apart better are in gap.json."
    head = ("effect", "effect", "|cos| [1]")
    return _table("ties", "Effects that these flights cannot tell apart", head, rows, note=note)


def cannot_table(result: GapResult) -> ReportTable | None:
    """Effects that these flights would not show, by the manoeuvre that would."""
    manoeuvres = collected((c["separate_by"], c["effect"]) for c in result.details["cannot_tell"])
    rows = ((fly, ", ".join(names)) for fly, names in manoeuvres.items())
    return _table("fly_next", "Not visible on these flights", ("fly next", "it would show"), rows, (0, 1))


def rejected_table(result: GapResult) -> ReportTable | None:
    """Rejected hypotheses by reason; an effect may be rejected in several rounds."""
    reasons = collected((_reason(r.why, r.effect), r.effect) for r in result.rejected)
    rows = ((reason, ", ".join(names)) for reason, names in reasons.items())
    return _table("rejected", "Looked at and rejected", ("why", "effects"), rows, (0, 1))


def _reason(why: str, effect: str) -> str:
    """A reason that several effects can share: without the effect's name at its head and without the numbers of one round."""
    for pattern, words in SHARED:
        why = re.sub(pattern, words, why)
    return why.removeprefix(f"{effect.partition(' ')[0]} ") if why.endswith("to nothing") else why


def sizes_table(result: GapResult, effects: Sequence[Effect]) -> ReportTable:
    """Score of every hypothesis, and the smallest size that would have been seen, with its unit."""
    units = {p.name: p.unit or "1" for e in effects for form in e.forms for p in form.parameters}
    # an effect of one form stands by its own name for its first parameter
    units |= {
        e.name: e.forms[0].parameters[0].unit or "1" for e in effects if len(e.forms) == 1 and e.forms[0].parameters
    }
    sizes = sorted(result.minimum_detectable.items(), key=lambda item: -result.scores.get(item[0], 0.0))
    return ReportTable(
        "sizes",
        "Smallest size that would have been seen",
        ("effect or its parameter", "score [σ of nulls]", "smallest size", "unit"),
        tuple((n, number(result.scores.get(n), 1), significant(size, 2), units.get(n, "")) for n, size in sizes),
        symbols=False,
        note=f"An effect of this size would pass the threshold of {result.threshold:.2f} on these flights. Units as in "
        "the catalogue of effects; 1: none, or per radian.",
    )
