"""Tables as people's programs leave them: their ends, their heads, their dates, their quaternions, their slips."""

import datetime as dt
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest

from groundstation.flight import Flight
from groundstation.importers.errors import ImportDataError
from groundstation.importers.run import import_data
from tests.support.attitude import quaternion
from tests.unit.groundstation.turning import Columns, turning_flight

NAMES = ("p", "q", "r", "phi", "theta", "psi", "V")


@pytest.fixture(scope="module")
def flown() -> Columns:
    return turning_flight(seed=21, hz=20.0, seconds=30.0)


def lines_of(flown: Columns, names: Sequence[str] = NAMES, delimiter: str = ",") -> list[str]:
    rows = zip(*([f"{v:.9g}" for v in flown[n].tolist()] for n in ("time", *names)), strict=True)
    return [delimiter.join(("time", *names)), *(delimiter.join(row) for row in rows)]


def read(path: Path, lines: Sequence[str]) -> Flight:
    path.write_text("\n".join(lines) + "\n")
    return import_data(path)


def told(flight: Flight) -> str:
    return "\n".join(n.text for n in flight.notes)


def test_a_whole_last_row_of_decimal_commas_stays(tmp_path: Path, flown: Columns) -> None:
    """A whole number in the last row has no comma: it was taken for a row cut off."""
    lines = [line.replace(".", ",") for line in lines_of(flown, delimiter=";")]
    lines[-1] = ";".join(["30", *lines[-1].split(";")[1:]])
    flight = read(tmp_path / "log.csv", lines)
    assert len(flight) == flown["time"].size
    assert "cut off" not in told(flight)


HEADS: dict[str, Callable[[list[str]], list[str]]] = {
    "in a remark, by savetxt": lambda lines: ["# " + lines[0], *lines[1:]],
    "below what they belong to": lambda lines: ["Time,IMU,IMU,IMU,EKF,EKF,EKF,Air", *lines],
    "below merged cells": lambda lines: ["Time,IMU,,,EKF,,,Air", *lines],
    "parted by bars": lambda lines: [line.replace(",", "|") for line in lines],
}


@pytest.mark.parametrize("how", HEADS)
def test_column_names(tmp_path: Path, flown: Columns, how: str) -> None:
    flight = read(tmp_path / "log.csv", HEADS[how](lines_of(flown)))
    np.testing.assert_allclose(flight["p"], flown["p"], atol=1e-6)
    assert set(NAMES) <= set(flight.known_columns)


def test_lines_that_are_no_rows_are_counted(tmp_path: Path, flown: Columns) -> None:
    lines = lines_of(flown)
    lines[200:200] = [lines[0]]
    flight = read(tmp_path / "log.csv", [*lines, "Rows,600", "End of log"])
    assert len(flight) == flown["time"].size
    assert "1 lines that repeat the column names left out" in told(flight)
    assert "2 lines below the last row left out" in told(flight)


DATES: dict[str, str] = {
    "28.03.2026 23:59:50,000": "%d.%m.%Y %H:%M:%S,%f",
    "03/28/2026 11:59:50.0 PM": "%m/%d/%Y %I:%M:%S.%f %p",
    "2026/3/28 23:59:50": "%Y/%m/%d %H:%M:%S.%f",
}


@pytest.mark.parametrize("how", DATES)
def test_dates_that_are_not_of_the_standard_pass_midnight(tmp_path: Path, flown: Columns, how: str) -> None:
    begin = dt.datetime(2026, 3, 28, 23, 59, 50)
    stamps = [(begin + dt.timedelta(seconds=t)).strftime(DATES[how]) for t in flown["time"].tolist()]
    rows = [
        f"{stamp};{line.partition(';')[2]}"
        for stamp, line in zip(stamps, lines_of(flown, delimiter=";")[1:], strict=True)
    ]
    flight = read(tmp_path / "log.csv", [";".join(("time", *NAMES)), *rows])
    np.testing.assert_allclose(flight.time - flight.time[0], flown["time"] - flown["time"][0], atol=2e-3)


