"""Logs of ArduPilot and PX4 aircraft without vanes, made of a simulated flight as their public definitions say.

IMU at 50 Hz, attitude at 25, pitot at 10, GNSS at 5, each sampled at its own times; servo outputs as pulses of two elevons and a
rudder.
"""

import struct
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tests.support.attitude import quaternion as quaternion_of

Array = NDArray[np.float64]

SERVOS = {
    "left": ((1100.0, -24.0), (1520.0, 0.0), (1900.0, 22.0)),
    "right": ((1100.0, 22.0), (1480.0, 0.0), (1900.0, -24.0)),
    "rudder": ((1100.0, -25.0), (1500.0, 0.0), (1900.0, 25.0)),
}
"""Pulse [us] and deflection [deg] at either end and at trim, as docs/import.md has measured them."""

BOOT = 12.0
"""Time since boot [s] at which the flight begins."""


@dataclass(frozen=True)
class Samples:
    """One kind of message: time since boot (n,) [s] and its fields (n,)."""

    time: Array
    fields: Mapping[str, Array] = field(default_factory=dict)


def pulses(truth: Mapping[str, Array]) -> dict[str, Array]:
    """Servo pulses [us] that put the surfaces where they are."""
    angles = {"left": truth["sensed_arm_left"], "right": truth["sensed_arm_right"], "rudder": truth["sensed_arm_r"]}
    out = {}
    for name, angle in angles.items():
        pulse, deflection = np.array(sorted(SERVOS[name], key=lambda end: end[1])).T
        assert np.abs(np.degrees(angle)).max() < 22.0  # within the travel of each
        out[name] = np.interp(np.degrees(angle), deflection, pulse)
    return out


def messages(truth: Mapping[str, Array], rng: np.random.Generator) -> dict[str, Samples]:
    """What the sensors of an autopilot show of a flight simulated at 50 Hz."""
    time = truth["time"]

    def seen(every: int, late: float, noise: Mapping[str, float]) -> Samples:
        at = time[::every]
        read = {n: np.interp(at, time, np.unwrap(truth[n]) if n == "psi" else truth[n]) for n in noise}
        return Samples(at + BOOT + late, {n: read[n] + s * rng.standard_normal(at.size) for n, s in noise.items()})

    rate = np.radians(0.3)
    imu = {"ax": 0.05, "ay": 0.05, "az": 0.08, "p": rate, "q": rate, "r": rate}
    servo = pulses(truth)
    return {
        "imu": seen(1, 0.0, imu),
        "attitude": seen(2, 0.003, dict.fromkeys(("phi", "theta", "psi"), np.radians(0.3))),
        "pitot": seen(5, 0.002, {"V": 0.15, "p_dynamic": 1.0}),
        "baro": seen(5, 0.002, {"altitude": 0.3, "p_static": 10.0, "rho": 0.0}),
        "gnss": seen(10, 0.004, {"vn": 0.15, "ve": 0.15, "vd": 0.2}),
        "servo": Samples(time + BOOT, {n: np.round(v) for n, v in servo.items()}),
    }


