"""Flights: the three file kinds give the same arrays back, and bad files get one clear sentence."""

import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass

from groundstation.flight import Flight, FlightError, MissingColumnError, Provenance, read_flight, write_flight
from groundstation.flight.files.reading import named_aircraft
from groundstation.flight.writing import FLIGHT_SCHEMA, _encoded_rows, _schema
from tests.support.paths import ROOT

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
    assert any("strange" in note.text for note in after.notes)
    if suffix != ".csv":
        assert after.provenance.source == "simulated"
        assert after.provenance.calibration == {"pitot.toml": "ab"}


@pytest.mark.parametrize(("rows", "columns"), [(0, 3), (1, 1), (40, 17), (9, 2101)])
def test_rows_are_encoded_as_protobuf_encodes_them(rows: int, columns: int, rng: np.random.Generator) -> None:
    """Tags of one to three bytes; any value, and none."""
    table = rng.normal(size=(rows, columns)) * 10.0 ** rng.integers(-300, 300, (rows, columns))
    table[rng.random(table.shape) < 0.3] = np.nan
    table[rng.random(table.shape) < 0.1] = -0.0
    table[rng.random(table.shape) < 0.1] = np.inf
    names = [f"column_{i}" for i in range(columns)]
    pool = DescriptorPool()
    pool.Add(FileDescriptorSet.FromString(_schema(names)).file[0])
    made = GetMessageClass(pool.FindMessageTypeByName(FLIGHT_SCHEMA))
    expected = [made(**{n: v for n, v in zip(names, row, strict=True) if v == v}) for row in table.tolist()]
    assert list(_encoded_rows(table)) == [message.SerializeToString(deterministic=True) for message in expected]


@pytest.mark.parametrize("suffix", [".mcap", ".parquet", ".csv"])
@pytest.mark.parametrize("aircraft", ["", "glider"])
def test_the_aircraft_of_a_file_is_that_of_the_flight_in_it(tmp_path: Path, aircraft: str, suffix: str) -> None:
    time = np.arange(40) / 20
    flight = Flight.build("a", time, {"p": np.sin(time)}, provenance=Provenance(aircraft=aircraft))
    path = tmp_path / f"a{suffix}"
    write_flight(flight, path)
    assert named_aircraft(path) == read_flight(path).provenance.aircraft


