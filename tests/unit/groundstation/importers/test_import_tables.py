"""Tables of other people: units, signs, times, layouts, and the mistakes the data give away."""

import csv
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from groundstation.cli.import_log import import_
from groundstation.flight import read_flight, write_flight
from groundstation.flight.findings import finding_texts
from groundstation.flight.quality.plausibility import suspicions
from groundstation.importers.errors import ImportDataError
from groundstation.importers.mapping import load_map
from groundstation.importers.run import import_data
from groundstation.importers.units import UNITS, conversion, find_unit

Columns = dict[str, np.ndarray]

DEG = 180 / np.pi


def write_csv(path: Path, columns: Columns, delimiter: str = ",", decimal: str = ".") -> Path:
    with path.open("w", newline="", encoding="utf-8") as handle:
        writer = csv.writer(handle, delimiter=delimiter)
        writer.writerow(columns)
        for row in zip(*(np.asarray(c).tolist() for c in columns.values()), strict=True):
            writer.writerow([repr(v).replace(".", decimal) if isinstance(v, float) else v for v in row])
    return path


MAP = """format = 1
aircraft = "cdfp"
[time]
column = "t_ms"
unit = "ms"
[columns]
ax = { column = "AccX", unit = "g" }
ay = { column = "AccY", unit = "g", sign = -1 }
az = { column = "AccZ", unit = "g" }
p = { column = "GyrX", unit = "deg/s" }
q = { column = "GyrY", unit = "°/s" }
r = { column = "GyrZ", unit = "dps" }
phi = { column = "Roll", unit = "deg" }
theta = { column = "Pitch", unit = "deg" }
psi = { column = "Yaw", unit = "deg" }
alpha = { column = "AoA", unit = "deg" }
beta = { column = "SSA", unit = "deg", sign = -1 }
V = { column = "TAS", unit = "knots" }
altitude = { column = "Alt", unit = "ft" }
p_static = { column = "Ps", unit = "hPa" }
p_dynamic = { column = "Qc", unit = "mbar" }
temperature = { column = "OAT", unit = "°C" }
rho = { column = "rho", unit = "kg/m^3" }
delta_e = { terms = [{ column = "EL", factor = 0.5 }, { column = "ER", factor = 0.5 }], unit = "deg" }
delta_a = { terms = [{ column = "EL", factor = -0.5 }, { column = "ER", factor = 0.5 }], unit = "deg" }
delta_r = { column = "Rud", unit = "deg" }
"""


def theirs(flown: Columns) -> Columns:
    """The flight in degrees, g, knots, feet, hPa, Celsius, ms, two signs turned, and elevons instead of controls."""
    return {
        "t_ms": flown["time"] * 1000, "AccX": flown["ax"] / 9.80665, "AccY": -flown["ay"] / 9.80665,
        "AccZ": flown["az"] / 9.80665,
        "GyrX": flown["p"] * DEG, "GyrY": flown["q"] * DEG, "GyrZ": flown["r"] * DEG, "Roll": flown["phi"] * DEG,
        "Pitch": flown["theta"] * DEG, "Yaw": flown["psi"] * DEG, "AoA": flown["alpha"] * DEG, "SSA": -flown["beta"] * DEG,
        "TAS": flown["V"] * 3600 / 1852, "Alt": flown["altitude"] / 0.3048, "Ps": flown["p_static"] / 100,
        "Qc": flown["p_dynamic"] / 100, "OAT": flown["temperature"] - 273.15, "rho": flown["rho"],
        "EL": (flown["delta_e"] - flown["delta_a"]) * DEG, "ER": (flown["delta_e"] + flown["delta_a"]) * DEG,
        "Rud": flown["delta_r"] * DEG,
    }  # fmt: skip


@pytest.fixture
def map_file(tmp_path: Path) -> Path:
    path = tmp_path / "map.toml"
    path.write_text(MAP, encoding="utf-8")
    return path


