"""Random aeroplanes flown with known derivatives in situations that a model or a record may lack something in.

Full motion of a rigid body in body velocities (u, v, w), written here on its own and vectorised over flights; classical
Runge-Kutta. Nothing comes from `estimation`, `firmware_sim` or `second_truth`. Mass, size, inertia, speed and all derivatives
are drawn; the pilot flies doublets and 3-2-1-1 of aileron and rudder with a weak wing leveller, and holds pitch.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from groundstation.flight import Flight

Array = NDArray[np.float64]

DEG = np.pi / 180
G = 9.80665
STEP = 0.005  # s

BASE: Mapping[str, float] = {
    "CY_beta": -0.45, "CY_p": -0.05, "CY_r": 0.2, "CY_da": 0.0, "CY_dr": 0.19,
    "Cl_beta": -0.085, "Cl_p": -0.47, "Cl_r": 0.11, "Cl_da": -0.17, "Cl_dr": 0.012,
    "Cn_beta": 0.075, "Cn_p": -0.03, "Cn_r": -0.11, "Cn_da": 0.0, "Cn_dr": -0.065,
    "CL_0": 0.3, "CL_alpha": 5.0, "CL_q": 7.0, "CL_de": 0.45, "CD_0": 0.03, "CD_k": 0.05,
    "Cm_0": 0.02, "Cm_alpha": -0.8, "Cm_q": -13.0, "Cm_de": -1.2,
}  # fmt: skip
MAIN = ("CY_beta", "CY_dr", "Cl_beta", "Cl_p", "Cl_da", "Cn_beta", "Cn_r", "Cn_dr")
NOISE: Mapping[str, float] = {
    "ax": 0.05, "ay": 0.05, "az": 0.08, "p": 0.25 * DEG, "q": 0.25 * DEG, "r": 0.2 * DEG, "phi": 0.25 * DEG,
    "theta": 0.25 * DEG, "psi": 0.4 * DEG, "alpha": 0.25 * DEG, "beta": 0.2 * DEG, "V": 0.1,
    "delta_e": 0.05 * DEG, "delta_a": 0.05 * DEG, "delta_r": 0.05 * DEG,
}  # fmt: skip


@dataclass(frozen=True)
class Aeroplane:
    """SI. derivatives: as BASE names them."""

    mass: float
    span: float
    area: float
    chord: float
    inertia: tuple[float, float, float, float]  # Ixx, Iyy, Izz, Ixz
    speed: float
    derivatives: Mapping[str, float]

    @classmethod
    def drawn(cls, rng: np.random.Generator) -> "Aeroplane":
        """From a 2 kg model to an aeroplane of some tonnes, by Froude's law."""
        size = float(np.exp(rng.uniform(np.log(0.6), np.log(5.0))))
        span = 2.4 * size
        aspect = rng.uniform(6.0, 9.0)
        area = span**2 / aspect
        mass = 6.0 * size**3 * rng.uniform(0.8, 1.3)
        Ixx, Iyy, Izz = (mass * (k * span * rng.uniform(0.9, 1.1)) ** 2 for k in (0.12, 0.13, 0.165))
        Ixz = 0.04 * np.sqrt(Ixx * Izz) * rng.uniform(-1, 1)
        derivatives = {n: v * rng.uniform(0.7, 1.3) for n, v in BASE.items()}
        speed = float(np.sqrt(2 * mass * G / (1.2 * area * rng.uniform(0.35, 0.55))))
        return cls(mass, span, area, area / span, (Ixx, Iyy, Izz, Ixz), speed, derivatives)


@dataclass(frozen=True)
class Situation:
    """What is special. Shifts in s, scales as factors, derivatives and Ixz added to what is flown. odd: factor on four
    derivatives of the last flight; gust: rms sideslip [rad]; clocked: edges lie on the sampling clock; damper: rudder by yaw
    rate [s] behind the recorded rudder, washed out within `washout`."""

    name: str
    rate: float = 20.0
    gust: float = 0.0
    noise: float = 1.0
    clocked: bool = False
    hidden: Mapping[str, float] = field(default_factory=dict)
    vane_scale: float = 1.0
    vane_lag: float = 0.0
    aileron_late: float = 0.0
    rudder_late: float = 0.0
    odd: float = 1.0
    Ixz_share: float = 0.0  # of Ixx
    servo: float = 0.035
    damper: float = 0.0
    washout: float = 3.0
    pitch: bool = False  # elevator is flown in place of aileron and rudder
    causes: tuple[str, ...] = ()


