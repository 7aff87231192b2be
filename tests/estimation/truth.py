"""Flights with known truth, made by equations written here a second time and integrated by another program.

Lateral-directional motion in body-axis velocities (v, p, r, phi), numpy, classical Runge-Kutta at 400 Hz, all seeds of
a study at once. Nothing here comes from `estimation`: a shared mistake cannot cancel itself.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from groundstation.flight import Flight

Array = NDArray[np.float64]

TRUE = {
    "CY_0": 0.001, "CY_beta": -0.118, "CY_p": -0.053, "CY_r": 0.11, "CY_dr": 0.42,
    "Cl_0": 0.0002, "Cl_beta": -0.089, "Cl_p": -0.48, "Cl_r": 0.09, "Cl_da": -0.095, "Cl_dr": 0.02,
    "Cn_0": -0.0001, "Cn_beta": 0.026, "Cn_p": 0.024, "Cn_r": -0.045, "Cn_dr": -0.033,
}  # fmt: skip
STRONG = ("CY_beta", "CY_dr", "Cl_beta", "Cl_p", "Cl_da", "Cn_beta", "Cn_r", "Cn_dr")
MASS, AREA, SPAN, IXX, IYY, IZZ, IXZ, GRAVITY = 3.5, 0.787, 1.5, 0.24, 0.23, 0.46, 0.008, 9.80665
DEG = np.pi / 180

NOISE = {
    "ay": 0.05, "p": 0.4 * DEG, "q": 0.4 * DEG, "r": 0.3 * DEG, "phi": 0.3 * DEG, "theta": 0.3 * DEG,
    "alpha": 0.3 * DEG, "beta": 0.25 * DEG, "V": 0.15, "delta_a": 0.07 * DEG, "delta_r": 0.07 * DEG,
}  # fmt: skip


@dataclass(frozen=True)
class Craft:
    """What flies: mass [kg], area [m2], span [m], inertia [kg m2], air density [kg/m3]."""

    mass: float = MASS
    area: float = AREA
    span: float = SPAN
    ixx: float = IXX
    iyy: float = IYY
    izz: float = IZZ
    ixz: float = IXZ
    rho: float = 1.17


SMALL = Craft()
JET = Craft(17_500.0, 64.0, 21.5, 2.0e5, 7.0e5, 8.5e5, 2.0e4, 0.9)
"""The size and weight of a twin jet of some 20 t, from no record."""

JET_TRUE = {
    "CY_0": 0.0, "CY_beta": -0.9, "CY_p": 0.16, "CY_r": 0.45, "CY_dr": 0.19,
    "Cl_0": 0.0, "Cl_beta": -0.11, "Cl_p": -0.55, "Cl_r": 0.22, "Cl_da": -0.20, "Cl_dr": 0.035,
    "Cn_0": 0.0, "Cn_beta": 0.17, "Cn_p": -0.09, "Cn_r": -0.22, "Cn_dr": -0.13,
}  # fmt: skip
"""Handbook sizes of such an aircraft's derivatives, from no record."""


@dataclass(frozen=True)
class Case:
    """What a made flight is like. noise: standard deviations by column; gust: rms side gust [m/s], Dryden-like with
    `gust_time` [s]; servo: lag of the surfaces [s], or None for surfaces that run straight between samples; edges of
    manoeuvres lie at `phase` [s] and later pulses at other phases of the sample interval."""

    seconds: float = 30.0
    rate: float = 20.0
    V: float = 16.5
    true: Mapping[str, float] = field(default_factory=lambda: TRUE)
    noise: Mapping[str, float] = field(default_factory=dict)
    gust: float = 0.0
    gust_time: float = 0.8
    servo: float | None = 0.04
    phase: float = 0.0
    aileron: float = 6.0 * DEG
    rudder: float = 5.0 * DEG
    craft: Craft = SMALL


def doublets(t: Array, starts: list[tuple[float, float, float]]) -> Array:
    """Sum of (start, length, sign) pulses."""
    u = np.zeros_like(t)
    for begin, length, sign in starts:
        u += sign * ((t >= begin) & (t < begin + length))
    return u


AILERON = [(2, 0.8, 1), (2.8, 0.8, -1), (10, 1.2, 1), (11.2, 0.8, -1), (12, 0.4, 1), (12.4, 0.4, -1),
           (20, 0.6, -1), (20.6, 0.6, 1), (25, 0.5, 1), (25.5, 0.5, -1)]  # fmt: skip
RUDDER = [(5.5, 0.9, 1), (6.4, 0.9, -1), (15, 1.5, 1), (16.5, 1.0, -1), (17.5, 0.5, 1), (18, 0.5, -1),
          (23, 0.7, -1), (23.7, 0.7, 1)]  # fmt: skip


