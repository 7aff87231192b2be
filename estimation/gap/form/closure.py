"""How much of what is significant a model with an increment closes: energy of whitened residuals against simulated nulls.

The plain gap counts gusts and slow errors of filters too, beside which half a usual effect can look like nothing; whitened
residuals weigh every frequency by what noise leaves of it.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from estimation.gap.likelihood.baseline import Baseline
from estimation.gap.likelihood.fitting import LikelihoodProblem, ModelFit, fit
from estimation.gap.likelihood.whitening import NoiseModel
from estimation.gap.random_streams import Stream
from estimation.gap.tests_of_fit.nulls import InputErrors, NullFlyer
from estimation.gap.tests_of_fit.tangent import RecordTangent

NULLS = 40  # flown of every record that is asked: enough for the upper end of what they leave


def closed(before: float, after: float, floor: float) -> float:
    """Share of what lies above the floor that is gone, in 0..1; nothing where there was nothing."""
    if before <= floor:
        return 0.0
    return float(np.clip(1.0 - (after - floor) / (before - floor), 0.0, 1.0))


def asked(problem: LikelihoodProblem, found: ModelFit, baseline: Baseline, noise: NoiseModel) -> float:
    """Whitened energy of a fitted model on the held-out flights, shared parameters frozen; on the training flights where there
    are none. problem, found: on the training flights; noise: by which it is weighed."""
    held = replace(baseline, problem=problem, fit=found, noise=noise).held_out
    return 2.0 * (found.cost if held is None else held[1].cost)


def floor_energy(child: Baseline, errors: Sequence[InputErrors], seed: int) -> float:
    """The same of what chance alone makes: upper end over simulated nulls of the model. errors: of every record, training first.

    The upper end, not the middle: one day's weather and one flight's surfaces are not the average ones.
    """
    held = child.held_out
    if held is None:
        own = errors[: len(child.problem.records)]
        return _upper(child.problem, child.fit, NullFlyer.build(child.problem, child.fit, child.noise, own), seed)
    own = errors[len(errors) - len(held[0].records) :]
    return _upper(*held, NullFlyer.build(*held, child.noise, own), seed)


def _upper(problem: LikelihoodProblem, found: ModelFit, flyer: NullFlyer, seed: int) -> float:
    total = np.zeros(NULLS)
    for i in range(len(problem.records)):
        flown = [flyer.fly(i, Stream.CLOSURE_NULLS.generator(seed, i, k)) for k in range(NULLS)]
        whole = [np.full(problem.coarse[i].z.shape, np.nan) if f is None else f for f in flown]
        here = RecordTangent.of(problem, found, i, whole)
        total += here.squares(here.fixed)[-NULLS:]
    return float(np.quantile(total, problem.criteria.floor_level))


def refitted_with(problem: LikelihoodProblem, found: ModelFit, child: Baseline) -> tuple[LikelihoodProblem, ModelFit]:
    """A model fitted to the training flights again, weighed with the noise of another."""
    same = LikelihoodProblem(
        problem.model, problem.base, child.problem.records, child.problem.whiteners, problem.criteria
    )
    return same, fit(same, found.values, found.locals)