@pytest.mark.parametrize("content", [b"", b"no flight at all", b"\x89MCAP0\r\n" + bytes(60)])
def test_of_what_is_no_flight_no_aircraft_is_read(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(content)
    with pytest.raises(FlightError):
        named_aircraft(path)


def test_a_time_jump_splits_and_is_said(tmp_path: Path) -> None:
    time = np.concatenate([np.arange(100) * 0.05, 35 + np.arange(100) * 0.05])
    f = Flight.build("f", time, {"p": time})
    assert [s.stop - s.start for s in f.segments] == [100, 100]
    assert any("gap of 30" in note.text for note in f.notes)


def test_unsorted_and_repeated_time_is_mended_and_said() -> None:
    f = Flight.build("f", np.array([0.0, 0.1, 0.1, 0.3, 0.2]), {"p": np.array([0.0, 1.0, 9.0, 3.0, 2.0])})
    assert f.time.tolist() == [0.0, 0.1, 0.2, 0.3]
    assert f["p"].tolist() == [0.0, 1.0, 2.0, 3.0]
    assert any("backwards" in n.text for n in f.notes)
    assert any("repeated" in n.text for n in f.notes)


def test_segment_column_splits(tmp_path: Path) -> None:
    rows = "".join(f"{i * 0.1},{i},{0},{i // 5}\n" for i in range(10))
    (tmp_path / "f.csv").write_text("time,p,q,segment\n" + rows)
    assert len(read_flight(tmp_path / "f.csv").segments) == 2


def test_part_renumbers_segments() -> None:
    time = np.concatenate([np.arange(100) * 0.05, 35 + np.arange(100) * 0.05])
    part = Flight.build("f", time, {"p": time}).part(slice(150, 200))
    assert set(part.segment) == {0}
    assert len(part) == 50


def test_part_by_a_mask_is_never_joined_across_what_was_left_out() -> None:
    time = np.arange(400) * 0.05
    whole = Flight.build("f", time, {"p": time})
    part = whole.part((time < 4.0) | ((time > 8.0) & (time < 12.0)) | (time > 15.0))
    assert [part.time[s.start] for s in part.segments] == pytest.approx([0.0, 8.05, 15.05])
    single_rows = np.arange(400) % 7 != 3
    assert len(whole.part(single_rows).segments) == 1  # rows lost one by one leave no gap
    assert len(whole.part(np.arange(400) % 5 == 0).segments) == 1  # nor does a lower rate


def test_part_may_be_empty() -> None:
    time = np.arange(10) * 0.05
    part = Flight.build("f", time, {"p": time}).part(time > 99.0)
    assert len(part) == 0
    assert part.segments == (slice(0, 0),)


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


@pytest.fixture(scope="module")
def recorded() -> Flight:
    return read_flight(ROOT / "recordings" / "cdfp_ld1.mcap")


class TestForOtherLibraries:
    """A flight in a notebook: short to print, and a table to pandas, xarray, polars, DuckDB and other processes."""

    def test_repr_is_one_short_line(self, recorded: Flight) -> None:
        assert repr(recorded).startswith("<Flight 'cdfp_ld1': 594 samples, 29.65 s at 20.0 Hz, 1 segment, ")
        assert len(repr(recorded)) < 200

    def test_html_escapes_what_a_file_says(self, recorded: Flight) -> None:
        evil = replace(recorded, name="<script>x</script>").with_notes("<b>bold</b>")
        page = evil._repr_html_()
        assert "<script>" not in page
        assert "<b>" not in page
        assert page.count("<tr>") == 1 + sum(map(recorded.measured, recorded.columns))

    def test_pandas_and_xarray_carry_units(self, recorded: Flight) -> None:
        frame, data = recorded.to_pandas(), recorded.to_xarray()
        np.testing.assert_array_equal(frame["beta"].to_numpy(), recorded["beta"])
        np.testing.assert_array_equal(data["beta"].to_numpy(), recorded["beta"])
        assert frame.attrs["units"]["beta"] == data["beta"].attrs["units"] == "rad"
        assert frame.index.name == "time"
        assert data.attrs["aircraft"] == "cdfp"

    def test_arrow_stream_feeds_polars_and_duckdb(self, recorded: Flight) -> None:
        import duckdb
        import polars as pl

        table = pl.DataFrame(recorded)
        np.testing.assert_array_equal(table["p"].to_numpy(), recorded["p"])
        assert table["phi"].null_count() == int(np.isnan(recorded["phi"]).sum())
        assert duckdb.sql("select count(*) from recorded").fetchall() == [(len(recorded),)]

    def test_goes_to_another_process_and_back(self, recorded: Flight) -> None:
        again = pickle.loads(pickle.dumps(recorded))
        assert again.name == recorded.name
        assert again.provenance.detail["session"] == recorded.provenance.detail["session"]
        np.testing.assert_array_equal(again["V"], recorded["V"])

    def test_plot_gives_axes_in_degrees_and_joins_no_segments(self, recorded: Flight) -> None:
        import matplotlib as mpl

        mpl.use("Agg")
        from matplotlib import pyplot as plt

        axes = recorded.plot("beta", "V")
        assert [a.get_ylabel() for a in axes] == ["beta [deg]", "V [m/s]"]
        assert len(axes[0].lines) == len(recorded.segments)
        with pytest.raises(MissingColumnError, match="nothing"):
            recorded.plot("nothing")
        with pytest.raises(FlightError, match="2 columns"):
            recorded.plot("beta", "V", ax=axes[0])
        plt.close("all")


@pytest.mark.parametrize("ending", ["mcap", "csv", "parquet"])
def test_a_flight_that_cannot_be_written_leaves_the_old_one(
    ending: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = Flight.build("x", np.arange(5) * 0.05, {"p": np.arange(5.0)})
    path = tmp_path / f"x.{ending}"
    write_flight(made, path)
    old = path.read_bytes()

    def fail(descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("daq.utilities.durable.os.fsync", fail)
    with pytest.raises(FlightError, match="No space left"):
        write_flight(made.with_columns(q=np.ones(5)), path)
    assert path.read_bytes() == old
    assert [f.name for f in tmp_path.iterdir()] == [path.name]


def test_a_flight_goes_through_a_link(tmp_path: Path) -> None:
    made = Flight.build("x", np.arange(5) * 0.05, {"p": np.arange(5.0)})
    (tmp_path / "real.csv").write_text("")
    (tmp_path / "link.csv").symlink_to(tmp_path / "real.csv")
    write_flight(made, tmp_path / "link.csv")
    assert (tmp_path / "link.csv").is_symlink()
    assert read_flight(tmp_path / "real.csv")["p"][3] == 3.0
