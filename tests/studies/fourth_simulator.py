"""A fourth simulator, of other choices than all others here: quaternions, Euler steps of a millisecond, servos with a limit of
rate, a pilot who holds pitch and bank through noisy sensors, instruments that may be quantised, an attitude that may be an
autopilot's, logged at 10 Hz.

Shares no code with `firmware_sim`, `estimation` or the other truths. Body axes x forward, y right, z down; SI and radians; every
aircraft has derivatives of its own, about those of a small flat-plate aeroplane.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import asin, atan2, cos, sin, sqrt
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from groundstation.flight import Flight, Provenance

Array = NDArray[np.float64]
DEG = np.pi / 180
STEP = 1e-3  # s
AREA, SPAN, CHORD, MASS, GRAVITY, DENSITY = 0.787, 1.5, 0.61, 3.5, 9.80665, 1.17
IXX, IYY, IZZ, IXZ = 0.24, 0.23, 0.46, 0.008
TRIM_SPEED = 16.5  # m/s, at which Cm_0 trims the elevator to nothing
SPREAD = 0.1  # of every derivative from aircraft to aircraft
FILTER_MEMORY, FILTER_ERROR, LOGGED = 5.0, 0.5 * DEG, 10  # s, rad, Hz: slow error of an autopilot's attitude, its log
USUAL: Mapping[str, float] = MappingProxyType({
    "CL_alpha": 3.0, "CL_q": 3.3, "CL_de": 1.0, "CD_0": 0.025, "CD_k": 0.24, "Cm_alpha": -0.168, "Cm_q": -0.92, "Cm_de": -0.36,
    "CY_beta": -0.1204, "CY_p": -0.05, "CY_r": 0.12, "CY_dr": 0.4586, "Cl_beta": -0.0901, "Cl_p": -0.45, "Cl_r": 0.1,
    "Cl_da": -0.0963, "Cl_dr": 0.0195, "Cn_beta": 0.0245, "Cn_p": 0.02, "Cn_r": -0.04, "Cn_dr": -0.042,
})  # fmt: skip
NOISE: Mapping[str, float] = MappingProxyType({
    "ax": 0.05, "ay": 0.05, "az": 0.08, "p": 0.4 * DEG, "q": 0.4 * DEG, "r": 0.3 * DEG, "phi": 0.3 * DEG, "theta": 0.3 * DEG,
    "alpha": 0.3 * DEG, "beta": 0.25 * DEG, "V": 0.15, "delta_e": 0.07 * DEG, "delta_a": 0.07 * DEG, "delta_r": 0.07 * DEG,
    "thrust": 0.05,
})  # fmt: skip
SPIKE, MEASURED_BY_POT = 8.0, ("delta_e", "delta_a", "delta_r", "thrust")  # noises; channels without spikes
RESOLUTION: Mapping[str, float] = MappingProxyType({
    "delta_e": 0.12 * DEG, "delta_a": 0.12 * DEG, "delta_r": 0.12 * DEG, "phi": 0.2 * DEG, "theta": 0.2 * DEG,
    "alpha": 0.35 * DEG, "beta": 0.35 * DEG, "p": 0.3 * DEG, "q": 0.3 * DEG, "r": 0.3 * DEG,
})  # fmt: skip
HIDDEN: Mapping[str, float] = MappingProxyType({
    "CY_da": 0.04, "Cn_da": -0.010, "Cl_beta3": -2.0, "Cn_beta3": 1.0, "Cl_alpha_beta": -0.75, "aileron_lag": 0.06,
    "rudder_lag": 0.06, "beta_lag": 0.07, "beta_scale": 0.10, "CL_alpha2": -4.0, "Cm_alpha2": -0.4, "Cm_alphadot": -0.4,
    "thrust_z": 0.02, "elevator_lag": 0.04, "alpha_scale": 0.1, "alpha_lag": 0.035, "imu_x": 0.08, "Cm_beta2": 0.3,
})  # fmt: skip
"""Effects that can be hidden, with their usual sizes, under the names of the catalogue."""


@dataclass(frozen=True)
class Kind:
    """How one set is flown. rate: samples a second; noise: by what the usual noise of a channel is multiplied; hold, level: gains
    of the pilot on pitch attitude and rate, bank and rate; hidden_lag: of the elevator behind its potentiometer [s]; hidden:
    effects and their sizes in usual ones; fastest: a servo [rad/s]; gust: rms flow angle [rad]; quantised: by `RESOLUTION`;
    attitude: `measured`, or an autopilot's with its values `held` or joined by `lines`; axes: those that are moved;
    course: of the sticks, one of `COURSES`; spikes: of each channel, each of eight times its noise; tails: noise by Student's t
    of three degrees of freedom, in usual noises; pots: the step of the converter of the surfaces [rad], 0 for none."""

    rate: int = 20
    duration: float = 30.0
    noise: tuple[tuple[str, float], ...] = ()
    hold: tuple[float, float] = (0.25, 0.05)
    level: tuple[float, float] = (0.1, 0.02)
    servo: float = 0.035
    hidden_lag: float = 0.0
    hidden: tuple[tuple[str, float], ...] = ()
    fastest: float = 6.0
    gust: float = 0.0
    quantised: bool = False
    attitude: str = "measured"
    axes: str = "longitudinal"
    course: str = "multisteps"
    spikes: int = 0
    tails: float = 0.0
    pots: float = 0.0


def fly(seed: int, kind: Kind, speeds: Sequence[float]) -> tuple[Flight, ...]:
    """One flight at each speed [m/s], of one aircraft."""
    rng = np.random.default_rng(seed)
    derivatives = {n: v * (1.0 + SPREAD * rng.standard_normal()) for n, v in USUAL.items()}
    return tuple(_flown(f"s{seed}_{i}", derivatives, v, kind, rng) for i, v in enumerate(speeds))


Multistep = tuple[float, tuple[float, ...], float, float]
ELEVATOR: tuple[Multistep, ...] = (
    (1.5, (0.9, 0.6, 0.3, 0.3), 1.4, 2.0), (6.3, (0.4, 0.4), 2.4, 3.0), (10.6, (1.1, 0.5), 1.0, 1.4),
    (15.2, (0.35,) * 4, 1.8, 2.8), (19.4, (0.9, 0.6, 0.3, 0.3), 0.8, 1.2), (26.0, (0.3, 0.3), 4.0, 6.0),
)  # fmt: skip
AILERON: tuple[Multistep, ...] = (
    (2.2, (0.6, 0.6), 4.5, 6.5), (11.6, (0.9, 0.6, 0.3, 0.3), 4.0, 6.0), (22.1, (0.35,) * 4, 2.5, 3.5),
)  # fmt: skip
RUDDER: tuple[Multistep, ...] = (
    (5.2, (0.7, 0.7), 1.6, 3.2), (16.9, (0.9, 0.6, 0.3, 0.3), 2.6, 3.4), (25.0, (0.5, 0.5), 2.0, 3.0),
)  # fmt: skip
THROTTLE: tuple[Multistep, ...] = ((3.6, (4.1, 4.0), 1.0, 1.9), (15.0, (3.5, 3.5), 1.0, 1.9))  # N
MOVED: Mapping[str, tuple[tuple[Multistep, ...], ...]] = MappingProxyType({
    "longitudinal": (ELEVATOR, (), (), THROTTLE), "lateral": ((), AILERON, RUDDER, ()),
    "six-dof": (ELEVATOR, AILERON, RUDDER, THROTTLE),
})  # fmt: skip


def inputs(time: Array, rng: np.random.Generator, steps: Sequence[Multistep] = ELEVATOR, unit: float = DEG) -> Array:
    """(N,) pilot's course of one control: multisteps of several lengths and sizes."""
    course = np.zeros(time.size)
    width, sign = rng.uniform(0.9, 1.1), rng.choice([-1.0, 1.0])
    for start, parts, low, high in steps:
        begin, size = start + rng.uniform(-0.3, 0.3), rng.uniform(low, high) * unit
        for part in parts:
            course[(time >= begin) & (time < begin + part * width)] += sign * size
            begin, size = begin + part * width, -size
        sign = -sign
    return course


