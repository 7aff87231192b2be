"""Flight files that are damaged or odd: one sentence, never another value and never a traceback."""

from pathlib import Path

import numpy as np
import pytest

from groundstation.flight import Flight, FlightError, Provenance, read_flight, write_flight
from groundstation.flight.flight import BACK, CHANNELS, HELD, INTERVAL
from groundstation.flight.quality import quality_report


@pytest.mark.parametrize("number", [np.nan, np.inf, -1.0, 0.0, 10**400, "0.04", None])
def test_numbers_of_a_provenance_that_cannot_be_are_not_used(number: object) -> None:
    stated = {"from": "servo", "kind": "measured", HELD: True, INTERVAL: number, BACK: number}
    counts = {key: {"p": number} for key in ("clipped", "extrapolated", "sensor_noise")}
    provenance = Provenance(detail={CHANNELS: {"delta_a": stated}, **counts})
    time = np.arange(200) * 0.05
    columns = {"delta_a": 0.1 * np.sin(time), "p": np.random.default_rng(1).standard_normal(200)}
    flight = Flight.build("x", time, columns, provenance=provenance)
    assert flight.held("delta_a") is None
    assert flight.dated_back("delta_a") == 0.0
    texts = [f.text for f in quality_report(flight)]
    assert not any("end of the sensor's range" in text or "outside the calibrated range" in text for text in texts)


def test_damaged_flight_files_never_give_other_values(tmp_path: Path, rng: np.random.Generator) -> None:
    flight = Flight.build("x", np.arange(60) * 0.05, {"p": rng.standard_normal(60), "V": np.full(60, 15.0)})
    write_flight(flight, tmp_path / "good.mcap")
    good = np.frombuffer((tmp_path / "good.mcap").read_bytes(), np.uint8)
    read = 0
    for i in range(300):
        data = good.copy()
        if i % 3 == 0:
            data = data[: rng.integers(0, data.size)]
        else:
            for at in rng.integers(0, data.size, 1 + i % 4):
                data[at] ^= 1 << rng.integers(0, 8)
        path = tmp_path / "bad.mcap"
        path.write_bytes(data.tobytes())
        try:
            again = read_flight(path)
        except FlightError:
            continue
        read += 1
        for column in again.columns:
            if column in flight.columns:
                np.testing.assert_array_equal(again[column], flight[column])
    assert read < 150


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('time,p\n0,"' + "1" * 200_000 + '"\n', "not a readable CSV"),
        ("time,p,segment\n0,1,0.5\n0.05,1,1\n", "fractions"),
        ("time,p,segment\n0,1,0\n0.05,1,1e300\n", "number segments from 0"),
    ],
)
def test_odd_tables_are_refused(tmp_path: Path, text: str, words: str) -> None:
    (tmp_path / "x.csv").write_text(text)
    with pytest.raises(FlightError, match=words):
        read_flight(tmp_path / "x.csv")


def test_infinite_values_are_not_measured(tmp_path: Path) -> None:
    (tmp_path / "x.csv").write_text("time,p\n0,1\n0.05,inf\n0.1,2\n")
    flight = read_flight(tmp_path / "x.csv")
    assert np.isnan(flight["p"][1])
    assert any("infinite" in n.text for n in flight.notes)


def test_notes_survive_a_round_trip_once(tmp_path: Path) -> None:
    time = np.concatenate([np.arange(40), np.arange(100, 140)]) * 0.05
    flight = Flight.build("x", time, {"p": np.ones(80)}, notes=["pitot: 3 samples extrapolated"])
    write_flight(flight, tmp_path / "x.mcap")
    assert read_flight(tmp_path / "x.mcap").notes == flight.notes


def test_place_that_cannot_be_written_is_said(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("x")
    with pytest.raises(FlightError, match="cannot be written"):
        write_flight(Flight.build("x", np.arange(3.0), {"p": np.ones(3)}), tmp_path / "file" / "x.csv")
