"""Sound inputs of every kind, small, from which the spoilt ones are made."""

import io
import json
import sqlite3
import struct
from collections.abc import Mapping
from functools import cache
from pathlib import Path

import numpy as np

from tests.support.paths import ROOT

RECORDINGS = ROOT / "recordings"
ROWS = 60


@cache
def flown(rows: int = ROWS) -> Mapping[str, np.ndarray]:
    """Three seconds (or as many rows) of a banking flight at 20 Hz."""
    t = np.arange(rows) * 0.05
    speed = 16 + 0.5 * np.sin(0.3 * t)
    return {
        "time": t, "ax": 0.8 + 0.05 * np.sin(9 * t), "ay": 0.1 * np.sin(2 * t), "az": -9.8 + 0.08 * np.cos(7 * t),
        "p": 0.48 * np.cos(1.2 * t), "q": 0.045 * np.cos(0.9 * t), "r": 0.2 * np.sin(t), "phi": 0.4 * np.sin(1.2 * t),
        "theta": 0.08 + 0.05 * np.sin(0.9 * t), "psi": 2.9 + 0.05 * t, "alpha": 0.09 + 0.02 * np.sin(t),
        "beta": 0.05 * np.sin(2 * t), "V": speed, "delta_a": 0.1 * np.sign(np.sin(t)), "delta_r": 0.03 * np.sin(2 * t),
        "p_dynamic": 0.5 * 1.17 * speed**2, "rho": np.full(rows, 1.17), "altitude": 60 + np.sin(0.1 * t),
    }  # fmt: skip


def csv_inputs() -> list[bytes]:
    """As this program writes it; with units, semicolons and decimal commas; lines above the names; blanks."""
    f = flown()
    rows = list(zip(*(v.tolist() for v in f.values()), strict=True))
    plain = "\n".join([",".join(f), *(",".join(f"{x:.6g}" for x in row) for row in rows)]) + "\n"
    units = "\n".join(
        ["time [ms];phi [deg];V (knots);Höhe (m);word", "ms;deg;knots;m;-"]
        + [f"{50 * i};{20 * np.sin(i / 9):.3f};31,5;{60 + i};a".replace(".", ",") for i in range(ROWS)]
    )
    above = "flight of today\nby somebody\n" + plain
    blanks = "\n".join(["time p q r", *(f"{0.05 * i:.2f} {np.cos(i):.4f} 0.1 nan" for i in range(ROWS))])
    return [plain.encode(), units.encode(), above.encode(), blanks.encode()]


def flight_inputs() -> list[bytes]:
    """Twelve seconds with all that a verb asks for."""
    f = dict(flown(240))
    f |= {"delta_e": 0.05 * np.sign(np.sin(0.7 * f["time"])), "thrust": np.zeros(240)}
    return [
        "\n".join([",".join(f), *(",".join(f"{x:.6g}" for x in row) for row in zip(*f.values(), strict=True))]).encode()
    ]


