"""What to fly next: of a small library of manoeuvres the one that brings the worst bound furthest down.

The information that was flown is known, and of each manoeuvre of the library what it would add is predicted: the linear
lateral motion at the airspeed of now, with what is known of the derivatives by now, makes the columns of the regression; the
noise of a row is that which explains the bounds so far. Bounds of what would be known then follow from the sum of both.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from daq.contract.constants import GRAVITY
from daq.identification.airframe import COLUMNS, EQUATIONS, Airframe, Sample
from daq.identification.live import EquationInformation

Array = NDArray[np.float64]

STEP = 0.025  # s of the prediction; the scan's interval is twice that at 20 Hz
ROW = 0.05  # s that a row lasts, nominally
LEAST_SPEED = 3.0  # m/s: below nothing flies that this program knows of, and equations divide by it
STEEPEST = math.radians(85.0)  # of pitch: the linear motion has tan(theta)
LONG = 8.0  # s of every manoeuvre, its free motion included: so they are compared at the same price
AILERON, RUDDER = math.radians(6.0), math.radians(3.5)  # peaks that a pilot flies without thinking
MOST_SIDESLIP, MOST_BANK = (
    math.radians(12.0),
    math.radians(40.0),
)  # a manoeuvre predicted to go further is flown smaller
NO_LAG = 0.035  # s, servo where the aircraft states none

PULSES: Mapping[str, tuple[tuple[float, float], ...]] = {  # parts of the peak, and how long [s]
    "doublet": ((1.0, 0.5), (-1.0, 0.5)),
    "slow doublet": ((1.0, 1.0), (-1.0, 1.0)),
    "3-2-1-1": ((1.0, 1.2), (-1.0, 0.8), (1.0, 0.4), (-1.0, 0.4)),
}


@dataclass(frozen=True, slots=True)
class CandidateManoeuvre:
    """One manoeuvre of the library. title: as a person says it; aileron, rudder: pulses, empty where it rests; aileron first."""

    title: str
    aileron: str = ""
    rudder: str = ""


LIBRARY = (
    *(CandidateManoeuvre(f"aileron {kind}", aileron=kind) for kind in PULSES),
    *(CandidateManoeuvre(f"rudder {kind}", rudder=kind) for kind in PULSES),
    CandidateManoeuvre("aileron doublet, then rudder doublet", "doublet", "doublet"),
    CandidateManoeuvre("aileron 3-2-1-1, then rudder doublet", "3-2-1-1", "doublet"),
)


@dataclass(frozen=True, slots=True)
class ManoeuvreAdvice:
    """What to fly. worst: the derivative furthest from its wanted bound; now, then: that bound in units of the wanted one,
    before and after the manoeuvre; share: of the library's usual peaks that is flown, so that the response stays small."""

    manoeuvre: str
    worst: str
    now: float
    then: float
    share: float


def next_manoeuvre(
    airframe: Airframe,
    values: Mapping[str, float],
    information: Mapping[str, EquationInformation],
    wanted: Mapping[str, float],
    sample: Sample,
) -> ManoeuvreAdvice | None:
    """The manoeuvre that lowers the largest bound / wanted most; None where all are reached, or nothing is solved yet.

    values: derivatives as known by now [1/rad], also those not solved. wanted: bounds [1/rad]. sample: flight condition.
    """
    if not has_condition(sample):
        return None
    known = {c: i for c, i in information.items() if len(i.columns) == len(EQUATIONS[c])}
    if len(known) < len(EQUATIONS):
        return None
    now = _ratios(known, dict.fromkeys(known, 0.0), wanted)
    worst = max(now, key=lambda n: now[n])
    if now[worst] <= 1.0:
        return None
    best: tuple[float, CandidateManoeuvre, float, dict[str, float]] | None = None
    for candidate in LIBRARY:
        columns, share = predicted_columns(airframe, values, candidate, sample)
        added = {c: _normal(columns, i) / i.noise for c, i in known.items()}
        then = _ratios(known, added, wanted)
        reached = max(then.values())
        if best is None or reached < best[0]:
            best = (reached, candidate, share, then)
    assert best is not None
    return ManoeuvreAdvice(best[1].title, worst, now[worst], best[3][worst], best[2])


def has_condition(sample: Sample) -> bool:
    """Whether a sample is a flight condition that a manoeuvre can be flown at: moving air, and an attitude in which it means
    anything. At standstill, on the tail or with a sensor off it is not."""
    finite = all(map(math.isfinite, (sample.V, sample.rho, sample.alpha, sample.theta)))
    return finite and LEAST_SPEED <= sample.V and sample.rho > 0.0 and abs(sample.theta) < STEEPEST


