"""What an aircraft file is unsure of, in the bounds of derivatives.

A force coefficient is mass times acceleration over q S, a moment coefficient inertia times angular acceleration over q S b or c;
those by a rate have the length once more in the rate's hat. So a relative error of mass, inertia or geometry is one of the
derivative, which no residual shows. Errors of the file are taken as independent; what Ixz carries from roll to yaw is left out.
"""

import math
from collections.abc import Mapping
from dataclasses import replace

from estimation.aircraft import Aircraft
from estimation.estimators.result import Estimate, Result
from estimation.models.base import ParameterRole
from estimation.session.session import EstimationSession

FORCE = {"mass": 1, "area": 1}
LINES: Mapping[str, Mapping[str, int]] = {
    "CY": FORCE,
    "CL": FORCE,
    "CD": FORCE,
    "Cl": {"Ixx": 1, "area": 1, "span": 1},
    "Cm": {"Iyy": 1, "area": 1, "chord": 1},
    "Cn": {"Izz": 1, "area": 1, "span": 1},
}
"""Coefficient -> power of what is stated in it, the sign left out: errors are squared."""
HATS: Mapping[str, str] = {"p": "span", "r": "span", "q": "chord"}
"""Ending of a derivative by a rate -> the length in its hat."""


def share(name: str, aircraft: Aircraft) -> float:
    """Relative 1 sigma of a derivative by what the file of the aircraft is unsure of; 0 for anything else."""
    line, _, ending = name.partition("_")
    powers = dict(LINES.get(line, {}))
    if powers and ending in HATS:
        powers[HATS[ending]] = powers.get(HATS[ending], 0) + 1
    return math.hypot(*(power * aircraft.uncertainty.get(key, 0.0) for key, power in powers.items()))


def with_stated_uncertainty(session: EstimationSession) -> EstimationSession:
    """The session with the uncertainty of its aircraft's file in the corrected bounds of derivatives.

    After the verdict: methods and flights share the error, so it is no excuse where they disagree.
    """
    if not session.aircraft.uncertainty:
        return session
    flights = tuple(replace(f, results=_all_wider(f.results, session.aircraft)) for f in session.flights)
    return replace(session, flights=flights, joint=_all_wider(session.joint, session.aircraft))


def _all_wider(results: Mapping[str, Result], aircraft: Aircraft) -> dict[str, Result]:
    return {method: _result_wider(r, aircraft) for method, r in results.items()}


def _result_wider(result: Result, aircraft: Aircraft) -> Result:
    derivatives = set(result.model.free_of(ParameterRole.DERIVATIVE))
    wider = {n: _wider(e, share(n, aircraft)) if n in derivatives else e for n, e in result.parameters.items()}
    return replace(result, parameters=wider)


def _wider(estimate: Estimate, relative: float) -> Estimate:
    return replace(estimate, std_coloured=math.hypot(estimate.std_coloured, relative * estimate.estimate))
