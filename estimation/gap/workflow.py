"""The gap workflow: from flights and a base model to a verdict, effects with sets and weights, and a better model.

Rounds of: baseline fit, nulls flown through the whole chain, score-test screen, full fits of the leading hypotheses,
held-out check, one effect added; until nothing is significant. Then the earlier effects are questioned again.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import norm

from estimation.engine.kernel import Array
from estimation.gap.baseline import Baseline, Round, bank_error, channel_noise, fit_baseline, screen_round
from estimation.gap.bench import Bench, build_bench
from estimation.gap.confirm import Candidate, assess, fit_hypothesis, linear_gains, linear_guess
from estimation.gap.dormant import awakened, with_dormant
from estimation.gap.effects import catalogue
from estimation.gap.effects.base import Effect
from estimation.gap.effects.missing import missing_derivatives
from estimation.gap.errors import GapError
from estimation.gap.fitting import prior_cost
from estimation.gap.gate import Gate, kinematic_gate
from estimation.gap.lineage import fitted
from estimation.gap.locate import disagreement, locate
from estimation.gap.measure import Floors, floors, on_holdout, predictive_cost, rms_over_noise
from estimation.gap.nuisance import is_nuisance, with_nuisance
from estimation.gap.nulls import InputErrors, input_errors
from estimation.gap.omnibus import Omnibus, examine
from estimation.gap.result import Gap, GapResult, Histories, Migration, Rejected, Step, Tie, Verdict, Weighed, Where
from estimation.gap.screen import build_screen, hypotheses_for
from estimation.gap.select import Choice, choose, credible_set
from estimation.gap.whitening import force_states
from estimation.gap.words import BANDS, conclude, describe_step
from estimation.models.base import Model
from groundstation.flight import Flight

LOOK = Callable[[str, float], None]

NAMED_SHARE = 0.75  # of what the best nameless term gains: an effect that gains less does not get to give its name
NAMED_CLOSED = 0.7  # of the gap: below, the rest is larger than noise
MARGIN = 1.3  # over the null threshold from which a nameless rest is called an unknown effect
BLIND_SHARE = 0.12  # of the effects asked about: more that could not have been seen, and the answer is "cannot tell"
RIVALS = 6
STRONG = 1.5  # times the threshold
HELD_SLACK = 9.0  # twice a log-likelihood: what chance may take from a strong effect on flights that hardly show it
EXCHANGE = 8.0  # in twice the log-likelihood, by which a rival must beat an accepted effect


@dataclass(frozen=True)
class Options:
    """seed: of every random draw. nulls: simulated baselines per round. most: effects added at the most."""

    seed: int = 1
    nulls: int = 200
    most: int = 4
    level: float = 0.975


@dataclass(frozen=True)
class Finding:
    """An effect accepted in some round: the hypothesis, its rivals, the model before and after."""

    round_: Round
    choice: Choice
    candidate: Candidate
    parent: Baseline
    child: Baseline


@dataclass(frozen=True)
class Trail:
    """All that the rounds left. unknown: what is still there, nameless; stopped: why no more was added."""

    findings: tuple[Finding, ...]
    rounds: tuple[Round, ...]
    omnibus: Omnibus
    unknown: bool
    rejected: tuple[Rejected, ...]


@dataclass(frozen=True)
class Setting:
    """What stays the same over all rounds."""

    base: Model
    clean: Model
    working: Model
    bench: Bench
    effects: tuple[Effect, ...]
    errors: tuple[InputErrors, ...]
    scatter: Array
    options: Options
    tell: LOOK

    def child(self, parent: Baseline, candidate: Candidate) -> Baseline:
        """The parent with a candidate's form, fitted afresh with its own noise."""
        at = {n: v for n, (v, _) in candidate.estimates.items()}
        clean = candidate.hypothesis.form.added_to(parent.clean, at)
        return fit_baseline(
            candidate.fit.model,
            clean,
            self.bench,
            self.scatter,
            candidate.fit.values,
            candidate.fit.locals,
            parent.noise,
        )

    def screened(self, baseline: Baseline, number: int) -> Round:
        """One round of nulls and screen about a fitted model."""
        start = 0.1 + 0.8 * number / (self.options.most + 1)

        def tick(done: int) -> None:
            if done % 10 == 0:
                self.tell(
                    f"round {number + 1}: null {done} of {self.options.nulls}", start + 0.1 * done / self.options.nulls
                )

        seed = self.options.seed + 1000 * number
        return screen_round(
            baseline, self.bench, self.effects, self.errors, self.options.nulls, seed, self.options.level, tick
        )


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
    if not training:
        raise GapError("no training flight given; name at least one flight file before --holdout")
    chosen = tuple(effects) if effects is not None else catalogue()
    chosen += missing_derivatives(model, {e.name for e in chosen})
    tell("preparing the flights", 0.0)
    bench = build_bench(model, chosen, training, holdout)
    records = bench.of(bench.training)
    scatter = bank_error(records, bench.base.output_names, channel_noise(records))
    interval = float(np.median([np.median(np.diff(r.time)) for r in records]))
    clean = with_nuisance(model, dict(zip(model.output_names, scatter, strict=True)), interval)
    working = with_dormant(clean, chosen, bench.available, force_states(model))
    errors = tuple(
        input_errors(r, clean, np.random.default_rng([options.seed, 104729, i])) for i, r in enumerate(bench.records)
    )
    setting = Setting(model, clean, working, bench, chosen, errors, scatter, options, tell)
    tell("fitting the baseline", 0.05)
    trail = _rounds(setting, fit_baseline(working, clean, bench, scatter))
    tell("kinematic gate", 0.9)
    gate = kinematic_gate(training, chosen, min(options.nulls, 100), options.seed)
    tell("measuring what is closed", 0.95)
    return conclude_trail(setting, trail, gate)


