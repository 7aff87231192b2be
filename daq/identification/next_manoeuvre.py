"""What to fly next: of a small library of manoeuvres the one that brings the worst bound furthest down.

The information that was flown is known, and of each manoeuvre of the library what it would add is predicted: the linear
lateral motion at the airspeed of now, with what is known of the derivatives by now, makes the columns of the regression; the
noise of a row is that which explains the bounds so far. Bounds of what would be known then follow from the sum of both.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from daq.identification.airframe import EQUATIONS, Airframe, Sample
from daq.identification.estimates import EquationInformation
from daq.identification.regression import LATERAL, PlaneRegression
from daq.utilities.constants import GRAVITY

Array = NDArray[np.float64]

STEP = 0.025  # s of the prediction; the scan's interval is twice that at 20 Hz
ROW = 0.05  # s that a row lasts, nominally
LEAST_SPEED = 3.0  # m/s: below nothing flies that this program knows of, and equations divide by it
STEEPEST = math.radians(85.0)  # of pitch: the linear motion has tan(theta)
LONG = 8.0  # s of every manoeuvre, its free motion included: so they are compared at the same price
AILERON, RUDDER, ELEVATOR = (
    math.radians(6.0),
    math.radians(3.5),
    math.radians(2.5),
)  # peaks that a pilot flies without thinking
# a manoeuvre predicted to go further is flown smaller
MOST_SIDESLIP, MOST_BANK, MOST_ALPHA = math.radians(12.0), math.radians(40.0), math.radians(5.0)
NO_LAG = 0.035  # s, servo where the aircraft states none

PULSES: Mapping[str, tuple[tuple[float, float], ...]] = {  # parts of the peak, and how long [s]
    "doublet": ((1.0, 0.5), (-1.0, 0.5)),
    "slow doublet": ((1.0, 1.0), (-1.0, 1.0)),
    "3-2-1-1": ((1.0, 1.2), (-1.0, 0.8), (1.0, 0.4), (-1.0, 0.4)),
}


@dataclass(frozen=True, slots=True)
class CandidateManoeuvre:
    """One manoeuvre of the library. title: as a person says it; aileron, rudder, elevator: pulses, empty where it rests; aileron
    first."""

    title: str
    aileron: str = ""
    rudder: str = ""
    elevator: str = ""


LIBRARY = (
    *(CandidateManoeuvre(f"aileron {kind}", aileron=kind) for kind in PULSES),
    *(CandidateManoeuvre(f"rudder {kind}", rudder=kind) for kind in PULSES),
    CandidateManoeuvre("aileron doublet, then rudder doublet", "doublet", "doublet"),
    CandidateManoeuvre("aileron 3-2-1-1, then rudder doublet", "3-2-1-1", "doublet"),
)
PITCH_LIBRARY = tuple(CandidateManoeuvre(f"elevator {kind}", elevator=kind) for kind in PULSES)


@dataclass(frozen=True, slots=True)
class ManoeuvreAdvice:
    """What to fly. worst: the derivative furthest from its wanted bound; now, then: that bound in units of the wanted one,
    before and after the manoeuvre; share: of the library's usual peaks that is flown, so that the response stays small; peaks:
    control -> [rad] that are flown; seconds: of moving it, after which hands are off until `LONG` are over."""

    manoeuvre: str
    worst: str
    now: float
    then: float
    share: float
    peaks: Mapping[str, float]
    seconds: float


def next_manoeuvre(
    airframe: Airframe,
    values: Mapping[str, float],
    information: Mapping[str, EquationInformation],
    wanted: Mapping[str, float],
    sample: Sample,
    regression: PlaneRegression = LATERAL,
) -> ManoeuvreAdvice | None:
    """The manoeuvre that lowers the largest bound / wanted most; None where all are reached, or nothing is solved yet.

    values: derivatives as known by now [1/rad], also those not solved. wanted: bounds [1/rad]. sample: flight condition.
    """
    if not has_condition(sample):
        return None
    terms = {e.coefficient: len(e.terms) for e in regression.equations if e.terms}
    solved = {c: i for c, i in information.items() if len(i.columns) == terms.get(c)}
    if len(solved) < len(terms):
        return None
    pitching = "alpha" in regression.states
    ratios_now = _ratios(solved, dict.fromkeys(solved, 0.0), wanted)
    worst_name = max(ratios_now, key=lambda n: ratios_now[n], default="")
    if not worst_name:
        return None
    if not ratios_now[worst_name] > 1.0:
        return None
    best_candidate: tuple[float, CandidateManoeuvre, float, dict[str, float]] | None = None
    for candidate in PITCH_LIBRARY if pitching else LIBRARY:
        predicted = predicted_pitch_columns if pitching else predicted_columns
        columns, share = predicted(airframe, values, candidate, sample)
        added_information = {c: _normal(columns, i) / i.noise for c, i in solved.items()}
        ratios_then = _ratios(solved, added_information, wanted)
        largest_ratio = max(ratios_then.values())
        if best_candidate is None or largest_ratio < best_candidate[0]:
            best_candidate = (largest_ratio, candidate, share, ratios_then)
    assert best_candidate is not None
    _, chosen, share, ratios_then = best_candidate
    kinds = {
        "aileron": (chosen.aileron, AILERON),
        "rudder": (chosen.rudder, RUDDER),
        "elevator": (chosen.elevator, ELEVATOR),
    }
    peaks = {control: share * peak for control, (kind, peak) in kinds.items() if kind}
    seconds = sum(length for kind, _ in kinds.values() if kind for _, length in PULSES[kind])
    return ManoeuvreAdvice(
        chosen.title, worst_name, ratios_now[worst_name], ratios_then[worst_name], share, peaks, seconds
    )


def has_condition(sample: Sample) -> bool:
    """Whether a sample is a flight condition that a manoeuvre can be flown at: moving air, and an attitude in which it means
    anything. At standstill, on the tail or with a sensor off it is not."""
    finite = all(map(math.isfinite, (sample.V, sample.rho, sample.alpha, sample.theta)))
    return finite and LEAST_SPEED <= sample.V and sample.rho > 0.0 and abs(sample.theta) < STEEPEST


def _ratios(
    known: Mapping[str, EquationInformation], added: Mapping[str, Array | float], wanted: Mapping[str, float]
) -> dict[str, float]:
    """Bound in units of the wanted one, of every derivative that has one, with so much information more."""
    ratios = {}
    for coefficient, i in known.items():
        covariance = np.linalg.inv(np.linalg.inv(i.covariance) + added[coefficient])
        for index, name in enumerate(i.names):
            if wanted.get(name, 0.0) > 0.0:
                ratios[name] = math.sqrt(max(covariance[index, index], 0.0)) / wanted[name]
    return ratios


def _normal(columns: Array, i: EquationInformation) -> Array:
    equation_columns = columns[:, list(i.columns)]
    return np.asarray(equation_columns.T @ equation_columns)


def predicted_columns(
    airframe: Airframe, values: Mapping[str, float], candidate: CandidateManoeuvre, sample: Sample
) -> tuple[Array, float]:
    """(rows, 6) columns of the regression without their mean [Pa s], and the share of the peaks that is flown."""
    if not has_condition(sample):
        return np.zeros((round(LONG / ROW), 6)), 1.0  # what cannot be flown adds nothing
    A, B = linear_lateral(airframe, values, sample)
    surfaces = _surfaces(((candidate.aileron, AILERON), (candidate.rudder, RUDDER)), airframe)
    states = _response(A, B, surfaces)
    largest = max(np.abs(states[:, 0]).max() / MOST_SIDESLIP, np.abs(states[:, 3]).max() / MOST_BANK)
    share = 1.0 / max(1.0, largest)
    stride = max(1, round(ROW / STEP))
    pressure = 0.5 * sample.rho * sample.V**2
    rate = airframe.span / (2.0 * sample.V)
    table = np.column_stack([np.ones(len(states)), states[:, 0], rate * states[:, 1], rate * states[:, 2], surfaces])[
        ::stride
    ]
    table[:, 1:] *= share
    table[:, 1:] -= table[:, 1:].mean(axis=0)  # the constant is estimated too, and takes the mean with it
    return ROW * pressure * table, float(share)


def predicted_pitch_columns(
    airframe: Airframe, values: Mapping[str, float], candidate: CandidateManoeuvre, sample: Sample
) -> tuple[Array, float]:
    """(rows, 5) columns of the pitching plane without their mean [Pa s], and the share of the peak that is flown."""
    if not has_condition(sample):
        return np.zeros((round(LONG / ROW), 5)), 1.0  # what cannot be flown adds nothing
    A, B = linear_pitch(airframe, values, sample)
    surfaces = _surfaces(((candidate.elevator, ELEVATOR),), airframe)
    states = _response(A, B, surfaces)
    largest = np.abs(states[:, 0]).max() / MOST_ALPHA
    share = 1.0 / max(1.0, largest)
    pressure, rate = 0.5 * sample.rho * sample.V**2, airframe.chord / (2.0 * sample.V)
    d = {n: values.get(n, 0.0) for n in ("CL_alpha", "CL_q", "CL_de")}
    level = airframe.mass_as(sample.mass) * GRAVITY * math.cos(sample.theta) / (pressure * airframe.area)
    alpha, q_hat, elevator = share * states[:, 0], share * rate * states[:, 1], share * surfaces[:, 0]
    lift = level + d["CL_alpha"] * alpha + d["CL_q"] * q_hat + d["CL_de"] * elevator
    table = np.column_stack([np.ones(len(states)), alpha, q_hat, elevator, lift**2])[:: max(1, round(ROW / STEP))]
    table[:, 1:] -= table[:, 1:].mean(axis=0)  # the constant is estimated too, and takes the mean with it
    return ROW * pressure * table, float(share)


def linear_pitch(airframe: Airframe, values: Mapping[str, float], sample: Sample) -> tuple[Array, Array]:
    """A (2, 2), B (2, 1) of d(alpha, q)/dt about level flight at the sample's V [SI, rad]."""
    a, V = airframe, sample.V
    q_s, rate = 0.5 * sample.rho * V * V * a.area, a.chord / (2.0 * V)
    lift, moment = (
        np.array([values.get(f"{c}_alpha", 0.0), rate * values.get(f"{c}_q", 0.0), values.get(f"{c}_de", 0.0)])
        for c in ("CL", "Cm")
    )
    moment = moment - a.cg_ahead(sample.cg_x) / a.chord * lift
    rows = np.stack([-q_s / (a.mass_as(sample.mass) * V) * lift, q_s * a.chord / a.Iyy * moment])
    rows[0, 1] += 1.0
    return rows[:, :2], rows[:, 2:]