def _size(steps: Sequence[Multistep], unit: float) -> float:
    return float(np.mean([0.5 * (low + high) for *_, low, high in steps])) * unit if steps else 0.0


def multisine(time: Array, rng: np.random.Generator, steps: Sequence[Multistep], unit: float) -> Array:
    """(N,) twelve sines of 0.1 to 2.5 Hz, of the multisteps' size."""
    frequencies = rng.permutation(np.arange(0.1, 2.55, 0.1))[:12]
    lines = [np.sin(2.0 * np.pi * f * time + rng.uniform(0.0, 2.0 * np.pi)) for f in frequencies]
    course = np.sum(lines, axis=0)
    return np.asarray(0.8 * _size(steps, unit) * course / np.std(course))


def sweep(time: Array, rng: np.random.Generator, steps: Sequence[Multistep], unit: float) -> Array:
    """(N,) one sweep from 0.2 to 3 Hz."""
    start, lasts, rise = rng.uniform(0.0, 0.3) * time[-1], 0.6 * time[-1], np.log(3.0 / 0.2)
    since = np.clip(time - start, 0.0, lasts)
    phase = 2.0 * np.pi * 0.2 * lasts / rise * (np.exp(rise * since / lasts) - 1.0)
    return np.asarray(1.2 * _size(steps, unit) * np.sin(phase) * (since > 0.0) * (since < lasts))


