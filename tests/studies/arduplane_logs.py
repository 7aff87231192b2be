"""Logs as ArduPlane's own firmware writes them, of aeroplanes with known derivatives, and what `analyse` makes of them.

`python -m tests.studies.arduplane_logs [NAME...] [--hz 25] [--wiring elevons] [--out DIR]`: each aeroplane flies legs in
FBWA and, between them, seconds of MANUAL with doublets. What such a log does to a record is in it: outputs logged at 25 or 50 Hz
and changed before that, gyros and accelerometers behind their low-pass, airspeed smoothed over a quarter second, fixes that are
old, an attitude that wanders, no vane, ARSPD_RATIO that is not Bernoulli's. Own equations of motion, apart from those of the
estimators.
"""

import argparse
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from scipy.signal import butter, lfilter, sosfilt

from tests.unit.groundstation.importers.autopilots import Table, dataflash

STEP = 0.0025
"""[s] of the integration; the autopilot's loop is every fourth."""
LOOP = 4
DEG = np.pi / 180.0
TRUE = {
    "CL_0": 0.33, "CL_alpha": 5.0, "CL_q": 6.5, "CL_de": 0.42, "CD_0": 0.04, "CD_k": 0.05, "Cm_0": 0.03, "Cm_alpha": -0.8,
    "Cm_q": -12.0, "Cm_de": -1.0, "CY_beta": -0.5, "CY_p": 0.02, "CY_r": 0.2, "CY_dr": 0.18, "Cl_beta": -0.09, "Cl_p": -0.42,
    "Cl_r": 0.13, "Cl_da": -0.16, "Cl_dr": 0.008, "Cn_beta": 0.07, "Cn_p": -0.045, "Cn_r": -0.1, "Cn_da": 0.006, "Cn_dr": -0.062,
}  # fmt: skip
MAIN = ("CY_beta", "CY_dr", "Cl_beta", "Cl_p", "Cl_da", "Cn_beta", "Cn_r", "Cn_dr")


@dataclass(frozen=True)
class Aeroplane:
    """Span, chord [m], area [m2], mass [kg], inertia [kg m2], speed [m/s], density [kg/m3], servo lag [s], derivatives."""

    span: float
    area: float
    chord: float
    mass: float
    inertia: tuple[float, float, float, float]
    speed: float
    rho: float = 1.15
    lag: float = 0.05
    derivatives: Mapping[str, float] = field(default_factory=dict)

    @property
    def true(self) -> dict[str, float]:
        return {**TRUE, **self.derivatives}


AEROPLANES = {
    "trainer": Aeroplane(1.7, 0.5, 0.3, 2.6, (0.26, 0.3, 0.5, 0.015), 17.0),
    "foam": Aeroplane(1.2, 0.22, 0.19, 0.9, (0.03, 0.045, 0.07, 0.003), 14.0, 1.2, 0.04,
                      {"Cl_p": -0.5, "Cl_da": -0.22, "Cn_beta": 0.1, "Cn_r": -0.16, "Cn_dr": -0.09, "CY_beta": -0.7}),
    "survey": Aeroplane(3.0, 0.95, 0.32, 10.0, (2.1, 2.0, 3.9, 0.1), 21.0, 1.08, 0.06,
                        {"Cl_p": -0.55, "Cl_da": -0.14, "Cn_beta": 0.055, "CY_beta": -0.4, "CY_dr": 0.14}),
    "glider": Aeroplane(2.8, 0.5, 0.18, 2.2, (0.5, 0.16, 0.62, 0.01), 14.0, 1.19, 0.05,
                        {"Cl_p": -0.58, "Cl_r": 0.2, "Cl_beta": -0.06, "Cn_beta": 0.045, "Cn_p": -0.07, "Cn_r": -0.06}),
    "stiff": Aeroplane(1.9, 0.45, 0.24, 2.1, (0.11, 0.15, 0.24, 0.01), 26.0),
}  # fmt: skip


