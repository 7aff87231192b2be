"""Noise that holds an effect: what the residuals say of it is asked again with each leading hypothesis in the model.

The strengths of gusts and other process noise come from the residuals of the base. A large effect that the base lacks is in
them, and passes for gusts: nulls scatter as far as it does, and a smaller one is found where a larger is not (a `Cn_beta3` of 1
named, of 2 not: its score was divided by 5.6, with a hundred times the process noise that there was). With the effect in the
model its noise falls, and the likelihood, of which the determinant of the noise is a part, says so.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

from estimation.engine.kernel import Array
from estimation.gap.criteria import Criteria
from estimation.gap.fit.baseline import Baseline, whiteners_for
from estimation.gap.fit.fitting import fit
from estimation.gap.fit.problem import ModelFit
from estimation.gap.fit.spectra import NoiseModel
from estimation.gap.fit.whitener import Whitener
from estimation.gap.search.select import ASKED, Choice
from estimation.gap.significance.calibration import Round

WORTH = 0.5  # of what decides: chance gains a third of that with the noise of the base, an effect that is worth it more


def sharper_base(round_: Round, choice: Choice) -> Baseline | None:
    """The round's base with the noise that the best of the leading hypotheses leaves; None where the flights are hardly likelier
    with any of them."""
    base = round_.baseline
    worth = [c for c in choice.candidates if c.gain > WORTH * base.criteria.noise_held]
    if not worth:
        return None
    usual, _ = _surprise(base, base.fit)
    leading = sorted(worth, key=lambda c: -c.gain)[:ASKED]
    asked = [_surprise(base, candidate.fit) for candidate in leading]
    surprise, noise = min(asked, key=lambda pair: pair[0])
    return with_noise(base, noise) if holds_an_effect(usual - surprise, base.criteria) else None


def holds_an_effect(likelier: float, criteria: Criteria) -> bool:
    """Whether flights likelier by so much (twice a log-likelihood) with a hypothesis and its own noise say that the noise of the
    base has an effect in it."""
    return likelier > criteria.noise_held


def _surprise(base: Baseline, found: ModelFit) -> tuple[float, NoiseModel]:
    """Minus twice the log-likelihood (Whittle, but for a constant) of the training flights about a fitted model with the noise
    that its own residuals have, and that noise."""
    noise, whiteners = _noise_of(base, found, None, found.residuals)
    pairs = list(zip(whiteners, found.residuals, strict=True))
    return sum(w.log_determinant + w.energy(r) for w, r in pairs), noise


def with_noise(base: Baseline, noise: NoiseModel) -> Baseline | None:
    """A base fitted again with another noise; None where its motion runs away."""
    _, whiteners = _noise_of(base, base.fit, noise, ())
    problem = replace(base.problem, whiteners=whiteners)
    fitted = fit(problem, base.fit.values, base.fit.locals)
    return None if fitted.diverged else replace(base, problem=problem, fit=fitted, noise=noise)


def _noise_of(
    base: Baseline, found: ModelFit, noise: NoiseModel | None, residuals: Sequence[Array]
) -> tuple[NoiseModel, tuple[Whitener, ...]]:
    values: Mapping[str, float] = {**found.model.starts(), **found.values}
    records = base.problem.records
    return whiteners_for(found.model, base.prepared, records, values, noise, residuals, base.scatter, base.noise)