SITUATIONS = (
    Situation("plain"),
    Situation("gusty", gust=1.2 * DEG),
    Situation("10 Hz", rate=10.0),
    Situation("edges on the clock", clocked=True),
    Situation("noise three times", noise=3.0),
    Situation("Cn_da hidden", hidden={"Cn_da": -0.010}, causes=("Cn_da",)),
    Situation("CY_da hidden", hidden={"CY_da": 0.06}, causes=("CY_da",)),
    Situation("vane scale 1.25", vane_scale=1.25, causes=("scale_beta",)),
    Situation("vane lags 60 ms", vane_lag=0.06, causes=("delay_beta",)),
    Situation("aileron lags its record by 50 ms", aileron_late=0.05, causes=("delay_delta_a",)),
    Situation("rudder recorded 50 ms late", rudder_late=-0.05, causes=("delay_delta_r",)),
    Situation("one flight of three with four derivatives 1.3 times", odd=1.3, causes=("odd",)),
    Situation("Ixz more than the file's", Ixz_share=0.06, causes=("Ixz",)),
)
PLAIN = ("plain", "gusty", "10 Hz", "edges on the clock", "noise three times")


def fly(
    craft: Aeroplane, situation: Situation, rng: np.random.Generator, flights: int = 3, seconds: float = 26.0
) -> list[Flight]:
    """Noisy records of one aeroplane in one situation."""
    rates = np.ones((flights, 1))
    truth = {n: np.full(flights, v) for n, v in craft.derivatives.items()}
    for name, value in situation.hidden.items():
        truth[name] = np.full(flights, value)
    if situation.odd != 1.0:
        for name in ("Cn_beta", "Cl_beta", "Cn_r", "CY_beta"):
            truth[name][-1] *= situation.odd
    steps = round(seconds / STEP)
    scale = float(np.sqrt(craft.span / 2.4))  # of time: motions of large aeroplanes are slow
    command = _commands(craft, situation, rng, flights, steps, scale) * rates[:, :, None]
    columns = _integrated(craft, situation, truth, command, rng, steps)
    every = round(1.0 / (situation.rate * STEP))
    made = []
    for i in range(flights):
        data = {n: v[i, ::every].copy() for n, v in columns.items()}
        count = len(data["p"])
        for n, s in NOISE.items():
            data[n] = data[n] + situation.noise * s * rng.standard_normal(count)
        data["rho"] = np.full(count, 1.2)
        data["thrust"] = np.full(count, _level(craft)[2] if situation.pitch else 0.0)
        made.append(Flight.build(f"f{i}", (np.arange(steps)[::every] * STEP).round(6), data))
    return made


def _level(craft: Aeroplane) -> tuple[float, float, float]:
    """Angle of attack [rad], elevator [rad] and thrust [N] of level flight."""
    S, d = craft.area, craft.derivatives
    CL = 2 * craft.mass * G / (1.2 * S * craft.speed**2)
    alpha = (CL - d["CL_0"]) / d["CL_alpha"]
    trim_e = -(d["Cm_0"] + d["Cm_alpha"] * alpha) / d["Cm_de"]
    return alpha, trim_e, 0.5 * 1.2 * S * craft.speed**2 * (d["CD_0"] + d["CD_k"] * CL**2)


def _commands(
    craft: Aeroplane, situation: Situation, rng: np.random.Generator, flights: int, steps: int, scale: float
) -> Array:
    """(flights, 3, steps) commanded aileron, rudder and elevator [rad]."""
    t = np.arange(steps) * STEP
    u = np.zeros((flights, 3, steps))
    for i in range(flights):
        sign = 1 if rng.uniform() < 0.5 else -1
        for row, start, widths, size in (
            (0, 1.5, (0.6, 0.6), 5.0), (1, 5.0, (0.7, 0.7), 5.0), (0, 9.5, (0.9, 0.6, 0.3, 0.3), 4.0),
            (1, 14.0, (0.9, 0.6, 0.3, 0.3), 4.0), (0, 19.0, (0.35, 0.35, 0.35, 0.35), 5.0), (1, 22.0, (0.5, 0.5), 5.0),
        ):  # fmt: skip
            a = start + rng.uniform(-0.3, 0.3)
            for w in widths:
                w = w * scale**0.5 * rng.uniform(0.95, 1.05)
                if situation.clocked:
                    a, w = (
                        round(a * situation.rate) / situation.rate,
                        max(round(w * situation.rate), 1) / situation.rate,
                    )
                u[i, 2 if situation.pitch else row, (t >= a - 1e-9) & (t < a + w - 1e-9)] += sign * size * DEG
                a, sign = a + w, -sign
    return u