def _rounds(setting: Setting, baseline: Baseline) -> Trail:
    findings: list[Finding] = []
    rounds: list[Round] = []
    rejected: list[Rejected] = []
    while True:
        round_ = setting.screened(baseline, len(rounds))
        rounds.append(round_)
        omnibus = examine(round_)
        if len(findings) == setting.options.most:
            break
        setting.tell(f"round {len(rounds)}: full fits", 0.1 + 0.8 * len(rounds) / (setting.options.most + 1))
        choice = choose(round_, setting.bench)
        finding, words = _accept(setting, round_, choice, omnibus)
        rejected += [*choice.rejected, *words]
        if finding is None:
            break
        findings.append(finding)
        if len(findings) > 1:
            questioned = _questioned(setting, findings)
            if questioned is not None:
                findings, said = questioned
                rejected += said
        baseline = findings[-1].child
    unknown = omnibus.score > MARGIN * omnibus.threshold
    return Trail(tuple(findings), tuple(rounds), omnibus, unknown, tuple(rejected))


def _accept(setting: Setting, round_: Round, choice: Choice, omnibus: Omnibus) -> tuple[Finding | None, list[Rejected]]:
    """The best candidate that is significant, explains what a nameless term can, and holds on flights it was not fitted to."""
    said: list[Rejected] = []
    refused: set[tuple[str, str]] = set()
    nameless = max((s.gain for s in omnibus.leading if s.kind == "term"), default=0.0)
    for candidate in choice.candidates:
        label = candidate.hypothesis.label
        if candidate.score < round_.threshold:
            break
        if candidate.gain < NAMED_SHARE * nameless:
            refused.add(candidate.hypothesis.key)
            said.append(Rejected(label, f"explains only {candidate.gain / nameless:.0%} of what a nameless term does"))
            continue
        if not repeats(round_, candidate):
            refused.add(candidate.hypothesis.key)
            said.append(Rejected(label, "does not hold on the training flights it was not fitted to"))
            continue
        child = setting.child(round_.baseline, candidate)
        held = held_gain(round_.baseline, child, setting.bench)
        strong = candidate.score > STRONG * round_.threshold
        least = -HELD_SLACK if strong or by_timing(round_, candidate) else 0.0
        if held is not None and held <= least:
            refused.add(candidate.hypothesis.key)
            said.append(Rejected(label, "does not hold on the held-out flights"))
            continue
        return Finding(round_, choice.without(refused), candidate, round_.baseline, child), said
    return None, said


