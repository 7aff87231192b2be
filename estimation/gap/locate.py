"""Where an effect acts: equation, channels, seconds of flight and regime, from what it changes in the outputs."""

from collections.abc import Sequence

import numpy as np

from estimation.engine.kernel import Array
from estimation.gap.baseline import Baseline
from estimation.gap.bench import Bench
from estimation.gap.effects.base import Form
from estimation.gap.result import Where

DEGREES = {"beta", "alpha", "phi", "theta", "delta_a", "delta_r", "delta_e", "p", "q", "r"}
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


def locate(parent: Baseline, child: Baseline, bench: Bench, form: Form, origin: str = "") -> Where:
    """Where the child explains what the parent could not. Segments count from each flight's own clock; those of the first
    training flight that shows the effect are given."""
    scatter = parent.scatter
    outputs = child.model.output_names
    gain = [np.nan_to_num((p / scatter) ** 2 - (c / scatter) ** 2)
            for p, c in zip(parent.fit.residuals, child.fit.residuals, strict=True)]  # fmt: skip
    by_channel = np.sum([g.sum(axis=0) for g in gain], axis=0)
    order = [int(i) for i in np.argsort(-by_channel) if by_channel[i] > 0.1 * max(by_channel.max(), 1e-12)]
    spans = [_spans(child.problem.coarse[i].time, g.sum(axis=1)) for i, g in enumerate(gain)]
    return Where(
        equation=equation_of(form),
        channels=tuple(outputs[i] for i in order),
        segments=tuple(spans[int(np.argmax([len(s) for s in spans]))][:4]),
        regime=regime(child, gain),
        origin=origin,
    )


def _spans(time: Array, gain: Array, width: float = 1.0) -> list[tuple[float, float]]:
    """Stretches that hold most of the gain, best first."""
    n = max(round(width / float(np.median(np.diff(time)))), 2)
    smooth = np.convolve(gain, np.ones(n) / n, mode="same")
    limit = max(0.25 * float(smooth.max()), 1e-9)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], (smooth > limit).astype(int), [0]])))
    found = [(a, b - 1) for a, b in zip(edges[::2], edges[1::2], strict=True) if b - a >= n // 2]
    found.sort(key=lambda s: -float(gain[s[0] : s[1] + 1].sum()))
    return [(float(time[a]), float(time[b])) for a, b in found]


def regime(child: Baseline, gain: Sequence[Array]) -> str:
    """The condition under which most of the gain is made: the signal whose large values coincide with it best."""
    total = np.concatenate([g.sum(axis=1) for g in gain])
    best, text = 1.3, "everywhere"
    for name, values in _signals(child).items():
        size = np.abs(values - np.median(values))
        limit = float(np.quantile(size, 0.7))
        inside = size > limit
        if not 0.05 < inside.mean() < 0.5:
            continue
        ratio = float(np.sum(total[inside])) / max(float(np.sum(np.maximum(total, 0.0))), 1e-12) / inside.mean()
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


def _signals(child: Baseline) -> dict[str, Array]:
    problem = child.problem
    shown = [np.nan_to_num(c.z - np.nan_to_num(r)) for c, r in zip(problem.coarse, child.fit.residuals, strict=True)]
    signals = {n: np.concatenate([s[:, i] for s in shown]) for i, n in enumerate(problem.model.output_names)}
    for i, s in enumerate(problem.model.inputs):
        if s.control or s.name in ("alpha", "V", "thrust"):
            signals[s.name] = np.concatenate([c.u[:, i] for c in problem.coarse])
    return {n: v for n, v in signals.items() if float(np.ptp(v)) > 0.0}


def disagreement(baseline: Baseline, bins: int = 6) -> dict[str, list[dict[str, float]]]:
    """Map of the disagreement over the flight regime: per signal, bins of rms residual / noise over all outputs."""
    total = np.concatenate([np.nanmean((r / baseline.scatter) ** 2, axis=1) for r in baseline.fit.residuals])
    table = {}
    for name, values in _signals(baseline).items():
        edges = np.unique(np.quantile(values, np.linspace(0, 1, bins + 1)))
        rows = []
        for a, b in zip(edges[:-1], edges[1:], strict=True):
            inside = (values >= a) & (values <= b)
            rows.append(
                {
                    "from": round(float(a), 5),
                    "to": round(float(b), 5),
                    "gap": round(float(np.sqrt(np.nanmean(total[inside]))), 4),
                }
            )
        table[name] = rows
    return table
