"""A second, independent truth for studies of the gap workflow: vectorised six-degree-of-freedom flights with effects.

Written from the textbook equations and sharing no code with `firmware_sim` or `estimation`: body velocities and Euler
angles, Runge-Kutta 4 at 200 Hz, a pilot with scheduled multi-steps and weak attitude feedback, servo lag and rate
limit, Ornstein-Uhlenbeck gusts, white sensor noise. `fly(requests)` returns one set of 20 Hz columns per request, with
the names, units and signs of a flight file. Effects are physics with the sizes given in each request.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from tests.studies import second_truth_pitch as pitch

Array = NDArray[np.float64]

RATE = 200  # Hz, integration
SAMPLE = 20  # Hz, columns
G = 9.80665
DEG = np.pi / 180
MASS, SPAN, AREA, CHORD, RHO = 3.5, 1.5, 0.787, 0.61, 1.17
INERTIA = {"Ixx": 0.24, "Iyy": 0.23, "Izz": 0.46, "Ixz": 0.008}

TRUE_DERIVATIVES: Mapping[str, float] = {
    "CY_0": 0.0, "CY_beta": -0.1204, "CY_p": -0.05, "CY_r": 0.12, "CY_dr": 0.4586,
    "Cl_0": 0.0, "Cl_beta": -0.0901, "Cl_p": -0.45, "Cl_r": 0.10, "Cl_da": -0.0963, "Cl_dr": 0.0195,
    "Cn_0": 0.0, "Cn_beta": 0.0245, "Cn_p": 0.02, "Cn_r": -0.04, "Cn_dr": -0.042,
    "CL_0": 0.0, "CL_alpha": 3.0, "CL_q": 3.3, "CL_de": 1.0, "CD_0": 0.025, "CD_k": 0.24,
    "Cm_0": 0.015, "Cm_alpha": -0.168, "Cm_q": -0.92, "Cm_de": -0.36,
}  # fmt: skip

NOISE: Mapping[str, float] = {
    "ax": 0.05, "ay": 0.05, "az": 0.08, "p": 0.4 * DEG, "q": 0.4 * DEG, "r": 0.3 * DEG, "phi": 0.3 * DEG,
    "theta": 0.3 * DEG, "psi": 0.6 * DEG, "alpha": 0.3 * DEG, "beta": 0.25 * DEG, "V": 0.15,
    "delta_e": 0.07 * DEG, "delta_a": 0.07 * DEG, "delta_r": 0.07 * DEG, "thrust": 0.05, "altitude": 0.2,
}  # fmt: skip

# Typical sizes: one number per effect (SI). Vector effects use a fixed direction.
TYPICAL: Mapping[str, float] = {
    "CY_da": 0.04, "Cn_da": -0.010, "Cl_alpha_beta": -0.75, "Cn_alpha_beta": 0.25, "Cl_da_de": 0.5,
    "Cl_beta3": -2.0, "Cn_beta3": 1.0, "CY_beta3": -4.0, "Cl_da3": 2.0, "Cn_dr3": 2.0, "Cl_p_abs_p": -1.5,
    "stall_separation": 9.0 * DEG, "Cl_betadot": -0.10, "Cn_betadot": -0.03, "indicial_lag": 0.05,
    "Ixz_error": 0.03, "lateral_cg": 0.010, "prop_gyroscopic": 0.15, "motor_torque": 0.04, "slipstream_rudder": 4.0,
    "p_factor": 0.15, "aileron_delay": 0.06, "rudder_delay": 0.06, "aileron_lag": 0.06, "rudder_lag": 0.06,
    "servo_delay": 0.06, "servo_lag": 0.06,
    "aileron_deadzone": 0.8 * DEG, "aileron_backlash": 1.0 * DEG, "rudder_backlash": 1.0 * DEG,
    "surface_compliance": 0.25, "beta_scale": 0.10, "beta_lag": 0.07, "vane_position": 0.35, "imu_lever_arm": 0.08,
    "gyro_misalignment": 1.7 * DEG, "gyro_scale": 0.03, "attitude_lag": 0.10, "airspeed_scale": 0.06,
    "time_skew": 0.075, "wind_shear": 0.20,
}  # fmt: skip

UNKNOWN: tuple[str, ...] = (
    "pendulum",
    "gyro_clip",
    "stale_vane",
    "bank_accelerometer",
    "vane_friction",
    "attitude_turn_error",
    "flexible_fin",
    "shear_burst",
)

EVERY: Mapping[str, float] = {**TYPICAL, **pitch.PITCH, **pitch.CROSS}
MANOEUVRES = ("rich", "aileron_only", "longitudinal", "longitudinal-advised", "all", "all-advised")
LOCAL: tuple[str, ...] = ("gyro_drift", "vane_slip", "short_burst")
"""Faults of one stretch of flight: no term of any model is wrong."""


@dataclass(frozen=True)
class Hidden:
    """A part of one coefficient that no catalogue holds.

    of: from beta, p_hat, q_hat, r_hat, alpha, delta_a, delta_e, delta_r and V, expressions of casadi, to the part.
    memory: seconds by which it follows, 0 where at once.
    """

    line: str
    of: Callable[[Mapping[str, Any]], Any]
    memory: float = 0.0


@dataclass(frozen=True)
class Request:
    """One flight to make. `effects`: name -> multiple of its typical size (unknown effects: 1 = as coded)."""

    seed: int
    speed: float = 16.5
    effects: Mapping[str, float] = field(default_factory=dict)
    gust: float = 0.15 * DEG  # rms sideslip angle of the gusts [rad]
    manoeuvres: str = "rich"  # one of MANOEUVRES
    derivatives: Mapping[str, float] = field(default_factory=dict)
    duration: float = 30.0
    jitter: float = 1.0
    throttle: float = 1.0  # share of the throttle steps that is flown
    inertia: Mapping[str, float] = field(default_factory=dict)
    centred: bool = (
        False  # surfaces recorded as the mean of what is held before and after; else 2.5 ms before their effect
    )
    hidden: Hidden | None = None


def perturbed_derivatives(rng: np.random.Generator, spread: float = 0.15) -> dict[str, float]:
    """True derivatives, each off by up to +-`spread` of its nominal value."""
    return {k: v * (1 + spread * rng.uniform(-1, 1)) for k, v in TRUE_DERIVATIVES.items()}


def _schedule(request: Request, rng: np.random.Generator, steps: int) -> Array:
    """Pilot's added commands (aileron, rudder, elevator, throttle force) at 200 Hz, shape (4, steps)."""
    u = np.zeros((4, steps))
    t = np.arange(steps) / RATE

    def multistep(row: int, start: float, widths: Sequence[float], amplitude: float, first: int) -> None:
        a, sign = start, first
        for w in widths:
            u[row, (t >= a) & (t < a + w)] += sign * amplitude
            a, sign = a + w, -sign

    if request.manoeuvres not in MANOEUVRES:
        raise ValueError(f"no manoeuvres {request.manoeuvres!r}; there are {', '.join(MANOEUVRES)}")
    if request.manoeuvres.startswith("longitudinal"):
        pitch.schedule(u, t, rng, request.manoeuvres, multistep)
        return u
    s = 1 if rng.uniform() < 0.5 else -1
    j = lambda x: x + rng.uniform(-0.4, 0.4)  # noqa: E731
    w = rng.uniform(0.9, 1.1)
    multistep(0, j(1.6), [0.6 * w, 0.6 * w], rng.uniform(5, 7) * DEG, s)
    multistep(0, j(12.2), [1.0 * w, 0.66 * w, 0.33 * w, 0.33 * w], rng.uniform(4, 6) * DEG, -s)
    multistep(0, j(21.6), [0.35 * w] * 4, rng.uniform(2.5, 3.5) * DEG, s)
    if request.manoeuvres == "rich" or request.manoeuvres.startswith("all"):
        multistep(1, j(5.8), [0.7 * w, 0.7 * w], rng.uniform(1.4, 3.2) * DEG, -s)
        multistep(1, j(16.6), [0.9 * w, 0.6 * w, 0.3 * w, 0.3 * w], rng.uniform(2.6, 3.4) * DEG, s)
        multistep(1, j(25.2), [0.5 * w, 0.5 * w], rng.uniform(2.0, 3.0) * DEG, s)
    if request.manoeuvres.startswith("all"):
        pitch.schedule(u, t, rng, request.manoeuvres, multistep)
        return u
    if request.manoeuvres == "rich":
        multistep(2, j(9.1), [0.4, 0.4], 0.9 * DEG, -1)
        multistep(2, j(20.1), [0.35, 0.35, 0.3], 0.7 * DEG, 1)
    for a, d in ((3.6, 1.3), (7.7, -1.9), (11.7, 0.3), (15.0, -1.3), (18.5, 1.9), (22.0, -1.5), (25.4, 0.3)):
        u[3, t >= a] = d * rng.uniform(0.8, 1.2)
    return u


