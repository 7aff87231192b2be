"""A fourth simulator, of other choices than all others here: the pitching plane alone, Euler steps of a millisecond, first-order
servo, a pilot who holds the pitch attitude through noisy sensors, instruments sampled without a filter.

Shares no code with `firmware_sim`, `estimation` or the other truths. Body axes x forward, z down; SI and radians; every aircraft
has derivatives of its own, about those of a small flat-plate aeroplane.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from groundstation.flight import Flight, Provenance

Array = NDArray[np.float64]
DEG = np.pi / 180
STEP = 1e-3  # s
AREA, CHORD, MASS, PITCH_INERTIA, GRAVITY, DENSITY = 0.787, 0.61, 3.5, 0.23, 9.80665, 1.17
TRIM_SPEED = 16.5  # m/s, at which Cm_0 trims the elevator to nothing
USUAL = {
    "CL_alpha": 3.0, "CL_q": 3.3, "CL_de": 1.0, "CD_0": 0.025, "CD_k": 0.24, "Cm_alpha": -0.168, "Cm_q": -0.92, "Cm_de": -0.36,
}  # fmt: skip
NOISE = {
    "ax": 0.05, "az": 0.08, "q": 0.4 * DEG, "theta": 0.3 * DEG, "alpha": 0.3 * DEG, "V": 0.15, "delta_e": 0.07 * DEG,
}  # fmt: skip


@dataclass(frozen=True)
class Kind:
    """How one set is flown. rate: samples a second; noise: by what the usual noise of a channel is multiplied; hold: gains of the
    pitch hold on pitch attitude and rate; hidden_lag: of the elevator behind its potentiometer [s]."""

    rate: int = 20
    duration: float = 30.0
    noise: tuple[tuple[str, float], ...] = ()
    hold: tuple[float, float] = (0.25, 0.05)
    servo: float = 0.035
    hidden_lag: float = 0.0


def fly(seed: int, kind: Kind, speeds: Sequence[float]) -> tuple[Flight, ...]:
    """One flight at each speed [m/s], of one aircraft."""
    rng = np.random.default_rng(seed)
    derivatives = {n: v * (1.0 + 0.1 * rng.standard_normal()) for n, v in USUAL.items()}
    return tuple(_flown(f"s{seed}_{i}", derivatives, v, kind, rng) for i, v in enumerate(speeds))


def inputs(time: Array, rng: np.random.Generator) -> Array:
    """(N,) pilot's elevator: multisteps of several lengths and sizes."""
    course = np.zeros(time.size)
    width, sign = rng.uniform(0.9, 1.1), rng.choice([-1.0, 1.0])
    for start, parts, low, high in (
        (1.5, (0.9, 0.6, 0.3, 0.3), 1.4, 2.0), (6.3, (0.4, 0.4), 2.4, 3.0), (10.6, (1.1, 0.5), 1.0, 1.4),
        (15.2, (0.35,) * 4, 1.8, 2.8), (19.4, (0.9, 0.6, 0.3, 0.3), 0.8, 1.2), (26.0, (0.3, 0.3), 4.0, 6.0),
    ):  # fmt: skip
        begin, size = start + rng.uniform(-0.3, 0.3), rng.uniform(low, high) * DEG
        for part in parts:
            course[(time >= begin) & (time < begin + part * width)] += sign * size
            begin, size = begin + part * width, -size
        sign = -sign
    return course


def _flown(name: str, d: dict[str, float], speed: float, kind: Kind, rng: np.random.Generator) -> Flight:
    time = np.arange(round(kind.duration / STEP) + 1) * STEP
    stick, pressure = inputs(time, rng), 0.5 * DENSITY * speed**2
    level = MASS * GRAVITY / (0.5 * DENSITY * TRIM_SPEED**2 * AREA) / d["CL_alpha"]
    lift = MASS * GRAVITY / (pressure * AREA)
    at = np.array([[d["CL_alpha"], d["CL_de"]], [d["Cm_alpha"], d["Cm_de"]]])
    alpha, rest = np.linalg.solve(at, [lift, d["Cm_alpha"] * level])
    thrust = pressure * AREA * (d["CD_0"] + d["CD_k"] * lift**2) / np.cos(alpha)
    u, w, q, theta, arm, surface = speed * np.cos(alpha), speed * np.sin(alpha), 0.0, alpha, rest, rest
    trim, seen, rows = theta, rng.standard_normal((2, time.size)), np.empty((time.size, 7))
    for k in range(time.size):
        airspeed, alpha = float(np.hypot(u, w)), float(np.arctan2(w, u))
        held = kind.hold[0] * (theta - trim + 0.002 * seen[0, k]) + kind.hold[1] * (q + 0.004 * seen[1, k])
        arm += STEP * (rest + stick[k] + held - arm) / kind.servo
        surface = surface + STEP * (arm - surface) / kind.hidden_lag if kind.hidden_lag else arm
        pressure, rate = 0.5 * DENSITY * airspeed**2, q * CHORD / (2.0 * airspeed)
        CL = d["CL_alpha"] * alpha + d["CL_q"] * rate + d["CL_de"] * surface
        CD = d["CD_0"] + d["CD_k"] * CL**2
        ax = (pressure * AREA * (CL * np.sin(alpha) - CD * np.cos(alpha)) + thrust) / MASS
        az = -pressure * AREA * (CL * np.cos(alpha) + CD * np.sin(alpha)) / MASS
        rows[k] = ax, az, q, theta, alpha, airspeed, arm
        Cm = d["Cm_alpha"] * (alpha - level) + d["Cm_q"] * rate + d["Cm_de"] * surface
        u, w = u + STEP * (ax - GRAVITY * np.sin(theta) - q * w), w + STEP * (az + GRAVITY * np.cos(theta) + q * u)
        theta += STEP * q
        q += STEP * pressure * AREA * CHORD * Cm / PITCH_INERTIA
    sampled = rows[:: round(1.0 / (kind.rate * STEP))]
    factors = dict(kind.noise)
    columns = {
        n: sampled[:, i] + factors.get(n, 1.0) * NOISE[n] * rng.standard_normal(len(sampled))
        for i, n in enumerate(("ax", "az", "q", "theta", "alpha", "V", "delta_e"))
    }
    still = np.zeros(len(sampled))
    steady = {"thrust": still + thrust, "rho": still + DENSITY, "beta": still, "p": still, "r": still, "phi": still}
    time = np.arange(len(sampled)) / kind.rate
    return Flight.build(name, time, {**columns, **steady}, provenance=Provenance(aircraft="cdfp"))