def dataflash(truth: Mapping[str, Array], rng: np.random.Generator) -> bytes:
    """ArduPilot dataflash: FMT messages, then data with head A3 95 and message id (developer guide, 'Log messages')."""
    m = messages(truth, rng)
    g = m["gnss"].fields
    speed, course = np.hypot(g["vn"], g["ve"]), np.degrees(np.arctan2(g["ve"], g["vn"])) % 360.0
    s = m["servo"].fields
    degrees = [np.degrees(m["attitude"].fields[n]) for n in ("phi", "theta")]
    yaw = np.degrees(m["attitude"].fields["psi"]) % 360.0
    imu, pitot, baro = m["imu"].fields, m["pitot"].fields, m["baro"].fields
    none = np.zeros_like(speed)
    inertial = [imu[n] for n in ("p", "q", "r", "ax", "ay", "az")]
    fix = [none + 3, none, none, none, speed, course, g["vd"]]
    kinds = {
        "IMU": (130, "ffffff", "GyrX,GyrY,GyrZ,AccX,AccY,AccZ", m["imu"].time, inertial),
        "ATT": (131, "fff", "Roll,Pitch,Yaw", m["attitude"].time, [*degrees, yaw]),
        "ARSP": (132, "ff", "Airspeed,DiffPress", m["pitot"].time, [pitot["V"], pitot["p_dynamic"]]),
        "BARO": (133, "ff", "Alt,Press", m["baro"].time, [baro["altitude"], baro["p_static"]]),
        "GPS": (134, "BLLefff", "Status,Lat,Lng,Alt,Spd,GCrs,VZ", m["gnss"].time, fix),
        "RCOU": (135, "HHHH", "C1,C2,C3,C4", m["servo"].time, [s["left"], s["right"], s["left"] * 0, s["rudder"]]),
    }
    code = {"Q": "Q", "B": "B", "f": "f", "L": "i", "e": "i", "H": "H"}
    out = [_fmt(128, 89, "FMT", "BBnNZ", "Type,Length,Name,Format,Columns")]
    rows: list[tuple[float, bytes]] = []
    for name, (kind, letters, labels, time, values) in kinds.items():
        layout = struct.Struct("<BBB" + "".join(code[c] for c in "Q" + letters))
        out.append(_fmt(kind, layout.size, name, "Q" + letters, "TimeUS," + labels))
        for t, *row in zip(time.tolist(), *(v.tolist() for v in values), strict=True):
            cast = [v if c == "f" else round(v) for c, v in zip(letters, row, strict=True)]
            rows.append((t, layout.pack(0xA3, 0x95, kind, round(t * 1e6), *cast)))
    return b"".join([*out, *(data for _, data in sorted(rows, key=lambda r: r[0]))])


def _fmt(kind: int, length: int, name: str, layout: str, labels: str) -> bytes:
    return struct.pack("<BBBBB4s16s64s", 0xA3, 0x95, 128, kind, length, name.encode(), layout.encode(), labels.encode())


def ulog(truth: Mapping[str, Array], rng: np.random.Generator) -> bytes:
    """PX4 ULog: header, flags, formats, subscriptions, data (PX4 user guide, 'ULog File Format')."""
    m = messages(truth, rng)
    quaternion = quaternion_of(*(m["attitude"].fields[n] for n in ("phi", "theta", "psi")))
    imu, pitot, baro, s = (m[n].fields for n in ("imu", "pitot", "baro", "servo"))
    inertial = [imu[n] for n in ("p", "q", "r", "ax", "ay", "az")]
    fix = [m["gnss"].fields[n] for n in ("vn", "ve", "vd")]
    topics = {
        "sensor_combined": ("float[3] gyro_rad;float[3] accelerometer_m_s2;", m["imu"].time, inertial),
        "vehicle_attitude": ("float[4] q;", m["attitude"].time, quaternion),
        "airspeed_validated": ("float true_airspeed_m_s;", m["pitot"].time, [pitot["V"]]),
        "vehicle_air_data": ("float baro_alt_meter;float rho;", m["baro"].time, [baro["altitude"], baro["rho"]]),
        "vehicle_gps_position": ("float vel_n_m_s;float vel_e_m_s;float vel_d_m_s;", m["gnss"].time, fix),
        "actuator_outputs": ("float[4] output;", m["servo"].time, [s["left"], s["right"], s["left"] * 0, s["rudder"]]),
    }
    out = [b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 1_000_000), _message(b"B", bytes(40))]
    out += [_message(b"F", f"{name}:uint64_t timestamp;{fields}".encode()) for name, (fields, _, _) in topics.items()]
    out += [_message(b"A", struct.pack("<BH", 0, i) + name.encode()) for i, name in enumerate(topics)]
    rows: list[tuple[float, bytes]] = []
    for i, (_, time, values) in enumerate(topics.values()):
        for t, *row in zip(time.tolist(), *(v.tolist() for v in values), strict=True):
            rows.append((t, _message(b"D", struct.pack(f"<HQ{len(row)}f", i, round(t * 1e6), *row))))
    return b"".join([*out, *(data for _, data in sorted(rows, key=lambda r: r[0]))])


def _message(kind: bytes, payload: bytes) -> bytes:
    return struct.pack("<H", len(payload)) + kind + payload
