"""Flights: the three file kinds give the same arrays back, and bad files get one clear sentence."""

from pathlib import Path

import numpy as np
import pytest

from groundstation.flight import Flight, FlightError, MissingColumnError, Provenance, read_flight, write_flight

HEADER = "time,p,q\n"


def flight(rng: np.random.Generator, n: int = 50) -> Flight:
    p = rng.normal(size=n)
    p[3] = np.nan
    provenance = Provenance("simulated", aircraft="cdfp", calibration={"pitot.toml": "ab"}, detail={"aligned": True})
    return Flight.build("f", np.arange(n) * 0.05, {"p": p, "strange": p**2}, provenance=provenance)


@pytest.mark.parametrize("suffix", [".mcap", ".csv", ".parquet"])
def test_round_trip(tmp_path: Path, rng: np.random.Generator, suffix: str) -> None:
    before = flight(rng)
    write_flight(before, tmp_path / f"f{suffix}")
    after = read_flight(tmp_path / f"f{suffix}")
    assert np.array_equal(after.time, before.time)
    for name in before.columns:
        assert np.array_equal(after[name], before[name], equal_nan=True)
    assert any("strange" in note for note in after.notes)
    if suffix != ".csv":
        assert after.provenance.source == "simulated"
        assert after.provenance.calibration == {"pitot.toml": "ab"}


def test_a_time_jump_splits_and_is_said(tmp_path: Path) -> None:
    time = np.concatenate([np.arange(100) * 0.05, 35 + np.arange(100) * 0.05])
    f = Flight.build("f", time, {"p": time})
    assert [s.stop - s.start for s in f.segments] == [100, 100]
    assert any("gap of 30" in note for note in f.notes)


def test_unsorted_and_repeated_time_is_mended_and_said() -> None:
    f = Flight.build("f", np.array([0.0, 0.1, 0.1, 0.3, 0.2]), {"p": np.array([0.0, 1.0, 9.0, 3.0, 2.0])})
    assert f.time.tolist() == [0.0, 0.1, 0.2, 0.3]
    assert f["p"].tolist() == [0.0, 1.0, 2.0, 3.0]
    assert any("backwards" in n for n in f.notes)
    assert any("repeated" in n for n in f.notes)


def test_segment_column_splits(tmp_path: Path) -> None:
    rows = "".join(f"{i * 0.1},{i},{0},{i // 5}\n" for i in range(10))
    (tmp_path / "f.csv").write_text("time,p,q,segment\n" + rows)
    assert len(read_flight(tmp_path / "f.csv").segments) == 2


def test_part_renumbers_segments() -> None:
    time = np.concatenate([np.arange(100) * 0.05, 35 + np.arange(100) * 0.05])
    part = Flight.build("f", time, {"p": time}).part(slice(150, 200))
    assert set(part.segment) == {0}
    assert len(part) == 50


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("", "not a header"),
        ("0,1,2\n0,1,2\n", "not a header"),
        (HEADER + "0,1\n", "line 2 has 2 cells"),
        (HEADER + "0,1,2\n0.1,1,fast\n", "line 3, column q: 'fast' is not a number"),
        ("t,p\n0,1\n1,2\n", "no column 'time'"),
        ("time,p,p\n0,1,1\n", "column p appears twice"),
        (HEADER + "0,1,2\n", "only 1 usable samples"),
    ],
)
def test_bad_csv_gets_one_sentence(tmp_path: Path, content: str, words: str) -> None:
    (tmp_path / "f.csv").write_text(content)
    with pytest.raises(FlightError, match=words):
        read_flight(tmp_path / "f.csv")


def test_missing_file_and_unknown_kind(tmp_path: Path) -> None:
    with pytest.raises(FlightError, match="no such file"):
        read_flight(tmp_path / "none.csv")
    with pytest.raises(FlightError, match="not a flight file"):
        read_flight(tmp_path / "f.xls")


@pytest.mark.parametrize("cut", [0, 7, 100, 400, 0.5, 0.9])
def test_truncated_mcap_gets_one_sentence(tmp_path: Path, rng: np.random.Generator, cut: float) -> None:
    path = tmp_path / "f.mcap"
    write_flight(flight(rng), path)
    data = path.read_bytes()
    path.write_bytes(data[: int(cut * len(data)) if 0 < cut < 1 else int(cut)])
    with pytest.raises(FlightError, match=r"damaged|no calibrated flight"):
        read_flight(path)


def test_missing_column_is_named() -> None:
    f = Flight.build("f", np.arange(5.0), {"p": np.full(5, np.nan)})
    with pytest.raises(MissingColumnError, match="columns p, beta missing, needed for model lateral"):
        f.require(["p", "beta"], "model lateral")