def repeats(round_: Round, candidate: Candidate) -> bool:
    """Whether an effect shows on more than one training flight.

    Effects linear in their unknowns: the gain on each flight with everything fitted to the others, summed. Delays, lags
    and plays: the gain of the joint fit without the flight that gains most. One flight alone cannot be asked.
    """
    screen, form = round_.screen, candidate.hypothesis.form
    if not form.nonlinear:
        cross = screen.cross_gain(screen.hypotheses.index(candidate.hypothesis))
        if cross is None or cross > 0.0:
            return True
        if candidate.score < STRONG * round_.threshold:
            return False  # a strong effect may be beyond linear theory: then the joint fit decides
    if by_timing(round_, candidate):
        return True
    whiteners, flights = round_.baseline.problem.whiteners, screen.flights
    gains: dict[int, float] = {}
    for w, flight, one, two in zip(
        whiteners, flights, round_.baseline.fit.residuals, candidate.fit.residuals, strict=True
    ):
        gains[flight] = gains.get(flight, 0.0) + float(np.sum(w.rows(one) ** 2) - np.sum(w.rows(two) ** 2))
    return len(gains) < 2 or sum(gains.values()) - max(gains.values()) > 0.0


def by_timing(round_: Round, candidate: Candidate) -> bool:
    """Whether the base had to move its surfaces in time by more than the sampling leaves open to follow the flights.

    Then the base fits as well as the effect does, flight by flight; what it cannot explain is that shift.
    """
    problem, names = round_.baseline.problem, round_.baseline.problem.free
    freed = prior_cost(problem, names, round_.baseline.fit.values) - prior_cost(problem, names, candidate.fit.values)
    return 2.0 * freed > 0.5 * candidate.gain


def held_gain(parent: Baseline, child: Baseline, bench: Bench) -> float | None:
    """Twice the log-likelihood the child gains on the held-out flights, both weighed with the child's noise, the fitted
    parameters uncertain as the training flights leave them."""
    before, after = predictive_cost(parent, bench, child.noise), predictive_cost(child, bench, child.noise)
    return None if before is None or after is None else 2.0 * (before - after)


def _questioned(setting: Setting, findings: Sequence[Finding]) -> tuple[list[Finding], list[Rejected]] | None:
    """Every earlier effect asked again with the later ones in the model: dropped where it has become insignificant,
    exchanged where a rival now explains the same flights better. None where all stand."""
    last = findings[-1]
    said: list[Rejected] = []
    for i in range(len(findings) - 1):
        others = [f for j, f in enumerate(findings) if j != i]
        model, clean = setting.working, setting.clean
        for f in others:
            at = {n: v for n, (v, _) in f.candidate.estimates.items()}
            model, clean = (
                awakened(model, f.candidate.hypothesis.form, at),
                f.candidate.hypothesis.form.added_to(clean, at),
            )
        without = fit_baseline(model, clean, setting.bench, setting.scatter, None, None, last.child.noise, passes=0)
        old = findings[i].candidate
        gain = 2.0 * (without.fit.cost - last.child.fit.cost)
        if np.sqrt(max(gain, 0.0)) < findings[i].round_.threshold:
            said.append(
                Rejected(
                    old.hypothesis.label, f"no longer needed once {last.candidate.hypothesis.label} is in the model"
                )
            )
            fresh = fit_baseline(
                model, clean, setting.bench, setting.scatter, without.fit.values, without.fit.locals, without.noise
            )
            return [replace(f, child=fresh) if f is others[-1] else f for f in others], said
        rival = _rival(setting, without, old, gain)
        if rival is not None:
            said.append(
                Rejected(
                    old.hypothesis.label,
                    f"{rival.hypothesis.label} explains the same better with the other effects in the model",
                )
            )
            child = setting.child(without, rival)
            choice = Choice((rival,), {rival.hypothesis.effect.name: 1.0}, ())
            return [*others, Finding(last.round_, choice, rival, without, child)], said
    return None


def _rival(setting: Setting, without: Baseline, old: Candidate, gain: float) -> Candidate | None:
    """A hypothesis that beats `old` by a clear margin where it was taken out, or None."""
    problem = without.problem
    hypotheses = hypotheses_for(without.clean, setting.effects, setting.bench.available)
    screen = build_screen(problem, without.fit, hypotheses)
    gains = linear_gains(screen, problem)
    best: Candidate | None = None
    for h in np.argsort(-gains)[:RIVALS]:
        hypothesis = screen.hypotheses[int(h)]
        if hypothesis.key == old.hypothesis.key:
            continue
        _, found = fit_hypothesis(problem, without.fit, hypothesis, linear_guess(screen, problem, int(h)))
        candidate = assess(problem, without.fit, hypothesis, found, 1.0)
        if not candidate.why_not and candidate.gain > gain + EXCHANGE and (best is None or candidate.gain > best.gain):
            best = candidate
    return best


