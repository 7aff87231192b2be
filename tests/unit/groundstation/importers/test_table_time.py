"""Time of tables as people write it, what their clocks and programs leave in them, and columns made by expressions."""

import datetime as dt
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from groundstation.flight import Flight
from groundstation.flight.expression import ExpressionError, parse
from groundstation.importers.errors import ImportDataError
from groundstation.importers.run import import_data
from tests.support.attitude import quaternion as quaternion_of
from tests.unit.groundstation.turning import Columns, turning_flight

NAMES = ("ax", "ay", "az", "p", "q", "r", "phi", "theta", "psi", "V")


@pytest.fixture
def turning() -> Columns:
    f = turning_flight(seed=9, hz=20.0, seconds=24.0)
    return {n: f[n] for n in ("time", *NAMES)}


def written(path: Path, f: Columns, time: Sequence[object], names: Sequence[str] = NAMES, head: str = "time") -> Path:
    rows = [",".join([head, *names])]
    rows += [",".join([str(t), *(f"{float(f[n][i]):.7g}" for n in names)]) for i, t in enumerate(time)]
    path.write_text("\n".join(rows) + "\n")
    return path


def mapping(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "map.toml"
    path.write_text("format = 1\n" + text)
    return path


def said(flight: Flight) -> str:
    return "\n".join(n.text for n in flight.notes)


# ------------------------------------------------------------------------------------------------------------------ time


@pytest.mark.parametrize(("since", "words"), [(45_771.37, "1899-12-30 (Excel)"), (738_912.37, "the year 0 (MATLAB)")])
def test_day_numbers(tmp_path: Path, turning: Columns, since: float, words: str) -> None:
    days = [f"{since + t / 86400:.12g}" for t in turning["time"].tolist()]
    path = written(tmp_path / "days.csv", turning, days)
    with pytest.raises(ImportDataError, match=r"is the column in .*days"):
        import_data(path)
    with pytest.raises(ImportDataError, match=r'not h; say so in a mapping file: \[time\] unit = "days"'):
        import_data(path, mapping(tmp_path, '[time]\ncolumn = "time"\nunit = "h"\n'))
    if since < 1e5:
        flight = import_data(path, mapping(tmp_path, '[time]\ncolumn = "time"\nunit = "days"\n'))
        assert words in said(flight)
        np.testing.assert_allclose(np.diff(flight.time), 0.05, rtol=0.02)
        assert flight.time[-1] - flight.time[0] == pytest.approx(23.95, abs=0.05)


@pytest.mark.parametrize("ratio", [24.0, 10.0])
def test_a_clock_that_the_gyros_deny_is_refused(tmp_path: Path, turning: Columns, ratio: float) -> None:
    path = written(tmp_path / "t.csv", turning, (turning["time"] / ratio).tolist())
    with pytest.raises(ImportDataError, match=r"time: runs [\d.]+ times too slowly"):
        import_data(path)


def test_a_zone_in_some_rows_only_is_one_sentence(tmp_path: Path, turning: Columns) -> None:
    start = dt.datetime(2025, 10, 26, 0, 59, 50)
    stamps = [
        (start + dt.timedelta(seconds=float(t))).isoformat() + ("+00:00" if i > 2 else "")
        for i, t in enumerate(turning["time"])
    ]
    path = written(tmp_path / "z.csv", turning, stamps)
    with pytest.raises(ImportDataError, match=r"row 1 .* has no time zone, row 4 .* has one"):
        import_data(path, mapping(tmp_path, '[time]\ncolumn = "time"\nunit = "iso"\n'))


def clock(second: float, day: int | None = None) -> str:
    whole = second % 86400
    text = f"{int(whole // 3600):02d}:{int(whole // 60) % 60:02d}:{whole % 60:06.3f}"
    return text if day is None else f"{day + int(second // 86400)}:{text}"


@pytest.mark.parametrize("form", ["time of day", "date beside", "IRIG"])
def test_times_of_day_go_through_midnight(tmp_path: Path, turning: Columns, form: str) -> None:
    seconds = (86390.0 + turning["time"]).tolist()
    if form == "date beside":
        days = [f"2025-03-{14 + int(s // 86400)},{clock(s)}" for s in seconds]
        path = written(tmp_path / "d.csv", turning, days, head="date,time")
    else:
        path = written(tmp_path / "d.csv", turning, [clock(s, 73 if form == "IRIG" else None) for s in seconds])
    flight = import_data(path)
    np.testing.assert_allclose(flight.time, turning["time"], atol=1e-3)
    assert len(flight.segments) == 1
    assert ("IRIG" in said(flight)) == (form == "IRIG")


@pytest.mark.parametrize("last_day", [365, 366])
def test_irig_time_goes_through_the_new_year(tmp_path: Path, turning: Columns, last_day: int) -> None:
    """The day of the year begins again at 1, after as many days as the old year had."""
    seconds = 86390.0 + turning["time"]
    cells = [clock(s, last_day if s < 86400.0 else 0) for s in seconds.tolist()]
    assert {c.partition(":")[0] for c in cells} == {str(last_day), "1"}
    flight = import_data(written(tmp_path / "y.csv", turning, cells))
    np.testing.assert_allclose(flight.time, turning["time"], atol=1e-3)
    assert len(flight.segments) == 1


def test_whole_seconds_are_spread_over_the_rows_in_them(tmp_path: Path, turning: Columns) -> None:
    path = written(tmp_path / "s.csv", turning, np.floor(turning["time"] + 500.4).astype(int).tolist())
    flight = import_data(path)
    assert len(flight) == turning["time"].size
    np.testing.assert_allclose(np.diff(flight.time), 0.05, atol=1e-6)
    assert "whole seconds only" in said(flight)


@pytest.mark.parametrize("back", [0.7, 3.0])
def test_a_clock_set_back_begins_a_record_and_no_row_is_lost(tmp_path: Path, turning: Columns, back: float) -> None:
    time = np.where(np.arange(turning["time"].size) >= 190, turning["time"] - back, turning["time"])
    flight = import_data(written(tmp_path / "b.csv", turning, time.tolist()))
    assert len(flight) == time.size
    assert len(flight.segments) == 2
    assert flight.segments[0].stop == 190
    np.testing.assert_allclose(flight["phi"], turning["phi"], atol=1e-6)
    assert "the clock falls back" in said(flight)


def test_halves_in_the_other_order_are_still_sorted(tmp_path: Path, turning: Columns) -> None:
    order = np.concatenate([np.arange(240, 480), np.arange(240)])
    shuffled = {n: v[order] for n, v in turning.items()}
    flight = import_data(written(tmp_path / "o.csv", shuffled, shuffled["time"].tolist()))
    np.testing.assert_allclose(flight["phi"], turning["phi"], atol=1e-6)


@pytest.mark.parametrize("kind", ["timestamp", "duration"])
def test_parquet_dates_and_durations_need_no_mapping(tmp_path: Path, turning: Columns, kind: str) -> None:
    pa, pq = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    micro = np.round(turning["time"] * 1e6).astype(np.int64)
    time = (
        pa.array(micro + 1_700_000_000_000_000, pa.timestamp("us", "UTC"))
        if kind == "timestamp"
        else pa.array(micro, pa.duration("us"))
    )
    path = tmp_path / "p.parquet"
    pq.write_table(pa.table({"time": time, **{n: turning[n] for n in NAMES}}), path)
    np.testing.assert_allclose(import_data(path).time, turning["time"], atol=1e-6)


# ----------------------------------------------------------------------------------------------------------- what is left


@pytest.mark.parametrize("cut", [5, 40, 61])
def test_half_a_last_line_is_left_out_and_said(tmp_path: Path, turning: Columns, cut: int) -> None:
    path = written(tmp_path / "h.csv", turning, turning["time"].tolist())
    whole = path.read_text()
    path.write_text(whole[: whole.rstrip("\n").rfind("\n") + 1 + cut])
    flight = import_data(path)
    assert len(flight) == turning["time"].size - 1
    assert "last line is cut off" in said(flight)


def test_numbers_that_stand_for_none(tmp_path: Path, turning: Columns) -> None:
    turning["V"] = np.where(np.arange(turning["V"].size) % 7 == 3, -9999.0, turning["V"])
    flight = import_data(written(tmp_path / "n.csv", turning, turning["time"].tolist()))
    assert np.nanmin(flight["V"]) > 10
    assert "cells of -9999 taken as not measured" in said(flight)


def test_a_speed_in_cm_a_second_is_asked_about(tmp_path: Path, turning: Columns) -> None:
    turning["V"] = np.round(turning["V"] * 100)
    with pytest.raises(ImportDataError, match=r"V: .*is it in cm/s"):
        import_data(written(tmp_path / "v.csv", turning, turning["time"].tolist()))


def test_a_magnetometer_that_is_not_calibrated_stops_nothing(tmp_path: Path, turning: Columns) -> None:
    turning |= {n: np.full(turning["time"].size, 900.0) for n in ("mx", "my", "mz")}
    path = written(tmp_path / "m.csv", turning, turning["time"].tolist(), (*NAMES, "mx", "my", "mz"))
    assert "mx: " in said(import_data(path))


def test_a_quaternion_is_an_attitude(tmp_path: Path, turning: Columns) -> None:
    a, b, c = (turning[n] / 2 for n in ("phi", "theta", "psi"))
    turning["qw"] = np.cos(a) * np.cos(b) * np.cos(c) + np.sin(a) * np.sin(b) * np.sin(c)
    turning["qx"] = np.sin(a) * np.cos(b) * np.cos(c) - np.cos(a) * np.sin(b) * np.sin(c)
    turning["qy"] = np.cos(a) * np.sin(b) * np.cos(c) + np.sin(a) * np.cos(b) * np.sin(c)
    turning["qz"] = np.cos(a) * np.cos(b) * np.sin(c) - np.sin(a) * np.sin(b) * np.cos(c)
    names = ("p", "q", "r", "V", "qw", "qx", "qy", "qz")
    flight = import_data(written(tmp_path / "q.csv", turning, turning["time"].tolist(), names))
    np.testing.assert_allclose(flight["phi"], turning["phi"], atol=1e-5)
    np.testing.assert_allclose(flight["theta"], turning["theta"], atol=1e-5)
    assert flight.channels["psi"]["kind"] == "computed"


# ------------------------------------------------------------------------------------------------------ several files


def test_topics_of_one_flight_are_joined_on_time(tmp_path: Path, turning: Columns) -> None:
    gyros = written(tmp_path / "imu.csv", turning, (turning["time"] + 100).tolist(), ("ax", "ay", "az", "p", "q", "r"))
    slow = {n: v[::4] for n, v in turning.items()}
    angles = written(tmp_path / "att.csv", slow, (slow["time"] + 100).tolist(), ("phi", "theta", "psi"))
    flight = import_data([gyros, angles])
    assert len(flight.segments) == 1
    assert flight.time[-1] - flight.time[0] == pytest.approx(23.95, abs=0.2)
    at = np.interp(flight.time - 100, turning["time"], turning["phi"])
    assert np.nanstd(flight["phi"] - at) < 0.02
    assert flight.native_rate("phi") == pytest.approx(5, rel=0.01)
    assert "joined on time" in said(flight)


def test_two_records_of_the_same_columns_stay_in_a_row(tmp_path: Path, turning: Columns) -> None:
    files = [written(tmp_path / f"{i}.csv", turning, turning["time"].tolist()) for i in range(2)]
    assert len(import_data(files).segments) == 2


def test_topics_that_ulog2csv_wrote_are_the_log(tmp_path: Path, turning: Columns) -> None:
    stamps = np.round(turning["time"] * 1e6 + 5e6).astype(np.int64)
    half = turning["phi"] / 2
    still = np.zeros_like(half)
    tables = {
        "vehicle_attitude_0": {"q[0]": np.cos(half), "q[1]": np.sin(half), "q[2]": still, "q[3]": still},
        "sensor_combined_0": {
            f"gyro_rad[{i}]": np.gradient(turning["phi"], turning["time"]) * (i == 0) for i in range(3)
        },
    }
    paths = []
    for name, fields in tables.items():
        paths.append(written(tmp_path / f"log_7_{name}.csv", fields, stamps.tolist(), tuple(fields), head="timestamp"))
    flight = import_data(paths, accept_implausible=True)
    assert np.nanstd(flight["phi"] - np.interp(flight.time - 5, turning["time"], turning["phi"])) < 0.01
    assert flight.channels["p"]["from"] == "sensor_combined.gyro_rad[0]"


# ---------------------------------------------------------------------------------------------------------- expressions


def test_columns_are_combined_by_an_expression(tmp_path: Path, turning: Columns) -> None:
    turning |= {
        "As": turning["V"] * 0.9,
        "E2T": np.full(turning["V"].size, 1 / 0.9),
        "Air Speed (kt)": turning["V"] / 0.514444,
    }
    names = (*NAMES[:-1], "As", "E2T", "Air Speed (kt)")
    path = written(tmp_path / "e.csv", turning, turning["time"].tolist(), names)
    for text, unit in (
        ("As * E2T", "m/s"),
        ("`Air Speed (kt)`", "knots"),
        ("sqrt(As ** 2 * E2T ** 2 + 0 * -E2T)", "m/s"),
    ):
        made = mapping(tmp_path, f'[columns]\nV = {{ expression = "{text}", unit = "{unit}" }}\n')
        np.testing.assert_allclose(import_data(path, made)["V"], turning["V"], rtol=1e-4)
        assert import_data(path, made).channels["V"]["from"] == text.replace(" ", "" if "`" not in text else " ")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("As *", "ends where"), ("As E2T", "not expected"), ("(As", "'\\)' is missing"), ("__import__('os')", "cannot read"),
        ("1 + 2", "names no column"), ("sqrt(As, E2T)", "takes 1"), ("As.__class__()", "not expected"),
        ("-" * 200 + "As", "deep"),
        ("As" * 300, "characters"), ("lambda: As", "cannot read"), ("As[0", "cannot read"),
    ],
)  # fmt: skip
def test_what_is_no_expression_is_told_and_never_run(text: str, words: str) -> None:
    with pytest.raises(ExpressionError, match=words):
        parse(text)