@dataclass(frozen=True)
class Wiring:
    """What an aeroplane's servos, pitots and filters are. throws [deg] for 500 us of aileron, elevator, rudder; reversed: servos
    that turn the other way, by their output; pitot: instance that flies, behind one that reads 0.8 of the pressure where it is
    not the first; lanes: of the EKF, each of which logs an attitude and a wind of its own."""

    throws: tuple[float, float, float] = (22.0, 22.0, 25.0)
    reversed: tuple[str, ...] = ()
    elevons: bool = False
    flaperons: bool = False
    pitot: int = 0
    tubes_swapped: bool = False
    lanes: int = 0

    @property
    def outputs(self) -> dict[str, tuple[str, int, float, dict[str, float]]]:
        """Output -> servo, SERVOn_FUNCTION, throw [deg], and what part of aileron, elevator, rudder its deflection is."""
        aileron, elevator, rudder = self.throws
        rows = {"C1": ("aileron", 4, aileron, {"a": 1.0}), "C2": ("elevator", 19, elevator, {"e": 1.0})}
        if self.elevons:
            rows = {
                "C1": ("left", 77, aileron, {"e": 1.0, "a": -1.0}),
                "C2": ("right", 78, aileron, {"e": 1.0, "a": 1.0}),
            }
        if self.flaperons:
            rows |= {"C1": ("left", 24, aileron, {"a": -1.0}), "C5": ("right", 25, aileron, {"a": 1.0})}
        return rows | {"C4": ("rudder", 21, rudder, {"r": 1.0})}


WIRINGS = {
    "usual": Wiring(),
    "reversed": Wiring((14.0, 18.0, 30.0), ("C1", "C4")),
    "elevons": Wiring((26.0, 26.0, 25.0), ("C2",), elevons=True),
    "flaperons": Wiring((18.0, 25.0, 25.0), ("C5",), flaperons=True),
    "pitots": Wiring(pitot=1, lanes=2),
    "tubes": Wiring(tubes_swapped=True, lanes=3),
}
WIND = (3.2, -2.1)
PHASES = (0.013, 0.031, 0.002, 0.024, 0.037, 0.009, 0.018)
"""[s] by which a pilot moves off the clock of the log, turn by turn."""
ATTITUDE_ERROR = 0.004
"""[rad] of an EKF's attitude, which comes and goes."""
LAUNCH = 22.0
"""Time since boot [s] at which the log begins, in flight."""


