"""Which derivatives a flight can determine, predicted before a fit.

The prior model is driven with the measured inputs. Its sensitivities and the noise of the measured outputs give the Cramer-Rao
bound of every derivative: the inverse of the information matrix, initial states eliminated. That bound holds for white residuals;
those of real flights are coloured, so the verdict widens it by `USUAL_WIDENING`. The rules of the verdict are those of a fit
(`estimation.estimators.uncertainty.judge_estimates`).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimation.aircraft import Aircraft
from estimation.engine.simulate import simulate_with_sensitivities
from estimation.errors import DataError
from estimation.estimators.normal_equations import pseudo_inverse
from estimation.estimators.uncertainty import STILL, TIED, input_movement, judge_estimates
from estimation.models import load_model
from estimation.models.base import Model
from estimation.prepare.flight_data import PIECES, FlightData, cut_into_pieces
from estimation.prepare.pipeline import prepare
from groundstation.flight import Array, Flight, MissingColumnError
from groundstation.flight.findings import Finding
from groundstation.flight.quality.noise import noise
from groundstation.flight.quality.report import SENSOR_NOISE

CHECK = "excitation of derivatives"
USUAL_WIDENING = 2.0
"""Corrected over Cramer-Rao bound: 1.5 to 4.2, median 2.2, over derivatives of ordinary_0, cdfp_ld1 and cdfp_ld4."""

WANDERED = 5.0
"""Prior motion beyond this many times the measured one has diverged: it is started again in shorter pieces."""

LEAST_REACH = 3.0
"""Noise levels that a measured output counts as having moved at least."""
LEAST_RMS = 1e-12
"""Movement of the elevator [rad rms], in recordings without noise, up to which it stood still."""

ELEVATOR = "delta_e"
_RUDDER = "a rudder doublet or 3-2-1-1 of 5 deg or more, its steps about half a Dutch-roll period, ailerons held"
_AILERON = "aileron doublets or bank-to-bank rolls of 20 deg of bank or more, rudder held"
_BOTH = "rudder and aileron doublets one after the other in the same flight, so that p, r and beta move independently"
_ELEVATOR = "an elevator 3-2-1-1 of 3 deg or more, its steps about half a short period"
_SPEED = "a slow sweep of airspeed in level flight at measured thrust, from near the stall to full speed"
_MANOEUVRES = {
    "dr": _RUDDER,
    "beta": _RUDDER,
    "r": _BOTH,
    "p": _BOTH,
    "da": _AILERON,
    "de": _ELEVATOR,
    "alpha": _ELEVATOR,
    "q": _ELEVATOR,
    "k": _SPEED,
}
_CONSTANTS = {"CL_0": _SPEED, "CD_0": _SPEED, "Cm_0": _SPEED}
_TRIM = "a stretch of steady, wings-level flight before the manoeuvre"


@dataclass(frozen=True, slots=True)
class PredictedBound:
    """One derivative before the fit. prior, bound: [1/rad], bound 1 sigma; relative: bound/|prior|, None where the prior is zero;
    reason, manoeuvre: why the flight cannot determine it and which manoeuvre would, empty where it can."""

    model: str
    name: str
    prior: float
    bound: float
    relative: float | None
    can_tell: bool
    reason: str = ""
    manoeuvre: str = ""


@dataclass(frozen=True)
class Prediction:
    """The predicted bounds of one model. why: reason where they cannot be predicted, else empty."""

    model: str
    bounds: tuple[PredictedBound, ...]
    why: str = ""


def predicted_bounds(flight: Flight, aircraft: Aircraft) -> tuple[Prediction, ...]:
    """Predicted bounds of the `lateral` and `longitudinal` derivatives. A flight without the data has a reason, no error."""
    return tuple(_prediction(load_model(name, aircraft), flight, aircraft.name) for name in ("lateral", "longitudinal"))


def excitation_findings(predictions: Sequence[Prediction]) -> tuple[Finding, ...]:
    """For each model a finding with the derivatives that can be determined, and a warning for each reason why others cannot."""
    findings: list[Finding] = []
    for prediction in predictions:
        if prediction.why:
            # no warning: the quality report warns of missing and unmoved controls
            findings.append(Finding(CHECK, f"{prediction.model}: not judged: {prediction.why}", "ok"))
            continue
        identifiable = [b for b in prediction.bounds if b.can_tell]
        if identifiable:
            words = ", ".join(f"{b.name} {_size(b)}" for b in identifiable)
            findings.append(
                Finding(CHECK, f"{prediction.model}: can tell (bound predicted from the prior model): {words}", "ok")
            )
        groups: dict[tuple[str, str], list[str]] = {}
        for b in prediction.bounds:
            if not b.can_tell:
                groups.setdefault((b.reason, b.manoeuvre), []).append(f"{b.name} ({_size(b)})")
        for (reason, manoeuvre), names in groups.items():
            text = f"{prediction.model}: cannot tell {', '.join(names)}: {reason}; would tell it: {manoeuvre}"
            findings.append(Finding(CHECK, text, "warn"))
    return tuple(findings)


def _size(bound: PredictedBound) -> str:
    if not math.isfinite(bound.bound):
        return "no bound"
    return f"+-{bound.relative:.2g} of it" if bound.relative is not None else f"+-{bound.bound:.1g}"


def _prediction(model: Model, flight: Flight, aircraft: str) -> Prediction:
    try:
        data = prepare(model, flight)
    except (MissingColumnError, DataError) as error:
        return Prediction(model.name, (), str(error))
    if model.name == "longitudinal":
        rms, level = input_movement(model, [data])[ELEVATOR]
        if rms <= max(STILL * level, LEAST_RMS):
            reason = f"{ELEVATOR} moved only {math.degrees(rms):.2g} deg rms; would tell it: {_ELEVATOR}"
            return Prediction(model.name, (), reason)
    bound = _covariance(model, data, _output_noise(model, flight))
    if bound is None:
        reason = f"motion by the derivatives believed of {aircraft} leaves the measured one within a second; is it this aircraft?"
        return Prediction(model.name, (), f"{reason} Name another by --aircraft")
    covariance, undetermined = bound
    names = model.free_names
    prior = np.array([model.parameter(n).start for n in names])
    widened = covariance * USUAL_WIDENING**2
    judged, _ = judge_estimates(model, names, prior, covariance, widened, undetermined, [data])
    bounds = []
    for name, value in zip(names, prior.tolist(), strict=True):
        e = judged[name]
        relative = e.std / abs(value) if value else None
        manoeuvre = "" if e.identifiable else _manoeuvre(name)
        bounds.append(PredictedBound(model.name, name, value, e.std, relative, e.identifiable, e.why, manoeuvre))
    return Prediction(model.name, tuple(bounds))


def _manoeuvre(name: str) -> str:
    variable = name.rpartition("_")[2]
    return _CONSTANTS.get(name) or _MANOEUVRES.get(variable, _TRIM)


def _output_noise(model: Model, flight: Flight) -> Array:
    """(ny,) noise of each output, 1 sigma: as measured from sample to sample, and no less than that of its sensor.

    A filtered channel (attitude) or a coarsely quantised one has larger errors than its samples show.
    """
    sensor_noise = {**SENSOR_NOISE, **_stated_noise(flight)}
    levels = []
    for signal in model.outputs:
        measured = noise(flight[signal.source]) if flight.measured(signal.source) else None
        levels.append(max(measured or 0.0, sensor_noise[signal.source]))
    return np.array(levels)


def _stated_noise(flight: Flight) -> dict[str, float]:
    noise_table = flight.provenance.detail.get("sensor_noise", {})
    return {str(k): float(v) for k, v in noise_table.items()} if isinstance(noise_table, dict) else {}


def _covariance(model: Model, data: FlightData, sigma: Array) -> tuple[Array, NDArray[np.bool_]] | None:
    """(n, n) Cramer-Rao covariance at the prior, initial states eliminated, and (n,) which derivatives leave no trace in the
    data.

    None where the prior motion diverges from the measured one: the aircraft is another one.
    """
    simulated = _staying_near(model, data, sigma)
    if simulated is None:
        return None
    data, by_parameter, by_state = simulated
    n, nx = by_parameter.shape[2], by_state.shape[2]
    information = np.zeros((n, n))
    for s in data.segments:
        rows = s.rows
        J = np.concatenate([by_parameter[rows], by_state[rows]], axis=2) / sigma[None, :, None]
        J = J[np.isfinite(s.z) & np.isfinite(J).all(axis=2)]
        H = J.T @ J
        inverse, _ = pseudo_inverse(H[n:, n:]) if nx else (np.zeros((0, 0)), None)
        information += H[:n, :n] - H[:n, n:] @ inverse @ H[n:, :n]
    covariance, blind = pseudo_inverse(information)
    undetermined = np.any(np.abs(blind) > TIED, axis=1) if blind.size else np.zeros(n, bool)
    return covariance, undetermined


def _staying_near(model: Model, data: FlightData, sigma: Array) -> tuple[FlightData, Array, Array] | None:
    """The flight and its sensitivities, cut into the longest pieces over which the prior motion stays near the measured one; None
    where it never does. Sensitivities along a diverged motion would predict bounds that are far too small.
    """
    for seconds in (None, *PIECES):
        candidate = data if seconds is None else cut_into_pieces(data, seconds)
        y, by_parameter, by_state = simulate_with_sensitivities(model, candidate)
        if _near(y, candidate, sigma):
            return candidate, by_parameter, by_state
    return None


def _near(y: Array, data: FlightData, sigma: Array) -> bool:
    for s in data.segments:
        motion = y[s.rows]
        if not np.isfinite(motion).all():
            return False
        for modelled, measured, level in zip(motion.T, s.z.T, sigma.tolist(), strict=True):
            finite = measured[np.isfinite(measured)]
            if not finite.size:
                continue
            middle = float(np.median(finite))
            reach = max(float(np.abs(finite - middle).max()), LEAST_REACH * level)
            if float(np.abs(modelled - middle).max()) > WANDERED * reach:
                return False
    return True