def test_an_expression_follows_the_rules_of_arithmetic() -> None:
    c = {"a": np.array([2.0, 3.0]), "b.c[1]": np.array([5.0, 0.0])}
    cases = {
        "a + b.c[1] * 2 - 1": [11.0, 2.0], "-a ** 2": [-4.0, -9.0], "2 ** a ** 1": [4.0, 8.0], "a / b.c[1]": [0.4, np.nan],
        "hypot(a, 1.5e0) - sqrt(a*a+2.25)": [0.0, 0.0], "max(a, b.c[1])": [5.0, 3.0], "(a - 1) * (a + 1)": [3.0, 8.0],
    }  # fmt: skip
    for text, expected in cases.items():
        np.testing.assert_allclose(parse(text).values(c), expected, atol=1e-12, err_msg=text)


@pytest.mark.parametrize(
    ("columns", "digits"),
    [
        (("header.stamp.secs", "header.stamp.nsecs"), 9),
        (("header.stamp.sec", "header.stamp.nanosec"), 9),
        (("field.header.stamp",), 0),
        (("%time",), 0),
    ],
)
def test_the_stamp_of_a_ros_header_is_the_time(
    tmp_path: Path, turning: Columns, columns: tuple[str, ...], digits: int
) -> None:
    nanoseconds = [round(t * 1e9) + 1_700_000_123_000_000_000 for t in turning["time"]]
    stamps = [f"{n // 10**9},{n % 10**9}" if digits else str(n) for n in nanoseconds]
    flight = import_data(written(tmp_path / "topic.csv", turning, stamps, head=",".join(columns)))
    np.testing.assert_allclose(flight.time - flight.time[0], turning["time"] - turning["time"][0], atol=1e-6)
    assert "the sender's own clock" in said(flight)
    np.testing.assert_allclose(flight["p"], turning["p"], atol=1e-6)