@pytest.mark.parametrize("layout", ["comma", "semicolon", "parquet"])
def test_foreign_units_become_the_same_flight(tmp_path: Path, flown: Columns, map_file: Path, layout: str) -> None:
    if layout == "parquet":
        import pyarrow as pa
        import pyarrow.parquet as pq

        path = tmp_path / "log.parquet"
        pq.write_table(pa.table(theirs(flown)), path)
    elif layout == "semicolon":
        path = write_csv(tmp_path / "log.csv", theirs(flown), ";", ",")
        map_file.write_text(MAP.replace("[time]", '[file]\ndecimal = ","\n[time]'), encoding="utf-8")
    else:
        path = write_csv(tmp_path / "log.csv", theirs(flown))
    flight = import_data(path, map_file)
    for name, values in flown.items():
        if name != "time":
            np.testing.assert_allclose(flight[name], values, rtol=1e-12, atol=1e-12, err_msg=name)
    np.testing.assert_allclose(flight.time, flown["time"], atol=1e-9)
    assert flight.provenance.source == "imported"
    assert flight.provenance.aircraft == "cdfp"
    assert len(flight.provenance.sha256) == 64
    assert flight.provenance.detail["mapping"]["delta_a"] == "(-0.5 EL + 0.5 ER) [deg]"


def test_si_file_needs_no_mapping_and_survives_the_round_trip(tmp_path: Path, flown: Columns) -> None:
    flight = import_data(write_csv(tmp_path / "si.csv", {**flown, "my_extra": flown["V"]}))
    write_flight(flight, tmp_path / "flight.mcap")
    again = read_flight(tmp_path / "flight.mcap")
    for name in (*flown, "my_extra"):
        if name != "time":
            np.testing.assert_array_equal(again[name], flight[name])
    assert any("my_extra" in n.text for n in flight.notes)


def test_units_in_the_header_are_understood(tmp_path: Path, flown: Columns) -> None:
    named = {
        "time [ms]": flown["time"] * 1000,
        "phi [deg]": flown["phi"] * DEG,
        "p (deg/s)": flown["p"] * DEG,
        "V [knots]": flown["V"] * 3.6 / 1.852,
    }
    flight = import_data(write_csv(tmp_path / "log.csv", named))
    np.testing.assert_allclose(flight["phi"], flown["phi"], atol=1e-12)
    np.testing.assert_allclose(flight["V"], flown["V"], rtol=1e-12)
    np.testing.assert_allclose(flight.time, flown["time"], atol=1e-9)


@pytest.mark.parametrize(
    ("column", "factor", "shift", "words"),
    [
        ("phi", DEG, 0, r"phi: .*is (it|phi) in deg\?"),
        ("theta", DEG, 0, r"theta: .*in deg\?"),
        ("alpha", DEG, 0, r"alpha: .*in deg\?"),
        ("delta_a", DEG, 0, r"delta_a: .*in deg\?"),
        ("p", DEG, 0, r"p: .*deg/s"),
        ("temperature", 1, -273.15, r"temperature: .*degC"),
        ("p_static", 0.01, 0, r"p_static: .*hPa"),
        ("V", 3600 / 1852, 0, r"V: 1\.9.*knots"),
        ("V", 3.6, 0, r"V: 3\.6.*km/h"),
        ("V", 1 / 0.3048, 0, r"V: 3\.28.*ft/s"),
        ("az", -1, 0, r"az: positive.*sign = -1"),
        ("p", -1, 0, r"p: turns against phi"),
        ("time", 1000, 0, r"time: 50 s .*ms\?"),
        ("time", 1e6, 0, r"time: .*us\?"),
    ],
)
def test_unit_and_sign_mistakes_are_caught(
    tmp_path: Path, flown: Columns, column: str, factor: float, shift: float, words: str
) -> None:
    wrong = {**flown, column: flown[column] * factor + shift}
    path = write_csv(tmp_path / "log.csv", wrong)
    with pytest.raises(ImportDataError, match=words):
        import_data(path)
    accepted = import_data(path, accept_implausible=True)
    assert any(n.text.startswith(column) for n in accepted.notes)


