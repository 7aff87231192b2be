"""Stated uncertainty of the aircraft file and of the airspeed's calibration, in the bounds of derivatives.

A force coefficient is mass times acceleration over q S, a moment coefficient inertia times angular acceleration over q S b or
q S c; rate derivatives contain the length once more, in the dimensionless rate. So a relative error of mass, inertia or geometry,
and twice that of a measured airspeed, is a relative error of the derivative, which no residual shows. Errors in the file are
taken as independent; the coupling of roll and yaw by Ixz is neglected. `evidence` treats reconstructed airspeeds.
"""

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from estimation.aircraft import Aircraft
from estimation.estimators.result import EstimateHistory, Result
from estimation.models.base import ParameterRole
from estimation.session.evidence import AIRSPEED_POWER, widened
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
"""Coefficient -> stated quantity -> magnitude of its power: errors add as squares, so signs do not matter."""
RATE_LENGTHS: Mapping[str, str] = {"p": "span", "r": "span", "q": "chord"}
"""Ending of a rate derivative -> the length in its dimensionless rate (p b / 2V)."""


def share(name: str, aircraft: Aircraft) -> float:
    """Relative 1 sigma of a derivative from the uncertainties stated in the aircraft file; 0 for any other name."""
    line, _, ending = name.partition("_")
    powers = dict(LINES.get(line, {}))
    if powers and ending in RATE_LENGTHS:
        length = RATE_LENGTHS[ending]
        powers[length] = powers.get(length, 0) + 1
    return math.hypot(*(power * aircraft.uncertainty.get(key, 0.0) for key, power in powers.items()))


def airspeed_share(flight: Flight) -> float:
    """Relative 1 sigma of every derivative from the calibration of a measured airspeed; 0 where none is stated."""
    if "V" in flight.reconstructed or not flight.measured("V"):
        return 0.0
    return AIRSPEED_POWER * calibration_error(flight.provenance.detail, flight["V"])


def with_stated_uncertainty(session: EstimationSession) -> EstimationSession:
    """The session with the stated uncertainties of aircraft file and airspeed in the corrected bounds of derivatives.

    To be called after the verdict: methods and flights share these errors, so they cannot explain a disagreement.
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
    wider = {n: widened(e, shares.get(n, 0.0)) for n, e in result.parameters.items()}
    return replace(result, parameters=wider, history=result.history and _history_wider(result.history, shares))


def _history_wider(history: EstimateHistory, shares: Mapping[str, float]) -> EstimateHistory:
    """The history of the bounds, widened like the final ones."""
    std = {n: np.hypot(s, shares.get(n, 0.0) * history.estimate[n]) for n, s in history.std.items()}
    return replace(history, std=std)