def conclude_trail(setting: Setting, trail: Trail, gate: Gate) -> GapResult:
    """Verdict, steps and words from what the rounds left."""
    bench, options = setting.bench, setting.options
    first, last = trail.rounds[0], trail.rounds[-1]
    held_errors = setting.errors[len(bench.of(bench.training)) :]
    floor = floors(last, on_holdout(last.baseline, bench), held_errors, options.seed)
    steps = [_step(setting, f, floor) for f in trail.findings]
    left = rms_over_noise(last.baseline.problem, last.baseline.fit, setting.scatter)
    shut = floor.covers(left)
    unknown = trail.unknown
    if steps_close(trail, shut):
        unknown = False
    if unknown and steps and not shut and steps[-1].gap.closed < NAMED_CLOSED:
        dropped = steps.pop()
        trail = replace(
            trail,
            rejected=(*trail.rejected, Rejected(dropped.effect, f"closes only {dropped.gap.closed:.0%} of the gap")),
        )
    kept = trail.findings[: len(steps)]
    cannot = undetectable(first, setting.base)
    if unknown:
        steps.append(_unknown_step(trail, Gap(left, left, floor.training_median)))
        verdict = Verdict.UNKNOWN
    elif steps:
        whole = Gap(steps[0].gap.before, left, floor.training_median)
        nothing_left = not trail.omnibus.significant
        verdict = Verdict.GAP_CLOSED if shut or nothing_left or whole.closed >= NAMED_CLOSED else Verdict.GAP_REDUCED
    else:
        asked = {h.effect.name for h in first.screen.hypotheses if not h.effect.tied_to}
        verdict = Verdict.CANNOT_TELL if len(cannot) > BLIND_SHARE * max(len(asked), 1) else Verdict.NO_GAP
    if steps:  # the gate saw the flights as they are: it speaks of the first effect
        steps[0] = replace(steps[0], where=replace(steps[0].where, origin=gate.origin))
    steps = [replace(s, text=describe_step(s)) for s in steps]
    detectable = _detectable(last)
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
    return GapResult(
        verdict=verdict,
        text=conclude(verdict, steps, detectable, cannot, tied, bool(bench.holdout)),
        minimum_detectable=detectable,
        steps=tuple(steps),
        scores=_effect_scores(first),
        threshold=first.threshold,
        nominal_threshold=float(norm.isf(0.025 / max(len(first.screen.hypotheses), 1))),
        rejected=trail.rejected,
        ties=_ties(first),
        model_before=before,
        model_after=after,
        notes=bench.notes,
        outputs=setting.base.output_names,
        histories=histories(setting, first.baseline, kept[-1].child if kept else first.baseline, last),
        details={
            "kinematic_gate": gate.to_json(),
            "cannot_tell": [{"effect": e.name, "separate_by": e.separate_by} for e in cannot],
            "left": [
                {"kind": s.kind, "place": s.place, "what": s.what, "score": round(s.score, 2)}
                for s in trail.omnibus.leading[:5]
            ],
            "left_threshold": round(float(trail.omnibus.threshold), 2),
            "map": {"before": disagreement(first.baseline), "after": disagreement(last.baseline)},
            "nulls": options.nulls, "seed": options.seed,
        },
    )  # fmt: skip


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


def undetectable(round_: Round, model: Model) -> list[Effect]:
    """Effects of which not even twice the usual size would have passed the threshold on these flights."""
    projected = round_.screen.projected()
    seen: dict[str, float] = {}
    effects = {h.effect.name: h.effect for h in round_.screen.hypotheses}
    for c, column in enumerate(round_.screen.columns):
        name = round_.screen.hypotheses[column.hypothesis].effect.name
        power = (
            np.sqrt(max(float(projected.B[c, c]), 0.0) / round_.inflation[column.hypothesis]) * column.parameter.typical
        )
        seen[name] = max(seen.get(name, 0.0), float(power))
    return [effects[n] for n, power in seen.items() if power < 0.5 * round_.threshold and not effects[n].tied_to]