def fly(requests: Sequence[Request]) -> list[dict[str, Array]]:
    """Fly every request at once; each result maps column name -> (samples,) array, `time` included."""
    n = len(requests)
    steps = round(max(r.duration for r in requests) * RATE) + 1
    rngs = [np.random.default_rng([r.seed, 20240713]) for r in requests]
    e: dict[str, Any] = {k: np.array([r.effects.get(k, 0.0) * v for r in requests]) for k, v in EVERY.items()}
    x_: dict[str, Any] = {
        k: np.array([r.effects.get(k, 0.0) for r in requests]) for k in (*UNKNOWN, *LOCAL, *pitch.PITCH_UNKNOWN)
    }
    d = {k: np.array([r.derivatives.get(k, v) for r in requests]) for k, v in TRUE_DERIVATIVES.items()}
    inertia = {k: np.array([r.inertia.get(k, v) for r in requests]) for k, v in INERTIA.items()}
    speed = np.array([r.speed for r in requests])
    u = np.stack([_schedule(r, g, steps) for r, g in zip(requests, rngs, strict=True)], axis=-1)  # (4, steps, n)
    u[3] *= np.array([r.throttle for r in requests])
    gust = np.stack([_gust(r, g, steps) for r, g in zip(requests, rngs, strict=True)], axis=-1)  # (3, steps, n)
    e["Ixz"] = inertia["Ixz"] + e["Ixz_error"]
    centred = np.array([r.centred for r in requests])
    history = _integrate(d, inertia, speed, u, gust, e, x_, centred, [r.hidden for r in requests], steps, n)
    return [
        _measure(
            {k: v[:, i] for k, v in history.items()},
            r,
            g,
            {k: v[i] for k, v in e.items()},
            {k: v[i] for k, v in x_.items()},
        )
        for i, (r, g) in enumerate(zip(requests, rngs, strict=True))
    ]


