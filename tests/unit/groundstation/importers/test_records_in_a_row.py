"""Files of several records, without a header line, or without a time."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from groundstation.flight.contradictions import CONTRADICTIONS, Contradiction
from groundstation.importers.errors import ImportDataError
from groundstation.importers.records import joined_flights
from groundstation.importers.run import import_data

RATE = 25.0


def write(path: Path, table: np.ndarray, header: str = "", delimiter: str = " ") -> Path:
    np.savetxt(path, table, delimiter=delimiter, header=header, comments="", fmt="%.9g")
    return path


def mapping(folder: Path, text: str) -> Path:
    path = folder / "map.toml"
    path.write_text(f"format = 1\n{text}", encoding="utf-8")
    return path


def records(*lengths: int) -> np.ndarray:
    rows = [np.column_stack([np.arange(n) / RATE, np.sin(np.arange(n)), np.cos(np.arange(n))]) for n in lengths]
    return np.concatenate(rows)


def test_time_that_begins_anew_starts_a_segment(tmp_path: Path) -> None:
    table = records(60, 40, 50)
    data = write(tmp_path / "r.csv", table, "T,ROLL,YAW", ",")
    chosen = mapping(
        tmp_path,
        '[time]\ncolumn = "T"\nrestarts = true\n[columns]\np = { column = "ROLL", unit = "deg/s" }\n'
        'r = { column = "YAW", unit = "deg/s" }\n',
    )
    flight = import_data(data, chosen)
    assert [part.stop - part.start for part in flight.segments] == [60, 40, 50]
    assert np.all(np.diff(flight.time) > 0)
    assert flight.sample_interval == pytest.approx(1 / RATE)
    assert np.allclose(flight["p"], np.radians(table[:, 1]))
    assert "record number" not in flight.columns
    once = write(tmp_path / "once.csv", records(60), "T,ROLL,YAW", ",")
    with pytest.raises(ImportDataError, match="time never begins anew"):
        import_data(once, chosen)


def test_a_table_of_bare_numbers_gets_names_rate_and_records_from_the_mapping(tmp_path: Path) -> None:
    table = records(60, 40)[:, 1:]
    data = write(tmp_path / "bare.asc", table)
    text = 'segment_rows = [60, 40]\n[file]\nnames = ["ROLL", "YAW"]\n[time]\nrate_hz = 25\n'
    columns = '[columns]\np = { column = "ROLL", unit = "deg/s" }\n'
    flight = import_data(data, mapping(tmp_path, text + columns))
    assert [part.stop - part.start for part in flight.segments] == [60, 40]
    assert flight.time[1] == pytest.approx(0.04)
    assert np.allclose(flight["YAW"], table[:, 1])
    with pytest.raises(ImportDataError, match="adds up to 90 rows; the file has 100"):
        import_data(data, mapping(tmp_path, text.replace("60", "50") + columns))
    with pytest.raises(ImportDataError, match="names = "):
        import_data(data)
    with pytest.raises(ImportDataError, match="either column, or rate_hz"):
        import_data(data, mapping(tmp_path, '[time]\ncolumn = "T"\nrate_hz = 25\n' + columns))


def test_later_records_bring_the_origins_of_their_columns_and_their_contradictions(tmp_path: Path) -> None:
    text = (
        '[columns]\np = { column = "ROLL", unit = "deg/s" }\ndelta_e = { column = "ELEV", unit = "deg", hold = true }\n'
    )
    chosen = mapping(tmp_path, '[time]\ncolumn = "T"\n' + text)
    first = import_data(write(tmp_path / "a.csv", records(60)[:, :2], "T,ROLL", ","), chosen)
    second = import_data(write(tmp_path / "b.csv", records(60), "T,ROLL,ELEV", ","), chosen)
    found = [Contradiction(("a", "b"), "a is twice b").to_json(), Contradiction(("c", "d"), "c is twice d").to_json()]
    parts = [
        replace(f, provenance=replace(f.provenance, detail={**f.provenance.detail, CONTRADICTIONS: found[i : i + 1]}))
        for i, f in enumerate((first, second))
    ]
    joined = joined_flights(parts)
    assert joined.held("delta_e") == second.held("delta_e") == pytest.approx(1 / RATE)
    assert list(joined.provenance.detail["mapping"]) == ["p", "delta_e"]
    assert joined.provenance.detail[CONTRADICTIONS] == found