def linear_lateral(airframe: Airframe, values: Mapping[str, float], sample: Sample) -> tuple[Array, Array]:
    """A (4, 4), B (4, 2) of d(beta, p, r, phi)/dt about level flight at the sample's V, alpha and theta [SI, rad]."""
    a, V = airframe, sample.V
    d = {n: values.get(n, 0.0) for c, terms in EQUATIONS.items() for n in (f"{c}_{t}" for t in terms)}
    q_s = 0.5 * sample.rho * V * V * a.area
    rate = a.span / (2.0 * V)
    side_gain = q_s / (a.mass_as(sample.mass) * V)
    side = side_gain * np.array([d["CY_beta"], rate * d["CY_p"], rate * d["CY_r"], 0.0, 0.0, d["CY_dr"]])
    rolling = [d["Cl_beta"], rate * d["Cl_p"], rate * d["Cl_r"], 0.0, d["Cl_da"], d["Cl_dr"]]
    yawing = [d["Cn_beta"], rate * d["Cn_p"], rate * d["Cn_r"], 0.0, 0.0, d["Cn_dr"]]
    L, N = q_s * a.span * np.array(rolling), q_s * a.span * np.array(yawing)
    N = N - a.cg_ahead(sample.cg_x) * a.mass_as(sample.mass) * V * side
    inertia = a.Ixx * a.Izz - a.Ixz**2
    rows = np.array(
        [
            side,
            (a.Izz * L + a.Ixz * N) / inertia,
            (a.Ixx * N + a.Ixz * L) / inertia,
            np.zeros(6),
        ]
    )
    rows[0, 1] += math.sin(sample.alpha)
    rows[0, 2] -= math.cos(sample.alpha)
    rows[0, 3] += GRAVITY * math.cos(sample.theta) / V
    rows[3, 1], rows[3, 2] = 1.0, math.tan(sample.theta)
    return rows[:, :4], rows[:, 4:]


