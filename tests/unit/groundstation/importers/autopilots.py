"""Logs of one turning flight as ArduPilot, PX4 and MAVLink ground stations write them, with what they may say wrongly as options.

Written after their public definitions (ArduPilot "Log messages", PX4 "ULog File Format", MAVLink common.xml), apart from the
readers under test.
"""

import struct
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from tests.support.attitude import quaternion as quaternion_of
from tests.unit.groundstation.turning import Columns, turning_flight

Table = tuple[str, str, np.ndarray, list[np.ndarray]]
"""Letters, labels, time [s], fields."""
BOOT = 31.0
GPS_FIELDS = "float vel_n_m_s;float vel_e_m_s;float vel_d_m_s;uint8_t fix_type;"
DEG = 180.0 / np.pi
_CODE = {"Q": "Q", "I": "I", "B": "B", "f": "f", "H": "H", "L": "i", "N": "16s"}


def flight(rho: float = 1.104, seed: int = 5, seconds: float = 50.0) -> Columns:
    """The turning flight in air of another density, at 25 Hz."""
    f = turning_flight(seed, seconds=seconds)
    f["p_dynamic"] = f["p_dynamic"] * rho / 1.104
    f["p_static"] = f["p_static"] * rho / 1.104
    f["rho"] = np.full_like(f["V"], rho)
    f["eas"] = f["V"] * np.sqrt(rho / 1.225)
    return f


def ardupilot(
    f: Columns,
    *,
    ratio: float = 1.633,
    pitots: tuple[float, float, int] | None = None,
    airspeed_type: int | None = 1,
    e2t: bool = True,
    aoa: bool = False,
    fix_lost: tuple[float, float] = (0.0, 0.0),
    health: tuple[int, int] = (1, 1),
    parameters: Sequence[tuple[str, float]] = (),
) -> dict[str, Table]:
    """Messages of a Plane. pitots: factor on the pressure of each of two, and which is primary (-1: the log does not say)."""
    t = f["time"] + BOOT
    out: dict[str, Table] = {}
    if parameters:
        names, values = zip(*parameters, strict=True)
        labels = np.array([n.encode() for n in names], object)
        out["PARM"] = ("Nf", "Name,Value", np.full(len(names), BOOT), [labels, np.array(values)])
    out["IMU"] = (
        "Bffffff",
        "I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ",
        t,
        [t * 0, *(f[c] for c in ("p", "q", "r", "ax", "ay", "az"))],
    )
    out["ATT"] = ("fff", "Roll,Pitch,Yaw", t, [f["phi"] * DEG, f["theta"] * DEG, f["psi"] * DEG % 360])
    pressure = f["eas"] ** 2 / ratio
    slow = slice(None, None, 3)
    if pitots is None:
        fields = [t * 0, f["eas"], pressure, t * 0 + 8.0, t * 0 + 1, t * 0 + 1, t * 0]
        out["ARSP"] = ("BfffBBB", "I,Airspeed,DiffPress,Temp,U,H,Pri", t[slow], [x[slow] for x in fields])
    else:
        first, second, primary = pitots
        which = np.tile([0, 1], t[slow].size)
        twice = np.repeat(pressure[slow], 2) * np.where(which == 0, first, second)
        alive = np.where(which == 0, health[0], health[1])
        fields = [which, np.sqrt(twice * ratio), twice, which * 0 + 8.0, which * 0 + 1, alive]
        labels_of, letters = "I,Airspeed,DiffPress,Temp,U,H", "BfffBB"
        if primary >= 0:
            fields, labels_of, letters = [*fields, which * 0 + primary], f"{labels_of},Pri", f"{letters}B"
        out["ARSP"] = (letters, labels_of, np.repeat(t[slow], 2), fields)
    out["BARO"] = ("fff", "Alt,Press,Temp", t[slow], [t[slow] * 0 + 55.0, f["p_static"][slow], t[slow] * 0 + 47.0])
    control = [("As", f["eas"])] + ([("E2T", np.sqrt(1.225 / f["rho"]))] if e2t else [])
    if airspeed_type is not None:
        control.append(("AsT", t * 0 + airspeed_type))
    letters = "".join("B" if n == "AsT" else "f" for n, _ in control)
    out["CTUN"] = (letters, ",".join(n for n, _ in control), t[slow] + 0.001, [x[slow] for _, x in control])
    g = slice(None, None, 5)
    lost = (f["time"][g] >= fix_lost[0]) & (f["time"][g] < fix_lost[1])
    speed, course = np.hypot(f["vn"], f["ve"])[g], np.arctan2(f["ve"], f["vn"])[g] * DEG % 360
    fields = [
        t[g] * 0,
        np.where(lost, 1, 3),
        np.where(lost, 0, speed),
        np.where(lost, 0, course),
        np.where(lost, 0, f["vd"][g]),
    ]
    out["GPS"] = ("BBfff", "I,Status,Spd,GCrs,VZ", t[g] + 0.004, fields)
    out["RCOU"] = (
        "HHHH",
        "C1,C2,C3,C4",
        t,
        [1500 + 60 * np.sign(np.sin(t)), 1500 + 0 * t, 1400 + 0 * t, 1500 + 40 * np.sin(t)],
    )
    if aoa:
        out["AOA"] = ("ff", "AOA,SSA", t, [3.0 + np.sin(t), np.cos(t)])
    return out


