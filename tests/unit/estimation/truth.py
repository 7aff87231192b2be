"""Flights with known truth, made by equations written here a second time and integrated by another program.

Lateral-directional motion in body-axis velocities (v, p, r, phi), classical Runge-Kutta at 400 Hz in plain numbers: numpy
takes a microsecond for each of a million additions. Nothing here comes from `estimation`: a shared mistake cannot cancel itself.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

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


@dataclass(frozen=True)
class Air:
    """What the motion does not change, at every fine step: V [m/s], alpha, theta [rad], q [rad/s], surfaces (2, steps) [rad]."""

    V: Array
    alpha: Array
    theta: Array
    q: Array
    surface: Array


def fly(case: Case, rng: np.random.Generator, seeds: int = 1, fine: int = 20) -> tuple[list[Flight], dict[str, Array]]:
    """`seeds` noisy records of the case, and the noise-free histories (seeds, N) by column."""
    h = 1.0 / (case.rate * fine)
    count = int(case.seconds * case.rate) + 1
    steps = (count - 1) * fine
    t = np.arange(steps + 1) * h
    pulses = [[(a + case.phase * i, d + case.phase, s) for i, (a, d, s) in enumerate(p)] for p in (AILERON, RUDDER)]
    command = np.stack([case.aileron * doublets(t, pulses[0]), case.rudder * doublets(t, pulses[1])])
    V, alpha = case.V + 0.6 * np.sin(0.35 * t), (5.2 + 1.0 * np.sin(0.5 * t + 1)) * DEG
    theta, q = (5.5 + 2.0 * np.sin(0.4 * t)) * DEG, 2.0 * DEG * np.cos(0.7 * t)
    gust = _gust(case, rng, seeds, steps, h)
    air = Air(V, alpha, theta, q, _surfaces(case, t, command, h, fine))
    # in still air all seeds fly the same, and whoever asks for them with other noise
    if case.gust > 0:
        moved = np.array([_integrate(case, air, gust[:, i].tolist(), h, fine) for i in range(seeds)])
    else:
        asked = repr((replace(case, noise={}), fine))
        if asked not in _STILL:
            _STILL[asked] = np.array(_integrate(case, air, gust[:, 0].tolist(), h, fine))
        moved = np.tile(_STILL[asked], (seeds, 1, 1))
    out = {name: moved[:, :, i].copy() for i, name in enumerate(("beta", "p", "r", "phi", "ay"))}
    known = {"V": V, "alpha": alpha, "theta": theta, "q": q, "delta_a": air.surface[0], "delta_r": air.surface[1]}
    out |= {name: np.tile(value[::fine], (seeds, 1)) for name, value in known.items()}
    time = t[::fine].round(9)
    flights = []
    for i in range(seeds):
        columns = {n: v[i] + case.noise.get(n, 0.0) * rng.normal(size=count) for n, v in out.items()}
        columns["rho"] = np.full(count, case.craft.rho)
        flights.append(Flight.build(f"made_{i}", time, columns))
    return flights, out


_STILL: dict[str, Array] = {}
"""Motion in still air by what it is of, but for its noise."""


def _integrate(case: Case, air: Air, gust: Sequence[float], h: float, fine: int) -> list[tuple[float, ...]]:
    """(beta, p, r, phi, ay) at every sample of one flight through side gusts [m/s] at every fine step."""
    craft, c = case.craft, case.true
    inertia = craft.ixx * craft.izz - craft.ixz**2
    pressure, over = (0.5 * craft.rho * air.V**2).tolist(), (craft.span / (2 * air.V)).tolist()
    forward, down = (air.V * np.cos(air.alpha)).tolist(), (air.V * np.sin(air.alpha)).tolist()
    weight, climb = (GRAVITY * np.cos(air.theta)).tolist(), np.tan(air.theta).tolist()
    V, q = air.V.tolist(), air.q.tolist()
    CY_0, CY_beta, CY_p, CY_r, CY_dr = (c[f"CY_{n}"] for n in ("0", "beta", "p", "r", "dr"))
    Cl_0, Cl_beta, Cl_p, Cl_r, Cl_da, Cl_dr = (c[f"Cl_{n}"] for n in ("0", "beta", "p", "r", "da", "dr"))
    Cn_0, Cn_beta, Cn_p, Cn_r, Cn_dr = (c[f"Cn_{n}"] for n in ("0", "beta", "p", "r", "dr"))

    def rates(x: tuple[float, ...], k: int, da: float, dr: float) -> tuple[float, ...]:
        """Of v, p, r and phi; then sideslip and lateral acceleration."""
        v, p, r, phi = x
        beta = math.asin(min(max((v - gust[k]) / V[k], -0.9), 0.9))
        ph, rh = p * over[k], r * over[k]
        CY = CY_0 + CY_beta * beta + CY_p * ph + CY_r * rh + CY_dr * dr
        Cl = Cl_0 + Cl_beta * beta + Cl_p * ph + Cl_r * rh + Cl_da * da + Cl_dr * dr
        Cn = Cn_0 + Cn_beta * beta + Cn_p * ph + Cn_r * rh + Cn_dr * dr
        force = pressure[k] * craft.area
        ay = force * CY / craft.mass
        u, w = forward[k] * math.cos(beta), down[k] * math.cos(beta)
        L = force * craft.span * Cl + craft.ixz * p * q[k] - (craft.izz - craft.iyy) * q[k] * r
        N = force * craft.span * Cn - craft.ixz * q[k] * r - (craft.iyy - craft.ixx) * p * q[k]
        dv = ay + weight[k] * math.sin(phi) + p * w - r * u
        dphi = p + climb[k] * (q[k] * math.sin(phi) + r * math.cos(phi))
        return (
            dv,
            (craft.izz * L + craft.ixz * N) / inertia,
            (craft.ixx * N + craft.ixz * L) / inertia,
            dphi,
            beta,
            ay,
        )

    def after(x: tuple[float, ...], step: float, slope: tuple[float, ...]) -> tuple[float, ...]:
        return (x[0] + step * slope[0], x[1] + step * slope[1], x[2] + step * slope[2], x[3] + step * slope[3])

    x: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0)
    surface = list(zip(*air.surface.tolist(), strict=True))
    rows = []
    for k, (da, dr) in enumerate(surface):
        k1 = rates(x, k, da, dr)
        if k % fine == 0:
            rows.append((k1[4], *x[1:], k1[5]))
        if k == len(surface) - 1:
            break
        later = surface[k + 1]
        middle = 0.5 * (da + later[0]), 0.5 * (dr + later[1])
        k2 = rates(after(x, 0.5 * h, k1), k, *middle)
        k3 = rates(after(x, 0.5 * h, k2), k, *middle)
        k4 = rates(after(x, h, k3), k + 1, *later)
        x = after(x, h / 6, tuple(a + 2 * b + 2 * c + d for a, b, c, d in zip(k1, k2, k3, k4, strict=True)))
    return rows


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
