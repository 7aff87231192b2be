"""Units that the file states or the mapping leaves out, servo outputs as deflections, several files in a row."""

from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from groundstation.cli.import_log import import_
from groundstation.export.run import export_file
from groundstation.flight import Flight, FlightError, read_flight, write_flight
from groundstation.importers.errors import ImportDataError
from groundstation.importers.mapping import example_maps, load_map
from groundstation.importers.run import import_data
from groundstation.importers.series import Log, TimeSeries, held_at
from groundstation.importers.servos import ServoMap, with_servos

Columns = dict[str, np.ndarray]


@pytest.fixture
def exported(tmp_path: Path, flown: Columns) -> Path:
    """A flight with throttle and segment, whose unit is the number 1, exported with its row of units."""
    columns = {n: v for n, v in flown.items() if n != "time"} | {"my_extra": flown["V"] ** 2}
    write_flight(Flight.build("f", flown["time"], columns), tmp_path / "f.mcap")
    export_file(tmp_path / "f.mcap", tmp_path / "f.csv", units_row=True)
    assert (tmp_path / "f.csv").read_text().splitlines()[1].endswith(",1")
    return tmp_path / "f.csv"


def test_a_row_of_units_is_read_back_as_a_flight_and_by_import(exported: Path, flown: Columns) -> None:
    for flight in (read_flight(exported), import_data(exported)):
        for name, values in flown.items():
            if name != "time":
                np.testing.assert_array_equal(flight[name], values, err_msg=name)
        np.testing.assert_array_equal(flight["my_extra"], flown["V"] ** 2)
        assert len(flight) == flown["time"].size


def test_a_row_of_other_units_is_converted_by_import_and_refused_as_a_flight(exported: Path, flown: Columns) -> None:
    lines = exported.read_text().splitlines()
    names, units = lines[0].split(","), lines[1].split(",")
    units[names.index("V")] = "knots"
    exported.write_text("\n".join([lines[0], ",".join(units), *lines[2:]]) + "\n")
    with pytest.raises(
        FlightError, match=r"line 2, column V: 'knots' is not a number, nor the unit m/s.*'sideslip import'"
    ):
        read_flight(exported)
    flight = import_data(exported, accept_implausible=True)
    np.testing.assert_allclose(flight["V"], flown["V"] * 1852 / 3600)


@pytest.mark.parametrize("second", ["0,a,0.1,0", "0,m,0.1,0", "x,y,z,w"])
def test_an_ordinary_row_is_never_taken_for_units(tmp_path: Path, second: str) -> None:
    path = tmp_path / "f.csv"
    path.write_text(f"time,p,q,r\n{second}\n0.1,0,0,0\n0.2,0,0,0\n")
    with pytest.raises(FlightError, match="is not a number"):
        read_flight(path)


def test_a_mapping_without_a_unit_is_told_which_it_can_be(tmp_path: Path) -> None:
    data, mapping = tmp_path / "x.csv", tmp_path / "m.toml"
    data.write_text("time,ROLL\n0,10\n0.1,11\n0.2,12\n")
    mapping.write_text('format = 1\n[columns]\nphi = { column = "ROLL" }\n')
    with pytest.raises(ImportDataError) as told:
        import_data(data, mapping)
    assert "column phi: the mapping does not say in which unit ROLL is" in str(told.value)
    assert 'phi = { column = "ROLL", unit = "rad" }, or one of: rad, deg, mrad, cdeg' in str(told.value)


@pytest.mark.parametrize("head", ["time,ROLL [deg]\n", "time,ROLL\ns,deg\n"])
def test_a_mapping_without_a_unit_takes_that_of_the_file(tmp_path: Path, head: str) -> None:
    data, mapping = tmp_path / "x.csv", tmp_path / "m.toml"
    data.write_text(head + "0,10\n0.1,11\n0.2,12\n")
    name = head.splitlines()[0].split(",")[1]
    mapping.write_text(f'format = 1\n[columns]\nphi = {{ column = "{name}" }}\n')
    np.testing.assert_allclose(import_data(data, mapping)["phi"], np.radians([10, 11, 12]))


def servo(**changes: object) -> ServoMap:
    table = {"column": "C1", "trim": 1520, "travel": [[1100, -24.0], [1900, 22.0]], "unit": "deg"}
    return ServoMap.model_validate({**table, **changes})


def test_a_deflection_is_straight_from_trim_to_either_end() -> None:
    output = np.array([1100.0, 1310.0, 1520.0, 1710.0, 1900.0, 2000.0, 0.0, 65535.0, np.nan])
    expected = np.radians([-24.0, -12.0, 0.0, 11.0, 22.0, 22.0 * 480 / 380, np.nan, np.nan, np.nan])
    np.testing.assert_allclose(servo().deflection(output, 1520.0), expected, atol=1e-12)