def test_rows_of_one_whole_second_of_a_day_are_spread_over_it(tmp_path: Path, flown: Columns) -> None:
    begin = dt.datetime(2026, 3, 28, 10, 0, 0)
    stamps = [(begin + dt.timedelta(seconds=int(t))).strftime("%H:%M:%S") for t in flown["time"].tolist()]
    rows = [f"{stamp},{line.partition(',')[2]}" for stamp, line in zip(stamps, lines_of(flown)[1:], strict=True)]
    flight = read(tmp_path / "log.csv", [",".join(("time", *NAMES)), *rows])
    assert len(flight) == flown["time"].size
    assert "whole seconds only" in told(flight)


@pytest.mark.parametrize("gyros", [True, False])
def test_the_scalar_of_a_counted_quaternion_is_where_the_gyros_say(tmp_path: Path, flown: Columns, gyros: bool) -> None:
    w, x, y, z = quaternion(*(flown[n] for n in ("phi", "theta", "psi")))
    table = {**flown, "q0": x, "q1": y, "q2": z, "q3": w}
    names = (*(("p", "q", "r") if gyros else ()), "V", "q0", "q1", "q2", "q3")
    flight = read(tmp_path / "log.csv", lines_of(table, names))
    assert ("scalar last, as the gyros turn" in told(flight)) is gyros
    assert ("scalar first" in told(flight)) is not gyros
    if gyros:
        np.testing.assert_allclose(flight["phi"], flown["phi"], atol=1e-6)
        table = {**flown, "q0": w, "q1": x, "q2": y, "q3": z}
        assert "scalar first" in told(read(tmp_path / "first.csv", lines_of(table, names)))


def test_a_slip_of_a_logger_is_not_measured_and_degrees_are_still_found(tmp_path: Path, flown: Columns) -> None:
    slipped = {**flown, "p": np.where(np.arange(flown["p"].size) == 77, 1e9, flown["p"])}
    flight = read(tmp_path / "log.csv", lines_of(slipped))
    assert np.flatnonzero(np.isnan(flight["p"])).tolist() == [77]
    assert "column p: 1 values beyond all that flies (the first 1e+09 rad/s" in told(flight)
    with pytest.raises(ImportDataError, match=r"p: .*deg/s"):
        read(tmp_path / "deg.csv", lines_of({**flown, "p": np.degrees(flown["p"])}))


def test_minutes_and_seconds_as_excel_shows_them_pass_the_hour(tmp_path: Path, flown: Columns) -> None:
    stamps = [f"{int((3590 + t) // 60) % 60}:{(3590 + t) % 60:06.3f}" for t in flown["time"].tolist()]
    rows = [f"{stamp},{line.partition(',')[2]}" for stamp, line in zip(stamps, lines_of(flown)[1:], strict=True)]
    flight = read(tmp_path / "log.csv", [",".join(("time", *NAMES)), *rows])
    np.testing.assert_allclose(flight.time - flight.time[0], flown["time"] - flown["time"][0], atol=2e-3)


def test_names_in_capitals_count_with_their_unit(tmp_path: Path, flown: Columns) -> None:
    lines = lines_of({**flown, "p": np.degrees(flown["p"])}, ("p", "phi", "V"))
    flight = read(tmp_path / "log.csv", ["time,P [deg/s],PHI [rad],V", *lines[1:]])
    np.testing.assert_allclose(flight["p"], flown["p"], atol=1e-6)
    pressure = read(tmp_path / "pressure.csv", ["time,P [Pa],PHI [rad],V", *lines[1:]])
    assert "p" not in pressure


def test_files_of_another_kind_than_their_ending_and_tables_without_a_value(tmp_path: Path) -> None:
    (tmp_path / "a.bin").write_bytes(b"ULog\x01\x12\x35\x01" + bytes(40))
    with pytest.raises(ImportDataError, match=r"by its first bytes a PX4 ULog; give it the ending \.ulg"):
        import_data(tmp_path / "a.bin")
    with pytest.raises(ImportDataError, match="no column holds a value"):
        read(tmp_path / "b.csv", ["time,p,phi", *(f"{0.1 * k},nan,nan" for k in range(40))])
