"""Lags and swings as something that a model can be fitted with, beside names or without any."""

import math
from collections.abc import Mapping
from dataclasses import replace

from estimation.gap.criteria import Criteria
from estimation.gap.effects.base import Effect, EffectParameter, Form, Group
from estimation.gap.form.memory import Memory
from estimation.gap.form.places import ModelMotion
from estimation.gap.form.swing import Swing, rings
from estimation.gap.likelihood.baseline import Baseline
from estimation.gap.likelihood.fitting import ModelFit
from estimation.gap.search.confirm import fit_hypothesis
from estimation.gap.tests_of_fit.hypotheses import Hypothesis
from estimation.gap.tests_of_fit.measured_again import MeasuredAgain
from estimation.models.base import Signal

Follower = Memory | Swing
SIZE, FOLLOWER = "nameless_late", "nameless_follower"
SWING, FREQUENCY, DAMPING = "nameless_swing", "nameless_frequency", "nameless_damping"
LEAST_DAMPING, MOST_DAMPING = 0.005, 1.0
OCTAVE = 2.0  # to either side of the frequency it was found at
NEAR_LIMIT = 1.01  # times a limit: stopped there by it


def hypothesis_of(follower: Follower, flown: ModelMotion) -> tuple[Hypothesis, dict[str, float]]:
    """What a lag or a swing adds to its coefficient, and where its fit begins."""
    return lag_of(follower, flown) if isinstance(follower, Memory) else swing_of(follower, flown)


def lag_of(memory: Memory, flown: ModelMotion) -> tuple[Hypothesis, dict[str, float]]:
    """How far a first-order lag of a variable is behind it."""
    line, variable = memory.place.line, memory.place.variable
    usual = flown.scale[line] / flown.reach(variable)
    form = Form(
        SIZE,
        (EffectParameter(SIZE, "1", usual, -1e3 * usual, 1e3 * usual),),
        terms={line: (f"{SIZE}*({FOLLOWER} - {variable})",)},
        states=(Signal(FOLLOWER, start=variable),),
        lines=(f"{FOLLOWER}_dot = ({variable} - {FOLLOWER})/{memory.time!r}",),
        requires=(line, variable),
    )
    return _unnamed(f"{line} late after {variable}", form), {SIZE: 0.0}


def swing_of(swing: Swing, flown: ModelMotion) -> tuple[Hypothesis, dict[str, float]]:
    """What an oscillator makes of accelerations; its frequency and damping are unknowns too."""
    sizes = {f"{SWING}_{a}": size for a, size in swing.by.items()}
    usual = {f"{SWING}_{a}": flown.scale[swing.line] / flown.reach(a) for a in swing.by}
    w, z = swing.frequency, swing.damping
    drive = " + ".join(f"{SWING}_{a}*{a}" for a in swing.by)
    form = Form(
        SWING,
        (
            *(EffectParameter(n, "1", u, -1e3 * u, 1e3 * u) for n, u in usual.items()),
            EffectParameter(FREQUENCY, "rad/s", 0.1 * w, w / OCTAVE, OCTAVE * w, w),
            EffectParameter(DAMPING, "1", 0.5 * z, LEAST_DAMPING, MOST_DAMPING, z),
        ),
        terms={swing.line: (SWING,)},
        states=(Signal(SWING, start=0.0), Signal(f"{SWING}_rate", start=0.0)),
        lines=(
            f"{SWING}_dot = {SWING}_rate",
            f"{SWING}_rate_dot = {FREQUENCY}^2*({drive} - {SWING}) - 2*{DAMPING}*{FREQUENCY}*{SWING}_rate",
        ),
        requires=(swing.line, *swing.by),
    )
    return _unnamed(swing.words, form), {**sizes, FREQUENCY: w, DAMPING: z}


def _unnamed(title: str, form: Form) -> Hypothesis:
    return Hypothesis(Effect(form.label, title, Group.UNSTEADY, "", "", "", "", {}, "", (form,)), form)


def settled(follower: Follower | None, baseline: Baseline, seed: int) -> Follower | None:
    """A lag as it is; a swing with frequency and damping as fitted beside a model, and none where the fit ends in something that
    does not ring. None too where it gains nearly as much with only the controls measured again. As linear theory has it where
    the fit runs away."""
    if follower is None:
        return None
    hypothesis, start = hypothesis_of(follower, ModelMotion.of(baseline.problem, baseline.fit))
    _, found = fit_hypothesis(baseline.problem, baseline.fit, hypothesis, start)
    if not found.diverged and not stands(follower, baseline, found, seed):
        return None
    return as_fitted(follower, found, baseline.criteria)


def stands(follower: Follower, baseline: Baseline, found: ModelFit, seed: int) -> bool:
    """Whether a fitted lag or swing is significant by what of its gain is its own."""
    share = MeasuredAgain(baseline, seed).share(2.0 * (baseline.fit.cost - found.cost), found)
    return follower.score * math.sqrt(share) > follower.threshold


def as_fitted(follower: Follower, found: ModelFit, criteria: Criteria) -> Follower | None:
    """A lag as it is, a swing with what was fitted; none where that does not ring, or where a limit stopped it: a tone that never
    dies is driven by nothing, and one that is elsewhere than it was found is another."""
    if not isinstance(follower, Swing) or found.diverged:
        return follower
    fitted = _with_bounds(follower, found.values, found.std())
    moved = max(fitted.frequency / follower.frequency, follower.frequency / fitted.frequency)
    inside = fitted.damping > LEAST_DAMPING * NEAR_LIMIT and moved < OCTAVE / NEAR_LIMIT
    return fitted if inside and rings(fitted.damping, criteria) else None


def _with_bounds(swing: Swing, values: Mapping[str, float], std: Mapping[str, float]) -> Swing:
    return replace(
        swing,
        by={a: float(values[f"{SWING}_{a}"]) for a in swing.by},
        frequency=float(values[FREQUENCY]),
        damping=float(values[DAMPING]),
        frequency_std=float(std[FREQUENCY]),
        damping_std=float(std[DAMPING]),
    )