def _gust(request: Request, rng: np.random.Generator, steps: int) -> Array:
    """Side, vertical and forward gust speeds [m/s], Ornstein-Uhlenbeck with a 1.2 s side correlation time."""
    out = np.zeros((3, steps))
    for row, (tau, share) in enumerate(((1.2, 1.0), (0.8, 0.7), (3.0, 0.7))):
        sigma = request.gust * request.speed * share
        a = np.exp(-1 / RATE / tau)
        white = rng.standard_normal(steps) * sigma * np.sqrt(1 - a * a)
        value = rng.standard_normal() * sigma
        for k in range(steps):
            value = a * value + white[k]
            out[row, k] = value
    return out


def _trim(d: Mapping[str, Array], V: Array) -> tuple[Array, Array, Array]:
    """Level-flight angle of attack, elevator and thrust."""
    q = 0.5 * RHO * V**2
    alpha, de, T = np.full_like(V, 0.1), np.zeros_like(V), np.full_like(V, 5.0)
    for _ in range(60):
        de = -(d["Cm_0"] + d["Cm_alpha"] * alpha) / d["Cm_de"]
        CL = (MASS * G - T * np.sin(alpha)) / (q * AREA)
        alpha = alpha + 0.7 * ((CL - d["CL_0"] - d["CL_de"] * de) / d["CL_alpha"] - alpha)
        T = q * AREA * (d["CD_0"] + d["CD_k"] * CL**2) / np.cos(alpha)
    return alpha, de, T


