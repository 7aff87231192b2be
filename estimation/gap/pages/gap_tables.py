"""The tables of the gap page, each with heads and units."""

import re
from collections.abc import Iterable, Sequence

from estimation.gap.answer.result import EffectStep, GapResult
from estimation.gap.answer.shape import ShapeCurve
from estimation.gap.effects.base import Effect
from estimation.report.flight_tables import collected
from estimation.report.tables import ReportTable, number, significant, value_and_bound

LISTED = 16  # closest pairs in the table of ties; the JSON file has all
SHARED = (
    (r"^fits \d+% of its usual size", "fits only a small part of its usual size"),
    (r"^closes only \d+% of the gap", "closes too little of the gap"),
)
"""Reasons that come back in many rounds with other numbers, and their common wording."""


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