class Airframe:
    """Rigid body with linear aerodynamics, quaternion attitude, first-order servos; in still-moving air."""

    def __init__(self, aeroplane: Aeroplane) -> None:
        self.a, self.d = aeroplane, aeroplane.true
        ixx, iyy, izz, ixz = aeroplane.inertia
        self.inertia = np.array([[ixx, 0, -ixz], [0, iyy, 0], [-ixz, 0, izz]])
        self.inverse = np.linalg.inv(self.inertia)
        alpha = (
            2 * aeroplane.mass * 9.80665 / (aeroplane.rho * aeroplane.speed**2 * aeroplane.area) - self.d["CL_0"]
        ) / self.d["CL_alpha"]
        self.x = np.array([aeroplane.speed * np.cos(alpha), 0, aeroplane.speed * np.sin(alpha), 0, 0, 0,
                           np.cos(alpha / 2), 0, np.sin(alpha / 2), 0, 0, 0, -120.0, 0, 0, 0])  # fmt: skip
        self.force = np.zeros(3)

    def rate(self, x: np.ndarray, command: np.ndarray, throttle: float) -> np.ndarray:
        a, d = self.a, self.d
        v, w, q = x[:3], x[3:6], x[6:10]
        de, da, dr = x[13:]
        speed = float(np.sqrt(v @ v))
        alpha, beta = np.arctan2(v[2], v[0]), np.arcsin(v[1] / speed)
        ph, qh, rh = w[0] * a.span / 2 / speed, w[1] * a.chord / 2 / speed, w[2] * a.span / 2 / speed
        lift = d["CL_0"] + d["CL_alpha"] * alpha + d["CL_q"] * qh + d["CL_de"] * de
        drag = d["CD_0"] + d["CD_k"] * lift**2
        side = d["CY_beta"] * beta + d["CY_p"] * ph + d["CY_r"] * rh + d["CY_dr"] * dr
        roll = d["Cl_beta"] * beta + d["Cl_p"] * ph + d["Cl_r"] * rh + d["Cl_da"] * da + d["Cl_dr"] * dr
        pitch = d["Cm_0"] + d["Cm_alpha"] * alpha + d["Cm_q"] * qh + d["Cm_de"] * de
        yaw = d["Cn_beta"] * beta + d["Cn_p"] * ph + d["Cn_r"] * rh + d["Cn_da"] * da + d["Cn_dr"] * dr
        c, s = np.cos(alpha), np.sin(alpha)
        bar = 0.5 * a.rho * speed**2 * a.area
        self.force = bar / a.mass * np.array([-drag * c + lift * s, side, -drag * s - lift * c])
        self.force[0] += throttle * 9.80665 / 0.7
        down = 9.80665 * np.array(
            [2 * (q[1] * q[3] - q[0] * q[2]), 2 * (q[2] * q[3] + q[0] * q[1]), 1 - 2 * (q[1] ** 2 + q[2] ** 2)]
        )
        moment = bar * np.array([roll * a.span, pitch * a.chord, yaw * a.span])
        h = self.inertia @ w
        wq = 0.5 * np.array([-q[1] * w[0] - q[2] * w[1] - q[3] * w[2], q[0] * w[0] + q[2] * w[2] - q[3] * w[1],
                             q[0] * w[1] - q[1] * w[2] + q[3] * w[0], q[0] * w[2] + q[1] * w[1] - q[2] * w[0]])  # fmt: skip
        return np.concatenate([self.force + down - cross(w, v), self.inverse @ (moment - cross(w, h)), wq,
                               turned(q, v), (command - x[13:]) / a.lag])  # fmt: skip

    def step(self, command: np.ndarray, throttle: float) -> None:
        first = self.rate(self.x, command, throttle)
        self.x = self.x + STEP * self.rate(self.x + 0.5 * STEP * first, command, throttle)
        self.x[6:10] /= np.sqrt(self.x[6:10] @ self.x[6:10])


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def turned(q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Body to earth."""
    return v + 2 * q[0] * cross(q[1:], v) + 2 * cross(q[1:], cross(q[1:], v))


def angles(q: np.ndarray) -> tuple[float, float, float]:
    phi = np.arctan2(2 * (q[0] * q[1] + q[2] * q[3]), 1 - 2 * (q[1] ** 2 + q[2] ** 2))
    theta = np.arcsin(2 * (q[0] * q[2] - q[3] * q[1]))
    return float(phi), float(theta), float(np.arctan2(2 * (q[0] * q[3] + q[1] * q[2]), 1 - 2 * (q[2] ** 2 + q[3] ** 2)))


def doublets(t: float, turn: int, size: float) -> np.ndarray:
    """Pulses [us] beside 1500 of aileron, elevator, rudder, t [s] after MANUAL began; sizes differ from turn to turn."""
    gain = size * (0.75 + 0.25 * (turn % 3)) * (1 if turn % 2 else -1)
    plans = ((2, 0.6, 0.5, 160.0), (0, 3.4, 0.4, 120.0), (1, 5.5, 0.4, 88.0))
    out = np.zeros(3)
    for axis, start, width, height in plans:
        if start <= t < start + width:
            out[axis] = height * gain
        elif start + width <= t < start + 2 * width:
            out[axis] = -height * gain
    return out


def flown(aeroplane: Aeroplane, legs: int = 12, size: float = 1.0) -> dict[str, np.ndarray]:
    """The truth at every step, pulses and the mode; time from 0."""
    body = Airframe(aeroplane)
    scale = np.array([22.0, 22.0, 25.0]) / 500 * DEG  # rad/us, negative: more pulse, less deflection
    leg, manual = 9.0, 7.6
    rows, integral, pulse, bank, trimmed, throttle = [], 0.0, np.zeros(3), 0.0, 0.0, 0.2
    for i in range(round((legs * (leg + manual) + 4.0) / STEP)):
        t = i * STEP
        turn, into = divmod(t, leg + manual)
        by_hand = into >= leg
        x = body.x
        phi, theta, psi = angles(x[6:10])
        if i % LOOP == 0:
            speed = float(np.sqrt(x[:3] @ x[:3]))
            throttle = float(np.clip(0.1 + 0.08 * (aeroplane.speed - speed), 0.0, 0.7)) if not by_hand else throttle
            if by_hand:
                pulse = np.round(
                    np.array([0.0, trimmed, 0.0])
                    + doublets(into - leg - PHASES[int(turn) % len(PHASES)], int(turn), size)
                )
            else:
                bank = (0.5 if into < leg - 3.0 else 0.0) * (1 if int(turn) % 4 < 2 else -1)
                wanted = 0.05 + 0.02 * float(np.clip(120.0 + x[12], -8, 8))
                integral = float(np.clip(integral + 0.01 * (wanted - theta), -0.5, 0.5))
                roll, pitch = 0.5 * (bank - phi) - 0.08 * x[3], 0.9 * (wanted - theta) - 0.12 * x[4] + 1.2 * integral
                deflection = np.array([-roll, -pitch, 0.0]) * (17.0 / aeroplane.speed)
                pulse = np.round(np.clip(-deflection / scale, -400, 400))
                trimmed = 0.98 * trimmed + 0.02 * pulse[1] if into > 1.0 else trimmed
        command = -pulse * scale
        body.step(np.array([command[1], command[0], command[2]]), throttle)
        earth = turned(x[6:10], x[:3])
        rows.append(
            [
                t,
                *x[:6],
                phi,
                theta,
                psi,
                *body.force,
                earth[0] + WIND[0],
                earth[1] + WIND[1],
                earth[2],
                -x[12],
                *pulse,
                float(by_hand),
            ]
        )
    names = "time u v w p q r phi theta psi ax ay az vn ve vd altitude C1 C2 C4 manual".split()
    return dict(zip(names, np.array(rows).T, strict=True))


def slow_noise(rng: np.random.Generator, count: int, seconds: float = 20.0) -> np.ndarray:
    """Of unit spread, that lasts so long."""
    keep = np.exp(-STEP / seconds)
    white = rng.standard_normal(count) * np.sqrt(1 - keep**2)
    white[0] = rng.standard_normal()
    return np.asarray(lfilter([1.0], [1.0, -keep], white))


def smoothed(values: np.ndarray, hz: float) -> np.ndarray:
    """The second-order low-pass of ArduPilot's sensors, running since before the log."""
    sos = butter(2, hz, fs=1 / STEP, output="sos")
    return np.asarray(sosfilt(sos, values - values[0])) + values[0]


def log(
    aeroplane: Aeroplane,
    seed: int = 1,
    hz: float = 25.0,
    old: bool = False,
    wiring: Wiring = WIRINGS["usual"],
    **options: float,
) -> bytes:
    """The dataflash log of a flight. hz: of surfaces and attitude; old: as of `tables`."""
    rng = np.random.default_rng(seed)
    f = flown(aeroplane, **options)  # type: ignore[arg-type]
    return dataflash(tables(f, aeroplane, rng, hz, old, wiring))


def pulses(f: Mapping[str, np.ndarray], wiring: Wiring) -> dict[str, np.ndarray]:
    """What each output stands at [us] for the deflections that were commanded."""
    angles = {n: -f[c] * throw / 500 for n, c, throw in (("a", "C1", 22.0), ("e", "C2", 22.0), ("r", "C4", 25.0))}
    out: dict[str, np.ndarray] = {}
    for output, (_, _, throw, shares) in wiring.outputs.items():
        angle = np.sum([share * angles[n] for n, share in shares.items()], axis=0)
        out[output] = np.asarray(np.round(1500 - angle / throw * 500 * (-1 if output in wiring.reversed else 1)))
    return out


def tables(
    f: Mapping[str, np.ndarray],
    aeroplane: Aeroplane,
    rng: np.random.Generator,
    hz: float,
    old: bool = False,
    wiring: Wiring = WIRINGS["usual"],
) -> dict[str, Table]:
    """Messages of a flight. old: of firmware whose ARSP is smoothed as CTUN is."""
    time, n = f["time"], f["time"].size
    every = round(1 / hz / STEP)

    def noisy(values: np.ndarray, pick: slice, sigma: float) -> np.ndarray:
        return values[pick] + sigma * rng.standard_normal(values[pick].size)

    imu, med, ten, five = slice(0, n, 4), slice(0, n, every), slice(0, n, 40), slice(40, n, 80)
    out: dict[str, Table] = {}
    parameters: dict[str, float] = {
        **{"ARSPD_RATIO": 2.0, "ARSPD_TYPE": 2, "INS_GYRO_FILTER": 40, "INS_ACCEL_FILTER": 20, "SCHED_LOOP_RATE": 100},
        **{"ARSPD_TUBE_ORDR": wiring.tubes_swapped, "ARSPD_PRIMARY": wiring.pitot},
    }
    for output, (_, function, _, _) in {**wiring.outputs, "C3": ("", 70, 0.0, {})}.items():
        stated = {"MIN": 1100, "MAX": 1900, "TRIM": 1500, "FUNCTION": function, "REVERSED": output in wiring.reversed}
        parameters |= {f"SERVO{output[1:]}_{ending}": value for ending, value in stated.items()}
    labels = np.array([name.encode() for name in parameters], object)
    stamp = np.full(len(parameters), LAUNCH)
    out["PARM"] = ("Nf", "Name,Value", stamp, [labels, np.array(list(parameters.values()), float)])
    change = np.flatnonzero(np.diff(f["manual"], prepend=-1.0))
    mode = np.where(f["manual"][change] > 0, 0.0, 5.0)
    out["MODE"] = ("BBB", "Mode,ModeNum,Rsn", time[change] + LAUNCH, [mode, mode, 0 * mode + 2])
    rates = [noisy(smoothed(f[c], 40.0), imu, 0.003) for c in "pqr"]
    forces = [noisy(smoothed(f[c], 20.0), imu, 0.05) for c in ("ax", "ay", "az")]
    out["IMU"] = ("Bffffff", "I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ", time[imu] + LAUNCH, [0 * time[imu], *rates, *forces])
    wander = [ATTITUDE_ERROR * slow_noise(rng, n) for _ in range(3)]
    attitude = [np.unwrap(f[c]) + w for c, w in zip(("phi", "theta", "psi"), wander, strict=True)]
    degrees = [a[med] / DEG for a in attitude]
    out["ATT"] = ("fff", "Roll,Pitch,Yaw", time[med] + LAUNCH, [degrees[0], degrees[1], degrees[2] % 360])
    speed = np.sqrt(f["u"] ** 2 + f["v"] ** 2 + f["w"] ** 2)
    pressure = aeroplane.rho / 1.225 * speed**2 / 2.0  # as the ratio of 2 makes of the airspeed, not Bernoulli's
    seen = noisy(pressure, ten, 1.5)
    raw = np.sqrt(np.maximum(seen, 0) * 2.0)
    late = raw.copy()
    for i in range(1, late.size):
        late[i] = 0.7 * late[i - 1] + 0.3 * raw[i]
    shown = late if old else raw
    none = 0 * time[ten]
    signed = -seen if wiring.tubes_swapped else seen
    fields = [none + wiring.pitot, shown, signed, none, none + 1, none + 1, none + wiring.pitot]
    stamps = time[ten] + LAUNCH
    if wiring.pitot:  # the first reads low
        low = [none, shown * np.sqrt(0.8), 0.8 * signed, none, none, none + 1, none + wiring.pitot]
        fields = [np.stack(pair, axis=1).ravel() for pair in zip(low, fields, strict=True)]
        stamps = np.repeat(stamps, 2)
    out["ARSP"] = ("BfffBBB", "I,Airspeed,DiffPress,Temp,U,H,Pri", stamps, fields)
    if wiring.lanes:
        out |= _lanes(f, ten, wiring.lanes, rng)
    ratio = np.sqrt(1.225 / aeroplane.rho)
    eas = late[np.searchsorted(time[ten], time[med], side="right") - 1]
    out["CTUN"] = ("fBf", "As,AsT,E2T", time[med] + LAUNCH, [eas, 0 * eas + 1, 0 * eas + ratio])
    static = aeroplane.rho * 287.05 * 290.0
    out["BARO"] = (
        "fff",
        "Alt,Press,Temp",
        time[ten] + LAUNCH,
        [noisy(f["altitude"], ten, 0.1), noisy(static - 11 * (f["altitude"] - 120), ten, 2.0), none + 31.0],
    )
    before = slice(0, n - 40, 80)  # a fix is a tenth of a second old when it is logged
    north, east, down = (noisy(f[c], before, 0.05) for c in ("vn", "ve", "vd"))
    size = min(north.size, time[five].size)
    north, east, down = north[:size], east[:size], down[:size]
    fix = [0 * north + 3, np.hypot(north, east), np.arctan2(east, north) / DEG % 360, down]
    out["GPS"] = ("Bfff", "Status,Spd,GCrs,VZ", time[five][:size] + LAUNCH, fix)
    behind = np.maximum(np.arange(0, n, every) - 3, 0)  # what the loop before has put out
    servos = {"C3": 1300 + 0 * time, "C5": 0 * time, **pulses(f, wiring)}
    order = sorted(servos)
    out["RCOU"] = ("H" * len(order), ",".join(order), time[med] + LAUNCH, [servos[c][behind] for c in order])
    out["AOA"] = ("ff", "AOA,SSA", time[ten] + LAUNCH, [none + 3, np.arcsin(f["v"] / speed)[ten] / DEG + 2.0])
    return out


def _lanes(f: Mapping[str, np.ndarray], rows: slice, count: int, rng: np.random.Generator) -> dict[str, Table]:
    """Attitude, velocity and wind by each lane of the EKF, and of the AHRS behind it, each with errors of its own."""
    time = np.repeat(f["time"][rows] + LAUNCH, count)
    core = np.tile(np.arange(count), f["time"][rows].size)
    wrong = 2.0 * rng.standard_normal((6, count))[:, core]
    angles = [np.repeat(f[c][rows] / DEG, count) + w for c, w in zip(("phi", "theta", "psi"), wrong[:3], strict=True)]
    angles[2] %= 360
    speeds = [np.repeat(f[c][rows], count) + w for c, w in zip(("vn", "ve", "vd"), wrong[3:], strict=True)]
    wind = [0 * time + w + v for w, v in zip(WIND, wrong[:2], strict=True)]
    return {
        "XKF1": ("Bffffff", "C,Roll,Pitch,Yaw,VN,VE,VD", time, [core, *angles, *speeds]),
        "XKF2": ("Bff", "C,VWN,VWE", time, [core, *wind]),
        "AHR2": ("fff", "Roll,Pitch,Yaw", time[::count], [a[::count] for a in angles]),
    }


def written(
    name: str, folder: Path, seed: int, hz: float, old: bool = False, wiring: Wiring = WIRINGS["usual"]
) -> tuple[Path, Path, Path]:
    """Log, map and aircraft file."""
    aeroplane = AEROPLANES[name]
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"{name}.bin").write_bytes(log(aeroplane, seed, hz, old, wiring))
    (folder / f"{name}_map.toml").write_text(surfaces(aeroplane.lag, wiring))
    ixx, iyy, izz, ixz = aeroplane.inertia
    text = f'name = "{name}"\n[geometry]\nspan = {aeroplane.span}\narea = {aeroplane.area}\nchord = {aeroplane.chord}\n[mass]\n'
    text += f"mass = {aeroplane.mass}\nIxx = {ixx}\nIyy = {iyy}\nIzz = {izz}\nIxz = {ixz}\n[sensors]\n"
    text += "".join(f"{s} = [0.0, 0.0, 0.0]\n" for s in ("imu", "alpha_vane", "beta_vane", "pitot", "gps"))
    (folder / f"{name}.toml").write_text(text)
    return folder / f"{name}.bin", folder / f"{name}_map.toml", folder / f"{name}.toml"