def dataflash(tables: Mapping[str, Table], *, unit: float = 1e-6) -> bytes:
    """The binary form; unit [s] of its time."""
    label, letter = ("TimeUS", "Q") if unit == 1e-6 else ("TimeMS", "I")
    out = [_fmt(128, 89, "FMT", "BBnNZ", "Type,Length,Name,Format,Columns")]
    rows: list[tuple[float, bytes]] = []
    for kind, (name, (letters, labels, time, fields)) in enumerate(tables.items(), start=140):
        layout = struct.Struct("<BBB" + "".join(_CODE[c] for c in letter + letters))
        out.append(_fmt(kind, layout.size, name, letter + letters, f"{label},{labels}"))
        for t, *row in zip(time.tolist(), *(list(x) for x in fields), strict=True):
            cast = [
                v if c == "N" else float(v) if c == "f" else round(float(v)) for c, v in zip(letters, row, strict=True)
            ]
            rows.append((t, layout.pack(0xA3, 0x95, kind, round(t / unit), *cast)))
    return b"".join([*out, *(data for _, data in sorted(rows, key=lambda r: r[0]))])


def dataflash_text(tables: Mapping[str, Table]) -> str:
    """The text form, as Mission Planner writes it."""
    lines = ["FMT, 128, 89, FMT, BBnNZ, Type,Length,Name,Format,Columns"]
    rows: list[tuple[float, str]] = []
    for kind, (name, (letters, labels, time, fields)) in enumerate(tables.items(), start=140):
        lines.append(f"FMT, {kind}, 40, {name}, Q{letters}, TimeUS,{labels}")
        for t, *row in zip(time.tolist(), *(list(x) for x in fields), strict=True):
            cells = [v.decode() if isinstance(v, bytes) else f"{float(v):.9g}" for v in row]
            rows.append((t, f"{name}, {round(t * 1e6)}, {', '.join(cells)}"))
    return "\r\n".join([*lines, *(text for _, text in sorted(rows, key=lambda r: r[0]))]) + "\r\n"


def _fmt(kind: int, size: int, name: str, letters: str, labels: str) -> bytes:
    return struct.pack("<BBBBB4s16s64s", 0xA3, 0x95, 128, kind, size, name.encode(), letters.encode(), labels.encode())