def test_normalised_outputs_and_a_travel_the_other_way_round() -> None:
    made = servo(trim=0.1, travel=[[-1.0, 0.4], [1.0, -0.3]], unit="rad")
    np.testing.assert_allclose(made.deflection(np.array([-1.0, 0.1, 1.0]), 0.1), [0.4, 0.0, -0.3], atol=1e-12)


def test_lag_is_that_of_a_first_order_servo() -> None:
    time = np.arange(-50, 50) * 0.02
    log = Log("x", {"C1": TimeSeries(time, np.where(time < 0.09, 1520.0, 1900.0))})
    made, absent = with_servos(log, {"a": servo(lag=0.1), "b": servo(column="C9")})
    step = np.radians(22.0) * (1 - np.exp(-np.clip(time - 0.1, 0, None) / 0.1))
    moved = made.series["servo.a"]
    assert moved.command
    known = time > -0.5  # four lags after the record begins
    # dated back by half of the 20 ms between records
    np.testing.assert_allclose(held_at(moved, time - 0.01)[known], step[known], atol=1e-9)
    assert absent == ("C9",)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"trim": 2000}, "trim 2000 does not lie between the ends of the travel"),
        ({"travel": [[1100, 24.0], [1900, 22.0]]}, "must be of either sign"),
        ({"unit": "m"}, "unit 'm' is not one of rad"),
        ({"travel": [[1100, -24.0], [1900, 22.0]], "unit": "rad"}, "more than 90 deg"),
    ],
)
def test_a_servo_table_that_cannot_be_is_a_sentence(tmp_path: Path, changes: dict[str, object], words: str) -> None:
    table = {"column": "C1", "trim": 1520, "travel": [[1100, -24.0], [1900, 22.0]], "unit": "deg", **changes}
    lines = "\n".join(f"{k} = {v!r}" for k, v in table.items())
    path = tmp_path / "m.toml"
    path.write_text(f"format = 1\n[servos.a]\n{lines}\n")
    with pytest.raises(ImportDataError, match=f"servos.a: .*{words}"):
        load_map(path)


def test_examples_are_sound_and_mix_as_the_signs_say() -> None:
    assert set(example_maps()) == {
        f"{a}-{k}" for a in ("ardupilot", "px4") for k in ("elevon", "conventional", "vtail")
    }
    for name in example_maps():
        chosen = load_map(name)
        assert set(chosen.columns) == {"delta_e", "delta_a", "delta_r"}
        down = {f"servo.{n}": 0.0 for n in chosen.servos}
        for right in [n for n in down if n.endswith("_right") and "tail" not in n]:
            down[right] = 0.1  # the trailing edge of the right side alone goes down: rolls left
        mixed = {c: sum(t.factor * down[t.column] for t in s[0].parts) for c, s in chosen.columns.items()}
        assert mixed["delta_a"] == pytest.approx(0.05)
        assert mixed["delta_r"] == 0.0


def test_files_in_a_row_become_segments(tmp_path: Path, flown: Columns) -> None:
    for i, part in enumerate((slice(0, 150), slice(150, 400))):
        rows = np.column_stack([flown["time"][: part.stop - part.start], flown["p"][part], flown["V"][part]])
        head = "time,p,V" if i else "time,p,speed"
        np.savetxt(tmp_path / f"{i}.csv", rows, delimiter=",", header=head, comments="")
    words = [str(tmp_path / "0.csv"), str(tmp_path / "1.csv"), "-o", str(tmp_path / "both.mcap")]
    done = CliRunner().invoke(import_, words, catch_exceptions=False)
    assert done.exit_code == 0
    flight = read_flight(tmp_path / "both.mcap")
    assert [part.stop - part.start for part in flight.segments] == [150, 250]
    np.testing.assert_allclose(flight["p"], flown["p"])
    assert np.isnan(flight["V"][:150]).all()
    np.testing.assert_allclose(flight["V"][150:], flown["V"][150:])
    assert len(flight.provenance.detail["files"]) == 2


def test_a_time_of_words_alone_is_refused_before_all_is_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("groundstation.importers.formats.tables._CELLS_AT_ONCE", 200)
    path = tmp_path / "words.csv"
    path.write_text("time,p\n" + "ab,1\n" * 150 + "0.05,2\n" * 150)
    with pytest.raises(ImportDataError, match="time column 'time' holds 'ab' and the like, neither numbers nor dates"):
        import_data(path, None)
    path.write_text("time,p\n" + "ab,1\n" * 60 + "".join(f"{0.05 * i},2\n" for i in range(400)))
    with pytest.raises(ImportDataError, match="not a number"):
        import_data(path, None)


def test_a_table_of_one_column_is_no_flight(tmp_path: Path) -> None:
    path = tmp_path / "one.csv"
    path.write_text("time\n" + "".join(f"{0.05 * i}\n" for i in range(100)))
    with pytest.raises(ImportDataError, match="one column only, 'time'"):
        import_data(path, None)