def random_steps(time: Array, rng: np.random.Generator, steps: Sequence[Multistep], unit: float) -> Array:
    """(N,) a random position every 0.3 s, on the clock of the samples."""
    positions = rng.choice([-1.0, 0.0, 1.0], int(time[-1] / 0.3) + 2, p=[0.25, 0.5, 0.25])
    return np.asarray(_size(steps, unit) * positions[(time / 0.3 + 1e-9).astype(int)])


def steps_off_clock(time: Array, rng: np.random.Generator, steps: Sequence[Multistep], unit: float) -> Array:
    """(N,) a random position every 0.3137 s, at any time between two samples."""
    positions = rng.choice([-1.0, 0.0, 1.0], int(time[-1] / 0.3) + 3, p=[0.25, 0.5, 0.25])
    return np.asarray(_size(steps, unit) * positions[((time + rng.uniform(0.0, 0.3)) / 0.3137).astype(int)])


COURSES: Mapping[str, Callable[[Array, np.random.Generator, Sequence[Multistep], float], Array]] = MappingProxyType({
    "multisteps": inputs, "multisine": multisine, "sweep": sweep, "random steps": random_steps,
    "steps off the clock": steps_off_clock,
})  # fmt: skip
"""Kind of course of a stick -> its course."""


def _gusts(count: int, size: float, rng: np.random.Generator) -> Array:
    """(3, count) side and vertical wind [m/s] of rms `size`, and the roll rate [rad/s] of gusts across the span."""
    winds = np.zeros((3, count))
    for row, (memory, rms) in enumerate(((1.2, size), (0.8, 0.7 * size), (0.15, 0.5 * size))):
        keep, value = np.exp(-STEP / memory), rms * rng.standard_normal()
        for k, push in enumerate(rms * np.sqrt(1.0 - keep**2) * rng.standard_normal(count)):
            value = keep * value + push
            winds[row, k] = value
    return winds


def _trim(d: Mapping[str, float], speed: float) -> tuple[float, float, float, float]:
    """Angle of attack, elevator, thrust of level flight, and the angle of attack about which Cm is linear."""
    pressure = 0.5 * DENSITY * speed**2
    level = MASS * GRAVITY / (0.5 * DENSITY * TRIM_SPEED**2 * AREA) / d["CL_alpha"]
    lift = MASS * GRAVITY / (pressure * AREA)
    slopes = np.array([[d["CL_alpha"], d["CL_de"]], [d["Cm_alpha"], d["Cm_de"]]])
    alpha, rest = np.linalg.solve(slopes, [lift, d["Cm_alpha"] * level])
    return float(alpha), float(rest), pressure * AREA * (d["CD_0"] + d["CD_k"] * lift**2) / cos(alpha), level


SEEN = (
    "ax",
    "ay",
    "az",
    "p",
    "q",
    "r",
    "phi",
    "theta",
    "psi",
    "alpha",
    "beta",
    "V",
    "delta_e",
    "delta_a",
    "delta_r",
    "thrust",
)


def _flown(name: str, d: Mapping[str, float], speed: float, kind: Kind, rng: np.random.Generator) -> Flight:
    count = round(kind.duration / STEP) + 1
    time = np.arange(count) * STEP
    course = COURSES[kind.course]
    sticks = np.array([course(time, rng, s, 1.0 if s is THROTTLE else DEG) for s in MOVED[kind.axes]])
    rows = _motion(d, speed, kind, sticks, _gusts(count, kind.gust * speed, rng), rng.standard_normal((4, count)))
    every = round(1.0 / (kind.rate * STEP))
    columns = _instruments({n: rows[:, i] for i, n in enumerate(SEEN)}, kind, every, rng)
    size = columns["V"].size
    columns |= {"rho": np.full(size, DENSITY), "altitude": np.full(size, 60.0)}
    return Flight.build(name, np.arange(size) / kind.rate, columns, provenance=Provenance(aircraft="cdfp"))


