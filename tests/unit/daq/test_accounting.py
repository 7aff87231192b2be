"""What verify, recover and info say of whole sessions, single segments and files of other kinds."""

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import given
from hypothesis import strategies as st

from daq import commands
from daq.clock import SimulatedClock
from daq.contract.channels import CHANNELS
from daq.contract.recordings.accounting import verify
from daq.contract.recordings.reading import read_recording
from daq.contract.recordings.recording import RecordingError, RecordingWriter, scan_entry
from daq.contract.recordings.summary import info_mcap
from daq.recorder.config import RecorderConfig
from daq.recorder.recorder import Recorder
from daq.utilities.ranges import count, ranges, subtract
from groundstation.flight import Flight, Provenance, write_flight
from sideslip.verbs.info import info
from tests.unit.daq.synthetic import PERIOD_NS, make_info, make_scan


@pytest.fixture
def session(tmp_path: Path) -> Path:
    """Four segments of 50 scans, numbers 0 to 199."""
    clock = SimulatedClock()
    recorder = Recorder(RecorderConfig(directories=(tmp_path / "s",), segment_s=2.5), make_info(), clock)
    clock.follow(recorder.busy)
    recorder.start()
    for n in range(200):
        clock.sleep_until(n * PERIOD_NS)
        recorder.scan(make_scan(n))
    recorder.close()
    return tmp_path / "s"


def test_a_lost_segment_is_missed(session: Path) -> None:
    (session / "s1_001.mcap").unlink()
    result = verify(session)
    assert not result.ok
    assert result.missing == result.unexplained == ((50, 99),)
    assert "50 missing without account: 50-99" in result.text
    (session / "s1_000.mcap").unlink()
    assert verify(session).unexplained == (), "what was before the first segment at hand cannot be told"


def test_a_truncated_last_segment_is_not_sound(session: Path) -> None:
    last = session / "s1_003.mcap"
    last.write_bytes(last.read_bytes()[:-9000])
    result = verify(session)
    assert not result.ok
    assert not result.closed
    assert result.slots == result.scans == result.written
    assert result.damages[0][0] == last


def test_sessions_are_not_mixed(session: Path) -> None:
    with (session / "other_000.mcap").open("wb") as stream:
        writer = RecordingWriter(stream, make_info("other"))
        writer.write(scan_entry(make_scan(1)))
        writer.finish()
    with pytest.raises(RecordingError, match=r"2 sessions \(other, s1\)"):
        verify(session)


def test_received_recordings_may_have_gaps(tmp_path: Path) -> None:
    path = tmp_path / "r_000.mcap"
    with path.open("wb") as stream:
        writer = RecordingWriter(stream, make_info("r", role="received"))
        for n in range(0, 100, 2):
            writer.write(scan_entry(make_scan(n)))
        writer.finish()
    result = verify(path)
    assert result.ok
    assert count(result.missing) == 49
    assert "49 not received" in result.text


def test_info_of_a_session(session: Path) -> None:
    info = info_mcap(session)
    assert (info["kind"], info["source"], info["aircraft"]) == ("raw", "simulated", "cdfp")
    assert (info["scans"], info["first_scan"], info["last_scan"], info["segments"]) == (200, 0, 199, 4)
    assert info["duration_s"] == pytest.approx(199 / 20)
    assert info["rate_hz"] == pytest.approx(20)
    assert [c["name"] for c in info["channels"]] == [c.name for c in CHANNELS]
    assert all(c["samples"] == 200 for c in info["channels"])


def test_info_and_verify_of_a_flight(tmp_path: Path) -> None:
    time = np.arange(50) / 20
    columns = {"p": np.sin(time), "beta": np.where(time > 1, np.nan, 0.1)}
    flight = Flight.build("f", time, columns, provenance=Provenance(source="imported", aircraft="cdfp", software="1.2"))
    path = tmp_path / "flight.mcap"
    write_flight(flight, path)
    info = info_mcap(path)
    assert (info["kind"], info["source"], info["aircraft"], info["software"]) == ("flight", "imported", "cdfp", "1.2")
    assert info["duration_s"] == pytest.approx(49 / 20)
    assert {c["name"]: (c["unit"], c["samples"]) for c in info["channels"]} == {"p": ("rad/s", 50), "beta": ("rad", 21)}
    assert verify(path).ok
    with pytest.raises(RecordingError, match="not a raw recording but a calibrated flight"):
        read_recording(path)
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)
    assert not verify(path).ok


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (None, "no such file"),
        (b"", "empty"),
        (b"time,p\n0,1\n", "not an MCAP file"),
        (b"\x89MCAP0\r\n", "nothing in it"),
    ],
)
def test_unusable_files_get_a_sentence(tmp_path: Path, content: bytes | None, words: str) -> None:
    path = tmp_path / "x.mcap"
    if content is not None:
        path.write_bytes(content)
    for action in (verify, read_recording):
        with pytest.raises(RecordingError, match=words):
            action(path)


def test_commands_print_write_json_and_exit(session: Path, tmp_path: Path) -> None:
    run = CliRunner().invoke
    out = tmp_path / "out"
    done = run(commands.verify, [str(session), "--json", str(out / "v.json")])
    assert done.exit_code == 0
    assert "sound: 200 scans, 0 to 199; none missing" in done.output
    assert json.loads((out / "v.json").read_text())["ok"] is True
    done = run(info, [str(session)])
    assert done.exit_code == 0
    assert "200 scans in 9.95 s" in done.output
    done = run(commands.recover, [str(session), "-o", str(out / "copy.mcap")])
    assert done.exit_code == 0
    segment = session / "s1_002.mcap"
    data = bytearray(segment.read_bytes())
    data[len(data) // 2] ^= 16
    segment.write_bytes(data)
    done = run(commands.verify, [str(session), "--json", str(out / "v.json")])
    assert done.exit_code == 1
    assert "s1_002.mcap byte" in done.output
    report = json.loads((out / "v.json").read_text())
    assert report["ok"] is False
    assert report["damaged"]
    done = run(commands.recover, [str(session), "-o", str(out / "r.mcap"), "--json", str(out / "r.json")])
    assert done.exit_code == 1, "the same verdict as verify: the original is damaged"
    report = json.loads((out / "r.json").read_text())
    assert report["ok"] is False
    assert report["recovered"] == report["scans"] == 199
    assert verify(out / "r.mcap").scans == 199


numbers = st.sets(st.integers(0, 300), max_size=80)


@given(numbers, numbers)
def test_ranges_are_sets(a: set[int], b: set[int]) -> None:
    def members(rs: tuple[tuple[int, int], ...]) -> set[int]:
        return {n for first, last in rs for n in range(first, last + 1)}

    assert members(ranges(a)) == a
    assert count(ranges(a)) == len(a)
    assert members(subtract(ranges(a), ranges(b))) == a - b