def _ratios(
    known: Mapping[str, EquationInformation], added: Mapping[str, Array | float], wanted: Mapping[str, float]
) -> dict[str, float]:
    """Bound in units of the wanted one, of every derivative that has one, with so much information more."""
    found = {}
    for coefficient, i in known.items():
        covariance = np.linalg.inv(np.linalg.inv(i.covariance) + added[coefficient])
        for at, column in enumerate(i.columns):
            name = f"{coefficient}_{COLUMNS[column]}"
            if wanted.get(name, 0.0) > 0.0:
                found[name] = math.sqrt(max(covariance[at, at], 0.0)) / wanted[name]
    return found


def _normal(columns: Array, i: EquationInformation) -> Array:
    own = columns[:, list(i.columns)]
    return np.asarray(own.T @ own)


def predicted_columns(
    airframe: Airframe, values: Mapping[str, float], candidate: CandidateManoeuvre, sample: Sample
) -> tuple[Array, float]:
    """(rows, 6) columns of the regression without their mean [Pa s], and the share of the peaks that is flown."""
    if not has_condition(sample):
        return np.zeros((round(LONG / ROW), 6)), 1.0  # what cannot be flown adds nothing
    A, B = linear_lateral(airframe, values, sample)
    surfaces = _surfaces(candidate, NO_LAG if airframe.servo_lag is None else airframe.servo_lag)
    block = np.zeros((6, 6))
    block[:4, :4], block[:4, 4:] = A, B
    moved = _exponential(STEP * block)
    Ad, Bd = moved[:4, :4], moved[:4, 4:]
    states = np.zeros((len(surfaces), 4))
    for k in range(len(surfaces) - 1):
        states[k + 1] = Ad @ states[k] + Bd @ surfaces[k]
    largest = max(np.abs(states[:, 0]).max() / MOST_SIDESLIP, np.abs(states[:, 3]).max() / MOST_BANK)
    share = 1.0 / largest if largest > 1.0 else 1.0
    every = max(1, round(ROW / STEP))
    pressure = 0.5 * sample.rho * sample.V**2
    rate = airframe.span / (2.0 * sample.V)
    table = np.column_stack([np.ones(len(states)), states[:, 0], rate * states[:, 1], rate * states[:, 2], surfaces])[
        ::every
    ]
    table[:, 1:] *= share
    table[:, 1:] -= table[:, 1:].mean(axis=0)  # the constant is estimated too, and takes the mean with it
    return ROW * pressure * table, float(share)


def linear_lateral(airframe: Airframe, values: Mapping[str, float], sample: Sample) -> tuple[Array, Array]:
    """A (4, 4), B (4, 2) of d(beta, p, r, phi)/dt about level flight at the sample's V, alpha and theta [SI, rad]."""
    a, V = airframe, sample.V
    d = {n: values.get(n, 0.0) for c, terms in EQUATIONS.items() for n in (f"{c}_{t}" for t in terms)}
    q_s = 0.5 * sample.rho * V * V * a.area
    rate = a.span / (2.0 * V)
    side = q_s / (a.mass * V) * np.array([d["CY_beta"], rate * d["CY_p"], rate * d["CY_r"], 0.0, 0.0, d["CY_dr"]])
    rolling = [d["Cl_beta"], rate * d["Cl_p"], rate * d["Cl_r"], 0.0, d["Cl_da"], d["Cl_dr"]]
    yawing = [d["Cn_beta"], rate * d["Cn_p"], rate * d["Cn_r"], 0.0, 0.0, d["Cn_dr"]]
    L, N = q_s * a.span * np.array(rolling), q_s * a.span * np.array(yawing)
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


def _surfaces(candidate: CandidateManoeuvre, lag: float) -> Array:
    """(steps, 2) aileron and rudder [rad] behind a first-order servo; the second control moves when the first is done."""
    command = np.zeros((round(LONG / STEP), 2))
    at = 0.0
    for control, (kind, peak) in enumerate(((candidate.aileron, AILERON), (candidate.rudder, RUDDER))):
        for part, seconds in PULSES[kind] if kind else ():
            command[round(at / STEP) : round((at + seconds) / STEP), control] = part * peak
            at += seconds
    fade = math.exp(-STEP / lag)
    moved = np.zeros_like(command)
    for k in range(1, len(command)):
        moved[k] = command[k - 1] + (moved[k - 1] - command[k - 1]) * fade
    return moved


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
