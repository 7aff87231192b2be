"""The gap workflow: from flights and a base model to a verdict, effects with sets and weights, and a better model.

Rounds of: baseline fit, nulls flown through the whole chain, score-test screen, full fits of the leading hypotheses,
held-out check, one effect added; until nothing is significant. Then the earlier effects are questioned again.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import norm

from estimation.gap.baseline import Baseline, Round, channel_noise, fit_baseline, screen_round
from estimation.gap.bench import Bench, build_bench
from estimation.gap.confirm import Candidate
from estimation.gap.dormant import with_dormant
from estimation.gap.effects.base import Effect
from estimation.gap.effects.missing import missing_derivatives
from estimation.gap.measure import Floors, floors, on_holdout, rms_over_noise
from estimation.gap.nulls import InputErrors, input_errors
from estimation.gap.nuisance import is_nuisance, with_nuisance
from estimation.gap.result import (
    Gap, GapResult, Migration, Rejected, Step, Tie, Verdict, Weighed, Where,
)  # fmt: skip
from estimation.gap.select import Choice, choose, credible_set
from estimation.gap.whitening import force_states
from estimation.models.base import Model
from groundstation.flight import Flight

LOOK = Callable[[str, float], None]


@dataclass(frozen=True)
class Options:
    """seed: of every random draw. nulls: simulated baselines per round. most: effects added at the most."""

    seed: int = 1
    nulls: int = 200
    most: int = 4
    level: float = 0.95


@dataclass(frozen=True)
class Finding:
    """An effect accepted in some round."""

    round_: Round
    choice: Choice
    candidate: Candidate
    child: Baseline


def run_gap(
    model: Model,
    training: Sequence[Flight],
    holdout: Sequence[Flight] = (),
    effects: Sequence[Effect] | None = None,
    options: Options = Options(),
    tell: LOOK = lambda what, share: None,
) -> GapResult:
    """Find, name and add what `model` lacks on the training flights.

    Raises MissingColumnError, DataError or GapError (one sentence each) where the flights cannot be used.
    """
    from estimation.gap.effects.catalogue import catalogue

    chosen = tuple(effects) if effects is not None else catalogue()
    chosen += missing_derivatives(model, {e.name for e in chosen})
    tell("preparing the flights", 0.0)
    bench = build_bench(model, chosen, training, holdout)
    records = bench.of(bench.training)
    scatter = channel_noise(records)
    interval = float(np.median([np.median(np.diff(r.time)) for r in records]))
    clean = with_nuisance(model, dict(zip(model.output_names, scatter, strict=True)), interval)
    working = with_dormant(clean, chosen, bench.available, force_states(model))
    errors = tuple(input_errors(r, clean, np.random.default_rng([options.seed, 104729, i])) for i, r in enumerate(bench.records))
    tell("fitting the baseline", 0.05)
    baseline = fit_baseline(working, clean, bench, scatter)
    findings, rounds = _rounds(baseline, bench, chosen, errors, options, tell)
    return _conclude(model, bench, findings, rounds, errors, options)


def _rounds(
    baseline: Baseline, bench: Bench, effects: Sequence[Effect], errors: Sequence[InputErrors], options: Options, tell: LOOK
) -> tuple[list[Finding], list[Round]]:
    findings: list[Finding] = []
    rounds: list[Round] = []
    while True:
        number = len(rounds)
        start = 0.1 + 0.8 * number / (options.most + 1)

        def tick(done: int, start: float = start) -> None:
            tell(f"round {number + 1}: null {done} of {options.nulls}", start + 0.1 * done / options.nulls)

        round_ = screen_round(baseline, bench, effects, errors, options.nulls, options.seed + 1000 * number, options.level, tick)
        rounds.append(round_)
        if len(findings) == options.most:
            return findings, rounds
        tell(f"round {number + 1}: full fits", start + 0.12)
        choice = choose(round_, bench)
        best = choice.best
        if best is None or best.score < round_.threshold:
            return findings, rounds
        form, at = best.hypothesis.form, {n: v for n, (v, _) in best.estimates.items()}
        child = fit_baseline(best.fit.model, form.added_to(baseline.clean, at), bench, baseline.scatter, best.fit.values, best.fit.locals, baseline.noise)
        findings.append(Finding(round_, choice, best, child))
        baseline = child


def _conclude(model: Model, bench: Bench, findings: Sequence[Finding], rounds: Sequence[Round],
              errors: Sequence[InputErrors], options: Options) -> GapResult:  # fmt: skip
    first, last = rounds[0], rounds[-1]
    scores = _effect_scores(first)
    steps = []
    for i, finding in enumerate(findings):
        after = rounds[i + 1]
        steps.append(_step(finding, after, bench, errors, options))
    verdict = Verdict.NO_GAP if not steps else Verdict.GAP_CLOSED
    return GapResult(
        verdict=verdict,
        text="",
        minimum_detectable=_detectable(last),
        steps=tuple(steps),
        scores=scores,
        threshold=first.threshold,
        nominal_threshold=float(norm.isf(0.025 / max(len(first.screen.hypotheses), 1))),
        rejected=tuple(r for f in findings for r in f.choice.rejected),
        ties=_ties(last),
        model_before=model,
        model_after=last.baseline.clean,
        notes=bench.notes,
        outputs=model.output_names,
    )


def _step(finding: Finding, after: Round, bench: Bench, errors: Sequence[InputErrors], options: Options) -> Step:
    effect = finding.candidate.hypothesis.effect
    members = credible_set(finding.choice.weights)
    parent, child = finding.round_.baseline, finding.child
    held_before, held_after = on_holdout(parent, bench), on_holdout(child, bench)
    floor = floors(after, held_after, errors[len(bench.of(bench.training)):], options.seed)
    gap = Gap(rms_over_noise(parent.fit.residuals, parent.scatter), rms_over_noise(child.fit.residuals, parent.scatter), floor.training_median)
    held = None
    if held_before is not None and held_after is not None and floor.holdout_median is not None:
        held = Gap(
            rms_over_noise(held_before[1].residuals, parent.scatter),
            rms_over_noise(held_after[1].residuals, parent.scatter),
            floor.holdout_median,
        )
    std = child.fit.std()
    return Step(
        effect=effect.name, title=effect.title, form=finding.candidate.hypothesis.form.label,
        confidence=members[0][1],
        members=tuple(Weighed(n, w) for n, w in members),
        separate_by=effect.separate_by,
        estimates={p.name: (float(child.fit.values[p.name]), float(std[p.name])) for p in finding.candidate.hypothesis.form.parameters},
        units={p.name: p.unit for p in finding.candidate.hypothesis.form.parameters},
        score=finding.candidate.score, threshold=finding.round_.threshold,
        where=Where("", (), (), ""),
        gap=gap, holdout=held, migrated=_migrated(parent, child), equation=effect.equation,
    )  # fmt: skip


def _migrated(parent: Baseline, child: Baseline) -> dict[str, Migration]:
    std = child.fit.std()
    moved = {}
    for name in parent.fit.free:
        if is_nuisance(name) or name not in child.fit.values:
            continue
        before, after = parent.fit.values[name], child.fit.values[name]
        bounds = abs(after - before) / max(std[name], 1e-300)
        if bounds > 3.0:
            moved[name] = Migration(before, after, bounds, parent.model.parameter(name).reference)
    return dict(sorted(moved.items(), key=lambda item: -item[1].bounds))


def _effect_scores(round_: Round) -> dict[str, float]:
    scores: dict[str, float] = {}
    for h, value in enumerate(round_.standardised()):
        name = round_.screen.hypotheses[h].effect.name
        scores[name] = max(scores.get(name, 0.0), float(value))
    return dict(sorted(scores.items(), key=lambda item: -item[1]))


def _detectable(round_: Round) -> dict[str, float]:
    """Smallest size of each parameter that would have passed the threshold on these flights."""
    projected = round_.screen.projected()
    sizes = {}
    for c, column in enumerate(round_.screen.columns):
        information = max(float(projected.B[c, c]), 1e-300) / round_.inflation[column.hypothesis]
        name = round_.screen.hypotheses[column.hypothesis].effect.name
        key = name if name not in sizes and len(round_.screen.hypotheses[column.hypothesis].effect.forms) == 1 else column.parameter.name
        sizes[key] = round_.threshold / float(np.sqrt(information))
    return sizes


def _ties(round_: Round, least: float = 0.9) -> tuple[Tie, ...]:
    cosines = round_.screen.projected().cosines()
    found = []
    columns = round_.screen.columns
    for i in range(len(columns)):
        for j in range(i + 1, len(columns)):
            a, b = round_.screen.hypotheses[columns[i].hypothesis], round_.screen.hypotheses[columns[j].hypothesis]
            if a.effect.name != b.effect.name and abs(cosines[i, j]) >= least:
                found.append(Tie(a.label, b.label, float(abs(cosines[i, j]))))
    return tuple(sorted(found, key=lambda t: -t.cosine))
