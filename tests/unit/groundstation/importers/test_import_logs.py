"""PX4 ULog, ArduPilot dataflash and MAVLink telemetry logs, written by other writers or byte by byte from their definitions."""

import io
import struct
from pathlib import Path

import numpy as np
import pytest

from groundstation.flight import FlightError
from groundstation.importers.errors import ImportDataError
from groundstation.importers.formats.dataflash import read_dataflash
from groundstation.importers.run import import_data
from tests.support.attitude import quaternion as quaternion_of

Columns = dict[str, np.ndarray]


# ------------------------------------------------------------------------------------------------------------- ULog


def ulog_message(kind: bytes, payload: bytes) -> bytes:
    return struct.pack("<H", len(payload)) + kind + payload


def ulog_bytes(topics: dict[str, tuple[str, list[tuple[float, ...]]]]) -> bytes:
    """A ULog by the PX4 user guide, 'ULog File Format': header, flags, formats, subscriptions, data.

    topics: name -> (field list without timestamp, rows of (time [s], field values...)), all fields float.
    """
    out = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 1_000_000)
    out += ulog_message(b"B", bytes(8) + bytes(8) + struct.pack("<3Q", 0, 0, 0))
    for name, (fields, _) in topics.items():
        out += ulog_message(b"F", f"{name}:uint64_t timestamp;{fields}".encode())
    for i, name in enumerate(topics):
        out += ulog_message(b"A", struct.pack("<BH", 0, i) + name.encode())
    rows = [(t, i, v) for i, (_, data) in enumerate(topics.values()) for t, *v in data]
    for t, i, values in sorted(rows, key=lambda r: r[0]):
        out += ulog_message(b"D", struct.pack(f"<HQ{len(values)}f", i, round(t * 1e6), *values))
    return out


def px4_topics(flown: Columns) -> dict[str, tuple[str, list[tuple[float, ...]]]]:
    t = flown["time"] + 5.0
    quaternion = quaternion_of(flown["phi"], flown["theta"], flown["psi"])
    return {
        "sensor_combined": (
            "float[3] gyro_rad;float[3] accelerometer_m_s2;",
            list(zip(t, *(flown[c] for c in ("p", "q", "r", "ax", "ay", "az")), strict=True)),
        ),
        "vehicle_attitude": ("float[4] q;", list(zip(t + 0.004, *quaternion, strict=True))),
        "airspeed": (
            "float indicated_airspeed_m_s;float true_airspeed_m_s;",
            list(zip(t[::2], flown["V"][::2], flown["V"][::2], strict=True)),
        ),
        "vehicle_air_data": (
            "float baro_alt_meter;float baro_pressure_pa;float rho;",
            list(zip(t[::4], flown["altitude"][::4], flown["p_static"][::4], flown["rho"][::4], strict=True)),
        ),
    }


def test_ulog_rewritten_by_pyulog_imports(tmp_path: Path, flown: Columns) -> None:
    from pyulog import ULog

    first = tmp_path / "by_hand.ulg"
    first.write_bytes(ulog_bytes(px4_topics(flown)))
    stream = io.BytesIO()
    ULog(str(first)).write_ulog(stream)
    path = tmp_path / "by_pyulog.ulg"
    path.write_bytes(stream.getvalue())
    flight = import_data(path)
    assert flight.sample_interval == pytest.approx(0.05, abs=1e-6)
    inside = slice(10, -10)
    at = flight.time[inside] - 5.0
    for column in ("p", "phi", "theta", "V", "altitude", "rho"):
        expected = np.interp(at, flown["time"], flown[column])
        np.testing.assert_allclose(flight[column][inside], expected, atol=0.01 * max(1.0, np.ptp(expected)))
    assert np.median(np.abs(flight["az"][inside])) == pytest.approx(9.8, abs=0.1)
    assert any("alpha (airflow_aoa.aoa_rad)" in n.text for n in flight.notes)  # what is missing is named
    assert flight.provenance.detail["format"] == "ulog"
    assert flight.provenance.detail["resampled_hz"] == pytest.approx(20.0)