def _unknown_step(trail: Trail, gap: Gap) -> Step:
    """Where and how the nameless rest shows."""
    leading = [s for s in trail.omnibus.leading if s.score > trail.omnibus.threshold]
    channels = tuple(dict.fromkeys(s.place for s in leading))
    spans = tuple(s.span for s in trail.omnibus.leading if s.span is not None and s.score > trail.omnibus.threshold)
    shape = "; ".join(f"{s.place}: like {s.what}" if s.kind == "term" else f"{s.place}: {s.what}" for s in leading[:3])
    return Step(
        effect="unknown", title="an effect the catalogue does not hold", form="", confidence=0.0, members=(),
        separate_by="repeat the manoeuvre and vary one signal at a time around the regime named here", estimates={}, units={},
        score=trail.omnibus.score, threshold=trail.omnibus.threshold,
        where=Where(leading[0].place if leading else "", channels, tuple(s for s in spans if s is not None)[:4], shape),
        gap=gap, holdout=None, migrated={},
    )  # fmt: skip


def _step(setting: Setting, finding: Finding, floor: Floors) -> Step:
    bench = setting.bench
    effect, form = finding.candidate.hypothesis.effect, finding.candidate.hypothesis.form
    members = credible_set(finding.choice.weights)
    if effect.name not in dict(members):
        members = [(effect.name, finding.choice.weights.get(effect.name, 0.0)), *members]
    members.sort(key=lambda m: m[0] != effect.name)
    parent, child = finding.parent, finding.child
    held_before, held_after = on_holdout(parent, bench), on_holdout(child, bench)
    scatter = setting.scatter
    gap = Gap(rms_over_noise(parent.problem, parent.fit, scatter), rms_over_noise(child.problem, child.fit, scatter),
              floor.training_median)  # fmt: skip
    held = None
    if held_before is not None and held_after is not None and floor.holdout_median is not None:
        held = Gap(rms_over_noise(*held_before, scatter), rms_over_noise(*held_after, scatter), floor.holdout_median)
    std = child.fit.std()
    inflation = {h.key: v for h, v in zip(finding.round_.screen.hypotheses, finding.round_.inflation, strict=True)}
    wider = float(np.sqrt(inflation.get(finding.candidate.hypothesis.key, 1.0)))
    titles = {e.name: e for e in setting.effects}
    return Step(
        effect=effect.name, title=effect.title, form=form.label,
        confidence=dict(members)[effect.name],
        members=tuple(Weighed(n, w, titles[n].title, titles[n].separate_by) for n, w in members),
        separate_by=_separate(effect, [n for n, _ in members]),
        estimates={p.name: (float(child.fit.values[p.name]), wider * float(std[p.name])) for p in form.parameters},
        units={p.name: p.unit for p in form.parameters},
        score=finding.candidate.score, threshold=finding.round_.threshold,
        where=locate(parent, child, bench, form),
        gap=gap, holdout=held, migrated=_migrated(parent, child), equation=effect.equation,
        practical=practical(parent, child),
    )  # fmt: skip


def _separate(effect: Effect, names: Sequence[str]) -> str:
    """What tells the effect from the other members of its set."""
    return next((effect.confusions[n] for n in names if n in effect.confusions), effect.separate_by)


def practical(parent: Baseline, child: Baseline) -> str:
    """What the effect is worth against the tolerances of flight-simulator qualification."""
    words = []
    for name, (tolerance, said) in BANDS.items():
        if name not in parent.model.output_names:
            continue
        c = parent.model.output_names.index(name)
        change = np.concatenate([(p - q)[:, c] for p, q in zip(parent.fit.residuals, child.fit.residuals, strict=True)])
        worth = float(np.nanmax(np.abs(change)))
        words.append(f"{name} {np.degrees(worth):.2g} against {said}" + (" (beyond it)" if worth > tolerance else ""))
    beyond = any("beyond" in w for w in words)
    return ("matters: " if beyond else "real but within simulator tolerances: ") + ", ".join(words)


def _migrated(parent: Baseline, child: Baseline) -> dict[str, Migration]:
    std = child.fit.std()
    moved = {}
    for name in parent.fit.free:
        if is_nuisance(name) or name not in std:
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
        key = (
            name
            if name not in sizes and len(round_.screen.hypotheses[column.hypothesis].effect.forms) == 1
            else column.parameter.name
        )
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
