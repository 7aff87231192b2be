"""What an ArduPilot log says of its own servos: SERVOn_TRIM for a mapping that leaves the trim out, a note where both differ."""

import struct
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from pymavlink.dialects.v20 import ardupilotmega

from groundstation.importers.errors import ImportDataError
from groundstation.importers.formats.dataflash import read_dataflash
from groundstation.importers.formats.tlog import read_tlog
from groundstation.importers.run import import_data
from sideslip.cli import cli

PARAMETERS = [("SERVO1_TRIM", 1500.0), ("SERVO1_TRIM", 1540.0), ("SERVO1_MIN", 1100.0), ("SERVO1_REVERSED", 1.0)]
MAP = """format = 1
[servos.a]
column = "{column}"
{trim}travel = [[1100, -20.0], [1900, 20.0]]
unit = "deg"
[columns]
delta_e = {{ column = "servo.a" }}
"""


def dataflash(parameters: list[tuple[str, float]]) -> bytes:
    """RCOU and PARM messages as ArduPilot writes them; output 1 goes from 1100 to 1900 us."""

    def described(kind: int, size: int, name: str, layout: str, labels: str) -> bytes:
        texts = (name.encode(), layout.encode(), labels.encode())
        return struct.pack("<BBBBB4s16s64s", 0xA3, 0x95, 128, kind, size, *texts)

    out = described(128, 89, "FMT", "BBnNZ", "Type,Length,Name,Format,Columns")
    out += described(64, 3 + 8 + 16 + 8, "PARM", "QNff", "TimeUS,Name,Value,Default")
    out += described(65, 3 + 8 + 2, "RCOU", "QH", "TimeUS,C1")
    for name, value in parameters:
        out += struct.pack("<BBBQ16sff", 0xA3, 0x95, 64, 1_000_000, name.encode(), value, 1500.0)
    for i in range(41):
        out += struct.pack("<BBBQH", 0xA3, 0x95, 65, 1_000_000 + 50_000 * i, 1100 + 20 * i)
    return out


def flown(tmp_path: Path, trim: str, parameters: list[tuple[str, float]] = PARAMETERS) -> tuple[Path, Path]:
    log, mapping = tmp_path / "log.bin", tmp_path / "map.toml"
    log.write_bytes(dataflash(parameters))
    mapping.write_text(MAP.format(column="RCOU.C1", trim=trim))
    return log, mapping


def test_a_trim_that_is_left_out_is_the_logs_own_as_last_stated(tmp_path: Path) -> None:
    flight = import_data(*flown(tmp_path, ""))
    expected = np.interp(1100 + 20 * np.arange(41), [1100, 1540, 1900], np.radians([-20, 0, 20]))
    np.testing.assert_allclose(flight["delta_e"], expected, atol=1e-9)
    assert any(n.text == "servo a: zero deflection at 1540, by SERVO1_TRIM of the log" for n in flight.notes)


@pytest.mark.parametrize(("trim", "told"), [(1500, True), (1538, False)])
def test_a_trim_that_differs_from_the_logs_is_used_and_told(tmp_path: Path, trim: int, told: bool) -> None:
    flight = import_data(*flown(tmp_path, f"trim = {trim}\n"))
    expected = np.interp(1100 + 20 * np.arange(41), [1100, trim, 1900], np.radians([-20, 0, 20]))
    np.testing.assert_allclose(flight["delta_e"], expected, atol=1e-9)
    assert any("the log's own SERVO1_TRIM is 1540" in n.text for n in flight.notes) == told


@pytest.mark.parametrize(
    ("parameters", "words"),
    [
        ([], "has no trim and the log has no SERVO1_TRIM; add trim"),
        ([("SERVO1_TRIM", 2100.0)], "SERVO1_TRIM of the log, 2100, does not lie between the ends of the travel"),
        ([("SERVO1_TRIM", float("nan"))], "has no trim and the log has no SERVO1_TRIM"),
    ],
)
def test_no_trim_anywhere_is_a_sentence(tmp_path: Path, parameters: list[tuple[str, float]], words: str) -> None:
    with pytest.raises(ImportDataError, match=words):
        import_data(*flown(tmp_path, "", parameters))


def test_an_output_of_px4_has_no_parameter(tmp_path: Path) -> None:
    data, mapping = tmp_path / "x.csv", tmp_path / "m.toml"
    data.write_text("time,out\n0,1100\n0.1,1500\n0.2,1900\n")
    mapping.write_text(MAP.format(column="out", trim=""))
    with pytest.raises(ImportDataError, match="has no trim and out has no parameter that says it"):
        import_data(data, mapping)


def test_the_recipe_prints_what_the_parameters_say(tmp_path: Path) -> None:
    log, mapping = flown(tmp_path, "")
    done = CliRunner().invoke(cli, ["import", str(log), "--map", str(mapping), "--recipe"])
    assert done.exit_code == 0, done.output
    assert "servo output RCOU.C1: 1100 to 1900, most often 1500; its parameters say MIN 1100, TRIM 1540" in done.output


def test_a_telemetry_log_states_them_in_param_value(tmp_path: Path) -> None:
    link = ardupilotmega.MAVLink(None, srcSystem=1, srcComponent=1)
    frames = [link.param_value_encode(n.encode(), v, 9, 900, i) for i, (n, v) in enumerate(PARAMETERS)]
    frames += [link.servo_output_raw_encode(1_000_000 * i, 0, 1500 + i, *[0] * 7) for i in range(3)]
    path = tmp_path / "x.tlog"
    path.write_bytes(b"".join((10**15 + i).to_bytes(8, "big") + f.pack(link) for i, f in enumerate(frames)))
    assert dict(read_tlog(path)[0].parameters) == {"SERVO1_TRIM": 1540.0, "SERVO1_MIN": 1100.0, "SERVO1_REVERSED": 1.0}


def test_dataflash_parameters_are_read(tmp_path: Path) -> None:
    path = tmp_path / "x.bin"
    path.write_bytes(dataflash(PARAMETERS))
    assert dict(read_dataflash(path).parameters) == {
        "SERVO1_TRIM": 1540.0,
        "SERVO1_MIN": 1100.0,
        "SERVO1_REVERSED": 1.0,
    }


def test_a_throw_is_laid_on_the_travel_that_the_log_states(tmp_path: Path) -> None:
    log, mapping = flown(tmp_path, "", [*PARAMETERS, ("SERVO1_MAX", 1880.0)])
    mapping.write_text(mapping.read_text().replace("travel = [[1100, -20.0], [1900, 20.0]]", "throw = [18.0, -21.0]"))
    flight = import_data(log, mapping)
    output = 1100.0 + 20 * np.arange(41)
    expected = np.where(output < 1540, 18.0 * (1540 - output) / 440, -21.0 * (output - 1540) / 340)
    np.testing.assert_allclose(flight["delta_e"], np.radians(expected), atol=1e-9)
    assert any(n.text == "servo a: travel from 1100 to 1880, by the parameters of the log" for n in flight.notes)


def test_a_throw_without_the_parameters_is_a_sentence(tmp_path: Path) -> None:
    log, mapping = flown(tmp_path, "trim = 1500\n")
    mapping.write_text(mapping.read_text().replace("travel = [[1100, -20.0], [1900, 20.0]]", "throw = [18.0, -21.0]"))
    with pytest.raises(ImportDataError, match="has a throw and no travel, and the log does not state SERVO1_MAX"):
        import_data(log, mapping)