OBSERVED = ("ax", "ay", "az", "alpha", "beta", "V", "pdot", "rdot", "qdot")
STATES = "u v w p q r phi theta psi h eta X fin fin_dot pend pend_dot slosh slosh_dot hidden".split()


def _motion(d: Mapping[str, float], inertia: Mapping[str, float], e: Mapping[str, float], x_: Mapping[str, float],
            hidden: Hidden | None, x: Sequence[Any], act: Sequence[Any],
            g: Sequence[Any]) -> tuple[list[Any], list[Any]]:  # fmt: skip
    """Rates of one flight's states and what is observed, as expressions; act: surfaces and thrust, g: gust speeds."""
    uu, vv, ww, p, q, r, phi, th, psi, _h, eta, X, fin, find, pen, pend, slosh, sloshd, follower = x
    da, dr, de, T = act
    Ixx, Iyy, Izz, Ixz = inertia["Ixx"], inertia["Iyy"], inertia["Izz"], e["Ixz"]
    stalls = e["stall_separation"] > 0
    sp, cp, st, ct = ca.sin(phi), ca.cos(phi), ca.sin(th), ca.cos(th)
    hdot = uu * st - vv * sp * ct - ww * cp * ct
    va, wa, ua = vv - g[0], ww - g[1], uu - g[2]
    V = ca.sqrt(ua**2 + va**2 + wa**2)
    al, be = ca.atan2(wa, ua), ca.asin(va / V)
    qd = 0.5 * RHO * V**2
    ph, qh, rh = p * SPAN / (2 * V), q * CHORD / (2 * V), r * SPAN / (2 * V)
    soft = 1 - e["surface_compliance"] * qd / 200.0
    da_, dr_ = da * soft, dr * soft
    over, wash = al - pitch.LEVEL, T / (qd * pitch.DISC)
    slip = 1 + e["slipstream_rudder"] * T / (qd * AREA)
    b_mom = eta if e["indicial_lag"] > 0 else be
    ben = be + fin
    CL = d["CL_0"] + d["CL_alpha"] * al * (((1 + ca.sqrt(X)) / 2) ** 2 if stalls else 1.0)
    CL = CL + d["CL_q"] * qh + d["CL_de"] * de
    CL = CL + pitch.lift(d, e, over, al, be, da_, de, qd, wash)
    CD = d["CD_0"] + d["CD_k"] * CL**2
    CD = CD + pitch.drag(e, CL, al, be, da_, de, qh)
    CY = (
        d["CY_0"]
        + d["CY_beta"] * be
        + d["CY_p"] * ph
        + d["CY_r"] * rh
        + d["CY_dr"] * slip * dr_
        + e["CY_da"] * da_
        + e["CY_beta3"] * be**3
    )
    Cl = (d["Cl_0"] + d["Cl_beta"] * b_mom + d["Cl_p"] * ph * (0.4 + 0.6 * X) + d["Cl_r"] * rh + d["Cl_da"] * da_
          + d["Cl_dr"] * slip * dr_ + e["Cl_alpha_beta"] * al * be + e["Cl_da_de"] * da_ * de
          + e["Cl_beta3"] * be**3 + e["Cl_da3"] * da_**3 + e["Cl_p_abs_p"] * ph * ca.fabs(ph)
          + pitch.rolling(e, over, da_, ph))  # fmt: skip
    Cn = (d["Cn_0"] + d["Cn_beta"] * b_mom + d["Cn_p"] * ph + d["Cn_r"] * rh + d["Cn_dr"] * slip * dr_
          + e["Cn_da"] * da_ + e["Cn_alpha_beta"] * al * be + e["Cn_beta3"] * be**3 + e["Cn_dr3"] * dr_**3
          + 0.6 * d["Cn_beta"] * (ben - be) + pitch.yawing(e, over, da_, dr_, ph))  # fmt: skip
    Cm = d["Cm_0"] + d["Cm_alpha"] * al + d["Cm_q"] * qh + d["Cm_de"] * de
    Cm = Cm + pitch.pitching(d, e, over, be, da_, de, qd, wash)
    signals = {"beta": be, "p_hat": ph, "q_hat": qh, "r_hat": rh, "alpha": al, "V": V,
               "delta_a": da, "delta_e": de, "delta_r": dr}  # fmt: skip
    parts: dict[str, Any] = {"CL": CL, "CD": CD, "CY": CY, "Cl": Cl, "Cm": Cm, "Cn": Cn}
    hidden_dot: Any = 0.0
    if hidden is not None:
        part = hidden.of(signals)
        if hidden.memory:
            hidden_dot, part = (part - follower) / hidden.memory, follower
        parts[hidden.line] = parts[hidden.line] + part
    CL, CD, CY, Cl, Cm, Cn = parts.values()
    CX, CZ = CL * ca.sin(al) - CD * ca.cos(al), -CL * ca.cos(al) - CD * ca.sin(al)
    up = e["thrust_tilt"]
    ax, ay, az = (
        (qd * AREA * CX + T * ca.cos(up)) / MASS,
        qd * AREA * CY / MASS,
        (qd * AREA * CZ - T * ca.sin(up)) / MASS,
    )
    if e["CL_alphadot"]:  # lift from the rate that it changes itself: passes until it stands
        still_x, still_z, polar = ax, az, d["CD_k"]
        for _ in range(4):
            back = ww * (r * vv - q * ww - G * st + ax) - uu * (q * uu - p * vv + G * ct * cp + az)
            more = e["CL_alphadot"] * (-back / (uu**2 + ww**2)) * CHORD / (2 * V)
            drags = polar * ((CL + more) ** 2 - CL**2)  # all lift pays for itself
            ax = still_x + qd * AREA / MASS * (more * ca.sin(al) - drags * ca.cos(al))
            az = still_z - qd * AREA / MASS * (more * ca.cos(al) + drags * ca.sin(al))
    # a steady wind that grows with height: the airframe drifts through it, felt as an air-mass acceleration
    shear = e["wind_shear"] * hdot  # rate of change of the east wind met while climbing
    bx, by = -shear * ca.sin(psi) * ct, -shear * ca.cos(psi) * cp
    udot = r * vv - q * ww - G * st + ax + bx
    vdot = p * ww - r * uu + G * ct * sp + ay + by
    wdot = q * uu - p * vv + G * ct * cp + az
    bdot_ = (vdot - 0.0) / V  # small angles are enough for an added damping term
    bdh = bdot_ * SPAN / (2 * V)
    Cl = Cl + e["Cl_betadot"] * bdh
    Cn = Cn + e["Cn_betadot"] * bdh
    L = qd * AREA * SPAN * Cl - e["lateral_cg"] * MASS * az + e["motor_torque"] * T * (-1)
    N = qd * AREA * SPAN * Cn + e["prop_gyroscopic"] * q - e["p_factor"] * T * al + e["lateral_cg"] * MASS * ax
    aldot = (wdot * uu - udot * ww) / (uu**2 + ww**2)
    Cm = Cm + e["Cm_alphadot"] * aldot * CHORD / (2 * V)
    M = qd * AREA * CHORD * Cm - e["prop_gyroscopic"] * r + e["thrust_z"] * T - x_["pitch_slosh"] * 0.25 * slosh
    L = L - x_["pendulum"] * 0.35 * pen
    roll = L + Ixz * p * q - (Izz - Iyy) * q * r
    yaw = N - Ixz * q * r - (Iyy - Ixx) * p * q
    det = Ixx * Izz - Ixz**2
    pdot, rdot = (Izz * roll + Ixz * yaw) / det, (Ixx * yaw + Ixz * roll) / det
    qdot = (M + (Izz - Ixx) * p * r - Ixz * (p**2 - r**2)) / Iyy
    phidot, thdot = p + ca.tan(th) * (q * sp + r * cp), q * cp - r * sp
    psidot = (q * sp + r * cp) / ct
    etadot = (be - eta) / max(e["indicial_lag"], 0.02)
    Xdot = (0.5 * (1 - ca.tanh(25 * (al - e["stall_separation"]))) - X) / 0.15 if stalls else 0.0
    flexible, swings, sloshes = x_["flexible_fin"], x_["pendulum"] > 0, x_["pitch_slosh"] > 0
    findd = (14.0**2) * (-flexible * 1.2 * (be + dr) - fin) - 3.0 * find if flexible > 0 else 0.0
    pendd = -(6.0**2) * pen - 0.8 * pend + 6.0 * ay + 1.5 * pdot if swings else 0.0
    sloshdd = -(9.0**2) * slosh - 0.8 * sloshd + 6.0 * (ax - 1.0) + 1.5 * qdot if sloshes else 0.0
    rates = [udot, vdot, wdot, pdot, qdot, rdot, phidot, thdot, psidot, hdot, etadot, Xdot, find, findd,
             pend, pendd, sloshd, sloshdd, hidden_dot]  # fmt: skip
    return rates, [ax, ay, az, al, be, V, pdot, rdot, qdot]