def surfaces(lag: float, wiring: Wiring = WIRINGS["usual"]) -> str:
    """A map of the servos: each deflection at either end, and what the surfaces are mixed of."""
    rows: list[str] = []
    mixed: dict[str, list[tuple[str, float]]] = {"e": [], "a": [], "r": []}
    for output, (servo, _, throw, shares) in wiring.outputs.items():
        end = -throw if output in wiring.reversed else throw
        rows += [f"[servos.{servo}]", f'column = "RCOU.{output}"', "trim = 1500"]
        rows += [f"travel = [[1000, {end}], [2000, {-end}]]", 'unit = "deg"', f"lag = {lag}"]
        for surface, share in shares.items():
            mixed[surface].append((servo, share))
    columns = []
    for surface, parts in mixed.items():
        terms = ", ".join(f'{{ column = "servo.{n}", factor = {share / len(parts):g} }}' for n, share in parts)
        columns.append(f"delta_{surface} = {{ terms = [{terms}], hold = true }}")
    return "\n".join(["format = 1", *rows, "[columns]", *columns, ""])


def judged(answer: Mapping[str, Any], name: str) -> str:
    """What is recommended, and a line for each main derivative: truth, how far off in bounds and per cent, bound in per cent."""
    estimate = answer["estimate"]
    if not estimate:
        return f"{name}: {answer['verdict']}"
    flight = estimate["flights"][0]
    method = flight["recommended"]["method"]
    found, true = flight["methods"]["ml" if method == "none" else method]["parameters"], AEROPLANES[name].true
    lines = [f"{name}: {estimate['model']}, recommended {method}: {flight['recommended']['why'][:200]}"]
    for n in MAIN:
        value, std = found[n]["estimate"], found[n]["std_coloured"]
        away = f"{(value - true[n]) / std:+.1f} bounds, {value / true[n] - 1:+.1%}; bound {abs(std / true[n]):.1%}"
        lines.append(
            f"   {n:8} {value:+.4f} for {true[n]:+.4f}: {away}{'' if found[n]['identifiable'] else ', untold'}"
        )
    return "\n".join(lines)


def main() -> None:
    import sideslip as ss

    parser = argparse.ArgumentParser()
    parser.add_argument("names", nargs="*", default=list(AEROPLANES))
    parser.add_argument("--hz", type=float, default=25.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--old", action="store_true")
    parser.add_argument("--wiring", choices=WIRINGS, default="usual")
    parser.add_argument("--out", type=Path, default=Path("arduplane_logs"))
    words = parser.parse_args()
    for name in words.names or list(AEROPLANES):
        folder = words.out / f"{name}_{words.hz:g}_{words.seed}{'_old' * words.old}_{words.wiring}"
        path, mapping, aircraft = written(name, folder, words.seed, words.hz, words.old, WIRINGS[words.wiring])
        found = ss.analyse(path, mapping=mapping, aircraft=str(aircraft), output=folder / "analysis")
        print(judged(json.loads(json.dumps(found.to_json())), name), flush=True)


if __name__ == "__main__":
    main()
