"""From the trail of the rounds to the verdict: steps, models before and after, histories for pictures."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.stats import norm

from estimation.gap.admissible import repeatability
from estimation.gap.baseline import Baseline, Round
from estimation.gap.gate import Gate
from estimation.gap.lineage import fitted
from estimation.gap.measure import floors, on_holdout, rms_over_noise
from estimation.gap.result import Gap, GapResult, Histories, Rejected, Step, Verdict
from estimation.gap.steps import step_of, unknown_step
from estimation.gap.tables import detectable_sizes, effect_scores, ties_of, undetectable
from estimation.gap.trail import Setting, Trail
from estimation.gap.where import views
from estimation.gap.words import conclude, describe_step

NAMED_CLOSED = 0.7  # of the gap: below, the rest is larger than noise
NAMED_OUTWEIGHS = 0.8  # of the significance, in energy: above, a name stands whatever the plain gap says
OWN_OUTWEIGHS = 0.9  # the same where the rest lives in the very instrument that the name blames
BLIND_SHARE = 0.12  # of the effects asked about: more that could not have been seen, and the answer is "cannot tell"


def closed_by(steps: Sequence[Step], after: float) -> float:
    """Share of the gap that steps close, down to `after` on the training flights or, where that is more, on the held-out ones:
    the weather of the day is in both, and in the training flights the base had its chance to absorb the effect."""
    first, last = steps[0], steps[-1]
    closed = Gap(first.gap.before, after, last.gap.floor).closed
    if first.holdout is None or last.holdout is None:
        return closed
    return max(closed, Gap(first.holdout.before, last.holdout.after, last.holdout.floor).closed)


def conclude_trail(setting: Setting, trail: Trail, gate: Gate) -> GapResult:
    """Verdict, steps and words from what the rounds left."""
    bench, options = setting.bench, setting.options
    first, last = trail.rounds[0], trail.rounds[-1]
    held_errors = setting.errors[len(bench.of(bench.training)) :]
    floor = floors(last, on_holdout(last.baseline, bench), held_errors, options.seed)
    steps = [step_of(setting, f, floor) for f in trail.findings]
    left = rms_over_noise(last.baseline.problem, last.baseline.fit, setting.scatter)
    shut = floor.covers(left)
    unknown = trail.unknown
    if steps_close(trail, shut):
        unknown = False
    few = bool(steps) and closed_by(steps[-1:], steps[-1].gap.after) < NAMED_CLOSED
    if unknown and few and not shut and not outweighs(steps[-1].score, trail.omnibus.score):
        dropped = steps.pop()
        trail = replace(
            trail,
            rejected=(*trail.rejected, Rejected(dropped.effect, f"closes only {dropped.gap.closed:.0%} of the gap")),
        )
    if unknown:
        steps, said = without_impostors(steps, trail)
        trail = replace(trail, rejected=(*trail.rejected, *said))
    kept = trail.findings[: len(steps)]
    cannot = undetectable(first, setting.base)
    if unknown:
        steps.append(unknown_step(trail, Gap(left, left, floor.training_median)))
        verdict = Verdict.UNKNOWN
    elif steps:
        nothing_left = not trail.omnibus.significant
        closed = shut or nothing_left or closed_by(steps, left) >= NAMED_CLOSED
        verdict = Verdict.GAP_CLOSED if closed else Verdict.GAP_REDUCED
    else:
        asked = {h.effect.name for h in first.screen.hypotheses if not h.effect.tied_to}
        verdict = Verdict.CANNOT_TELL if len(cannot) > BLIND_SHARE * max(len(asked), 1) else Verdict.NO_GAP
    if steps:  # the gate saw the flights as they are: it speaks of the first effect
        steps[0] = replace(steps[0], where=replace(steps[0].where, origin=gate.origin))
    steps = [replace(s, text=describe_step(s)) for s in steps]
    detectable = detectable_sizes(last)
    tied = tuple(
        e for e in setting.effects if e.tied_to and any(h.effect.name == e.name for h in first.screen.hypotheses)
    )
    before = fitted(setting.base, first.baseline.fit.values)
    after = before
    if kept:
        child, plain = kept[-1].child, setting.base
        for f in kept:
            plain = f.candidate.hypothesis.form.added_to(plain)
        names = "+".join(f.candidate.hypothesis.effect.name for f in kept)
        after = replace(fitted(plain, child.fit.values), name=f"{setting.base.name}+{names}")
    seen = views(first.baseline, kept[-1].child if kept else first.baseline, bench, bool(kept))
    repeats = repeatability(last, bench.names)
    odd = [r.flight for r in repeats if r.odd]
    return GapResult(
        verdict=verdict,
        text=conclude(verdict, steps, detectable, cannot, tied, bool(bench.holdout), odd),
        minimum_detectable=detectable,
        steps=tuple(steps),
        scores=effect_scores(first),
        threshold=first.threshold,
        nominal_threshold=float(norm.isf(0.025 / max(len(first.screen.hypotheses), 1))),
        rejected=trail.rejected,
        ties=ties_of(first),
        model_before=before,
        model_after=after,
        notes=bench.notes,
        outputs=setting.base.output_names,
        views=seen,
        histories=histories(setting, first.baseline, kept[-1].child if kept else first.baseline, last),
        details={
            "kinematic_gate": gate.to_json(),
            "cannot_tell": [{"effect": e.name, "separate_by": e.separate_by} for e in cannot],
            "left": [
                {"kind": s.kind, "place": s.place, "what": s.what, "score": round(s.score, 2)}
                for s in trail.omnibus.leading[:5]
            ],
            "left_threshold": round(float(trail.omnibus.threshold), 2),
            "where": [v.to_json() for v in seen],
            "repeatability": [r.to_json() for r in repeats],
            "nulls": options.nulls, "seed": options.seed,
        },
    )  # fmt: skip


def outweighs(named: float, rest: float, share: float = NAMED_OUTWEIGHS) -> bool:
    """Whether a named effect holds most of what is significant, whatever the plain gap says.

    named, rest: scores of the effect and of the strongest nameless term after it, both on whitened residuals. share: of
    the sum of their squares. The plain gap also counts slow errors of an attitude filter and the gusts of the day, beside
    which a certain effect can look small.
    """
    return named**2 >= share * (named**2 + rest**2)


def without_impostors(steps: Sequence[Step], trail: Trail) -> tuple[list[Step], list[Rejected]]:
    """Steps up to the first that names a fault of the very instrument in which the nameless rest lives, without outweighing it.

    A vane that sticks is late too, but what is wrong with it is not that it is late. Later steps were found on top of it.
    """
    place = trail.omnibus.leading[0].place
    for k, (step, finding) in enumerate(zip(steps, trail.findings, strict=False)):
        form = finding.candidate.hypothesis.form
        own = place in (*form.outputs, *form.output_delays)
        if own and not outweighs(step.score, trail.omnibus.score, OWN_OUTWEIGHS):
            why = f"the nameless rest in {place} is too large beside it: the instrument does something else than this"
            return list(steps[:k]), [Rejected(s.effect, why) for s in steps[k:]]
    return list(steps), []


def steps_close(trail: Trail, shut: bool) -> bool:
    """Whether named effects bring the gap within what nulls show and the nameless rest is no more than restless scatter."""
    return bool(trail.findings) and shut and trail.omnibus.score < 2.0 * trail.omnibus.threshold


def histories(setting: Setting, before: Baseline, after: Baseline, last: Round) -> tuple[Histories, ...]:
    """Measured, before and after over time for every flight, training and held out."""
    band = np.array([np.nanstd(np.concatenate([n[i][:, c] for n in last.null_residuals[:20] for i in range(len(n))]))
                     for c in range(len(setting.base.outputs))])  # fmt: skip
    bench, made = setting.bench, []
    pairs = [(before.problem, before.fit, after.fit, False)]
    held_before, held_after = on_holdout(before, bench), on_holdout(after, bench)
    if held_before is not None and held_after is not None:
        pairs.append((held_before[0], held_before[1], held_after[1], True))
    for problem, one, two, held in pairs:
        for i, record in enumerate(problem.records):
            z = problem.coarse[i].z
            made.append(
                Histories(
                    bench.names[record.flight], held, record.time, z, z - one.residuals[i], z - two.residuals[i], band
                )
            )
    return tuple(made)
