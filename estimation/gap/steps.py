"""One found effect, or the nameless rest, as a person reads it: set, size, place, gap closed, worth in simulator tolerances."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from estimation.gap.accept import by_timing
from estimation.gap.baseline import Baseline
from estimation.gap.effects.base import Effect
from estimation.gap.fitting import fit
from estimation.gap.locate import locate
from estimation.gap.measure import Floors, on_holdout, rms_over_noise
from estimation.gap.nuisance import is_nuisance
from estimation.gap.result import Gap, Migration, Step, Weighed, Where
from estimation.gap.select import credible_set
from estimation.gap.trail import Finding, Setting, Trail
from estimation.gap.words import BANDS


def unknown_step(trail: Trail, gap: Gap) -> Step:
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


def step_of(setting: Setting, finding: Finding, floor: Floors) -> Step:
    bench = setting.bench
    effect, form = finding.candidate.hypothesis.effect, finding.candidate.hypothesis.form
    members = credible_set(finding.choice.weights)
    if effect.name not in dict(members):
        members = [(effect.name, finding.choice.weights.get(effect.name, 0.0)), *members]
    members.sort(key=lambda m: m[0] != effect.name)
    followed = followed_by_timing(finding)
    parent, child = as_sampled(finding.parent) if followed else finding.parent, finding.child
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
        gap=gap, holdout=held, migrated=_migrated(parent, child), absorbed=_absorbed(finding), equation=effect.equation,
        practical=practical(parent, child), followed=followed,
    )  # fmt: skip


def followed_by_timing(finding: Finding) -> dict[str, float]:
    """Control -> time [s] by which the base had moved it where it followed the effect in that way."""
    if not by_timing(finding.round_, finding.candidate):
        return {}
    values = finding.parent.fit.values
    moved = {s.name: values.get(f"timing_{s.name}", 0.0) for s in finding.parent.model.inputs if s.control}
    least = max(map(abs, moved.values()), default=0.0) / 2
    return {n: v for n, v in moved.items() if abs(v) > least}


def as_sampled(parent: Baseline) -> Baseline:
    """The parent with its surfaces moving when they are seen to."""
    late = [n for n in parent.problem.free if n.startswith("timing_")]
    values = {**parent.fit.values, **dict.fromkeys(late, 0.0)}
    return replace(parent, fit=fit(parent.problem, values, parent.fit.locals, held=late))


def _separate(effect: Effect, names: Sequence[str]) -> str:
    """What tells the effect from the other members of its set."""
    return next((effect.confusions[n] for n in names if n in effect.confusions), effect.separate_by)


def _absorbed(finding: Finding) -> float | None:
    """Share of the effect's whitened signature that the base's own parameters can take over."""
    screen = finding.round_.screen
    if finding.candidate.hypothesis not in screen.hypotheses:
        return None
    span = screen.span(screen.hypotheses.index(finding.candidate.hypothesis))
    projected = screen.projected()
    return 1.0 - float(np.diag(projected.B)[span].sum()) / max(float(projected.raw[span].sum()), 1e-300)


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
