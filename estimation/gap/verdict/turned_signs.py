"""Columns of the wrong sign or unit that the first model's fit gives away: no effect of an aircraft does that."""

from estimation.estimators.result import Estimate
from estimation.gap.likelihood.baseline import Baseline
from estimation.session.sanity_checks import (
    controls_of_another_unit,
    turned_controls,
    turned_outputs,
    turned_side_force,
)


def turned_signs(baseline: Baseline) -> list[str]:
    """One sentence for each column that moves against what the base model makes of the others, or of what was believed."""
    problem, fit = baseline.problem, baseline.fit
    base = problem.base
    measured = [r.z for r in problem.coarse]
    outputs = turned_outputs(base, [(z, z - e) for z, e in zip(measured, fit.residuals, strict=True)])
    bounds = fit.std()
    found = {
        n: Estimate(n, fit.values[n], bounds[n], bounds[n], reference=base.parameter(n).reference)
        for n in base.starts()
        if n in bounds
    }
    return [
        *outputs,
        *turned_side_force(base, found),
        *turned_controls(base, found),
        *controls_of_another_unit(base, found),
    ]
