"""Flight modes, events, messages and parameters of each format, and that they travel with a flight."""

import json
import struct
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from pymavlink.dialects.v20 import ardupilotmega

from groundstation.flight import read_flight, write_flight
from groundstation.flight.marks import FlightMode, Mark, marks_of
from groundstation.importers.formats.tlog import read_tlog
from groundstation.importers.formats.ulog_scan import UlogScan
from groundstation.importers.modes import dataflash_marks, heartbeat_mode
from groundstation.importers.run import import_data
from sideslip.cli import cli
from tests.unit.groundstation.importers.test_import_logs import ulog_bytes, ulog_message


def test_an_ardupilots_modes_are_of_the_vehicle_that_it_says() -> None:
    rows = {
        "MSG": [(1.0, {"Message": b"ArduCopter V4.3.1\0\0"})],
        "MODE": [
            (2.0, {"Mode": 5, "ModeNum": 5}),
            (8.0, {"Mode": 9, "ModeNum": 9}),
            (9.0, {"Mode": 77, "ModeNum": 77}),
        ],
        "EV": [(3.0, {"Id": 10}), (4.0, {"Id": 18}), (4.5, {"Id": 250})],
        "ERR": [(5.0, {"Subsys": 5, "ECode": 1})],
    }
    found = dataflash_marks(rows, 20.0)
    assert found.modes == (
        FlightMode("LOITER", 2.0, 8.0),
        FlightMode("LAND", 8.0, 9.0),
        FlightMode("mode 77", 9.0, 20.0),
    )
    assert [m.text for m in found.events] == [
        "armed",
        "land complete",
        "event 250",
        "error: failsafe of the radio, code 1",
    ]
    assert found.messages == (Mark(1.0, "ArduCopter V4.3.1"),)
    plane = dataflash_marks({"MODE": rows["MODE"], "ARM": [(2.0, {"ArmState": 1})], "EV": [(2.0, {"Id": 10})]}, 20.0)
    assert plane.modes[0].name == "FBWA"
    assert [m.text for m in plane.events] == ["armed"]  # once, though two messages say it
    named = dataflash_marks({"MODE": [(1.0, {"Mode": "Auto", "ModeNum": "x"})]}, 2.0)
    assert named.modes == (FlightMode("Auto", 1.0, 2.0),)


@pytest.mark.parametrize(
    ("vehicle", "autopilot", "custom", "name"),
    [
        (1, 3, 5, "FBWA"),
        (2, 3, 5, "LOITER"),
        (10, 3, 4, "HOLD"),
        (1, 12, 3 << 16, "POSCTL"),
        (1, 12, (4 << 16) | (5 << 24), "AUTO_RTL"),
    ],
)
def test_a_heartbeat_names_its_mode(vehicle: int, autopilot: int, custom: int, name: str) -> None:
    assert heartbeat_mode(vehicle, autopilot, custom) == name


def test_telemetry_says_modes_arming_and_messages(tmp_path: Path) -> None:
    link = ardupilotmega.MAVLink(None, srcSystem=1, srcComponent=1)
    frames: list[bytes] = []
    for k in range(60):
        frames.append(link.attitude_encode(1000 * (100 + k), 0.1, 0.0, 0.0, 0.0, 0.0, 0.0).pack(link))
        armed = 128 if k >= 10 else 0
        frames.append(link.heartbeat_encode(1, 3, armed, 0 if 20 <= k < 40 else 5, 4, 3).pack(link))
        if k == 30:
            frames.append(link.statustext_encode(6, b"Takeoff complete").pack(link))
    path = tmp_path / "x.tlog"
    stamps = (10**15 + 500_000 * i for i in range(len(frames)))
    path.write_bytes(b"".join(s.to_bytes(8, "big") + f for s, f in zip(stamps, frames, strict=True)))
    (log,) = read_tlog(path)
    assert [m.name for m in log.marks.modes] == ["FBWA", "MANUAL", "FBWA"]
    assert log.marks.modes[1].start == pytest.approx(120.0, abs=1.0)
    assert [m.text for m in log.marks.events] == ["disarmed", "armed"]
    (said,) = log.marks.messages
    assert said.text == "Takeoff complete"
    assert said.time == pytest.approx(130.0, abs=1.5)


def test_a_ulog_says_modes_messages_and_parameters(tmp_path: Path) -> None:
    rows = [(float(k), 0.0 if k < 6 else 14.0, 2.0 if k > 2 else 1.0) for k in range(12)]
    data = ulog_bytes({"vehicle_status": ("float nav_state;float arming_state;", rows)})
    data += ulog_message(b"L", b"6" + struct.pack("<Q", 4_000_000) + b"Takeoff detected")
    key = b"float FW_AIRSPD_TRIM"
    data += ulog_message(b"P", bytes([len(key)]) + key + struct.pack("<f", 17.5))
    found = UlogScan(data)
    assert found.logged == [(4.0, "Takeoff detected")]
    assert found.parameters == {"FW_AIRSPD_TRIM": 17.5}
    path = tmp_path / "x.ulg"
    path.write_bytes(data)
    done = CliRunner().invoke(cli, ["info", str(path), "--json", str(tmp_path / "i.json")])
    assert done.exit_code == 0, done.output
    content = json.loads((tmp_path / "i.json").read_text())
    assert [(m["mode"], m["from"]) for m in content["modes"]] == [("MANUAL", 0.0), ("OFFBOARD", 6.0)]
    assert [e["text"] for e in content["events"]] == ["disarmed", "armed"]
    assert content["messages"][0]["text"] == "Takeoff detected"
    assert content["parameters"] == {"FW_AIRSPD_TRIM": 17.5}
    assert content["boots"] == [{"from": 0.0, "to": 11.0}]


def test_marks_travel_with_a_flight_and_move_with_its_record(tmp_path: Path) -> None:
    text = "FMT, 128, 89, FMT, BBnNZ, Type,Length,Name,Format,Columns\n"
    text += "FMT, 1, 1, IMU, Qffffff, TimeUS,GyrX,GyrY,GyrZ,AccX,AccY,AccZ\nFMT, 2, 1, MODE, QMBB, TimeUS,Mode,ModeNum,Rsn\n"
    text += "FMT, 3, 1, PARM, QNf, TimeUS,Name,Value\nPARM, 0, TRIM_X, 12.5\nMODE, 100000, 0, 0, 1\n"
    text += "".join(f"IMU, {20000 * k}, 0.1, 0.0, {0.01 * np.sin(k)}, 0.0, 0.0, -9.8\n" for k in range(200))
    for name in "ab":
        (tmp_path / f"{name}.log").write_text(text)
    flight = import_data([tmp_path / "a.log", tmp_path / "b.log"])
    write_flight(flight, tmp_path / "x.mcap")
    read = read_flight(tmp_path / "x.mcap")
    first, second = marks_of(read).modes
    assert (first.name, second.name) == ("MANUAL", "MANUAL")
    assert second.start - first.start == pytest.approx(
        float(read.time[read.segments[1].start] - read.time[0]), abs=1e-6
    )
    assert read.provenance.detail["parameters"] == {"TRIM_X": 12.5}
