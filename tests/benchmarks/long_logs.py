"""Long logs of a turning flight, made fast: one record of a fifth of a second of an autopilot's messages, again and again."""

import struct
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

PERIOD = 0.2
"""[s] of one record."""
Message = tuple[str, int, Sequence[tuple[str, str]]]
"""Name, how many in a record, fields with their numpy types."""
ARDUPILOT: tuple[Message, ...] = (
    ("IMU", 40, [("I", "u1"), *((f"{kind}{axis}", "<f4") for kind in ("Gyr", "Acc") for axis in "XYZ")]),
    ("ATT", 5, [("Roll", "<f4"), ("Pitch", "<f4"), ("Yaw", "<f4")]),
    ("CTUN", 5, [("As", "<f4"), ("AsT", "u1"), ("E2T", "<f4")]),
    ("RCOU", 5, [(f"C{i}", "<u2") for i in range(1, 9)]),
    ("ARSP", 2, [("I", "u1"), ("Airspeed", "<f4"), ("DiffPress", "<f4"), ("U", "u1"), ("H", "u1")]),
    ("BARO", 2, [("Alt", "<f4"), ("Press", "<f4"), ("Temp", "<f4")]),
    ("GPS", 1, [("Status", "u1"), ("Spd", "<f4"), ("GCrs", "<f4"), ("VZ", "<f4")]),
)
PX4: tuple[Message, ...] = (
    ("sensor_combined", 40, [*((f"g{i}", "<f4") for i in range(3)), *((f"a{i}", "<f4") for i in range(3))]),
    ("vehicle_attitude", 20, [(f"q{i}", "<f4") for i in range(4)]),
    ("actuator_outputs", 10, [(f"o{i}", "<f4") for i in range(8)]),
    ("airspeed_validated", 2, [("true_airspeed_m_s", "<f4"), ("airspeed_source", "u1")]),
    ("vehicle_air_data", 4, [("baro_pressure_pa", "<f4"), ("rho", "<f4")]),
    ("vehicle_gps_position", 1, [("vel_n_m_s", "<f4"), ("vel_e_m_s", "<f4"), ("vel_d_m_s", "<f4"), ("fix_type", "u1")]),
)
TOPICS = {
    "sensor_combined": "float[3] gyro_rad;float[3] accelerometer_m_s2;",
    "vehicle_attitude": "float[4] q;",
    "actuator_outputs": "float[8] output;",
    "airspeed_validated": "float true_airspeed_m_s;uint8_t airspeed_source;",
    "vehicle_air_data": "float baro_pressure_pa;float rho;",
    "vehicle_gps_position": "float vel_n_m_s;float vel_e_m_s;float vel_d_m_s;uint8_t fix_type;",
}