def _step_of(d: Mapping[str, Array], inertia: Mapping[str, Array], e: Mapping[str, Array], x_: Mapping[str, Array],
             hidden: Sequence[Hidden | None]) -> ca.Function:  # fmt: skip
    """One Runge-Kutta step of all flights: states (19, n), surfaces and thrust (4, n), gusts (3, n) to states and observed.

    Traced once, so that what a flight does not have costs nothing in its 6000 steps.
    """
    n, dt = len(hidden), 1 / RATE
    x, act, g = ca.SX.sym("x", len(STATES), n), ca.SX.sym("act", 4, n), ca.SX.sym("g", 3, n)
    after, observed = [], []
    for i, part in enumerate(hidden):
        own = [{k: float(v[i]) for k, v in values.items()} for values in (d, inertia, e, x_)]
        a, b = ca.vertsplit(act[:, i]), ca.vertsplit(g[:, i])

        def rates(at: ca.SX, own: list[dict[str, float]] = own, part: Hidden | None = part, a: list[ca.SX] = a,
                  b: list[ca.SX] = b) -> tuple[ca.SX, ca.SX]:  # fmt: skip
            rate, seen = _motion(*own, part, ca.vertsplit(at), a, b)
            return ca.vertcat(*rate), ca.vertcat(*seen)

        k1, seen = rates(x[:, i])
        k2, _ = rates(x[:, i] + dt / 2 * k1)
        k3, _ = rates(x[:, i] + dt / 2 * k2)
        k4, _ = rates(x[:, i] + dt * k3)
        after.append(x[:, i] + dt / 6 * (k1 + 2 * k2 + 2 * k3 + k4))
        observed.append(seen)
    return ca.Function("step", [x, act, g], [ca.horzcat(*after), ca.horzcat(*observed)])


