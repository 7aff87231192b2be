"""The fast road of a CSV gives what the slow one gives, to the bit, or leaves the file to it."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from groundstation.flight import FlightError
from groundstation.flight.files import csv_columns
from groundstation.flight.files.csv_columns import plain_columns
from groundstation.importers.formats import tables
from groundstation.importers.mapping import FileFormat

numbers = st.one_of(
    st.floats(allow_nan=False, allow_infinity=False).map(repr),
    st.integers(-(10**20), 10**20).map(str),
    st.sampled_from(
        ["", "-0", "1e-320", "1.7976931348623157e308", "0.1", ".5", "5.", "1E5", "nan", "NaN", "inf", "-inf"]
    ),
    st.decimals(allow_nan=False, allow_infinity=False, places=17, min_value=-1000, max_value=1000).map(str),
)
odd = st.sampled_from(
    [" 1", "1 ", "+1", "1_0", "0x10", "1e400", "infinity", "nan(1)", "1,", "'1'", '"1"', "one", "1\xa0", "\t2", "-"]
)
rows = st.lists(st.tuples(numbers, numbers, numbers).map(list), max_size=12)


@settings(max_examples=300, deadline=None, derandomize=True)
@given(
    rows,
    st.sampled_from(["\n", "\r\n"]),
    st.booleans(),
    st.none() | st.tuples(st.integers(0, 11), st.integers(0, 2), odd),
)
def test_both_roads_agree(
    tmp_path_factory: pytest.TempPathFactory,
    body: list[list[str]],
    ending: str,
    last: bool,
    spoilt: tuple[int, int, str] | None,
) -> None:
    if spoilt and spoilt[0] < len(body):
        body[spoilt[0]][spoilt[1]] = spoilt[2]
    lines = ["time,p,q", *(",".join(row) for row in body)]
    path = tmp_path_factory.getbasetemp() / "x.csv"
    path.write_text(ending.join(lines) + (ending if last else ""), newline="", encoding="utf-8")
    for read in (_flight_columns, _imported_columns):
        fast = read(path)
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(csv_columns, "plain_columns", lambda *a, **k: None)
            patch.setattr(tables, "plain_columns", lambda *a, **k: None)
            slow = read(path)
        if isinstance(slow, str):
            assert fast == slow
            continue
        assert not isinstance(fast, str), fast
        assert list(fast) == list(slow)
        for name, values in slow.items():
            np.testing.assert_array_equal(fast[name], values)


def _flight_columns(path: Path) -> dict[str, np.ndarray] | str:
    try:
        return csv_columns.read_csv(path, FlightError)
    except FlightError as error:
        return str(error)


def _imported_columns(path: Path) -> dict[str, np.ndarray] | str:
    """Without rows of which nothing was measured, which have no time either."""
    try:
        table = tables.read_table(path, FileFormat())
    except tables.ImportDataError as error:
        return str(error)
    if table.words:
        return f"words {sorted(table.words)}"
    values = np.array(list(table.numeric.values()))
    kept = ~np.isnan(values).all(axis=0)
    return dict(zip(table.numeric, values[:, kept], strict=True))


def test_the_fast_road_is_taken_for_plain_numbers_and_for_nothing_else() -> None:
    assert plain_columns("1,2\n3,4\n", ["a", "b"]) is not None
    for body in ("1,2\n3\n", "1,x\n", "1,2,3\n"):
        assert plain_columns(body, ["a", "b"]) is None
    comma = plain_columns("1,5;2\n", ["a", "b"], delimiter=";", decimal=",")
    assert comma is not None
    assert [c.tolist() for c in comma] == [[1.5], [2.0]]


def test_a_row_of_written_nan_is_a_row_and_one_of_empty_cells_is_none(tmp_path: Path) -> None:
    path = tmp_path / "x.csv"
    path.write_text("time,p\n1,2\nnan,NaN\n,\n3,\n")
    assert csv_columns.read_csv(path, FlightError)["time"].tolist() == pytest.approx([1.0, np.nan, 3.0], nan_ok=True)
    assert plain_columns("1,2\n,\n3,\n", ["a", "b"]) is not None
    assert plain_columns("1,2\nnan,nan\n", ["a", "b"]) is None


def test_reading_numbers_loads_no_arrow() -> None:
    code = (
        "import sys; from groundstation.flight.files.csv_columns import plain_columns as p;"
        "print([c.tolist() for c in p('1,2\\n,\\n3,\\n', ['a', 'b'])], 'pyarrow' in sys.modules)"
    )
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert said == "[[1.0, 3.0], [2.0, nan]] False\n"