@pytest.mark.parametrize(("unit", "one_g"), [("g", 1.0), ("ft/s2", 32.174), ("mg", 1000.0), ("cm/s2", 980.665)])
def test_gravity_that_is_not_9_8(tmp_path: Path, flown: Columns, unit: str, one_g: float) -> None:
    wrong = {**flown, **{a: flown[a] / 9.80665 * one_g for a in ("ax", "ay", "az")}}
    with pytest.raises(ImportDataError, match=f"are ax, ay, az in .*{unit}"):
        import_data(write_csv(tmp_path / "log.csv", wrong))


def test_degrees_too_small_to_break_a_limit_are_found_by_the_gyro(tmp_path: Path, flown: Columns) -> None:
    """Bank of at most 1.7 'rad' is possible; but it moves 57 times as far as the gyro turns."""
    gentle = {**flown, "phi": flown["phi"] * DEG / 20, "p": flown["p"] / 20}
    with pytest.raises(ImportDataError, match="phi: moves 57 times as far as p turns"):
        import_data(write_csv(tmp_path / "log.csv", gentle))


def test_a_sound_flight_raises_no_suspicion(root: Path, tmp_path: Path, flown: Columns) -> None:
    assert import_data(write_csv(tmp_path / "log.csv", flown)).notes == ()


def sideways_flight(root: Path) -> Columns:
    """A flight of another simulator, with consistent kinematics and neither dynamic nor GPS speed."""
    flight = read_flight(root / "recordings" / "foreign" / "ordinary_0.csv")
    return {"time": flight.time, **flight.columns}


@pytest.mark.parametrize(("unit", "factor"), [("knots", 3600 / 1852), ("km/h", 3.6), ("mph", 1 / 0.44704)])
def test_speed_in_another_unit_is_told_by_how_the_aircraft_turns(
    root: Path, tmp_path: Path, unit: str, factor: float
) -> None:
    sound = sideways_flight(root)
    assert import_data(write_csv(tmp_path / "sound.csv", sound)).notes == ()
    wrong = {**sound, "V": sound["V"] * factor}
    with pytest.raises(ImportDataError, match=f"turns and slips; is it in .*{unit}"):
        import_data(write_csv(tmp_path / "log.csv", wrong))


def test_tubes_of_a_pitot_that_are_swapped_are_told_and_a_zero_that_drifts_is_not() -> None:
    time = 0.04 * np.arange(500)
    speed = np.where(time < 8.0, 0.0, 17.0 + np.sin(time))
    pressure = 0.58 * speed**2

    def told(p_dynamic: np.ndarray) -> list[str]:
        return [s.text for s in suspicions(time, {"V": speed, "p_dynamic": p_dynamic}) if "tubes" in s.text]

    assert told(-pressure)
    assert not told(pressure - 6.0)


@pytest.mark.parametrize(
    ("columns", "words"),
    [
        ("beta", "beta: turned, it would agree with the sideways motion"),
        ("r", "r: turns against psi"),
        ("r psi", "r: turned, it would agree with the sideways motion that ay, phi and beta make"),
        ("p phi", "phi, p: turned, it would agree .* are the signs of phi and p wrong"),
        ("phi", "phi: turned, it would agree .* is its sign wrong"),
    ],
)
def test_signs_that_contradict_the_motion(root: Path, tmp_path: Path, columns: str, words: str) -> None:
    sound = sideways_flight(root)
    with pytest.raises(ImportDataError, match=words):
        import_data(write_csv(tmp_path / "log.csv", {**sound, **{c: -sound[c] for c in columns.split()}}))