def test_ulog_that_is_none(tmp_path: Path, flown: Columns) -> None:
    path = tmp_path / "x.ulg"
    path.write_bytes(b"not a log at all, only text")
    with pytest.raises(ImportDataError, match="not a ULog"):
        import_data(path)
    whole = ulog_bytes(px4_topics(flown))
    path.write_bytes(whole[: len(whole) // 2])  # a log that ends with the battery still gives its first half
    assert 5 < np.ptp(import_data(path).time) < 15


def test_heading_is_interpolated_through_north(tmp_path: Path, flown: Columns) -> None:
    flown["psi"] = 3.1 + 0.02 * flown["time"]  # crosses south, where the angle jumps from pi to -pi
    path = tmp_path / "x.ulg"
    path.write_bytes(ulog_bytes(px4_topics(flown)))
    flight = import_data(path)
    psi = np.unwrap(flight["psi"][5:-5])
    np.testing.assert_allclose(np.diff(psi), 0.001, atol=2e-4)


# -------------------------------------------------------------------------------------------------------- dataflash


def dataflash_bytes(flown: Columns) -> bytes:
    """A dataflash log by the ArduPilot developer guide: FMT messages, then data with head A3 95 and message id."""
    messages = {
        "IMU": (130, "QBffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ"),
        "ATT": (131, "Qccc", "TimeUS,Roll,Pitch,Yaw"),
        "ARSP": (132, "Qff", "TimeUS,Airspeed,DiffPress"),
        "BARO": (133, "Qff", "TimeUS,Alt,Press"),
        "GPS": (134, "QBIHLLeff", "TimeUS,Status,GMS,GWk,Lat,Lng,Alt,Spd,GCrs"),
    }
    sizes = {"Q": 8, "B": 1, "I": 4, "H": 2, "f": 4, "c": 2, "L": 4, "e": 4}
    codes = {"Q": "Q", "B": "B", "I": "I", "H": "H", "f": "f", "c": "h", "L": "i", "e": "i"}
    out = b""

    def fmt(kind: int, length: int, name: str, layout: str, labels: str) -> bytes:
        return struct.pack(
            "<BBBBB4s16s64s", 0xA3, 0x95, 128, kind, length, name.encode(), layout.encode(), labels.encode()
        )

    out += fmt(128, 89, "FMT", "BBnNZ", "Type,Length,Name,Format,Columns")
    for name, (kind, layout, labels) in messages.items():
        out += fmt(kind, 3 + sum(sizes[c] for c in layout), name, layout, labels)

    def data(name: str, *values: float) -> bytes:
        kind, layout, _ = messages[name]
        cast = [v if c == "f" else round(v * (100 if c in "ce" else 1)) for c, v in zip(layout, values, strict=True)]
        return struct.pack("<BBB" + "".join(codes[c] for c in layout), 0xA3, 0x95, kind, *cast)

    f = {k: v.tolist() for k, v in flown.items()}
    for i, t in enumerate(f["time"]):
        us = t * 1e6 + 2e6
        out += data("IMU", us, 0, f["p"][i], f["q"][i], f["r"][i], f["ax"][i], f["ay"][i], f["az"][i])
        out += data("IMU", us, 1, 0, 0, 0, 0, 0, 0)  # a second IMU, which must not mix with the first
        out += data("ATT", us, np.degrees(f["phi"][i]), np.degrees(f["theta"][i]), np.degrees(f["psi"][i]))
        if i % 2 == 0:
            out += data("ARSP", us, f["V"][i], f["p_dynamic"][i])
            out += data("BARO", us, f["altitude"][i], f["p_static"][i])
        if i % 4 == 0:
            out += data("GPS", us, 3, 200_000, 2400, 470_000_000, 85_000_000, 500.0, 15.0, 90.0)
    return out


def test_dataflash_imports(tmp_path: Path, flown: Columns) -> None:
    path = tmp_path / "00000001.BIN"
    path.write_bytes(dataflash_bytes(flown))
    flight = import_data(path)
    np.testing.assert_allclose(flight["p"], np.interp(flight.time - 2, flown["time"], flown["p"]), atol=2e-3)
    np.testing.assert_allclose(flight["phi"], np.interp(flight.time - 2, flown["time"], flown["phi"]), atol=2e-3)
    assert flight.provenance.detail["format"] == "dataflash"
    fix = np.flatnonzero(np.isfinite(flight["latitude"]))[0]
    assert flight["latitude"][fix] == pytest.approx(47.0)
    assert (flight["vn"][fix], flight["ve"][fix]) == (pytest.approx(0.0, abs=1e-6), pytest.approx(15.0))
    assert any("beta (AOA.SSA)" in n.text for n in flight.notes)


def test_dataflash_agrees_with_pymavlink(tmp_path: Path, flown: Columns) -> None:
    """The same file through pymavlink's DFReader, value by value."""
    from pymavlink import DFReader

    path = tmp_path / "log.bin"
    path.write_bytes(dataflash_bytes(flown))
    theirs: dict[str, list[float]] = {}
    reader = DFReader.DFReader_binary(str(path), zero_time_base=True)
    while (m := reader.recv_msg()) is not None:
        fields = m.to_dict()
        if "TimeUS" in fields and fields.get("I", 0) == 0:
            for field, value in fields.items():
                theirs.setdefault(f"{m.get_type()}.{field}", []).append(value)
    reader.close()
    ours = read_dataflash(path).series
    for name in ("IMU.GyrX", "IMU.AccZ", "ATT.Roll", "ARSP.DiffPress", "BARO.Press", "GPS.Lat", "GPS.Alt", "GPS.Spd"):
        np.testing.assert_allclose(ours[name].values, theirs[name], rtol=1e-12)
        np.testing.assert_allclose(ours[name].time * 1e6, theirs[name.split(".", maxsplit=1)[0] + ".TimeUS"])
    assert np.ptp(ours["IMU[1].GyrX"].values) == 0


def test_damaged_dataflash_loses_only_the_damage(tmp_path: Path, flown: Columns) -> None:
    data = bytearray(dataflash_bytes(flown))
    at = data.index(b"\xa3\x95\x83", len(data) // 2)  # an ATT message in the middle
    del data[at + 4 : at + 9]
    path = tmp_path / "log.bin"
    path.write_bytes(bytes(data))
    flight = import_data(path)
    assert any("damaged" in n.text for n in flight.notes)
    assert np.isfinite(flight["phi"]).mean() > 0.97


@pytest.mark.parametrize("kind", ["ulg", "bin", "tlog"])
def test_damaged_logs_import_or_say_why(tmp_path: Path, flown: Columns, kind: str, rng: np.random.Generator) -> None:
    short = {k: v[:60] for k, v in flown.items()}
    whole = {
        "ulg": lambda: ulog_bytes(px4_topics(short)),
        "bin": lambda: dataflash_bytes(short),
        "tlog": lambda: tlog_bytes(short),
    }
    good = np.frombuffer(whole[kind](), np.uint8)
    for i in range(40):
        data = good.copy()
        if i % 2:
            data[rng.integers(0, data.size, 5)] ^= 1 << rng.integers(0, 8, 5).astype(np.uint8)
        else:
            data = np.delete(data, slice(at := int(rng.integers(0, data.size)), at + int(rng.integers(1, 200))))
        path = tmp_path / f"x.{kind}"
        path.write_bytes(data.tobytes())
        try:
            flight = import_data(path, accept_implausible=True)
        except (ImportDataError, FlightError):
            continue
        assert len(flight) >= 2


def test_dataflash_with_a_mapping_for_the_surfaces(tmp_path: Path, flown: Columns) -> None:
    path = tmp_path / "log.bin"
    path.write_bytes(dataflash_bytes(flown))
    mapping = tmp_path / "m.toml"
    mapping.write_text('format = 1\n[columns]\ndelta_e = { column = "ATT.Pitch", unit = "deg", factor = 0.5 }\n')
    flight = import_data(path, mapping)
    inside = np.isfinite(flight["delta_e"])
    np.testing.assert_allclose(flight["delta_e"][inside], 0.5 * flight["theta"][inside], atol=1e-12)


def test_dataflash_that_is_none(tmp_path: Path) -> None:
    path = tmp_path / "x.bin"
    path.write_bytes(b"\x00" * 100)
    with pytest.raises(ImportDataError, match="not an ArduPilot dataflash"):
        import_data(path)


# ------------------------------------------------------------------------------------------------------------- tlog


def tlog_bytes(flown: Columns, damage: bool = False) -> bytes:
    """A telemetry log with messages packed by pymavlink, as a ground station writes it."""
    from pymavlink.dialects.v20 import ardupilotmega as dialect

    mav = dialect.MAVLink(None, srcSystem=7, srcComponent=1)
    other = dialect.MAVLink(None, srcSystem=255, srcComponent=190)
    out = b""
    for i, t in enumerate(flown["time"].tolist()):
        f = {k: v[i].item() for k, v in flown.items()}
        ms = round(t * 1000) + 60_000
        frames = [
            mav.attitude_encode(ms, f["phi"], f["theta"], f["psi"], f["p"], f["q"], f["r"]).pack(mav),
            mav.scaled_imu2_encode(
                ms, *(round(f[a] / 9.80665 * 1000) for a in ("ax", "ay", "az")), 0, 0, 0, 0, 0, 0
            ).pack(mav),
            mav.vfr_hud_encode(f["V"], f["V"], 90, 50, f["altitude"], 0.0).pack(mav),
        ]
        if i % 20 == 0:
            frames.append(other.heartbeat_encode(6, 8, 0, 0, 4).pack(other))
        for frame in frames:
            broken = bytes([frame[0], *(b ^ 0x55 for b in frame[1:])]) if damage and i % 37 == 5 else frame
            out += struct.pack(">Q", round((1.7e9 + t) * 1e6)) + bytes(broken)
    return out


@pytest.mark.parametrize("damage", [False, True])
def test_tlog_imports(tmp_path: Path, flown: Columns, damage: bool) -> None:
    path = tmp_path / "flight.tlog"
    path.write_bytes(tlog_bytes(flown, damage))
    flight = import_data(path)
    good = np.isfinite(flight["phi"])
    assert good.mean() > 0.9
    expected = np.interp(flight.time[good] - 60, flown["time"], flown["phi"])
    np.testing.assert_allclose(flight["phi"][good], expected, atol=0.02)
    assert np.nanmedian(flight["az"]) == pytest.approx(-9.8, abs=0.05)
    assert flight.provenance.detail["system"] == "7"


def test_tlog_values_that_mean_not_known(tmp_path: Path, flown: Columns) -> None:
    """65535 mV is 'no voltage', and a position without a fix is none (MAVLink common.xml)."""
    from pymavlink.dialects.v20 import ardupilotmega as dialect

    mav = dialect.MAVLink(None, srcSystem=7, srcComponent=1)
    data = tlog_bytes(flown)
    for i in range(40):
        stamp = struct.pack(">Q", round((1.7e9 + i * 0.5) * 1e6))
        status = mav.sys_status_encode(0, 0, 0, 0, 65535 if i < 20 else 12_000, -1, -1, 0, 0, 0, 0, 0, 0)
        fix = mav.gps_raw_int_encode(
            int(60e6 + i * 5e5), 3 if i >= 20 else 1, 470_000_000, 85_000_000, 0, 0, 0, 0, 0, 9
        )
        data += stamp + bytes(status.pack(mav)) + stamp + bytes(fix.pack(mav))
    path = tmp_path / "flight.tlog"
    path.write_bytes(data)
    flight = import_data(path)
    assert np.nanmax(flight["supply_voltage"]) == pytest.approx(12.0)
    assert np.isnan(flight["latitude"][flight.time < 65]).all()
    assert np.nanmin(flight["latitude"]) == pytest.approx(47.0)


def test_tlog_that_is_none(tmp_path: Path) -> None:
    path = tmp_path / "x.tlog"
    path.write_bytes(bytes(range(256)) * 8)
    with pytest.raises(ImportDataError, match="no MAVLink message"):
        import_data(path)
