"""Bytes of another session within a recording: each scan comes back, and none under the wrong session."""

import io
import struct
from dataclasses import replace
from pathlib import Path

import pytest

from daq.contract.recordings.mcap_records import CHUNK
from daq.contract.recordings.reading import read_recording
from daq.contract.recordings.recording import RecordingWriter, scan_entry
from daq.contract.recordings.recovery import recover
from daq.contract.recordings.segments import split_sessions
from daq.contract.scan import encode_scan
from tests.unit.daq.synthetic import make_info, make_scan

LATER = 9_000_000_000_000  # ns, another start of the computer


def written(session: str, scans: range, later: int = 0) -> tuple[bytes, dict[bytes, int]]:
    stream, encoded = io.BytesIO(), {}
    writer = RecordingWriter(stream, make_info(session))
    for n in scans:
        scan = make_scan(n)
        scan = replace(scan, time_monotonic_ns=scan.time_monotonic_ns + later)
        encoded[encode_scan(scan)] = n
        writer.write(scan_entry(scan))
        if n % 8 == 0:
            writer.flush()
    writer.finish()
    return stream.getvalue(), encoded


def chunks(data: bytes) -> list[int]:
    found, at = [], 8
    while at < len(data) - 8:
        opcode, length = struct.unpack_from("<BQ", data, at)
        if opcode == CHUNK:
            found.append(at)
        at += 9 + length
    return found


ONE, OF_ONE = written("one", range(160))
TWO, OF_TWO = written("two", range(240), LATER)
A, B = chunks(ONE), chunks(TWO)
PASTED = {
    "chunks of two within one": ONE[: A[6]] + TWO[B[3] : B[15]] + ONE[A[6] :],
    "one, cut off, and the tail of two": ONE[: A[9]] + TWO[B[4] :],
    "one, torn in a chunk, and the tail of two": ONE[: A[9] + 70] + TWO[B[4] :],
    "the end of one written over": ONE[: A[8] + 60] + TWO[B[6] + 25 :],
}


def intact(data: bytes) -> tuple[set[int], set[int]]:
    """Numbers of the scans whose chunks stand whole in the bytes, of each session."""
    out = []
    for source, places, numbers in ((ONE, A, OF_ONE), (TWO, B, OF_TWO)):
        ends = [*places[1:], None]
        whole = [source[a:e] for a, e in zip(places, ends, strict=True)]
        there = [n for n, piece in enumerate(whole[:-1]) if piece in data]
        per = [sorted(numbers.values())[0 if k == 0 else 8 * (k - 1) + 1 : 8 * k + 1] for k in range(len(places))]
        out.append({n for k in there for n in per[k]})
    return out[0], out[1]


@pytest.mark.parametrize("what", PASTED)
def test_scans_of_both_sessions_come_back_each_under_its_own(what: str, tmp_path: Path) -> None:
    path = tmp_path / "x_000.mcap"
    path.write_bytes(PASTED[what])
    result = recover(path, tmp_path / "out.mcap")
    of_one, of_two = intact(PASTED[what])
    assert len(of_two) > 60
    assert len(result.sessions) == 2
    for (_, out, _), known, wanted in zip(result.sessions, (OF_ONE, OF_TWO), (of_one, of_two), strict=True):
        got = {
            n: encode_scan(scan)
            for n, scan in zip(read_recording(out).numbers, read_recording(out).scans(), strict=True)
        }
        assert wanted <= got.keys()
        assert all(known.get(data) == n for n, data in got.items()), "a scan of the other session"


def test_one_session_stays_in_one_piece_whatever_is_lost_of_it() -> None:
    entries = [scan_entry(make_scan(n), encode_scan(make_scan(n))) for n in range(50) if n % 7]
    assert split_sessions(entries) == [tuple(entries)]
    assert split_sessions([*entries[20:], *entries[:20]]) == [(*entries[20:], *entries[:20])]