@pytest.mark.parametrize(
    ("columns", "said"),
    [("", []), ("alpha", ["alpha"]), ("q theta", ["q, theta"]), ("q", ["q", "q"]), ("theta", ["q"]), ("az", ["az"])],
)
def test_signs_that_contradict_vertical_motion(columns: str, said: list[str]) -> None:
    """A phugoid and a short period of a point mass: V alpha grows by V q + g cos(theta) + az."""
    rng, time = np.random.default_rng(1), 0.05 * np.arange(601)
    alpha = 0.06 + 0.03 * np.sin(2.1 * time) + 0.01 * np.sin(0.5 * time)
    q = 0.1 * np.sin(1.9 * time + 0.3) + 0.03 * np.sin(0.7 * time)
    theta = 0.05 + np.concatenate([[0.0], np.cumsum(0.025 * (q[1:] + q[:-1]))])
    speed = np.full(601, 16.0)
    made = {"alpha": alpha, "q": q, "theta": theta, "V": speed, "ax": 0.0 * time, "ay": 0.0 * time}
    made["az"] = np.gradient(speed * np.sin(alpha), time) - speed * np.cos(alpha) * q - 9.80665 * np.cos(theta)
    made = {n: v + 0.01 * v.std() * rng.standard_normal(601) for n, v in made.items()}
    made |= {n: -made[n] for n in columns.split()}
    assert [", ".join(s.columns) for s in suspicions(time, made)] == said