def motion(t: np.ndarray, rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Level S-turns at 20 m/s in wind, under the names that the fields have in either log, with noise."""
    phi, rate = 0.4 * np.sin(0.5 * t), 0.2 * np.cos(0.5 * t)
    turn = 9.80665 * np.tan(phi) / 20.0
    psi = 9.80665 / 20.0 * 1.6 * np.sin(0.25 * t) ** 2  # integral of the turn, the tangent for its angle
    north, east = 20.0 * np.cos(psi) + 3.0, 20.0 * np.sin(psi) - 2.0
    body = [rate, turn * np.sin(phi), turn * np.cos(phi), 0 * t, 0 * t, -9.80665 / np.cos(phi)]
    seen = [b + s * rng.standard_normal(t.size) for b, s in zip(body, [0.003] * 3 + [0.05] * 3, strict=True)]
    names = {n: seen[i] for i, n in enumerate(("GyrX", "GyrY", "GyrZ", "AccX", "AccY", "AccZ"))}
    names |= {f"{k}{i}": seen[i + 3 * (k == "a")] for k in "ga" for i in range(3)}
    cf, sf, cp, sp = np.cos(phi / 2), np.sin(phi / 2), np.cos(psi / 2), np.sin(psi / 2)
    names |= {"q0": cf * cp, "q1": sf * cp, "q2": sf * sp, "q3": cf * sp}
    pulse = np.round(1500 + 80 * np.cos(0.5 * t))
    names |= {f"C{i}": pulse if i == 1 else 1500 + 0 * t for i in range(1, 9)}
    names |= {f"o{i}": pulse if i == 0 else 1500 + 0 * t for i in range(8)}
    speed = 20.0 + 0.2 * rng.standard_normal(t.size)
    static = 95_700.0 + 8 * rng.standard_normal(t.size)
    eas = speed * np.sqrt(1.15 / 1.225)
    return names | {
        "I": 0 * t,
        **dict.fromkeys(("U", "H", "AsT", "airspeed_source"), 0 * t + 1),
        **dict.fromkeys(("Status", "fix_type"), 0 * t + 3),
        "Roll": np.degrees(phi), "Pitch": 0 * t, "Yaw": np.degrees(psi) % 360, "As": eas, "E2T": 0 * t + np.sqrt(1.225 / 1.15),
        "Airspeed": eas, "DiffPress": 0.5 * 1.225 * eas**2, "Alt": 0 * t + 80.0, "Press": static,
        "Temp": 0 * t + 17.0, "Spd": np.hypot(north, east), "GCrs": np.degrees(np.arctan2(east, north)) % 360, "VZ": 0 * t,
        "true_airspeed_m_s": speed, "baro_pressure_pa": static, "rho": 0 * t + 1.15,
        "vel_n_m_s": north, "vel_e_m_s": east, "vel_d_m_s": 0 * t,
    }  # fmt: skip


def records(messages: Sequence[Message], head: Mapping[str, list[tuple[str, str, float]]], count: int) -> bytes:
    """The messages of `count` records. head: of each kind of message, the fields before its own, with their values; the one
    named `time` has the time [us]."""
    kinds = {n: np.dtype([*((h, t) for h, t, _ in head[n]), *fields]) for n, _, fields in messages}
    frame = np.dtype([(f"{n}_{i}", kinds[n]) for n, each, _ in messages for i in range(each)])
    out, rng = np.zeros(count, frame), np.random.default_rng(7)
    for name, each, fields in messages:
        for i in range(each):
            time = 30.0 + PERIOD * (np.arange(count) + i / each)
            values, part = motion(time, rng), out[f"{name}_{i}"]
            for field, _, value in head[name]:
                part[field] = np.round(time * 1e6) if field == "time" else value
            for field, _ in fields:
                part[field] = values[field]
    return out.tobytes()


def _letters(kind: str) -> str:
    return {"u1": "B", "<f4": "f", "<u2": "H"}[kind]


def dataflash(path: Path, seconds: float) -> Path:
    """An ArduPilot log of so many seconds of flight, 9.5 kB each."""
    head: dict[str, list[tuple[str, str, float]]] = {}
    text = [_fmt(128, 89, "FMT", "BBnNZ", "Type,Length,Name,Format,Columns")]
    for number, (name, _, fields) in enumerate(ARDUPILOT, start=150):
        head[name] = [("a", "u1", 0xA3), ("b", "u1", 0x95), ("id", "u1", number), ("time", "<u8", 0.0)]
        size = 11 + sum(np.dtype(t).itemsize for _, t in fields)
        layout = "Q" + "".join(_letters(t) for _, t in fields)
        text.append(_fmt(number, size, name, layout, ",".join(["TimeUS", *(f for f, _ in fields)])))
    path.write_bytes(b"".join(text) + records(ARDUPILOT, head, round(seconds / PERIOD)))
    return path


def _fmt(kind: int, size: int, name: str, letters: str, labels: str) -> bytes:
    return struct.pack("<BBBBB4s16s64s", 0xA3, 0x95, 128, kind, size, name.encode(), letters.encode(), labels.encode())


def ulog(path: Path, seconds: float) -> Path:
    """A PX4 log of so many seconds of flight, 13 kB each."""
    head = {}
    start = [b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 1_000_000), _message(b"B", bytes(40))]
    start += [_message(b"F", f"{name}:uint64_t timestamp;{fields}".encode()) for name, fields in TOPICS.items()]
    for k, (name, _, fields) in enumerate(PX4):
        size = 10 + sum(np.dtype(t).itemsize for _, t in fields)
        head[name] = [("size", "<u2", size), ("kind", "u1", ord("D")), ("id", "<u2", k), ("time", "<u8", 0.0)]
        start.append(_message(b"A", struct.pack("<BH", 0, k) + name.encode()))
    path.write_bytes(b"".join(start) + records(PX4, head, round(seconds / PERIOD)))
    return path


def _message(kind: bytes, payload: bytes) -> bytes:
    return struct.pack("<H", len(payload)) + kind + payload