def _response(A: Array, B: Array, surfaces: Array) -> Array:
    """(steps, states) motion of a linear system from rest."""
    states, controls = B.shape
    block = np.zeros((states + controls, states + controls))
    block[:states, :states], block[:states, states:] = A, B
    discrete = _exponential(STEP * block)
    Ad, Bd = discrete[:states, :states], discrete[:states, states:]
    motion = np.zeros((len(surfaces), states))
    for k in range(len(surfaces) - 1):
        motion[k + 1] = Ad @ motion[k] + Bd @ surfaces[k]
    return motion


def _surfaces(moves: Sequence[tuple[str, float]], airframe: Airframe) -> Array:
    """(steps, controls) surfaces [rad] behind a first-order servo; each moves when the one before is done. moves: kind of pulses
    and peak of each."""
    lag = NO_LAG if airframe.servo_lag is None else airframe.servo_lag
    command = np.zeros((round(LONG / STEP), len(moves)))
    start = 0.0
    for control, (kind, peak) in enumerate(moves):
        for part, seconds in PULSES[kind] if kind else ():
            command[round(start / STEP) : round((start + seconds) / STEP), control] = part * peak
            start += seconds
    fade = math.exp(-STEP / lag)
    surfaces = np.zeros_like(command)
    for k in range(1, len(command)):
        surfaces[k] = command[k - 1] + (surfaces[k - 1] - command[k - 1]) * fade
    return surfaces


def _exponential(matrix: Array) -> Array:
    """Of a small matrix, by its series after halving until the norm is below one eighth: 12 terms are exact to rounding."""
    halvings = max(0, math.ceil(math.log2(max(float(np.abs(matrix).sum(axis=1).max()), 1e-300) * 8.0)))
    small = matrix / 2.0**halvings
    total = term = np.eye(len(matrix))
    for k in range(1, 13):
        term = term @ small / k
        total = total + term
    for _ in range(halvings):
        total = total @ total
    return total