def _integrate(d: Mapping[str, Array], inertia: Mapping[str, Array], V0: Array, u: Array, gust: Array,
               e: Mapping[str, Array], x_: Mapping[str, Array], centred: NDArray[np.bool_],
               hidden: Sequence[Hidden | None], steps: int, n: int) -> dict[str, Array]:  # fmt: skip
    a0, de0, T0 = _trim(d, V0)
    x = np.zeros((len(STATES), n))
    x[0], x[2], x[7], x[9] = V0 * np.cos(a0), V0 * np.sin(a0), a0, 60.0
    x[11] = 1.0
    servo = np.stack([np.zeros(n), np.zeros(n), de0])  # da dr de at the potentiometer
    post = servo[:2].copy()  # surface after any lag
    loose = servo[:2].copy()  # backlash
    pilot = np.zeros((2, n))
    elevator_before = servo[2].copy()
    delay = np.round((np.stack([e["aileron_delay"], e["rudder_delay"]]) + e["servo_delay"]) * RATE).astype(int)
    line = np.zeros((2, steps, n))
    thrust, pull = T0.copy(), T0.copy()
    elevator = pitch.Elevator(e, de0, RATE, steps)
    keep = "ax ay az p q r phi theta psi alpha beta V delta_e delta_a delta_r thrust altitude pdot rdot qdot".split()
    out = {k: np.zeros((steps, n)) for k in keep}
    dt = 1 / RATE
    step, run = _step_of(d, inertia, e, x_, hidden).buffer()
    given = [np.zeros((n, rows)) for rows in (len(STATES), 4, 3)]
    made = [np.zeros((n, rows)) for rows in (len(STATES), len(OBSERVED))]
    for i, there in enumerate(given):
        step.set_arg(i, memoryview(there))
    for i, there in enumerate(made):
        step.set_res(i, memoryview(there))
    for k in range(steps):
        phi, p, th, q, _r = x[6], x[3], x[7], x[4], x[5]
        pilot += dt / 0.25 * (np.stack([0.10 * phi + 0.02 * p, 0.05 * (th - a0) + 0.02 * q]) - pilot)
        quiet = np.where(np.abs(u[0, k]) + np.abs(u[1, k]) > 0, 0.35, 1.0)
        want = np.stack([u[0, k] + quiet * pilot[0], u[1, k], de0 + u[2, k] + pilot[1]])
        servo = servo + dt * np.clip((want - servo) / 0.035, -6.0, 6.0)
        thrust = thrust + dt / 0.08 * (T0 + u[3, k] - thrust)
        slow = e["thrust_lag"]
        pull = np.where(slow > 0, pull + dt / np.maximum(slow, 1e-3) * (thrust - pull), thrust)
        line[:, k] = servo[:2]
        back = np.maximum(k - delay, 0)
        late = np.take_along_axis(line, back[:, None, :], axis=1)[:, 0]
        taus = np.stack([e["aileron_lag"], e["rudder_lag"]]) + e["servo_lag"]
        post = np.where(taus > 0, post + dt / np.maximum(taus, 1e-3) * (late - post), late)
        half = 0.5 * np.stack([e["aileron_backlash"], e["rudder_backlash"]])
        loose = np.clip(loose, post - half, post + half)
        act = np.where(half > 0, loose, post)
        dz = e["aileron_deadzone"]
        act[0] = np.where(dz > 0, np.sign(act[0]) * np.maximum(np.abs(act[0]) - dz, 0), act[0])
        g = gust[:, k].copy()
        burst = (k > 14.0 * RATE) & (k < 17.0 * RATE)
        g[0] += x_["shear_burst"] * V0 * 2.0 * DEG * (burst * np.sin(np.pi * (k / RATE - 14.0) / 3.0))
        g[1] += x_["vertical_burst"] * V0 * 1.5 * DEG * (burst * np.sin(np.pi * (k / RATE - 14.0) / 3.0))
        short = (k > 14.0 * RATE) & (k < 14.8 * RATE)
        g[0] += x_["short_burst"] * V0 * 2.5 * DEG * (short * np.sin(np.pi * (k / RATE - 14.0) / 0.8))
        surfaces = (act[0], act[1], elevator.step(k, servo[2]), pull * (1 + e["thrust_scale"]))
        for there, values in zip(given, (x, surfaces, g), strict=True):
            there.T[:] = values
        run()
        for name, row in zip(OBSERVED, made[1].T, strict=True):
            out[name][k] = row
        for name, i in (("p", 3), ("q", 4), ("r", 5), ("phi", 6), ("theta", 7), ("psi", 8), ("altitude", 9)):
            out[name][k] = x[i]
        before = line[:, max(k - 1, 0)]
        out["delta_a"][k], out["delta_r"][k] = np.where(centred, 0.5 * (servo[:2] + before), servo[:2])
        out["delta_e"][k] = np.where(centred, 0.5 * (servo[2] + elevator_before), servo[2])
        out["thrust"][k], elevator_before = thrust, servo[2].copy()
        x = made[0].T.copy()
    return out


