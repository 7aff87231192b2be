"""Damaged recordings: everything intact comes out, nothing altered does, and every damage is noticed.

The oracle is independent of the reader: a scan is intact when its encoded bytes are still in the damaged file.
"""

import random
from collections.abc import Callable
from functools import cache
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader

from daq.contract.recordings.accounting import verify
from daq.contract.recordings.reading import read_recording
from daq.contract.recordings.recording import RecordingError
from daq.contract.recordings.recovery import recover
from daq.contract.recordings.segments import read_parts
from daq.contract.scan import encode_scan
from tests.unit.daq.synthetic import PER_CHUNK, SCANS, make_scan


@cache
def encoded() -> dict[int, bytes]:
    """The scans as they were written."""
    return {n: encode_scan(make_scan(n)) for n in range(SCANS)}


def truncate(data: bytes, rng: random.Random) -> bytes:
    return data[: rng.randrange(1, len(data))]


def flip(data: bytes, rng: random.Random) -> bytes:
    damaged = bytearray(data)
    for _ in range(rng.choice((1, 1, 1, 5, 50))):
        damaged[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
    return bytes(damaged)


def zero_tail(data: bytes, rng: random.Random) -> bytes:
    at = rng.randrange(len(data))
    return data[:at] + bytes(len(data) - at)


def zero_sector(data: bytes, rng: random.Random) -> bytes:
    at = rng.randrange(len(data)) // 4096 * 4096
    return data[:at] + bytes(min(4096, len(data) - at)) + data[at + 4096 :]


def garble_sector(data: bytes, rng: random.Random) -> bytes:
    at = rng.randrange(len(data)) // 4096 * 4096
    return data[:at] + rng.randbytes(min(4096, len(data) - at)) + data[at + 4096 :]


def drop_bytes(data: bytes, rng: random.Random) -> bytes:
    at = rng.randrange(len(data))
    return data[:at] + data[at + rng.randrange(1, 3000) :]


DAMAGES = (truncate, flip, zero_tail, zero_sector, garble_sector, drop_bytes)


def check_damaged(data: bytes, path: Path, *, compressed: bool = False) -> None:
    """All promises for one damaged file."""
    path.write_bytes(data)
    try:
        (segment,) = read_parts(path)
    except RecordingError:
        assert not any(e in data for e in encoded().values())
        return
    got = {e.sequence: e.data for e in segment.entries if e.topic == "/scan"}
    assert all(encoded()[n] == d for n, d in got.items()), "an altered scan was passed on"
    if not compressed:
        intact = {n for n, e in encoded().items() if e in data}
        assert got.keys() == intact, f"intact scans not recovered: {sorted(intact - got.keys())}"
    assert not segment.sound, "damage went unnoticed"
    if not got:
        return
    result = verify(path)
    assert not result.ok
    assert result.scans == len(got)
    assert result.slots == result.scans + sum(b - a + 1 for a, b in result.missing)
    assert result.slots == result.written + result.dropped + result.lost + result.missed


@pytest.mark.parametrize("damage", DAMAGES, ids=lambda d: d.__name__)
def test_damaged_files(
    original: bytes, damage: Callable[[bytes, random.Random], bytes], tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    compressed = "zstd" in request.node.callspec.id
    rng = random.Random(f"{damage.__name__}{compressed}")
    for _ in range(25):
        damaged = damage(original, rng)
        if damaged != original:
            check_damaged(damaged, tmp_path / "x_000.mcap", compressed=compressed)


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.data())
def test_any_edit_of_any_bytes(plain: bytes, tmp_path: Path, data: st.DataObject) -> None:
    at = data.draw(st.integers(0, len(plain) - 1), label="at")
    new = data.draw(st.binary(min_size=0, max_size=40), label="new")
    drop = data.draw(st.integers(0, 40), label="dropped")
    damaged = plain[:at] + new + plain[at + drop :]
    if damaged != plain:
        check_damaged(damaged, tmp_path / "x_000.mcap")


def test_every_single_bit_near_the_edges_of_a_chunk(plain: bytes, tmp_path: Path) -> None:
    """Heads of records are where a reader can be led astray: try each bit of one chunk's head and first message."""
    at = plain.index(encode_scan(make_scan(100))) - 31 - 49 + 5
    for byte in range(at, at + 90):
        damaged = bytearray(plain)
        damaged[byte] ^= 1 << (byte % 8)
        check_damaged(bytes(damaged), tmp_path / "x_000.mcap")


def test_first_chunk_with_the_schemas_destroyed(plain: bytes, tmp_path: Path) -> None:
    start = plain.index(b"\x06", plain.index(b"calibration/pitot.toml"))
    end = plain.index(encode_scan(make_scan(PER_CHUNK)))
    damaged = plain[:start] + bytes(end - 200 - start) + plain[end - 200 :]
    check_damaged(damaged, tmp_path / "x_000.mcap")


def test_identity_survives_damage_to_its_metadata(plain: bytes, tmp_path: Path) -> None:
    damaged = bytearray(plain)
    damaged[plain.index(b"simulated")] ^= 1
    path = tmp_path / "x_000.mcap"
    path.write_bytes(damaged)
    (segment,) = read_parts(path)
    assert segment.info is not None
    assert segment.info.source == "simulated", "the copy among the attachments must be used"
    assert not segment.sound


def test_recover_writes_a_sound_recording_any_reader_opens(original: bytes, tmp_path: Path) -> None:
    path, out = tmp_path / "torn_000.mcap", tmp_path / "recovered.mcap"
    path.write_bytes(original[: len(original) * 2 // 3])
    result = recover(path, out)
    with out.open("rb") as stream:
        messages = list(make_reader(stream, validate_crcs=True).iter_messages(topics=["/scan"]))
    assert len(messages) == result.recovered == result.verification.scans > SCANS // 3
    assert all(encoded()[m.sequence] == m.data for _, _, m in messages)
    again = read_recording(out)
    assert again.info.source == "simulated"
    assert again.info.calibration == {"pitot.toml": b"slope = 1.0\n"}
    assert "torn_000.mcap" in again.info.details["recovered_from"]
    assert verify(out).ok


def test_recover_says_for_good_which_scans_are_gone(plain: bytes, tmp_path: Path) -> None:
    first, second = plain.index(encode_scan(make_scan(50))), plain.index(encode_scan(make_scan(120)))
    damaged = bytearray(plain)
    damaged[first + 20] ^= 4
    damaged[second + 20] ^= 4
    path, out = tmp_path / "x_000.mcap", tmp_path / "recovered.mcap"
    path.write_bytes(damaged)
    result = recover(path, out)
    assert result.verification.missing == ((50, 50), (120, 120))
    assert result.recovered == SCANS - 2
    assert read_recording(out).events[0].text == "end of run"
    after = verify(out)
    assert after.missing == ((50, 50), (120, 120))
    assert after.ok, "what recovery could not save is accounted for in the recovered file"
    assert after.lost == 2


def test_recover_refuses_to_overwrite_and_to_invent(plain: bytes, tmp_path: Path) -> None:
    path = tmp_path / "x_000.mcap"
    path.write_bytes(plain)
    with pytest.raises(RecordingError, match="exists already"):
        recover(path, path)
    empty = tmp_path / "y_000.mcap"
    empty.write_bytes(plain[:60])
    with pytest.raises(RecordingError, match="nothing to recover"):
        recover(empty, tmp_path / "out.mcap")
    assert not (tmp_path / "out.mcap").exists()


def test_a_sound_file_is_sound(original: bytes, tmp_path: Path) -> None:
    path = tmp_path / "s1_000.mcap"
    path.write_bytes(original)
    result = verify(path)
    assert result.ok, result.text
    assert (result.scans, result.missing, result.damages) == (SCANS, (), ())


def test_reading_a_damaged_file_names_the_byte_and_the_remedy(plain: bytes, tmp_path: Path) -> None:
    path = tmp_path / "x_000.mcap"
    path.write_bytes(plain[:-500])
    with pytest.raises(RecordingError, match=r"damaged at byte \d+ .*sideslip recover"):
        read_recording(path)
