"""Files as rescue tools leave them: codes of records altered, sectors out of order, several recordings in one file.

The oracle is independent of the reader: a scan is intact when its encoded bytes are still in the file.
"""

import struct
from pathlib import Path

import pytest
import zstandard

from daq import commands
from daq.contract.recordings.accounting import verify
from daq.contract.recordings.mcap_records import ATTACHMENT_INDEX, CHUNK, METADATA_INDEX, STATISTICS, SUMMARY_OFFSET
from daq.contract.recordings.reading import read_recording, read_recordings
from daq.contract.recordings.recording import LogTime, RecordingError, RecordingWriter, scan_entry
from daq.contract.recordings.recovery import recover
from daq.contract.recordings.segments import read_parts
from daq.contract.recordings.summary import info_mcap
from daq.contract.scan import encode_scan
from groundstation.calibration.recording import calibrate_recording
from groundstation.receiver.storage.recording import ReceivedWriter
from groundstation.viewer.recorded import as_rrd
from tests.unit.daq.synthetic import PER_CHUNK, SCANS, make_info, make_scan, write_recording

OTHER_FIRST, OTHER_SCANS = 500, 60


@pytest.fixture(scope="module")
def other(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    path = tmp_path_factory.mktemp("other") / "other_000.mcap"
    with path.open("wb") as stream:
        writer = RecordingWriter(stream, make_info("other"))
        for n in range(OTHER_FIRST, OTHER_FIRST + OTHER_SCANS):
            writer.write(scan_entry(make_scan(n)))
            if n % PER_CHUNK == 0:
                writer.flush()
        writer.finish()
    return path.read_bytes()


def chunks(data: bytes) -> list[int]:
    """Where the chunks of a sound file begin."""
    found, at = [], 8
    while at < len(data) - 8:
        opcode, length = struct.unpack_from("<BQ", data, at)
        if opcode == CHUNK:
            found.append(at)
        at += 9 + length
    return found


def numbers(path: Path) -> list[int]:
    return sorted(e.sequence for part in read_parts(path) for e in part.entries if e.topic == "/scan")


# ------------------------------------------------------------------------------------------------- altered codes


@pytest.mark.parametrize("code", [*range(1, 6), *range(7, 16), 0, 16, 70, 134, 255])
def test_a_chunk_under_any_other_code_is_not_lost(original: bytes, code: int, tmp_path: Path) -> None:
    at = chunks(original)[SCANS // PER_CHUNK // 2]
    path = tmp_path / "x_000.mcap"
    path.write_bytes(original[:at] + bytes([code]) + original[at + 1 :])
    result = verify(path)
    assert numbers(path) == list(range(SCANS)), "its bytes are whole"
    assert not result.ok
    assert [d.at_byte for _, d in result.damages] == [at], "the report points at the byte"


@pytest.mark.parametrize("code", [ATTACHMENT_INDEX, STATISTICS, METADATA_INDEX, SUMMARY_OFFSET])
def test_messages_that_have_no_seal_are_not_lost_either(code: int, tmp_path: Path) -> None:
    path = tmp_path / "x_000.mcap"
    with path.open("wb") as stream:
        writer = ReceivedWriter(stream, make_info(role="received"), LogTime())
        for n in range(20):
            writer.write(scan_entry(make_scan(n)))
            writer.write_link(b"{}", n, n)
        writer.finish()
    data = path.read_bytes()
    at = chunks(data)[0]
    path.write_bytes(data[:at] + bytes([code]) + data[at + 1 :])
    assert [part.foreign for part in read_parts(path)] == [{"/link": 20}]


# ------------------------------------------------------------------------------------------------- sectors


@pytest.mark.parametrize("sector", [512, 4096])
def test_sectors_in_reverse_order(plain: bytes, sector: int, tmp_path: Path) -> None:
    parts = [plain[at : at + sector] for at in range(0, len(plain), sector)]
    turned = b"".join(reversed(parts))
    path = tmp_path / "x_000.mcap"
    path.write_bytes(turned)
    whole = [n for n in range(SCANS) if encode_scan(make_scan(n)) in turned]
    assert len(whole) > SCANS // 8
    assert sorted({e.sequence for s in read_parts(path) for e in s.entries if e.topic == "/scan"}) == whole
    assert not verify(path).ok


def test_whole_compressed_chunks_in_reverse_order(tmp_path: Path) -> None:
    """Chunks that are whole come out whole, wherever they lie and whatever lies around them."""
    path = tmp_path / "x_000.mcap"
    write_recording(path, compress=True)
    data = path.read_bytes()
    at = chunks(data)
    bodies = [data[a : a + 9 + struct.unpack_from("<Q", data, a + 1)[0]] for a in at]
    path.write_bytes(b"\x00" * 512 + b"".join(b + bytes(37) for b in reversed(bodies)))
    assert numbers(path) == list(range(SCANS))


def test_a_frame_is_found_without_its_chunk(tmp_path: Path) -> None:
    content = b"".join(
        struct.pack("<BQHIQQ", 5, 22 + len(d), 1, n, 0, 0) + d
        for n, d in ((n, encode_scan(make_scan(n))) for n in range(9))
    )
    path = tmp_path / "x_000.mcap"
    path.write_bytes(bytes(100) + zstandard.ZstdCompressor().compress(content) + bytes(100))
    assert numbers(path) == list(range(9))


# ------------------------------------------------------------------------------------------------- two in one file


@pytest.fixture
def both(plain: bytes, other: bytes, tmp_path: Path) -> Path:
    path = tmp_path / "both.mcap"
    path.write_bytes(plain + other)
    return path


def test_verify_and_info_tell_both_sessions(both: Path, tmp_path: Path) -> None:
    result = verify(both)
    assert result.ok
    assert result.scans == SCANS + OTHER_SCANS
    assert [(name, v.scans, v.missing) for name, v in result.sessions] == [
        ("s1", SCANS, ()),
        ("other", OTHER_SCANS, ()),
    ]
    assert "2 sessions" in result.text
    info = info_mcap(both)
    assert info["session"] == "s1, other"
    assert info["scans"] == SCANS + OTHER_SCANS
    assert [(s["session"], s["scans"], s["first_scan"]) for s in info["sessions"]] == [
        ("s1", SCANS, 0),
        ("other", OTHER_SCANS, OTHER_FIRST),
    ]
    said = "\n".join(commands.info_lines(both, info))
    assert "session s1" in said
    assert "session other" in said


def test_recover_writes_each_session_to_a_file_of_its_own(both: Path, tmp_path: Path) -> None:
    result = recover(both, tmp_path / "out.mcap")
    assert result.recovered == SCANS + OTHER_SCANS
    assert [(s, p.name, n) for s, p, n in result.sessions] == [
        ("s1", "out.mcap", SCANS),
        ("other", "out_2.mcap", OTHER_SCANS),
    ]
    for name, path, scans in result.sessions:
        saved = read_recording(path)
        assert (saved.info.session, len(saved.numbers)) == (name, scans)
        assert verify(path).ok
    with pytest.raises(RecordingError, match=r"out_2\.mcap: exists already"):
        recover(both, (tmp_path / "out.mcap").rename(tmp_path / "gone.mcap").with_name("out.mcap"))


@pytest.mark.filterwarnings("ignore:invalid value encountered:RuntimeWarning")  # made-up counts are no atmosphere
def test_a_flight_is_made_of_one_session_and_says_so(both: Path, tmp_path: Path) -> None:
    flight = calibrate_recording(both, "cdfp")
    assert len(flight) == SCANS
    assert any(
        "2 sessions in one file: s1 (240 scans) taken, other (60 scans) left out" in n.text for n in flight.notes
    )
    assert flight.provenance.detail["session"] == "s1"
    with pytest.raises(RecordingError, match=r"2 sessions in one file: s1 \(240 scans\), other \(60 scans\)"):
        read_recording(both)
    assert as_rrd(both, tmp_path / "x.rrd", calibration=Path("cdfp")).is_file()


@pytest.mark.parametrize("between", [b"", bytes(3000), b"\xff" * 100])
@pytest.mark.parametrize("cut", [0, 8, 60, 5000, 20_000])
def test_sessions_are_never_mixed(plain: bytes, other: bytes, cut: int, between: bytes, tmp_path: Path) -> None:
    path = tmp_path / "both.mcap"
    path.write_bytes(plain[: len(plain) - cut] + between + other)
    found = {r.info.session: r.numbers for r in read_recordings(path)}
    assert found.keys() == {"s1", "other"}
    assert found["other"] == list(range(OTHER_FIRST, OTHER_FIRST + OTHER_SCANS))
    assert max(found["s1"]) < SCANS
    intact = [n for n in range(SCANS) if encode_scan(make_scan(n)) in plain[: len(plain) - cut]]
    assert found["s1"] == intact
    assert verify(path).ok == (not cut and not between)


def test_the_second_without_its_beginning_keeps_its_session(plain: bytes, other: bytes, tmp_path: Path) -> None:
    path = tmp_path / "both.mcap"
    path.write_bytes(plain + b"\xee" * 40 + other[40:])
    found = {r.info.session: len(r.numbers) for r in read_recordings(path)}
    assert found == {"s1": SCANS, "other": OTHER_SCANS}


def test_two_segments_of_a_session_in_one_file_are_one_recording(tmp_path: Path) -> None:
    parts = []
    for segment in range(2):
        path = tmp_path / f"s1_{segment:03}.mcap"
        with path.open("wb") as stream:
            writer = RecordingWriter(stream, make_info(segment=segment))
            for n in range(segment * 50, segment * 50 + 50):
                writer.write(scan_entry(make_scan(n)))
            writer.finish()
        parts.append(path.read_bytes())
    joined = tmp_path / "joined.mcap"
    joined.write_bytes(b"".join(parts))
    recording = read_recording(joined)
    assert recording.numbers == list(range(100))
    assert len(recording.segments) == 2
    assert all(part.sound for part in read_parts(joined))
    assert verify(joined).ok


def test_the_same_file_twice_is_one_recording(plain: bytes, tmp_path: Path) -> None:
    path = tmp_path / "twice.mcap"
    path.write_bytes(plain + plain)
    assert read_recording(path).numbers == list(range(SCANS))