def _lagged(signal: Array, tau: float) -> Array:
    out, value = np.empty_like(signal), signal[0]
    for k, s in enumerate(signal):
        value += (1 / RATE) / tau * (s - value)
        out[k] = value
    return out


def _measure(
    h: Mapping[str, Array], request: Request, rng: np.random.Generator, e: Mapping[str, float], x_: Mapping[str, float]
) -> dict[str, Array]:
    """Instruments: effects on the measured signals, sampling at 20 Hz, white noise."""
    m = {k: h[k].copy() for k in h}
    m["beta"] = m["beta"] + e["vane_position"] * h["r"] / h["V"]
    m["beta"] = m["beta"] * (1 + e["beta_scale"])
    if e["beta_lag"]:
        m["beta"] = _lagged(m["beta"], e["beta_lag"])
    m["ay"] = m["ay"] - e["imu_lever_arm"] * h["pdot"]
    c, s = np.cos(e["gyro_misalignment"]), np.sin(e["gyro_misalignment"])
    m["p"], m["r"] = c * h["p"] - s * h["r"], c * h["r"] + s * h["p"]
    for k in "pqr":
        m[k] = m[k] * (1 + e["gyro_scale"])
    if e["attitude_lag"]:
        m["phi"], m["theta"] = _lagged(h["phi"], e["attitude_lag"]), _lagged(h["theta"], e["attitude_lag"])
    m["V"] = h["V"] * (1 + e["airspeed_scale"])
    pitch.bend(m, h, e, x_, _lagged)
    if e["time_skew"]:
        lateness = round(e["time_skew"] * RATE)
        for k in ("p", "q", "r", "ax", "ay", "az"):
            m[k] = np.concatenate([np.full(lateness, m[k][0]), m[k][: m[k].size - lateness]])
    if x_["gyro_clip"]:
        limit = np.quantile(np.abs(h["p"]), 0.93) / x_["gyro_clip"]
        m["p"] = np.clip(m["p"], -limit, limit)
    if x_["bank_accelerometer"]:
        m["ay"] = m["ay"] + x_["bank_accelerometer"] * 1.2 * h["phi"] * np.abs(h["phi"]) * 4
    if x_["attitude_turn_error"]:
        m["phi"] = h["phi"] - x_["attitude_turn_error"] * _lagged(h["r"] * h["V"] / G, 1.5) * 0.35
    clock = np.arange(h["r"].size) / RATE
    m["r"] = m["r"] + x_["gyro_drift"] * 1.0 * DEG * clock / 30.0
    m["beta"] = m["beta"] + x_["vane_slip"] * 1.5 * DEG * (clock > 18.0)
    every = RATE // SAMPLE
    out = {k: m[k][::every] for k in NOISE}
    if x_["vane_friction"]:
        out["beta"] = _stick(out["beta"], 0.9 * DEG * x_["vane_friction"])
    if x_["alpha_friction"]:
        out["alpha"] = _stick(out["alpha"], 0.9 * DEG * x_["alpha_friction"])
    for k, sigma in NOISE.items():
        scale = request.jitter if k.startswith("delta") else 1.0
        out[k] = out[k] + sigma * scale * rng.standard_normal(out[k].size)
    if x_["stale_vane"]:
        hold = round(6 * x_["stale_vane"])
        index = (np.arange(out["beta"].size) // hold) * hold
        out["beta"] = out["beta"][index]
    if x_["stale_alpha"]:
        hold = round(6 * x_["stale_alpha"])
        out["alpha"] = out["alpha"][(np.arange(out["alpha"].size) // hold) * hold]
    count = round(request.duration * SAMPLE) + 1
    out = {k: v[:count] for k, v in out.items()}
    return {"time": np.arange(count) / SAMPLE, **out, "rho": np.full(count, RHO)}


def _stick(signal: Array, width: float) -> Array:
    out, value = np.empty_like(signal), signal[0]
    for k, s in enumerate(signal):
        value = min(max(value, s - width), s + width)
        out[k] = value
    return out
