"""The tables of the gap page, each with heads and units."""

import re
from collections.abc import Mapping, Sequence

from estimation.gap.answer.result import EffectStep, Gap, GapResult
from estimation.gap.answer.shape import ShapeCurve
from estimation.gap.effects.base import Effect
from estimation.report.flight_tables import collected
from estimation.report.tables import ReportTable, number, significant, value_and_bound

GAP_HEAD = ("before [σ]", "after [σ]", "floor [σ]", "closed [%]")
BEFORE_FLYING, MIGRATED = ("from [1/rad]", "to [1/rad]"), "moved by [bounds]"
LISTED = 16  # closest pairs in the table of ties; the JSON file has all
SHARED = (
    (r"^fits \d+% of its usual size", "fits only a small part of its usual size"),
    (r"^closes only \d+% of the gap", "closes too little of the gap"),
)
"""Reasons that come back in many rounds with other numbers, and their common wording."""


def step_gap(step: EffectStep) -> ReportTable:
    """The disagreement before and after a step, on the flights it was found on and on those held out."""
    rows = [("training flights", *_gap(step.gap))]
    if step.holdout is not None:
        rows.append(("held-out flights", *_gap(step.holdout)))
    return ReportTable(
        f"gap_{step.effect}", "Disagreement of model and flight", ("", *GAP_HEAD), tuple(rows), symbols=False
    )


def _gap(gap: Gap) -> tuple[str, str, str, str]:
    return number(gap.before, 3), number(gap.after, 3), number(gap.floor, 3), gap.share.removesuffix("%")


def step_parameters(step: EffectStep) -> ReportTable | None:
    """What was estimated of the effect."""
    if not step.estimates:
        return None
    rows = tuple((n, *value_and_bound(*e), _unit(step.units.get(n, ""))) for n, e in step.estimates.items())
    head = ("", "estimate", "bound", "unit")
    return ReportTable(f"parameters_{step.effect}", "Estimate of the effect", head, rows)


def value_and_unit(step: EffectStep, name: str) -> tuple[str, str]:
    """A parameter of the effect, and its bound with the unit."""
    value, bound = value_and_bound(*step.estimates[name])
    return value, f"{bound} {step.units.get(name, '')}".rstrip()


def step_members(step: EffectStep) -> ReportTable | None:
    """Effects that explain the disagreement about as well, where there are any."""
    if len(step.members) < 2:
        return None
    rows = tuple((m.effect, m.title, number(m.weight, 2), m.separate_by) for m in step.members)
    return ReportTable(
        f"members_{step.effect}",
        "What it could be",
        ("effect", "what it is", "weight", "what would separate it"),
        rows,
        symbols=False,
        texts=(1, 3),
        note="Weights add to one over the effects that explain the disagreement about as well.",
    )


def step_migrated(step: EffectStep) -> ReportTable | None:
    """Derivatives of the base that had absorbed the effect."""
    if not step.migrated:
        return None
    rows = tuple((n, number(m.before), number(m.after), number(m.bounds, 1)) for n, m in step.migrated.items())
    return ReportTable(
        f"migrated_{step.effect}", "Derivatives that had absorbed it", ("", *BEFORE_FLYING, MIGRATED), rows
    )


def step_formulas(step: EffectStep) -> ReportTable | None:
    """Plain formulas tried in place of a nameless curve."""
    if not isinstance(step.shape, ShapeCurve) or not step.shape.candidates:
        return None
    rows = tuple(
        (
            formula,
            ", ".join(f"{n} = {v:.4g} ± {s:.2g}" for n, (v, s) in estimates.items()),
            f"{100 * closed:.0f}",
            "as good as the curve" if as_good else "worse",
        )
        for formula, estimates, closed, as_good in step.shape.candidates
    )
    head = ("formula", "unknowns", "closed [%]", "")
    note = "Share of the whitened energy above the nulls' that is gone on the held-out flights, or on the training flights."
    return ReportTable(
        "formulas", "Plain formulas in place of the curve", head, rows, symbols=False, texts=(1, 3), note=note
    )


def missing_table(result: GapResult) -> ReportTable:
    """The part missing in each coefficient, stage by stage."""
    first = result.views[0]
    rows = tuple((n, *(significant(v.equations[n], 2) for v in result.views)) for n in first.equations)
    return ReportTable(
        "missing",
        "Missing in each coefficient, rms [1]",
        ("coefficient", *(v.stage for v in result.views)),
        rows,
        symbols=False,
    )