def test_topics_of_a_bag_are_joined_by_the_sender_s_stamp_and_not_by_the_receiver_s(
    tmp_path: Path, turning: Columns
) -> None:
    """The second topic came 0.7 s later over the network."""
    stamp = ["1700000123", "1700000200"][0]
    cells = [f"{1700000124.2 + t:.4f},odom,{int(stamp) + int(t)},{round((t % 1) * 1e9)}" for t in turning["time"]]
    head = "Time,header.frame_id,header.stamp.secs,header.stamp.nsecs"
    late = [c.replace(c.split(",")[0], f"{float(c.split(',')[0]) + 0.7:.4f}", 1) for c in cells]
    first = written(tmp_path / "imu.csv", turning, cells, ("ax", "ay", "az", "p", "q", "r"), head)
    second = written(tmp_path / "attitude.csv", turning, late, ("phi", "theta", "psi", "V"), head)
    flight = import_data([first, second])
    inside = slice(10, -10)
    expected = np.interp(flight.time - flight.time[0], turning["time"] - turning["time"][0], turning["phi"])
    np.testing.assert_allclose(flight["phi"][inside], expected[inside], atol=2e-3)
    assert "joined on time" in said(flight)


@pytest.mark.parametrize("prefix", ["", "field."])
def test_topics_of_ros_need_no_map_and_come_in_our_axes(tmp_path: Path, turning: Columns, prefix: str) -> None:
    """Imu, attitude and velocity as a file each, in the axes of REP 103; the second file comes 0.9 s late over the network."""
    t = turning["time"]
    ground = {"vn": 19 * np.cos(turning["psi"]) + 2, "ve": 19 * np.sin(turning["psi"]) - 1, "vd": 0.5 * np.sin(t)}
    turning = {**turning, **ground}
    from_east = np.pi / 2 - turning["psi"]  # against the clock
    quaternion = quaternion_of(turning["phi"], -turning["theta"], from_east)
    topics = {
        "imu": {
            **{f"angular_velocity.{a}": s * turning[n] for a, n, s in (("x", "p", 1), ("y", "q", -1), ("z", "r", -1))},
            **{f"linear_acceleration.{a}": s * turning[n] for a, n, s in (("x", "ax", 1), ("y", "ay", -1), ("z", "az", -1))},
        },
        "pose": {"pose.position.z": 0 * t, **{f"pose.orientation.{a}": v for a, v in zip("wxyz", quaternion, strict=True)}},
        "velocity": {"twist.linear.x": turning["ve"], "twist.linear.y": turning["vn"], "twist.linear.z": -turning["vd"]},
    }  # fmt: skip
    paths = []
    for late, (topic, fields) in zip((0.0, 0.9, 0.1), topics.items(), strict=True):
        stamps = [round((1_700_000_200 + x) * 1e9) for x in t]
        seconds = [[s // 10**9, s % 10**9] if not prefix else [s] for s in stamps]
        received = [s / 1e9 + late if not prefix else s + round(late * 1e9) for s in stamps]
        head = ["Time", "header.stamp.secs", "header.stamp.nsecs"] if not prefix else ["%time", "field.header.stamp"]
        rows = [[str(r), *map(str, s)] for r, s in zip(received, seconds, strict=True)]
        lines = [",".join([*head, *(prefix + n for n in fields)])]
        lines += [",".join([*row, *(f"{v[i]:.9g}" for v in fields.values())]) for i, row in enumerate(rows)]
        paths.append(tmp_path / f"{topic}.csv")
        paths[-1].write_text("\n".join(lines) + "\n")
    flight = import_data(paths)
    assert len(flight.segments) == 1
    inside = slice(5, -5)
    for name in ("p", "q", "r", "ax", "ay", "az", "phi", "theta", "vn", "ve", "vd"):
        expected = np.interp(flight.time - flight.time[0], t - t[0], turning[name])
        np.testing.assert_allclose(flight[name][inside], expected[inside], atol=5e-3, err_msg=name)
    turn = flight["psi"] - np.interp(flight.time - flight.time[0], t - t[0], turning["psi"])
    assert np.nanmax(np.abs(np.sin(turn[inside] / 2))) < 5e-3
    assert flight.channels["phi"]["kind"] == "computed"
    assert "axes turned" in said(flight)