def px4(
    f: Columns,
    *,
    source: int | None = 1,
    pitot: bool = True,
    fix_lost: tuple[float, float] = (0.0, 0.0),
    outputs: int = 0,
) -> bytes:
    """A ULog. source: airspeed_source; outputs: the instance of actuator_outputs that moves."""
    t = f["time"] + BOOT
    q = quaternion_of(f["phi"], f["theta"], f["psi"])
    g = slice(None, None, 5)
    lost = (f["time"][g] >= fix_lost[0]) & (f["time"][g] < fix_lost[1])
    fix = [np.where(lost, 0.0, f[c][g]) for c in ("vn", "ve", "vd")]
    inertial = [f[c] for c in ("p", "q", "r", "ax", "ay", "az")]
    speed = f["V"] if source != 0 else np.hypot(f["vn"], f["ve"])
    validated: tuple[str, list[np.ndarray]] = ("float true_airspeed_m_s;", [speed[g]])
    if source is not None:
        validated = (f"{validated[0]}uint8_t airspeed_source;", [*validated[1], t[g] * 0 + source])
    still = [t * 0, t * 0]
    moving = [1500 + 50 * np.sign(np.sin(t)), 1500 + 50 * np.sin(t)]
    topics = [
        ("sensor_combined", 0, "float[3] gyro_rad;float[3] accelerometer_m_s2;", t, inertial),
        ("vehicle_attitude", 0, "float[4] q;", t + 0.003, q),
        ("airspeed_validated", 0, validated[0], t[g] + 0.002, validated[1]),
        ("vehicle_air_data", 0, "float baro_pressure_pa;float rho;", t[g], [f["p_static"][g], f["rho"][g]]),
        ("vehicle_gps_position", 0, GPS_FIELDS, t[g], [*fix, np.where(lost, 0, 3)]),
        *(("actuator_outputs", i, "float[2] output;", t, moving if i == outputs else still) for i in range(outputs + 1)),
    ]  # fmt: skip
    if pitot:
        topics.append(("differential_pressure", 0, "float differential_pressure_pa;", t[g], [f["p_dynamic"][g]]))
    out = [b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 1_000_000), _message(b"B", bytes(40))]
    formats = {name: fields for name, _, fields, _, _ in topics}
    out += [_message(b"F", f"{name}:uint64_t timestamp;{fields}".encode()) for name, fields in formats.items()]
    rows: list[tuple[float, bytes]] = []
    for i, (name, instance, fields, time, values) in enumerate(topics):
        out.append(_message(b"A", struct.pack("<BH", instance, i) + name.encode()))
        code = "".join(
            ("B" if part.startswith("uint8_t") else "f") * int(part.split("[")[1].split("]")[0] if "[" in part else 1)
            for part in fields.split(";")
            if part
        )
        layout = struct.Struct("<HQ" + code)
        for t0, *row in zip(time.tolist(), *(v.tolist() for v in values), strict=True):
            cast = [round(v) if c == "B" else v for c, v in zip(code, row, strict=True)]
            rows.append((t0, _message(b"D", layout.pack(i, round(t0 * 1e6), *cast))))
    return b"".join([*out, *(data for _, data in sorted(rows, key=lambda r: r[0]))])


def _message(kind: bytes, payload: bytes) -> bytes:
    return struct.pack("<H", len(payload)) + kind + payload


def telemetry(
    f: Columns,
    *,
    boot: float = BOOT,
    every: int = 2,
    pitot: bool = True,
    arrival: Callable[[float], float] = lambda t: t,
    start: float = 0.0,
    gimbal: bool = False,
    ports: bool = False,
    version: int = 2,
    servos: Sequence[np.ndarray] = (),
) -> bytes:
    """A .tlog. arrival: time since the first message -> time at which the receiver stamps it; start: of its clock; servos: pulses
    [us] (N,) of the first four outputs."""
    from pymavlink.dialects.v10 import ardupilotmega as v1
    from pymavlink.dialects.v20 import ardupilotmega as v2

    m = v1 if version == 1 else v2
    mav, other = m.MAVLink(None, srcSystem=3, srcComponent=1), m.MAVLink(None, srcSystem=3, srcComponent=154)
    out = []
    for i in range(0, f["time"].size, every):
        x = {n: float(v[i]) for n, v in f.items()}
        t = x["time"]
        ms, us = round((t + boot) * 1e3), round((t + boot) * 1e6)
        g = [round(x[a] / 9.80665 * 1000) for a in ("ax", "ay", "az")]
        w = [round(x[a] * 1000) for a in ("p", "q", "r")]
        north, east, down = (round(x[a] * 100) for a in ("vn", "ve", "vd"))
        still = 0.0 if not pitot else x["eas"] ** 2 / 1.633 / 100
        speed = x["eas"] if pitot else float(np.hypot(x["vn"], x["ve"]))
        pulses = [round(float(v[i])) for v in servos] or [1500 + round(40 * np.sin(t)), 1500, 1400, 1500]
        rows = [
            m.MAVLink_attitude_message(ms, x["phi"], x["theta"], x["psi"], x["p"], x["q"], x["r"]),
            m.MAVLink_raw_imu_message(us, *g, *w, 0, 0, 0),
            m.MAVLink_servo_output_raw_message(us, 0, *pulses, 0, 0, 0, 0),
            m.MAVLink_global_position_int_message(ms, 470000000, 85000000, 60000, 50000, north, east, down, 0),
            m.MAVLink_vfr_hud_message(speed, 20.0, 0, 50, 60.0, 0.0),
            m.MAVLink_scaled_pressure_message(ms, x["p_static"] / 100, still, 4700),
        ]
        if ports:
            rows.append(m.MAVLink_servo_output_raw_message(us, 1, 1900, 1900, 1900, 1900, 0, 0, 0, 0))
        stamp = struct.pack(">Q", round((1.6e9 + start + arrival(t)) * 1e6))
        out += [stamp + bytes(row.pack(mav)) for row in rows]
        if gimbal:
            out.append(stamp + bytes(m.MAVLink_attitude_message(ms, 1.0, -1.0, 0.0, 0.0, 0.0, 0.0).pack(other)))
    return b"".join(out)
