"""The answer of `gap` on one screen: a sentence, the effects with their bounds, the leading scores, and the next steps."""

from dataclasses import replace
from pathlib import Path

from markupsafe import Markup

from estimation.gap.answer.result import EffectStep, GapResult, GapVerdict
from estimation.gap.answer.shape import NotPredicted
from estimation.gap.pages.gap_tables import value_and_unit
from estimation.report.drawing.figures import Picture
from estimation.report.flight_tables import collected
from estimation.report.page import Section, bullets, paragraph
from estimation.report.tables import ReportTable, number

SMALLEST = 8  # rows of the table of smallest sizes, where no effect was found
FLY_NEXT = 3  # manoeuvres; the table further down has all


def first_screen(result: GapResult, sizes: ReportTable, scores: Picture, note: Markup) -> list[Section]:
    """Sentence; table beside picture; next steps. sizes: the smallest size of each effect that would have been seen."""
    table = _found(result) if result.steps else replace(sizes, name="smallest", rows=sizes.rows[:SMALLEST], filed=False)
    return [
        Section("", "", [paragraph(f"{result.text[:1].upper()}{result.text[1:]}", "verdict-line")]),
        Section("answer", "", [table, scores], kind="answer"),
        Section("", "", [Markup("<p><b>Next</b></p>"), bullets(next_steps(result)), note]),
    ]


def _found(result: GapResult) -> ReportTable:
    """Each parameter of each effect, and the share of the gap that the effect closes."""
    rows = [row for step in result.steps for row in _step_rows(step)]
    head = ("", "estimate", "± bound", "score", "threshold", "closed", "held out")
    caption = (
        "What was found; bound: one standard deviation; closed: of the gap, on the flights fitted and on those held out"
    )
    return ReportTable("found", caption, head, tuple(rows), filed=False)


def _step_rows(step: EffectStep) -> list[tuple[str, ...]]:
    held_out = "" if step.holdout is None else step.holdout.share
    shares = (number(step.score, 1), number(step.threshold, 1), step.gap.share, held_out)
    rows = [(name, *value_and_unit(step, name)) for name in step.estimates] or [(step.effect, "", "")]
    return [(*row, *(shares if k == 0 else [""] * len(shares))) for k, row in enumerate(rows)]


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
        manoeuvres = collected((c["separate_by"], c["effect"]) for c in result.details["cannot_tell"])
        steps += [f"Fly {fly}: it would show {', '.join(names)}." for fly, names in manoeuvres.items() if fly][
            :FLY_NEXT
        ]
    if result.verdict is GapVerdict.NO_GAP:
        steps.append("Watch the next flights with this model: watch FLIGHT --model MODEL.toml.")
    unlike = [step for step in result.steps if isinstance(step.shape, NotPredicted)]
    steps += [f"{step.separate_by[:1].upper()}{step.separate_by[1:]}." for step in unlike]
    if result.verdict is GapVerdict.UNKNOWN and not unlike:
        steps.append("Fly the same manoeuvre again: what is real comes back; then look where it lives, below.")
    return steps or ["Fly more of the motion that the model is to predict, and ask again."]
