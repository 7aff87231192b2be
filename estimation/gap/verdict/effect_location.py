"""Where one effect acts: equation, channels, seconds of flight and regime, from what it changes in the outputs."""

from collections.abc import Mapping

import numpy as np

from estimation.engine.kernel import Array
from estimation.gap.answer.result import Where
from estimation.gap.criteria import Criteria
from estimation.gap.effects.base import Form
from estimation.gap.likelihood.baseline import Baseline
from groundstation.flight.arrays import true_runs

DEGREES = {"beta", "alpha", "phi", "theta", "delta_a", "delta_r", "delta_e", "p", "q", "r"}
SPANS = 4  # stretches of flight given for one effect
NOTHING = 1e-12  # gain of an effect that changes nothing
EQUATIONS = ("CY", "Cl", "Cn", "CL", "CD", "Cm")


def equation_of(form: Form) -> str:
    """The equation a form enters: a coefficient, a rate, an instrument or a control."""
    lines = list(form.terms)
    named = [line for line in lines if line in EQUATIONS] or lines
    if form.outputs or form.output_delays:
        return "measured " + ", ".join(form.outputs or form.output_delays)
    if form.transforms:
        return form.transforms[0].input
    return ", ".join(named) or ", ".join(p.name for p in form.parameters)


def locate(parent: Baseline, child: Baseline, form: Form) -> Where:
    """Where the child explains what the parent could not. Segments count from each flight's own clock; those of the first
    training flight that shows the effect are given."""
    scatter = parent.scatter
    outputs = child.model.output_names
    gain = [
        np.nan_to_num((p / scatter) ** 2 - (c / scatter) ** 2)
        for p, c in zip(parent.fit.residuals, child.fit.residuals, strict=True)
    ]
    criteria = child.criteria
    order = channels_that_gain(np.sum([g.sum(axis=0) for g in gain], axis=0), criteria)
    spans = [spans_of(child.problem.coarse[i].time, g.sum(axis=1), criteria) for i, g in enumerate(gain)]
    return Where(
        equation=equation_of(form),
        channels=tuple(outputs[i] for i in order),
        segments=tuple(spans[int(np.argmax([len(s) for s in spans]))][:SPANS]),
        regime=regime(signals_of(child), np.concatenate([g.sum(axis=1) for g in gain]), criteria),
    )


def channels_that_gain(gain: Array, criteria: Criteria) -> list[int]:
    """Indices of the outputs that show an effect, best first. gain: (ny,)."""
    least = criteria.channel_share * max(float(gain.max()), NOTHING)
    return [int(i) for i in np.argsort(-gain) if gain[i] > least]


def spans_of(time: Array, gain: Array, criteria: Criteria) -> list[tuple[float, float]]:
    """Stretches that hold most of the gain (N,), best first."""
    n = min(max(round(criteria.span_window / float(np.median(np.diff(time)))), 2), time.size)
    smooth = np.convolve(gain, np.ones(n) / n, mode="same")
    limit = max(criteria.span_share * float(smooth.max()), NOTHING)
    found = [(a, b - 1) for a, b in true_runs(smooth > limit) if b - a >= n // 2]
    found.sort(key=lambda s: -float(gain[s[0] : s[1] + 1].sum()))
    return [(float(time[a]), float(time[b])) for a, b in found]


def regime(signals: Mapping[str, Array], gain: Array, criteria: Criteria) -> str:
    """The condition under which most of the gain (N,) is made: the signal whose large values coincide with it best."""
    best, text = criteria.regime_gain, "everywhere"
    for name, values in signals.items():
        size = np.abs(values - np.median(values))
        limit = float(np.quantile(size, criteria.regime_quantile))
        inside = size > limit
        if inside.mean() <= criteria.regime_least:
            continue
        ratio = float(np.sum(gain[inside])) / max(float(np.sum(np.maximum(gain, 0.0))), NOTHING) / inside.mean()
        if ratio > best:
            best = ratio
            centre = float(np.median(values))
            if name not in DEGREES:
                text = f"{name} more than {limit:.3g} from {centre:.3g}"
            elif abs(centre) > limit:
                text = f"{name} more than {np.degrees(limit):.1f} deg from {np.degrees(centre):.1f}"
            else:
                text = f"|{name}| > {np.degrees(limit):.1f} {'deg/s' if name in 'pqr' else 'deg'}"
    return text


def signals_of(child: Baseline) -> dict[str, Array]:
    problem = child.problem
    shown = [np.nan_to_num(c.z - np.nan_to_num(r)) for c, r in zip(problem.coarse, child.fit.residuals, strict=True)]
    signals = {n: np.concatenate([s[:, i] for s in shown]) for i, n in enumerate(problem.model.output_names)}
    for i, s in enumerate(problem.model.inputs):
        if s.control or s.name in ("alpha", "V", "thrust"):
            signals[s.name] = np.concatenate([c.u[:, i] for c in problem.coarse])
    return {n: v for n, v in signals.items() if float(np.ptp(v)) > 0.0}