def _motion(d: Mapping[str, float], speed: float, kind: Kind, sticks: Array, winds: Array, seen: Array) -> Array:
    """(steps, SEEN) what instruments without error would show."""
    e = dict.fromkeys(HIDDEN, 0.0) | {n: share * HIDDEN[n] for n, share in kind.hidden}
    trim, rest, push, level = _trim(d, speed)
    u, v, w, p, q, r = speed * cos(trim), 0.0, speed * sin(trim), 0.0, 0.0, 0.0
    a, b, c, k4 = cos(0.5 * trim), 0.0, sin(0.5 * trim), 0.0  # quaternion, earth to body
    arms, lags = [rest, 0.0, 0.0], (kind.hidden_lag + e["elevator_lag"], e["aileron_lag"], e["rudder_lag"])
    surfaces, thrust, slow, rate_of_alpha = list(arms), push, 0.0, 0.0
    rows, det = np.empty((sticks.shape[1], len(SEEN))), IXX * IZZ - IXZ**2
    for k in range(sticks.shape[1]):
        phi, theta = atan2(2 * (a * b + c * k4), 1 - 2 * (b * b + c * c)), asin(2 * (a * c - k4 * b))
        psi = atan2(2 * (a * k4 + b * c), 1 - 2 * (c * c + k4 * k4))
        held = kind.hold[0] * (theta - trim + 0.002 * seen[0, k]) + kind.hold[1] * (q + 0.004 * seen[1, k])
        banked = kind.level[0] * (phi + 0.002 * seen[2, k]) + kind.level[1] * (p + 0.004 * seen[3, k])
        for i, wanted in enumerate((rest + sticks[0, k] + held, sticks[1, k] + banked, sticks[2, k])):
            arms[i] += STEP * min(max((wanted - arms[i]) / kind.servo, -kind.fastest), kind.fastest)
            surfaces[i] = surfaces[i] + STEP * (arms[i] - surfaces[i]) / lags[i] if lags[i] else arms[i]
        thrust += STEP * (push + sticks[3, k] - thrust) / 0.2
        de, da, dr = surfaces
        va, wa = v - winds[0, k], w - winds[1, k]
        airspeed = sqrt(u * u + va * va + wa * wa)
        alpha, beta, pressure = atan2(wa, u), asin(va / airspeed), 0.5 * DENSITY * airspeed**2
        ph, qh, rh = (p + winds[2, k]) * SPAN / (2 * airspeed), q * CHORD / (2 * airspeed), r * SPAN / (2 * airspeed)
        over = alpha - level
        CL = d["CL_alpha"] * alpha + d["CL_q"] * qh + d["CL_de"] * de + e["CL_alpha2"] * over**2
        CD = d["CD_0"] + d["CD_k"] * CL**2
        CY = d["CY_beta"] * beta + d["CY_p"] * ph + d["CY_r"] * rh + d["CY_dr"] * dr + e["CY_da"] * da
        Cl = d["Cl_beta"] * beta + d["Cl_p"] * ph + d["Cl_r"] * rh + d["Cl_da"] * da + d["Cl_dr"] * dr
        Cl += e["Cl_beta3"] * beta**3 + e["Cl_alpha_beta"] * over * beta
        Cm = (
            d["Cm_alpha"] * over + d["Cm_q"] * qh + d["Cm_de"] * de + e["Cm_alpha2"] * over**2 + e["Cm_beta2"] * beta**2
        )
        Cm += e["Cm_alphadot"] * rate_of_alpha * CHORD / (2 * airspeed)
        Cn = (
            d["Cn_beta"] * beta
            + d["Cn_p"] * ph
            + d["Cn_r"] * rh
            + d["Cn_dr"] * dr
            + e["Cn_da"] * da
            + e["Cn_beta3"] * beta**3
        )
        lift = pressure * AREA / MASS
        ax = lift * (CL * sin(alpha) - CD * cos(alpha)) + thrust / MASS
        ay, az = lift * CY, -lift * (CL * cos(alpha) + CD * sin(alpha))
        qdot = (
            pressure * AREA * CHORD * Cm + e["thrust_z"] * thrust + (IZZ - IXX) * p * r - IXZ * (p * p - r * r)
        ) / IYY
        slow = slow + STEP * (beta - slow) / e["beta_lag"] if e["beta_lag"] and k else beta
        rows[k] = (
            ax - e["imu_x"] * (q * q + r * r), ay, az - e["imu_x"] * qdot, p, q, r, phi, theta, psi,
            alpha * (1.0 + e["alpha_scale"]), slow * (1.0 + e["beta_scale"]), airspeed, *arms, thrust,
        )  # fmt: skip
        gx, gy, gz = 2 * (b * k4 - a * c), 2 * (c * k4 + a * b), 1 - 2 * (b * b + c * c)
        before = alpha
        u, v, w = (
            u + STEP * (ax + GRAVITY * gx + r * v - q * w),
            v + STEP * (ay + GRAVITY * gy + p * w - r * u),
            w + STEP * (az + GRAVITY * gz + q * u - p * v),
        )
        rate_of_alpha = (atan2(w - winds[1, k], u) - before) / STEP
        roll = pressure * AREA * SPAN * Cl + IXZ * p * q - (IZZ - IYY) * q * r
        yaw = pressure * AREA * SPAN * Cn - IXZ * q * r - (IYY - IXX) * p * q
        a, b, c, k4 = (
            a - 0.5 * STEP * (b * p + c * q + k4 * r), b + 0.5 * STEP * (a * p + c * r - k4 * q),
            c + 0.5 * STEP * (a * q - b * r + k4 * p), k4 + 0.5 * STEP * (a * r + b * q - c * p),
        )  # fmt: skip
        size = sqrt(a * a + b * b + c * c + k4 * k4)
        a, b, c, k4 = a / size, b / size, c / size, k4 / size
        p, q, r = p + STEP * (IZZ * roll + IXZ * yaw) / det, q + STEP * qdot, r + STEP * (IXX * yaw + IXZ * roll) / det
    if e["alpha_lag"]:
        rows[:, SEEN.index("alpha")] = _late(rows[:, SEEN.index("alpha")], e["alpha_lag"])
    return rows