def fly(case: Case, rng: np.random.Generator, seeds: int = 1, fine: int = 20) -> tuple[list[Flight], dict[str, Array]]:
    """`seeds` noisy records of the case, and the noise-free histories (seeds, N) by column."""
    h = 1.0 / (case.rate * fine)
    count = int(case.seconds * case.rate) + 1
    steps = (count - 1) * fine
    t = np.arange(steps + 1) * h
    pulses = [[(a + case.phase * i, d + case.phase, s) for i, (a, d, s) in enumerate(p)] for p in (AILERON, RUDDER)]
    command = np.stack([case.aileron * doublets(t, pulses[0]), case.rudder * doublets(t, pulses[1])])
    V = case.V + 0.6 * np.sin(0.35 * t)
    alpha = (5.2 + 1.0 * np.sin(0.5 * t + 1)) * DEG
    theta = (5.5 + 2.0 * np.sin(0.4 * t)) * DEG
    q = 2.0 * DEG * np.cos(0.7 * t)
    craft, rho = case.craft, case.craft.rho
    gust = _gust(case, rng, seeds, steps, h)
    c = case.true
    inertia = craft.ixx * craft.izz - craft.ixz**2

    def rates(x: Array, k: int, da: Array, dr: Array) -> tuple[Array, Array, Array]:
        v, p, r, phi = x
        beta = np.arcsin(np.clip((v - gust[k]) / V[k], -0.9, 0.9))
        qbar, ph, rh = 0.5 * rho * V[k] ** 2, p * craft.span / (2 * V[k]), r * craft.span / (2 * V[k])
        CY = c["CY_0"] + c["CY_beta"] * beta + c["CY_p"] * ph + c["CY_r"] * rh + c["CY_dr"] * dr
        Cl = c["Cl_0"] + c["Cl_beta"] * beta + c["Cl_p"] * ph + c["Cl_r"] * rh + c["Cl_da"] * da + c["Cl_dr"] * dr
        Cn = c["Cn_0"] + c["Cn_beta"] * beta + c["Cn_p"] * ph + c["Cn_r"] * rh + c["Cn_dr"] * dr
        ay = qbar * craft.area * CY / craft.mass
        u, w = V[k] * np.cos(alpha[k]) * np.cos(beta), V[k] * np.sin(alpha[k]) * np.cos(beta)
        L = qbar * craft.area * craft.span * Cl + craft.ixz * p * q[k] - (craft.izz - craft.iyy) * q[k] * r
        N = qbar * craft.area * craft.span * Cn - craft.ixz * q[k] * r - (craft.iyy - craft.ixx) * p * q[k]
        dv = ay + GRAVITY * np.cos(theta[k]) * np.sin(phi) + p * w - r * u
        dphi = p + np.tan(theta[k]) * (q[k] * np.sin(phi) + r * np.cos(phi))
        return (
            np.stack([dv, (craft.izz * L + craft.ixz * N) / inertia, (craft.ixx * N + craft.ixz * L) / inertia, dphi]),
            beta,
            ay,
        )

    x = np.zeros((4, seeds))
    surface = _surfaces(case, t, command, h, fine)
    out = {name: np.zeros((seeds, count)) for name in ("beta", "p", "r", "phi", "ay")}
    for k in range(steps + 1):
        k1, beta, ay = rates(x, k, surface[0, k], surface[1, k])
        if k % fine == 0:
            for name, value in zip(out, (beta, x[1], x[2], x[3], ay), strict=True):
                out[name][:, k // fine] = value
        if k == steps:
            break
        middle = 0.5 * (surface[:, k] + surface[:, k + 1])
        k2, _, _ = rates(x + 0.5 * h * k1, k, *middle)
        k3, _, _ = rates(x + 0.5 * h * k2, k, *middle)
        k4, _, _ = rates(x + h * k3, k + 1, *surface[:, k + 1])
        x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    known = {"V": V, "alpha": alpha, "theta": theta, "q": q, "delta_a": surface[0], "delta_r": surface[1]}
    out |= {name: np.tile(value[::fine], (seeds, 1)) for name, value in known.items()}
    time = t[::fine].round(9)
    flights = []
    for i in range(seeds):
        columns = {n: v[i] + case.noise.get(n, 0.0) * rng.normal(size=count) for n, v in out.items()}
        columns["rho"] = np.full(count, rho)
        flights.append(Flight.build(f"made_{i}", time, columns))
    return flights, out


def _surfaces(case: Case, t: Array, command: Array, h: float, fine: int) -> Array:
    """Surfaces (2, steps + 1) behind their servos."""
    if case.servo is None:
        return np.stack([np.interp(t, t[::fine], c[::fine]) for c in command])
    surface = np.zeros_like(command)
    decay = np.exp(-h / case.servo)
    for k in range(t.size - 1):
        surface[:, k + 1] = command[:, k] + decay * (surface[:, k] - command[:, k])
    return surface


def _gust(case: Case, rng: np.random.Generator, seeds: int, steps: int, h: float) -> Array:
    """First-order side gust (steps + 1, seeds) [m/s]."""
    gust = np.zeros((steps + 1, seeds))
    if case.gust > 0:
        a = np.exp(-h / case.gust_time)
        kick = case.gust * np.sqrt(1 - a * a) * rng.normal(size=(steps, seeds))
        for k in range(steps):
            gust[k + 1] = a * gust[k] + kick[k]
    return gust
