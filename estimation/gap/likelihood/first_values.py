"""Where the first fit begins: at what the model states, or at a regression of the measured motion where that is nearer.

An aircraft that was never written down has no beliefs, or those of its shape alone. From there the motion runs away, or the
search ends in a valley that is not the one of these flights.
"""

from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType

from estimation.engine.simulate import Simulator
from estimation.estimators.equation_error import start_values
from estimation.gap.likelihood.fitting import LikelihoodProblem, cost_at
from estimation.prepare.flight_data import FlightData


def first_values(problem: LikelihoodProblem, known: Mapping[str, float] = MappingProxyType({})) -> dict[str, float]:
    """Shared values at which the first fit begins, the nearest of three: none (the model's own starts), a regression, and what
    another model of these flights has of the same derivatives (`known`)."""
    taken = {n: known[n] for n in problem.parameters if n in known and not problem.nuisance(n)}
    others = [values for values in (by_regression(problem), taken) if values]
    return min([{}, *others], key=lambda values: cost_at(problem, values)) if others else {}


def by_regression(problem: LikelihoodProblem) -> dict[str, float]:
    """Derivatives of the model by equation error over the records, what is only nuisance at rest; none where a state is not
    measured, as those that an effect brings with it."""
    if len(problem.model.states) != len(problem.base.states):
        return {}
    asked = tuple(n for n in problem.parameters if not problem.nuisance(n))
    flights = [
        FlightData(f"record {i}", len(r), (replace(s, first=0),), r.states, {}, (), ())
        for i, (r, s) in enumerate(zip(problem.records, problem.coarse, strict=True))
        if r.states is not None
    ]
    if len(flights) < len(problem.records):
        return {}
    found = start_values(Simulator.build(problem.model, asked, substeps=1, hold="linear"), flights)
    return {} if found is None else {n: found[n] for n in asked}
