"""Noise that contains an effect: estimated again with each leading hypothesis in the model.

The strengths of gusts and other process noise are estimated from the residuals of the base. A large effect that the base lacks
is in these residuals too, and passes for gusts. Then nulls scatter as widely as the effect, and a large effect is missed where a
smaller one is found: a `Cn_beta3` of 1 was named, one of 2 was not, for the noise model had a hundred times the true process
noise and the score was divided by 5.6. With the effect in the model the estimated noise falls. The likelihood shows it, because
the determinant of the noise covariance is a part of it.
"""

from dataclasses import replace

from estimation.gap.criteria import Criteria
from estimation.gap.fit.baseline import Baseline
from estimation.gap.fit.fitting import fit
from estimation.gap.fit.problem import ModelFit
from estimation.gap.fit.spectra import NoiseModel
from estimation.gap.search.select import NOISE_CANDIDATES, Choice
from estimation.gap.significance.calibration import Round

WORTH = 0.5  # of the gain that decides, with the noise of the base: chance reaches a third, an effect hidden in it more


def sharper_base(round_: Round, choice: Choice) -> Baseline | None:
    """The round's base refitted with the noise of the leading hypothesis that makes the flights likeliest; None where none of
    them makes the flights clearly likelier."""
    base = round_.baseline
    worth = [c for c in choice.candidates if c.gain > WORTH * base.criteria.noise_held]
    if not worth:
        return None
    base_deviance, _ = _deviance(base, base.fit)
    leading = sorted(worth, key=lambda c: -c.gain)[:NOISE_CANDIDATES]
    deviances = [_deviance(base, candidate.fit) for candidate in leading]
    deviance, noise = min(deviances, key=lambda pair: pair[0])
    return with_noise(base, noise) if holds_an_effect(base_deviance - deviance, base.criteria) else None


def holds_an_effect(likelier: float, criteria: Criteria) -> bool:
    """Whether the noise of the base contains an effect. likelier: increase of twice the log-likelihood with a hypothesis in the
    model and the noise estimated with it."""
    return likelier > criteria.noise_held


def _deviance(base: Baseline, model_fit: ModelFit) -> tuple[float, NoiseModel]:
    """Minus twice the log-likelihood (Whittle, up to a constant) of the training flights about a fitted model, with the noise
    estimated from its own residuals; and that noise."""
    noise, whiteners = base.noise_about(model_fit)
    pairs = list(zip(whiteners, model_fit.residuals, strict=True))
    return sum(w.log_determinant + w.energy(r) for w, r in pairs), noise


def with_noise(base: Baseline, noise: NoiseModel) -> Baseline | None:
    """A base fitted again with another noise; None where its motion runs away."""
    _, whiteners = base.noise_about(base.fit, noise)
    problem = replace(base.problem, whiteners=whiteners)
    fitted = fit(problem, base.fit.values, base.fit.locals)
    return None if fitted.diverged else replace(base, problem=problem, fit=fitted, noise=noise)
