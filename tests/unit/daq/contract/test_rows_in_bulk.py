"""Rows of a flight are decoded many at once where they are laid out alike, and give what one by one gives."""

from pathlib import Path

import numpy as np
import pytest

from daq.contract.recordings import flight_rows as rows_of
from daq.contract.recordings.segments import FLIGHT_TOPIC, RecordingWalk

NAMES = {"time": 1, "p": 2, "V": 20, "alpha": 300, "far": 4000}


def encoded(columns: tuple[str, ...], values: np.ndarray) -> bytes:
    """A row as protobuf writes it: a key as varint, eight bytes of a double, for each column."""
    row = b""
    for name, value in zip(columns, values, strict=True):
        key = NAMES[name] << 3 | 1
        while key > 0x7F:
            row, key = row + bytes([key & 0x7F | 0x80]), key >> 7
        row += bytes([key]) + np.array([value]).tobytes()
    return row


def segment(monkeypatch: pytest.MonkeyPatch, rows: list[bytes]) -> RecordingWalk:
    monkeypatch.setattr(rows_of, "_columns", lambda _: NAMES)
    return RecordingWalk(Path("made"), 10_000, None, (), {}, (), True, auxiliary={FLIGHT_TOPIC: tuple(rows)})


LAYOUTS = [("time", "p", "V", "alpha", "far"), ("time", "p"), ("time", "V"), (), ("p", "time", "alpha")]


def test_rows_of_any_layout_are_read_as_one_by_one(monkeypatch: pytest.MonkeyPatch, rng: np.random.Generator) -> None:
    rows = []
    for i in range(400):
        columns = LAYOUTS[int(rng.integers(len(LAYOUTS)))]
        rows.append(encoded(columns, rng.standard_normal(len(columns)) if i % 7 else np.full(len(columns), np.inf)))
    walk = segment(monkeypatch, rows)
    bulk = rows_of.flight_rows(walk)
    monkeypatch.setattr(rows_of, "_rows_in_bulk", lambda rows, *_: range(len(rows)))
    assert np.array_equal(bulk.values, rows_of.flight_rows(walk).values, equal_nan=True)
    assert np.isfinite(bulk.values[:, 0]).sum() > 200


@pytest.mark.parametrize(
    "odd", [b"\x0d\x00\x00\x00\x00", b"\x18\x07", encoded(("time",), np.ones(1)) * 2, b"\xa1\x9c\x01" + bytes(8)]
)
def test_what_we_do_not_write_is_left_to_protobuf(monkeypatch: pytest.MonkeyPatch, odd: bytes) -> None:
    """Another wire type, an integer, a column twice, a column that the schema does not name."""
    plain = encoded(("time", "p"), np.array([3.0, 4.0]))
    values = rows_of.flight_rows(segment(monkeypatch, [plain, plain + odd, odd, plain])).values
    assert values[0].tolist()[:2] == values[3].tolist()[:2] == [3.0, 4.0]


def test_a_row_that_is_none_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    plain = encoded(("time", "p"), np.array([3.0, 4.0]))
    with pytest.raises(rows_of.FlightRowsError, match="row 2 of the flight is none"):
        rows_of.flight_rows(segment(monkeypatch, [plain, plain, plain[:-3]]))