def parquet_inputs() -> list[bytes]:
    """Plain; compressed with words and stamps; nested and decimal columns; as this program writes it."""
    import decimal

    import pyarrow as pa
    import pyarrow.parquet as pq

    f = dict(flown())
    stamps = pa.array((f["time"] * 1e6).astype("int64") + 1_700_000_000_000_000, pa.timestamp("us"))
    tables = (
        (pa.table(f), {}),
        (pa.table({**f, "word": ["a", "b", None] * (ROWS // 3), "stamp": stamps}), {"compression": "zstd"}),
        (pa.table({"time": f["time"], "p": f["p"], "nested": [[1.0, 2.0]] * ROWS, "struct": [{"a": 1}] * ROWS,
                   "money": [decimal.Decimal("1.5")] * ROWS, "flag": [True] * ROWS}), {"compression": "gzip"}),
        (pa.table({"time": pa.array([*f["time"].tolist()[:-1], None]), "q": np.arange(ROWS, dtype="uint8")}),
         {"use_dictionary": False, "data_page_version": "2.0", "row_group_size": 13}),
    )  # fmt: skip
    out = []
    for table, options in tables:
        stream = io.BytesIO()
        pq.write_table(table, stream, **options)
        out.append(stream.getvalue())
    return out


def matlab_inputs() -> list[bytes]:
    """MATLAB 5, packed and not: a struct with units, an array of structs, a cell; MATLAB 7.3."""
    import h5py
    from scipy.io import savemat

    f = {n: v.reshape(-1, 1) for n, v in flown().items()}
    records = np.array([f, {n: v[:20] for n, v in f.items()}], dtype=object)
    sets = ({"flight": {**f, "units": {"p": "rad/s"}}}, {"run": records, "note": "words"}, {**f, "half": f["p"][:30]})
    out = []
    for i, variables in enumerate(sets):
        stream = io.BytesIO()
        savemat(stream, variables, do_compression=i == 0, long_field_names=True)
        out.append(stream.getvalue())
    stream = io.BytesIO()
    with h5py.File(stream, "w", userblock_size=512) as file:
        group = file.create_group("flight")
        group.attrs["MATLAB_class"] = np.bytes_("struct")
        for name, values in f.items():
            group.create_dataset(name, data=values.T).attrs["MATLAB_class"] = np.bytes_("double")
    return [*out, b"MATLAB 7.3 MAT-file".ljust(512, b"\0") + stream.getvalue()[512:]]


def ulog_message(kind: bytes, payload: bytes) -> bytes:
    """One message of a ULog."""
    return struct.pack("<H", len(payload)) + kind + payload


def ulog_inputs() -> list[bytes]:
    """Two topics, one of them nested and padded; with sync, information, parameters and a dropout."""
    f = flown()
    head = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0) + ulog_message(b"B", bytes(40))
    out = head + ulog_message(
        b"F", b"sensor_combined:uint64_t timestamp;float[3] gyro_rad;float[3] accelerometer_m_s2;"
    )
    out += ulog_message(b"F", b"inner:float x;uint8_t[2] flags;")
    out += ulog_message(
        b"F", b"airspeed:uint64_t timestamp;float true_airspeed_m_s;inner[2] more;uint8_t[4] _padding0;"
    )
    out += ulog_message(b"I", b"\x0fchar[5] ver_swabcde") + ulog_message(b"P", b"\x0dfloat CAL_ONE" + bytes(4))
    out += ulog_message(b"A", b"\0\0\0sensor_combined") + ulog_message(b"A", b"\0\1\0airspeed")
    for i, t in enumerate(f["time"]):
        values = [f[c][i] for c in ("p", "q", "r", "ax", "ay", "az")]
        out += ulog_message(b"D", struct.pack("<HQ6f", 0, round(t * 1e6), *values))
        out += ulog_message(b"D", struct.pack("<HQ", 1, round(t * 1e6)) + struct.pack("<f", f["V"][i]) + bytes(12))
        if i % 20 == 7:
            out += ulog_message(b"S", b"\x2f\x73\x13\x20\x25\x0c\xbb\x12") + ulog_message(b"O", struct.pack("<H", 12))
    return [out]


def dataflash_inputs() -> list[bytes]:
    """IMU with two instances, attitude, airspeed, GPS, and units that tell the instance field."""
    formats = {
        "IMU": (130, "QBffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ"),
        "ATT": (131, "Qccc", "TimeUS,Roll,Pitch,Yaw"),
        "ARSP": (132, "Qff", "TimeUS,Airspeed,DiffPress"),
        "GPS": (134, "QBLLeff", "TimeUS,Status,Lat,Lng,Alt,Spd,GCrs"),
        "FMTU": (135, "QBNN", "TimeUS,FmtType,UnitIds,MultIds"),
    }
    code = {"Q": "Q", "B": "B", "f": "f", "c": "h", "L": "i", "e": "i", "N": "16s"}

    def fmt(kind: int, length: int, name: str, letters: str, labels: str) -> bytes:
        texts = (name.encode(), letters.encode(), labels.encode())
        return b"\xa3\x95\x80" + struct.pack("<BB4s16s64s", kind, length, *texts)

    out = fmt(128, 89, "FMT", "BBnNZ", "Type,Length,Name,Format,Columns")
    for name, (kind, letters, labels) in formats.items():
        out += fmt(kind, 3 + struct.calcsize("<" + "".join(code[c] for c in letters)), name, letters, labels)

    def data(name: str, *values: object) -> bytes:
        kind, letters, _ = formats[name]
        return b"\xa3\x95" + bytes([kind]) + struct.pack("<" + "".join(code[c] for c in letters), *values)

    out += data("FMTU", 0, 130, b"s#EEEooo", b"F-------")
    f = {k: v.tolist() for k, v in flown().items()}
    for i, t in enumerate(f["time"]):
        us = round(t * 1e6)
        for instance in (0, 1):
            out += data("IMU", us, instance, *(f[c][i] for c in ("p", "q", "r", "ax", "ay", "az")))
        out += data("ATT", us, *(round(np.degrees(f[c][i]) * 100) for c in ("phi", "theta", "psi")))
        out += data("ARSP", us, f["V"][i], f["p_dynamic"][i])
        if i % 4 == 0:
            out += data("GPS", us, 3, 470_000_000, 85_000_000, 50_000, 15.0, 90.0)
    return [out]


def tlog_inputs() -> list[bytes]:
    """MAVLink 2 of an autopilot with a ground station between; MAVLink 1; and our own downlink."""
    from pymavlink.dialects.v20 import ardupilotmega as mav

    f = {k: v.tolist() for k, v in flown().items()}
    out = []
    for force_v1 in (False, True):
        sender = mav.MAVLink(None, srcSystem=7)
        station = mav.MAVLink(None, srcSystem=255)
        data = b""
        for i, t in enumerate(f["time"]):
            ms = round(t * 1e3)
            messages = [
                mav.MAVLink_attitude_message(ms, *(f[c][i] for c in ("phi", "theta", "psi", "p", "q", "r"))),
                mav.MAVLink_vfr_hud_message(f["V"][i], f["V"][i], 90, 50, f["altitude"][i], 0.0),
                mav.MAVLink_gps_raw_int_message(
                    ms * 1000, 3, 470_000_000, 85_000_000, 60_000, 65535, 65535, 1500, 9000, 9
                ),
                mav.MAVLink_servo_output_raw_message(ms * 1000, 0, *range(1100, 1900, 100)),
            ]
            for message in messages:
                data += struct.pack(">Q", 1_700_000_000_000_000 + ms * 1000) + message.pack(
                    sender, force_mavlink1=force_v1
                )
            if i % 20 == 0:
                beat = mav.MAVLink_heartbeat_message(6, 8, 0, 0, 0, 3)
                data += struct.pack(">Q", 1_700_000_000_000_000 + ms * 1000) + beat.pack(station)
        out.append(data)
    return out


def ubx_inputs() -> list[bytes]:
    """Fixes of a receiver with a sentence of NMEA between."""
    from daq.sensors.ubx import NAV_PVT, frame

    fix = struct.pack("<IHBBBBBBIiBBBB", 1000, 2026, 6, 1, 12, 0, 0, 7, 20, 5, 3, 1, 0, 9) + bytes(64)
    return [frame(NAV_PVT, fix) * 3 + b"$GNRMC,,V,,,,,,,,,,N*4D\r\n" + frame(NAV_PVT, fix)]


def toml_inputs(*folders: str) -> list[bytes]:
    """The files of that kind that come with the software."""
    return [path.read_bytes() for folder in folders for path in sorted(ROOT.glob(folder))]


def ground_inputs() -> list[bytes]:
    """A ground station's configuration with every table in it."""
    return [
        b'[link]\nports = ["udpin:127.0.0.1:14550", "serial:/dev/ttyUSB0:57600"]\nsystems = [1]\nbackfill = "all"\n'
        b'[output]\ndirectory = "flights"\ndated = false\n[calibration]\ndirectory = "cdfp"\n[view]\nlayout = "light"\n'
        b"port = 9876\n[handover]\nbackfill_limit_s = 60.0\n[handover.landing]\nflying_speed = 9.0\n"
        b'[[alarms]]\nchannel = "V"\nlow = 10.0\nhigh = 27.0\nhysteresis = 0.5\nhold_s = 0.5\nlevel = "ERROR"\ntext = "speed"\n'
    ]


def mapping_inputs() -> list[bytes]:
    """Mapping files of the software, and one that uses every key on the plain CSV."""
    own = (
        b'format = 1\naircraft = "mine"\nrate_hz = 20\n[file]\ndelimiter = ","\ndecimal = "."\nheader_line = 1\n'
        b'[time]\ncolumn = "time"\nunit = "s"\noffset = 1.0\n[columns]\nax = { column = "ax", unit = "g", factor = 0.1 }\n'
        b'V = [{ column = "TAS", unit = "knots" }, { column = "V", unit = "m/s" }]\n'
        b'delta_e = { terms = [{ column = "delta_a", factor = -0.5 }, { column = "delta_r" }], unit = "rad", '
        b"sign = -1, hold = true }\n"
    )
    return [own, own.replace(b"rate_hz = 20\n", b"segment_rows = [30, 30]\n")]


def plan_inputs() -> list[bytes]:
    """A bench plan of each procedure."""
    points = "".join(f"[[fit.dwell]]\nstart = {i}.0\nstop = {i}.8\nreference = {i / 10}\n" for i in range(5))
    vectors = "".join(
        f"[[fit.dwell]]\nstart = {i}.0\nstop = {i}.8\nreference = [0.0, 0.0, {-9.8 + i}]\n" for i in range(6)
    )
    return [
        f'format = 1\n[[fit]]\ninstrument = "beta_vane"\nprocedure = "static_points"\nmethod = "m"\n{points}'.encode(),
        f'format = 1\n[[fit]]\ninstrument = "accelerometer"\nprocedure = "vectors"\n{vectors}'.encode(),
        b'format = 1\n[[fit]]\ninstrument = "magnetometer"\nprocedure = "sphere"\nfield = 4.5e-5\n'
        b"[[fit.dwell]]\nstart = 1.0\nstop = 20.0\n",
    ]


def effect_inputs() -> list[bytes]:
    """A file with an effect of one's own."""
    return [
        b'[[effect]]\nname = "Cn_beta3"\ntitle = "cubic"\nphysics = "p"\nequation = "e"\nsource = "s"\nsignature = "g"\n'
        b'separate_by = "x"\nfamily = "f"\n[effect.confusions]\nCn_beta = "alike"\n[[effect.form]]\nlabel = "form"\n'
        b'terms = { Cn = "Cn_beta3*beta^3" }\nparameters = [{ name = "Cn_beta3", unit = "1/rad3", '
        b"lower = -1.0, upper = 1.0, typical = 0.1 }]\n"
    ]


def model_inputs() -> list[bytes]:
    """The model of the examples, and a built-in one as this program writes it."""
    import tempfile

    from estimation.models.load import load_model, write_model

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "model.toml"
        write_model(load_model("lateral-simple", "cdfp"), path)
        return [(ROOT / "docs/examples/short_period.toml").read_bytes(), path.read_bytes()]


def expression_inputs() -> list[bytes]:
    """Right sides of equations."""
    return [
        b"CY_0 + CY_beta*beta + CY_p*p*b/(2*V)",
        b"where(alpha < 0.2, sin(alpha)^2, tanh(beta)/(1 + abs(q)))",
        b"q*S*b/Ixx*(Cl_0 + Cl_beta*beta) - (Izz - Iyy)*q*r/Ixx",
        b"max(min(p, 1e3), -2.5e-3)**3 + atan2(alpha, V)",
    ]


def state_inputs() -> list[bytes]:
    """A signing state as it is saved."""
    return [json.dumps({"sent": 5, "heard": 9, "streams": [[1, 1, 0, 7], [255, 190, 2, 9]]}).encode()]


def key_inputs() -> list[bytes]:
    """A signing key in either form."""
    return [bytes(range(1, 33)), bytes(range(1, 33)).hex().encode() + b"\n"]


def recording_inputs() -> list[bytes]:
    """A raw recording and a flight."""
    return [(RECORDINGS / name).read_bytes()[:400_000] for name in ("cdfp_ld1_raw.mcap", "cdfp_ld1.mcap")]


def sitl_inputs() -> list[bytes]:
    """As this program writes it, and the few keys of a person."""
    from estimation.simulation.autopilot.equations import BUILT_IN

    keys = ",\n".join(f'  "{k}": {v!r}' for k, v in BUILT_IN.items())
    own = f'# real mass = 3.5 kg\n# by hand\n{{\n{keys},\n  "CGOffset": [-0.15, 0.0, -0.05]\n}}\n'
    return [own.encode(), b'{"s": 0.3, "b": 1.2, "c": 0.2, # more to come\n "c_lift_a": 4.5, "mystery": {"a": [1, 2]}}']


def sdf_inputs() -> list[bytes]:
    """As this program writes it."""
    from xml.etree import ElementTree as ET

    from estimation.aircraft import load_aircraft
    from estimation.simulation.autopilot.gazebo import model_sdf
    from estimation.simulation.autopilot.linear import LinearAircraft

    craft = load_aircraft("cdfp")
    derivatives = {n: d.value for n, d in craft.derivatives.items()}
    throws = dict.fromkeys(("delta_e", "delta_a", "delta_r"), (-0.3, 0.3))
    made = LinearAircraft("cdfp", "cdfp", craft, derivatives, throws=throws, thrust=14.0)
    return [ET.tostring(model_sdf("cdfp", made, None))]


def campaign_inputs() -> list[bytes]:
    """A plan with every table in it, for a flight that stands in the repository."""
    flight = str(RECORDINGS / "foreign" / "ordinary_0.csv")
    return [
        f'flights = ["{flight}"]\nmethods = ["ls"]\nmodel = "lateral"\naircraft = "cdfp"\ngroups = ["aircraft"]\nseed = 3\n'
        f'time_limit = 60.0\n[[flight]]\npath = "{flight}"\nmass = 3.5\nsegments = "2:8"\ndate = "2026-03-01"\n'
        f'[[simulate]]\nscenario = "quiet"\ncount = 3\n'.encode()
    ]


def manoeuvre_inputs() -> list[bytes]:
    """A doublet, as `design` writes one."""
    from daq.contract.manoeuvre import Manoeuvre

    steps = [0.0] * 4 + [0.05] * 10 + [-0.05] * 10 + [0.0] * 4
    digest = Manoeuvre("doublet", 0.05, {"delta_a": tuple(steps)}).digest
    text = (
        f'version = 1\ndigest = "{digest}"\nkind = "doublet"\naircraft = "cdfp"\nmodel = "lateral"\ntime_step = 0.05\n'
    )
    return [f'{text}[about]\nwhy = "none"\n[limits]\nbeta = 0.2\n[increments]\ndelta_a = {steps}\n'.encode()]


def limits_inputs() -> list[bytes]:
    """A file of limits for `design`."""
    return [
        b"[controls.delta_a]\namplitude_deg = 5.0\nrate_deg_s = 60.0\n[response]\nbeta = [-8.0, 8.0]\nphi = [-30.0, 30.0]\n"
    ]


def jsbsim_inputs() -> list[bytes]:
    """A small aircraft whose coefficients are functions and a table."""
    place = "<x>0</x><y>0</y><z>0</z>"
    lift = "".join(f"{0.1 * n:.1f} {0.4 * n:.1f}\n" for n in range(-3, 4))
    return [
        f"""<?xml version="1.0"?><fdm_config name="small" version="2.0" release="BETA">
<metrics><wingarea unit="M2">0.5</wingarea><wingspan unit="M">1.5</wingspan><chord unit="M">0.4</chord>
<location name="AERORP" unit="M">{place}</location><location name="EYEPOINT" unit="M">{place}</location>
<location name="VRP" unit="M">{place}</location></metrics>
<mass_balance><ixx unit="KG*M2">0.2</ixx><iyy unit="KG*M2">0.2</iyy><izz unit="KG*M2">0.4</izz><emptywt unit="KG">3.5</emptywt>
<location name="CG" unit="M">{place}</location></mass_balance><ground_reactions/>
<aerodynamics><function name="aero/own"><product><property>aero/beta-rad</property><value>2.0</value></product></function>
<axis name="LIFT"><function name="aero/lift"><product><property>aero/qbar-psf</property><property>metrics/Sw-sqft</property>
<table><independentVar>aero/alpha-rad</independentVar><tableData>{lift}</tableData></table></product></function></axis>
<axis name="ROLL"><function name="aero/roll"><product><property>aero/qbar-psf</property><property>metrics/Sw-sqft</property>
<property>metrics/bw-ft</property><property>fcs/left-aileron-pos-rad</property><property>aero/own</property><value>-0.1</value>
</product></function></axis></aerodynamics></fdm_config>""".encode()
    ]


def bag_inputs() -> list[bytes]:
    """An MCAP file of JSON messages, and one whose messages are described in ROS's words."""
    from mcap.writer import Writer

    made = []
    for encoding, schema, body in (
        ("jsonschema", b'{"type": "object"}', lambda k: json.dumps({"p": 0.1 * k, "roll": 0.01 * k}).encode()),
        (
            "ros2msg",
            b"uint64 timestamp\nfloat32[3] gyro_rad\n",
            lambda k: b"\0\1\0\0" + struct.pack("<Q3f", k, 0.1, 0.2, 0.3),
        ),
    ):
        stream = io.BytesIO()
        writer = Writer(stream)
        writer.start(profile="ros2" if encoding == "ros2msg" else "")
        number = writer.register_schema("px4_msgs/msg/SensorCombined", encoding, schema)
        channel = writer.register_channel("/imu", "json" if encoding == "jsonschema" else "cdr", number)
        for k in range(200):
            writer.add_message(channel, 10**18 + 50_000_000 * k, body(k), 10**18 + 50_000_000 * k)
        writer.finish()
        made.append(stream.getvalue())
    return made


def sqlite_bag_inputs() -> list[bytes]:
    """A ROS 2 bag in SQLite of standard messages, which carries no definition, and of described ones."""
    file = sqlite3.connect(":memory:")
    file.executescript(
        "create table topics(id integer primary key, name text, type text, serialization_format text, offered_qos_profiles text);"
        "create table messages(id integer primary key, topic_id integer, timestamp integer, data blob);"
        "create table message_definitions(id integer, topic_type text, encoding text, encoded_message_definition text);"
    )
    file.execute("insert into topics values(1, '/imu', 'own_msgs/msg/Imu', 'cdr', '')")
    file.execute("insert into topics values(2, '/air', 'std_msgs/msg/Float64', 'cdr', '')")
    text = "uint64 timestamp\nfloat32[3] gyro_rad\n"
    file.execute("insert into message_definitions values(1, 'own_msgs/msg/Imu', 'ros2msg', ?)", (text,))
    for k in range(200):
        stamp = 10**18 + 50_000_000 * k
        bodies = (struct.pack("<Q3f", k, 0.1, 0.2, 0.3), struct.pack("<d", 0.1 * k))
        for topic, body in enumerate(bodies, 1):
            row = (topic, stamp, b"\0\1\0\0" + body)
            file.execute("insert into messages(topic_id, timestamp, data) values(?, ?, ?)", row)
    file.commit()
    return [bytes(file.serialize())]