@pytest.mark.parametrize("layout", ["spaces", "utf16", "decimal comma", "unit row", "shuffled"])
def test_layouts_that_need_no_mapping(tmp_path: Path, flown: Columns, layout: str, rng: np.random.Generator) -> None:
    theirs_ = {"time": flown["time"], "phi": flown["phi"], "beta": flown["beta"]}
    path = tmp_path / "log.csv"
    if layout == "decimal comma":
        write_csv(path, theirs_, ";", ",")
    else:
        if layout == "unit row":
            theirs_ = {"time": flown["time"] * 1e3, "phi": flown["phi"] * DEG, "beta": flown["beta"] * DEG}
        text = write_csv(path, theirs_).read_text()
        head, *rows = text.splitlines()
        if layout == "shuffled":
            rows = [rows[i] for i in rng.permutation(len(rows))]
        if layout == "unit row":
            rows = ["ms,deg,[deg]", *rows]
        text = "\n".join([head, *rows])
        text = text.replace(",", "  ") if layout == "spaces" else text
        path.write_text(text, encoding="utf-16" if layout == "utf16" else "utf-8")
    flight = import_data(path)
    np.testing.assert_allclose(flight.time, flown["time"], atol=1e-9)
    for name in ("phi", "beta"):
        np.testing.assert_allclose(flight[name], flown[name], rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("layout", ["commas", "semicolons", "blanks and units"])
def test_lines_above_the_column_names_are_passed_over_and_counted(tmp_path: Path, flown: Columns, layout: str) -> None:
    chosen = {n: flown[n] for n in ("time", "phi", "p", "r", "V")}
    text = write_csv(tmp_path / "plain.csv", chosen).read_text()
    preamble = [
        "Date file: /data/flight_10.cdf",
        "4 variables plus time, values each",
        "",
        "Aircraft, X-1, Pilot, N.N.",
        "Mass, 3.5",
    ]
    if layout == "semicolons":
        text = text.replace(",", ";")
    if layout == "blanks and units":
        names, rest = text.split("\n", 1)
        text = "\n".join([names.replace(",", "  "), "S   RAD  RAD/S  RAD/S  M/S", "", rest.replace(",", "  ")])
    path = tmp_path / "log.asc"
    path.write_text("\n".join([*preamble, text]))
    flight = import_data(path)
    assert "4 lines above the column names passed over" in finding_texts(flight.notes)
    for name, values in chosen.items():
        assert np.array_equal(flight.time if name == "time" else flight[name], values)


def test_a_broken_row_is_no_preamble_and_left_out(tmp_path: Path, flown: Columns) -> None:
    lines = write_csv(tmp_path / "log.csv", {n: flown[n] for n in ("time", "phi", "p")}).read_text().splitlines()
    lines[2] = lines[2].rpartition(",")[0]
    path = tmp_path / "log.csv"
    path.write_text("\n".join(lines))
    flight = import_data(path)
    assert len(flight) == len(lines) - 2
    assert any("1 lines without 3 cells left out (the first, of 2, table line 3)" in n.text for n in flight.notes)
    lines[3:9] = [line.rpartition(",")[0] for line in lines[3:9]]
    path.write_text("\n".join(lines))
    with pytest.raises(ImportDataError, match=r"table line 3 has 2 cells, the header has 3; .*header_line"):
        import_data(path)


def test_words_among_numbers_are_not_measured_and_named(tmp_path: Path, flown: Columns) -> None:
    lines = write_csv(tmp_path / "log.csv", {"time": flown["time"], "beta": flown["beta"]}).read_text().splitlines()
    lines[60], lines[61] = lines[60].split(",")[0] + ",ERR", lines[61].split(",")[0] + ",inf"
    (tmp_path / "log.csv").write_text("\n".join(lines))
    flight = import_data(tmp_path / "log.csv")
    assert np.flatnonzero(np.isnan(flight["beta"])).tolist() == [59, 60]
    assert any(
        "column beta: 1 cells that are no numbers (the first 'ERR' in table line 61)" in n.text for n in flight.notes
    )


def test_headers_that_cannot_be_field_names_are_kept_under_plain_ones(tmp_path: Path, flown: Columns) -> None:
    odd = {"time": flown["time"], "phi": flown["phi"], "Höhe (AGL)": flown["V"], "1st": flown["V"], "V.": flown["V"]}
    flight = import_data(write_csv(tmp_path / "log.csv", odd))
    assert {"Hohe_AGL", "_1st", "V_other"} <= set(flight.columns)
    assert any("Höhe (AGL) as Hohe_AGL" in n.text for n in flight.notes)
    write_flight(flight, tmp_path / "flight.mcap")
    np.testing.assert_array_equal(read_flight(tmp_path / "flight.mcap")["Hohe_AGL"], flown["V"])


def test_split_writes_a_file_for_each_stretch(tmp_path: Path, flown: Columns) -> None:
    jumped = {**flown, "time": flown["time"] + np.where(flown["time"] > 10.0, 30.0, 0.0)}
    path = write_csv(tmp_path / "log.csv", jumped)
    done = CliRunner().invoke(import_, [str(path), "-o", str(tmp_path / "out.mcap"), "--split"])
    assert done.exit_code == 0, done.output
    parts = [read_flight(tmp_path / f"out_{i}.mcap") for i in (1, 2)]
    assert [len(p) for p in parts] == [201, 199]
    assert not (tmp_path / "out.mcap").exists()
    assert all(len(p.segments) == 1 for p in parts)


def test_dates_and_large_stamps(tmp_path: Path, flown: Columns) -> None:
    stamps = [f"2026-03-01T10:00:{t:09.6f}" for t in flown["time"]]
    rows = {"when": np.array(stamps), "phi": flown["phi"]}
    path = write_csv(tmp_path / "iso.csv", rows)
    mapping = tmp_path / "m.toml"
    mapping.write_text('format = 1\n[time]\ncolumn = "when"\nunit = "iso"\n[columns]\n')
    np.testing.assert_allclose(import_data(path, mapping).time, flown["time"], atol=1e-6)
    # microseconds since 1970 keep their last digit
    big = write_csv(tmp_path / "us.csv", {"t": 1.7e15 + np.round(flown["time"] * 1e6), "phi": flown["phi"]})
    mapping.write_text('format = 1\n[time]\ncolumn = "t"\nunit = "us"\n[columns]\n')
    np.testing.assert_allclose(import_data(big, mapping).time, flown["time"], atol=1e-9)


def test_a_column_that_is_not_time_is_not_taken_for_it(
    tmp_path: Path, flown: Columns, rng: np.random.Generator
) -> None:
    path = write_csv(tmp_path / "log.csv", {"T": flown["temperature"], "phi": flown["phi"]})
    with pytest.raises(ImportDataError, match="no column 'time'"):
        import_data(path)
    noisy = {**flown, "time": rng.standard_normal(400)}
    with pytest.raises(ImportDataError, match="time: runs backwards"):
        import_data(write_csv(tmp_path / "noisy.csv", noisy))


def test_resampling_averages_fast_channels_and_never_bridges(tmp_path: Path) -> None:
    t = np.arange(0, 20, 0.005)
    vibration = np.sin(2 * np.pi * 21 * t)  # would fold to 1 Hz when every tenth sample were taken
    keep = (t < 8) | (t > 12)
    path = write_csv(tmp_path / "fast.csv", {"time": t[keep], "q": (0.2 * np.sin(t) + vibration)[keep]})
    flight = import_data(path, rate_hz=20)
    np.testing.assert_allclose(np.diff(flight.time), 0.05, atol=1e-9)
    inside = (flight.time < 7.9) | (flight.time > 12.1)
    error = (flight["q"] - 0.2 * np.sin(flight.time))[inside][1:-1]
    assert np.max(np.abs(error)) < 0.06  # sinc of a 50 ms mean at 21 Hz: 0.048
    assert np.isnan(flight["q"][(flight.time > 8.1) & (flight.time < 11.9)]).all()


def test_gap_and_disorder_are_reported(tmp_path: Path, flown: Columns) -> None:
    late = flown["time"] + np.where(flown["time"] > 10, 30.0, 0.0)
    flight = import_data(write_csv(tmp_path / "log.csv", {**flown, "time": late}))
    assert len(flight.segments) == 2
    assert any("gap of 30" in n.text for n in flight.notes)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("format = 1\n[columns]\nV = { column = 'a', unit = 'furlong' }\n", "furlong.*known"),
        ("format = 1\n[columns]\nV = { column = 'a', unit = 'deg' }\n", "not one of m/s"),
        ("format = 1\n[columns]\nV = { colum = 'a' }\n", "colum"),
        ("format = 1\n[columns]\nV = { unit = 'm/s' }\n", "either column or terms"),
        ("format = 1\n[columns\n", "TOML"),
    ],
)
def test_mapping_mistakes_are_named(tmp_path: Path, text: str, words: str) -> None:
    path = tmp_path / "m.toml"
    path.write_text(text)
    with pytest.raises(ImportDataError, match=words) as caught:
        load_map(path)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("", "no table"),
        ("time,phi\n", "no table"),
        ("time,phi\n0,1,2\n", "3 cells"),
        ("a,b\n0,1\n1,2\n", "no column 'time'"),
        ("time,time\n0,1\n1,2\n", "appears twice"),
        ("0,1\n1,2\n2,3\n", "holds numbers, not column names"),
        ("time,ax [deg]\n0,1\n1,2\n", "unit 'deg' is not one of m/s2"),
        ("time,phi\nzero,1\none,2\n", "'zero', not a number"),
        ("time,bank\n0,1\n1,2\n", "knows none of its columns .bank.; name them in a mapping"),
    ],
)
def test_unusable_tables_say_why(tmp_path: Path, content: str, words: str) -> None:
    path = tmp_path / "bad.csv"
    path.write_text(content)
    with pytest.raises(ImportDataError, match=words):
        import_data(path)


def test_unknown_kind_and_missing_file(tmp_path: Path) -> None:
    with pytest.raises(ImportDataError, match="no such file"):
        import_data(tmp_path / "none.csv")
    (tmp_path / "log.xyz").write_text("x")
    with pytest.raises(ImportDataError, match="not known"):
        import_data(tmp_path / "log.xyz")


def test_every_unit_converts_to_its_own_quantity() -> None:
    for name, unit in UNITS.items():
        assert find_unit(name) == unit
        assert conversion(name, "x", unit.si) == (unit.scale, unit.offset)
    assert conversion("knots", "V", "m/s")[0] == pytest.approx(0.514444, rel=1e-5)
    assert conversion("degF", "t", "K")[0] * 212 + conversion("degF", "t", "K")[1] == pytest.approx(373.15)
    assert conversion("rad", "latitude", "deg")[0] == pytest.approx(DEG)
