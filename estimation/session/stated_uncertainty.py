"""What an aircraft file and the calibration of the airspeed are unsure of, in the bounds of derivatives.

A force coefficient is mass times acceleration over q S, a moment coefficient inertia times angular acceleration over q S b or c;
those by a rate have the length once more in the rate's hat. So a relative error of mass, inertia or geometry is one of the
derivative, which no residual shows. Errors of the file are taken as independent; what Ixz carries from roll to yaw is left out.
So is twice the relative error of a measured airspeed; a reconstructed one has its own (`evidence`).
"""

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from estimation.aircraft import Aircraft
from estimation.estimators.result import Estimate, EstimateHistory, Result
from estimation.models.base import ParameterRole
from estimation.session.evidence import POWER
from estimation.session.session import EstimationSession
from groundstation.flight import Flight
from groundstation.flight.airspeed import calibration_error

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


def airspeed_share(flight: Flight) -> float:
    """Relative 1 sigma of every derivative by the calibration of a measured airspeed; 0 where none is stated."""
    if "V" in flight.reconstructed or not flight.measured("V"):
        return 0.0
    return POWER * calibration_error(flight.provenance.detail, flight["V"])


def with_stated_uncertainty(session: EstimationSession) -> EstimationSession:
    """The session with what its aircraft's file and its airspeeds are unsure of in the corrected bounds of derivatives.

    After the verdict: methods and flights share the error, so it is no excuse where they disagree.
    """
    shares = [airspeed_share(f.flight) for f in session.flights]
    if not session.aircraft.uncertainty and not any(shares):
        return session
    flights = tuple(
        replace(f, results=_all_wider(f.results, session.aircraft, by_airspeed))
        for f, by_airspeed in zip(session.flights, shares, strict=True)
    )
    common = float(np.mean(shares)) if shares else 0.0
    return replace(session, flights=flights, joint=_all_wider(session.joint, session.aircraft, common))


def _all_wider(results: Mapping[str, Result], aircraft: Aircraft, by_airspeed: float) -> dict[str, Result]:
    return {method: _result_wider(r, aircraft, by_airspeed) for method, r in results.items()}


def _result_wider(result: Result, aircraft: Aircraft, by_airspeed: float) -> Result:
    derivatives = result.model.free_of(ParameterRole.DERIVATIVE)
    shares = {n: math.hypot(share(n, aircraft), by_airspeed) for n in derivatives}
    wider = {n: _wider(e, shares.get(n, 0.0)) for n, e in result.parameters.items()}
    return replace(result, parameters=wider, history=result.history and _history_wider(result.history, shares))


def _wider(estimate: Estimate, relative: float) -> Estimate:
    return replace(estimate, std_coloured=math.hypot(estimate.std_coloured, relative * estimate.estimate))


def _history_wider(history: EstimateHistory, shares: Mapping[str, float]) -> EstimateHistory:
    """The bounds during the flight, which end at the corrected ones."""
    std = {n: np.hypot(s, shares.get(n, 0.0) * history.estimate[n]) for n, s in history.std.items()}
    return replace(history, std=std)