def _late(course: Array, memory: float) -> Array:
    late = course.copy()
    for k in range(1, course.size):
        late[k] = late[k - 1] + STEP / memory * (course[k] - late[k - 1])
    return late


def _instruments(motion: Mapping[str, Array], kind: Kind, every: int, rng: np.random.Generator) -> dict[str, Array]:
    """Columns as they are recorded."""
    factors, columns = dict(kind.noise), {}
    for name, course in motion.items():
        sampled = course[::every]
        if name in ("phi", "theta", "psi") and kind.attitude != "measured":
            columns[name] = _autopilot(sampled, kind, rng)
            continue
        columns[name] = sampled + factors.get(name, 1.0) * NOISE.get(name, 0.6 * DEG) * rng.standard_normal(
            sampled.size
        )
        if kind.tails and name in NOISE:
            columns[name] += kind.tails * NOISE[name] * rng.standard_t(3, sampled.size)
        if kind.spikes and name in NOISE and name not in MEASURED_BY_POT:
            at = rng.integers(0, sampled.size, kind.spikes)
            columns[name][at] += SPIKE * NOISE[name] * rng.choice([-1.0, 1.0], kind.spikes)
        if kind.pots and name in ("delta_e", "delta_a", "delta_r"):
            columns[name] = kind.pots * np.round(columns[name] / kind.pots)
        if kind.quantised and name in RESOLUTION:
            columns[name] = RESOLUTION[name] * np.round(columns[name] / RESOLUTION[name])
    return columns


def _autopilot(true: Array, kind: Kind, rng: np.random.Generator) -> Array:
    """An attitude without noise, with a slow error, logged at 10 Hz."""
    keep = np.exp(-1.0 / (kind.rate * FILTER_MEMORY))
    error = np.empty(true.size)
    error[0] = FILTER_ERROR * rng.standard_normal()
    for k in range(1, true.size):
        error[k] = keep * error[k - 1] + FILTER_ERROR * np.sqrt(1.0 - keep**2) * rng.standard_normal()
    index, hold = np.arange(true.size), max(kind.rate // LOGGED, 1)
    logged = (true + error)[::hold]
    return np.repeat(logged, hold)[: true.size] if kind.attitude == "held" else np.interp(index, index[::hold], logged)
