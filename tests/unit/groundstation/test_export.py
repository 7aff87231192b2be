"""Exports are read back by the programs people use, values and units included."""

import struct
import xml.etree.ElementTree as ET
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from groundstation.export.foxglove import quaternion_flu_to_enu, write_foxglove
from groundstation.export.run import ExportError, export_file
from groundstation.export.tracks import utc_offset
from groundstation.flight import Flight, FlightError, read_flight, write_flight
from groundstation.flight.writing import UTC_KEY
from tests.support.paths import RECORDINGS

RAW = RECORDINGS / "cdfp_ld4_raw.mcap"
GPX = "{http://www.topografix.com/GPX/1/1}"


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One raw recording in all formats, side by side."""
    folder = tmp_path_factory.mktemp("exported")
    for suffix in ("csv", "parquet", "mat", "kml", "gpx", "mcap"):
        export_file(RAW, folder / f"flight.{suffix}", units_row=True)
    return folder


@pytest.fixture(scope="module")
def flight(exported: Path) -> Flight:
    return read_flight(exported / "flight.mcap")


class TestTables:
    def test_duckdb_reads_parquet_and_pyarrow_its_units(self, exported: Path, flight: Flight) -> None:
        import duckdb
        import pyarrow.parquet as pq

        path = exported / "flight.parquet"
        rows, top = duckdb.sql(f"select count(beta), max(V) from '{path}'").fetchall()[0]
        assert rows == int(np.isfinite(flight["beta"]).sum())
        assert top == np.nanmax(flight["V"])
        field = pq.read_schema(path).field("beta")
        assert field.metadata[b"unit"] == b"rad"
        assert b"from the right" in field.metadata[b"meaning"]

    def test_matlab_struct_by_scipy(self, exported: Path, flight: Flight) -> None:
        from scipy.io import loadmat

        struct = loadmat(exported / "flight.mat", simplify_cells=True)["flight"]
        np.testing.assert_array_equal(struct["p"], flight["p"])
        assert struct["units"]["p"] == "rad/s"
        assert struct["about"]["aircraft"] == "cdfp"
        assert set(flight.columns) < set(struct)

    def test_tables_carry_utc_where_the_flight_knows_it(self, exported: Path, flight: Flight, tmp_path: Path) -> None:
        import duckdb
        from scipy.io import loadmat

        offset = utc_offset(flight)
        assert offset is not None
        expected = np.round(flight.time + offset, 6)
        struct = loadmat(exported / "flight.mat", simplify_cells=True)["flight"]
        np.testing.assert_array_equal(struct["utc_time"], expected)
        assert struct["units"]["utc_time"] == "s"
        path = exported / "flight.parquet"
        first, year = duckdb.sql(
            f"select utc_time, year(to_timestamp(utc_time)) from '{path}' order by time limit 1"
        ).fetchall()[0]
        assert (first, year) == (expected[0], datetime.fromtimestamp(expected[0], UTC).year)
        detail = {k: v for k, v in flight.provenance.detail.items() if k != UTC_KEY}
        lost = replace(flight, provenance=replace(flight.provenance, detail=detail))
        write_flight(lost, tmp_path / "lost.mcap")
        export_file(tmp_path / "lost.mcap", tmp_path / "lost.csv")
        assert "utc_time" not in (tmp_path / "lost.csv").read_text().splitlines()[0]

    def test_csv_has_units_in_its_second_line(self, exported: Path, flight: Flight) -> None:
        lines = (exported / "flight.csv").read_text().splitlines()
        units = dict(zip(lines[0].split(","), lines[1].split(","), strict=True))
        assert (units["time"], units["beta"], units["V"], units["mx"]) == ("s", "rad", "m/s", "T")
        assert len(lines) == len(flight) + 2

    def test_counts_as_recorded(self, tmp_path: Path) -> None:
        import pyarrow.parquet as pq

        export_file(RAW, tmp_path / "counts.parquet", raw=True)
        table = pq.read_table(tmp_path / "counts.parquet")
        assert table.schema.field("alpha_vane").metadata[b"unit"] == b"count"
        values = table["alpha_vane"].drop_null().to_numpy()
        assert np.array_equal(values, np.round(values))
        assert table["scan"].to_pylist() == list(range(len(table)))

    def test_name_that_matlab_cannot_take_is_told(self, tmp_path: Path) -> None:
        time = np.arange(5.0)
        made = Flight.build("odd", time, {"p": time, "no name": time})
        write_flight(made, tmp_path / "odd.csv")
        done = export_file(tmp_path / "odd.csv", tmp_path / "odd.mat")
        assert done.notes == ("column no name: no name that MATLAB takes, left out",)


class TestTracks:
    def test_gpx_has_the_fixes_at_their_utc(self, exported: Path, flight: Flight) -> None:
        points = list(ET.parse(exported / "flight.gpx").iter(f"{GPX}trkpt"))
        known = np.flatnonzero(np.isfinite(flight["latitude"]))
        assert len(points) == known.size
        assert float(points[0].attrib["lat"]) == pytest.approx(flight["latitude"][known[0]], abs=1e-9)
        stamp = points[-1].findtext(f"{GPX}time")
        assert stamp is not None
        offset = utc_offset(flight)
        assert offset is not None
        seconds = datetime.fromisoformat(stamp).timestamp()
        assert seconds == pytest.approx(flight.time[known[-1]] + offset, abs=2e-3)
        assert stamp.startswith("2026-")

    def test_kml_has_a_track_with_times_or_a_line_without(self, exported: Path, flight: Flight, tmp_path: Path) -> None:
        text = (exported / "flight.kml").read_text()
        assert text.count("<when>") == text.count("<gx:coord>") > 100
        detail = {k: v for k, v in flight.provenance.detail.items() if k != UTC_KEY}
        untimed = replace(flight, provenance=replace(flight.provenance, detail=detail))
        write_flight(untimed, tmp_path / "untimed.mcap")
        done = export_file(tmp_path / "untimed.mcap", tmp_path / "line.kml")
        assert "UTC" in done.notes[0]
        assert "<when>" not in (tmp_path / "line.kml").read_text()

    def test_flight_without_positions_is_refused(self, tmp_path: Path) -> None:
        with pytest.raises(FlightError, match="no latitude and longitude"):
            export_file(RECORDINGS / "foreign" / "ordinary_0.csv", tmp_path / "x.gpx")


def test_a_recording_of_rerun_is_not_exported_to_itself(tmp_path: Path) -> None:
    (tmp_path / "a.rrd").write_bytes(b"RRF2")
    with pytest.raises(ExportError, match="already"):
        export_file(tmp_path / "a.rrd", tmp_path / "b.rrd")
    assert not (tmp_path / "b.rrd").exists()


class TestFoxglove:
    @pytest.mark.parametrize(
        "events", [7, [1], [{"time": "now", "text": "x"}], [{"time": 1e300, "text": "x"}], [{"time": 1.0}]]
    )
    def test_malformed_events_of_a_flight_are_left_out(self, flight: Flight, tmp_path: Path, events: object) -> None:
        detail = {**flight.provenance.detail, "events": events}
        short = replace(flight.part(slice(0, 20)), provenance=replace(flight.provenance, detail=detail))
        write_foxglove(short, tmp_path / "flight.mcap")
        assert len(read_flight(tmp_path / "flight.mcap")) == 20

    def test_stock_decoder_finds_map_pose_events_and_scalars_in_utc(self, exported: Path, flight: Flight) -> None:
        from mcap.reader import make_reader
        from mcap_protobuf.decoder import DecoderFactory

        seen: dict[str, list[Any]] = {}
        with (exported / "flight.mcap").open("rb") as handle:
            reader = make_reader(handle, decoder_factories=[DecoderFactory()])
            summary = reader.get_summary()
            assert summary is not None
            topics = [c.topic for c in summary.channels.values() if c.message_encoding == "protobuf"]
            for schema, channel, message, decoded in reader.iter_decoded_messages(topics=topics):
                assert schema is not None
                seen.setdefault(channel.topic, []).append((schema.name, message.log_time, decoded))
        assert {topic: rows[0][0] for topic, rows in seen.items()} == {
            "/flight": "sideslip.FlightSample",
            "/gnss/fix": "foxglove.LocationFix",
            "/tf": "foxglove.FrameTransform",
            "/events": "foxglove.Log",
        }
        offset = utc_offset(flight)
        assert offset is not None
        assert seen["/flight"][0][1] * 1e-9 == pytest.approx(flight.time[0] + offset, abs=1e-6)
        assert len(seen["/flight"]) == len(flight)
        stamp = seen["/gnss/fix"][0][2].timestamp
        assert stamp.ToNanoseconds() == seen["/gnss/fix"][0][1]

    def test_rerun_s_own_importer_shows_scalars_by_name_and_unit(self, exported: Path, flight: Flight) -> None:
        from rerun.chunk import McapReader

        lines: dict[str, list[str]] = {}
        values: dict[str, list[Any]] = {}
        times: list[Any] = []
        for chunk in McapReader(exported / "flight.mcap").stream().to_chunks():
            batch = chunk.to_record_batch().to_pydict()
            if "SeriesLines:names" in batch:
                lines[chunk.entity_path] = batch["SeriesLines:names"][0]
            if "Scalars:scalars" in batch:
                values.setdefault(chunk.entity_path, []).extend(batch["Scalars:scalars"])
                if chunk.entity_path == "/scalars/rates/position":
                    times.extend(batch["message_log_time"])
        assert lines["/scalars/rates/position"] == ["p [rad/s]", "q [rad/s]", "r [rad/s]"]
        found = np.array(values["/scalars/rates/position"])
        np.testing.assert_array_equal(found, np.column_stack([flight[n] for n in "pqr"]))
        assert {str(t)[:4] for t in times} == {"2026"}
        assert len(values["/scalars/gnss/position/position"]) == np.isfinite(flight["latitude"]).sum()

    def test_a_column_of_one_s_own_is_a_scalar_too(self, flight: Flight, tmp_path: Path) -> None:
        from mcap.reader import make_reader

        added = replace(flight, columns={**flight.columns, "torque": np.full(len(flight), 2.5)})
        write_flight(added, tmp_path / "own.mcap")
        export_file(tmp_path / "own.mcap", tmp_path / "out.mcap")
        with (tmp_path / "out.mcap").open("rb") as handle:
            found = next(iter(make_reader(handle).iter_messages(topics=["/scalars/others"])))
        assert found[2].data[12:].count(b"torque\0") == 1
        assert struct.pack("<d", 2.5) in found[2].data

    def test_a_flight_itself_is_filed_under_utc_where_it_is_known(self, flight: Flight, tmp_path: Path) -> None:
        from mcap.reader import make_reader

        offset = utc_offset(flight)
        assert offset is not None
        for told, wanted in ((offset, offset), (1e300, 0.0), ("soon", 0.0)):
            detail = {**flight.provenance.detail, UTC_KEY: told}
            timed = replace(flight, provenance=replace(flight.provenance, detail=detail))
            write_flight(timed, tmp_path / "timed.mcap")
            with (tmp_path / "timed.mcap").open("rb") as handle:
                stamps = [m.log_time * 1e-9 for _, _, m in make_reader(handle).iter_messages()]
            np.testing.assert_allclose(stamps, flight.time + wanted, atol=1e-6, rtol=0)

    def test_still_a_flight(self, flight: Flight, tmp_path: Path) -> None:
        write_flight(flight, tmp_path / "plain.mcap")
        plain = read_flight(tmp_path / "plain.mcap")
        for name in flight.columns:
            np.testing.assert_array_equal(plain[name], flight[name])

    def test_attitude_against_rotation_matrices(self) -> None:
        rng = np.random.default_rng(3)
        phi, theta, psi = rng.uniform(-3, 3, 50), rng.uniform(-1.5, 1.5, 50), rng.uniform(-3, 3, 50)
        found = quaternion_flu_to_enu(phi, theta, psi)
        ned_from_frd = Rotation.from_euler("ZYX", np.column_stack([psi, theta, phi]))
        enu_from_ned = Rotation.from_matrix([[0, 1, 0], [1, 0, 0], [0, 0, -1]])
        frd_from_flu = Rotation.from_matrix(np.diag([1.0, -1.0, -1.0]))
        wanted = (enu_from_ned * ned_from_frd * frd_from_flu).as_quat(scalar_first=True)
        np.testing.assert_allclose(np.abs(np.sum(found * wanted, axis=1)), 1.0, atol=1e-12)


class TestRefusals:
    def test_unknown_ending(self, tmp_path: Path) -> None:
        with pytest.raises(ExportError, match=r"\.csv \.parquet \.mat"):
            export_file(RAW, tmp_path / "flight.xlsx")

    def test_onto_itself(self, tmp_path: Path) -> None:
        copy = tmp_path / "flight.mcap"
        copy.write_bytes((RECORDINGS / "cdfp_ld4.mcap").read_bytes())
        with pytest.raises(ExportError, match="another name"):
            export_file(copy, copy)
        assert copy.read_bytes() == (RECORDINGS / "cdfp_ld4.mcap").read_bytes()