def _step_of(craft: Aeroplane, s: Situation, d: Mapping[str, Array]) -> ca.Function:
    """A Runge-Kutta step of all flights, traced once: states (9, flights), surfaces (3, flights) before and after it, wind at its
    begin and in it, to states after it and what is observed at its begin (6, flights)."""
    Ixx, Iyy, Izz, Ixz = craft.inertia
    Ixz = Ixz + s.Ixz_share * Ixx
    S, b, c, m = craft.area, craft.span, craft.chord, craft.mass
    thrust = _level(craft)[2]
    of_flight = {name: ca.DM(values).T for name, values in d.items()}

    def rates(x: ca.SX, surface: ca.SX, wind: ca.SX) -> tuple[ca.SX, ca.SX]:
        u, v, w, p, q, r, phi, theta, _ = ca.vertsplit(x)
        va = v - wind
        V = ca.sqrt(u**2 + va**2 + w**2)
        al, be = ca.atan2(w, u), ca.asin(va / V)
        qd = 0.5 * 1.2 * V**2
        ph, qh, rh = p * b / (2 * V), q * c / (2 * V), r * b / (2 * V)
        da, dr, de = ca.vertsplit(surface)
        CY = (
            of_flight["CY_beta"] * be
            + of_flight["CY_p"] * ph
            + of_flight["CY_r"] * rh
            + of_flight["CY_da"] * da
            + of_flight["CY_dr"] * dr
        )
        Cl = (
            of_flight["Cl_beta"] * be
            + of_flight["Cl_p"] * ph
            + of_flight["Cl_r"] * rh
            + of_flight["Cl_da"] * da
            + of_flight["Cl_dr"] * dr
        )
        Cn = (
            of_flight["Cn_beta"] * be
            + of_flight["Cn_p"] * ph
            + of_flight["Cn_r"] * rh
            + of_flight["Cn_da"] * da
            + of_flight["Cn_dr"] * dr
        )
        Lift = of_flight["CL_0"] + of_flight["CL_alpha"] * al + of_flight["CL_q"] * qh + of_flight["CL_de"] * de
        Drag = of_flight["CD_0"] + of_flight["CD_k"] * Lift**2
        Cm = of_flight["Cm_0"] + of_flight["Cm_alpha"] * al + of_flight["Cm_q"] * qh + of_flight["Cm_de"] * de
        fx = (qd * S * (Lift * ca.sin(al) - Drag * ca.cos(al)) + thrust) / m
        fy = qd * S * CY / m
        fz = qd * S * (-Lift * ca.cos(al) - Drag * ca.sin(al)) / m
        L, M, N = qd * S * b * Cl, qd * S * c * Cm, qd * S * b * Cn
        hx = L + Ixz * p * q - (Izz - Iyy) * q * r
        hz = N - Ixz * q * r - (Iyy - Ixx) * p * q
        det = Ixx * Izz - Ixz**2
        dx = ca.vertcat(
            fx - G * ca.sin(theta) - q * w + r * v,
            fy + G * ca.cos(theta) * ca.sin(phi) - r * u + p * w,
            fz + G * ca.cos(theta) * ca.cos(phi) - p * v + q * u,
            (Izz * hx + Ixz * hz) / det,
            (M + (Izz - Ixx) * p * r - Ixz * (p**2 - r**2)) / Iyy,
            (Ixx * hz + Ixz * hx) / det,
            p + ca.tan(theta) * (q * ca.sin(phi) + r * ca.cos(phi)),
            q * ca.cos(phi) - r * ca.sin(phi),
            (q * ca.sin(phi) + r * ca.cos(phi)) / ca.cos(theta),
        )
        return dx, ca.vertcat(fx, fy, fz, al, be, V)

    flights = len(d["CY_beta"])
    x, before, after = (ca.SX.sym(n, rows, flights) for n, rows in (("x", 9), ("before", 3), ("after", 3)))
    first, wind = ca.SX.sym("first", 1, flights), ca.SX.sym("wind", 1, flights)
    middle = 0.5 * (before + after)
    k1 = rates(x, before, wind)[0]
    k2 = rates(x + 0.5 * STEP * k1, middle, wind)[0]
    k3 = rates(x + 0.5 * STEP * k2, middle, wind)[0]
    k4 = rates(x + STEP * k3, after, wind)[0]
    made = [x + STEP / 6 * (k1 + 2 * k2 + 2 * k3 + k4), rates(x, before, first)[1]]
    return ca.Function("step", [x, before, after, first, wind], made)