def repeat_table(result: GapResult) -> ReportTable | None:
    """Whether the flights repeat each other; those beyond the limit are in red."""
    entries = result.details["repeatability"]
    if not entries:
        return None
    words = {True: "FAIL: unlike the others", False: "pass"}
    rows = tuple((f["flight"], str(f["chi2"]), str(f["usual"]), str(f["limit"]), words[f["odd"]]) for f in entries)
    failed = frozenset((i, c) for i, f in enumerate(entries) if f["odd"] for c in (1, 4))
    return ReportTable(
        "repeatability",
        "Do the flights repeat each other?",
        ("flight", "fitted alone instead of together gains [χ²]", "usual [χ²]", "limit [χ²]", "verdict"),
        rows,
        symbols=False,
        texts=(4,),
        failed=failed,
        note="Red: beyond the limit. Usual and limit: simulated nulls.",
    )


def ties_table(result: GapResult) -> ReportTable | None:
    """Pairs of effects with nearly the same signature."""
    if not result.ties:
        return None
    rows = tuple((t.first, t.second, number(t.cosine, 3)) for t in result.ties[:LISTED])
    omitted = len(result.ties) - len(rows)
    note = "|cos| of their signatures in the residuals, 1: the same." + (
        f" {omitted} pairs that are told apart better are in gap.json." if omitted else ""
    )
    return ReportTable(
        "ties",
        "Effects that these flights cannot tell apart",
        ("effect", "effect", "|cos| [1]"),
        rows,
        symbols=False,
        note=note,
    )


def cannot_table(result: GapResult) -> ReportTable | None:
    """Effects that these flights would not show, by the manoeuvre that would."""
    manoeuvres = collected((c["separate_by"], c["effect"]) for c in result.details["cannot_tell"])
    if not manoeuvres:
        return None
    return ReportTable(
        "fly_next",
        "Not visible on these flights",
        ("fly next", "it would show"),
        tuple((fly, ", ".join(names)) for fly, names in manoeuvres.items()),
        symbols=False,
        texts=(0, 1),
    )


def rejected_table(result: GapResult) -> ReportTable | None:
    """Rejected hypotheses by reason; an effect may be rejected in several rounds."""
    reasons = collected((_reason(r.why, r.effect), r.effect) for r in result.rejected)
    if not reasons:
        return None
    return ReportTable(
        "rejected",
        "Looked at and rejected",
        ("why", "effects"),
        tuple((reason, ", ".join(names)) for reason, names in reasons.items()),
        symbols=False,
        texts=(0, 1),
    )


def _reason(why: str, effect: str) -> str:
    """A reason that several effects can share: without the effect's name at its head and without the numbers of one round."""
    for pattern, words in SHARED:
        why = re.sub(pattern, words, why)
    return why.removeprefix(f"{effect.partition(' ')[0]} ") if why.endswith("to nothing") else why


def sizes_table(result: GapResult, effects: Sequence[Effect]) -> ReportTable:
    """Score of every hypothesis, and the smallest size that would have been seen, with its unit."""
    units = _units(effects)
    rows = []
    for name, size in sorted(result.minimum_detectable.items(), key=lambda item: -result.scores.get(item[0], 0.0)):
        score = result.scores.get(name)
        rows.append((name, "" if score is None else number(score, 1), significant(size, 2), units.get(name, "")))
    return ReportTable(
        "sizes",
        "Smallest size that would have been seen",
        ("effect or its parameter", "score [σ of nulls]", "smallest size", "unit"),
        tuple(rows),
        symbols=False,
        note=f"An effect of this size would pass the threshold of {result.threshold:.2f} on these flights. Units as in "
        "the catalogue of effects; 1: none, or per radian.",
    )


def _units(effects: Sequence[Effect]) -> Mapping[str, str]:
    """Unit of every parameter by its name, and by the effect's name where that has one form."""
    units = {p.name: _unit(p.unit) for e in effects for form in e.forms for p in form.parameters}
    return units | {
        e.name: _unit(e.forms[0].parameters[0].unit) for e in effects if len(e.forms) == 1 and e.forms[0].parameters
    }


def _unit(unit: str) -> str:
    return unit or "1"