def _integrated(
    craft: Aeroplane, s: Situation, d: Mapping[str, Array], command: Array, rng: np.random.Generator, steps: int
) -> dict[str, Array]:
    flights = len(command)
    b = craft.span
    alpha, trim_e, _ = _level(craft)
    x = np.zeros((flights, 9))  # u v w p q r phi theta psi
    x[:, 0], x[:, 2], x[:, 7] = craft.speed * np.cos(alpha), craft.speed * np.sin(alpha), alpha
    surface = np.zeros((flights, 3))
    surface[:, 2] = trim_e
    wind, tau = np.zeros(flights), max(0.25 * b / 2.4, 0.6)
    kick = s.gust * craft.speed * np.sqrt(2 * STEP / tau)
    keep: dict[str, Array] = {}
    names = ("ax ay az p q r phi theta psi alpha beta V delta_e delta_a delta_r").split()
    for n in names:
        keep[n] = np.zeros((flights, steps))

    step, run = _step_of(craft, s, d).buffer()
    given = [np.zeros((flights, rows)) for rows in (9, 3, 3, 1, 1)]
    made = [np.zeros((flights, rows)) for rows in (9, 6)]
    for i, there in enumerate(given):
        step.set_arg(i, memoryview(there))
    for i, there in enumerate(made):
        step.set_res(i, memoryview(there))
    vane, steady, unseen = np.zeros(flights), np.zeros(flights), np.zeros((flights, 3))
    for k in range(steps):
        level = 0.12 * x[:, 6] + 0.03 * x[:, 3] * b / craft.speed
        wanted = np.stack([
            command[:, 0, k] + level,
            command[:, 1, k],
            trim_e + command[:, 2, k] + (0.5 * (x[:, 7] - alpha) + 0.1 * x[:, 4]) * (0.1 if s.pitch else 1.0),
        ], axis=1)  # fmt: skip
        before, first = surface, wind
        surface = surface + (1 - np.exp(-STEP / s.servo)) * (wanted - surface)
        wind = wind * (1 - STEP / tau) + kick * rng.standard_normal(flights) if s.gust else wind
        steady = steady + STEP / s.washout * (x[:, 5] - steady)
        flown, unseen = before + unseen, np.outer(s.damper * (x[:, 5] - steady), (0.0, 1.0, 0.0))
        moved = surface + unseen
        for there, values in zip(given, (x, flown, moved, first[:, None], wind[:, None]), strict=True):
            there[:] = values
        run()
        out = made[1]
        if s.vane_lag > 0.0:
            vane = vane + STEP / s.vane_lag * (out[:, 4] - vane) if k else out[:, 4].copy()
        shown = vane if s.vane_lag > 0.0 else out[:, 4]
        seen = (*out[:, :3].T, *x[:, 3:9].T, out[:, 3], s.vane_scale * shown, out[:, 5], *before[:, [2, 0, 1]].T)
        for n, value in zip(names, seen, strict=True):
            keep[n][:, k] = value
        x = made[0].copy()
    for name, late in (("delta_a", s.aileron_late), ("delta_r", s.rudder_late)):
        shift = round(late / STEP)  # the motion follows the record by `late`: the record runs ahead of it
        if shift:
            v = keep[name]
            keep[name] = (
                np.concatenate([v[:, shift:], np.repeat(v[:, -1:], shift, 1)], 1)
                if shift > 0
                else np.concatenate([np.repeat(v[:, :1], -shift, 1), v[:, :shift]], 1)
            )
    return keep


def situations(names: Sequence[str]) -> tuple[Situation, ...]:
    """Situations by name, all where none is given."""
    return tuple(s for s in SITUATIONS if not names or s.name in names)


def quiet(situation: Situation) -> Situation:
    """The situation without noise, to check the integration."""
    return replace(situation, noise=0.0)
