"""Every message with every kind of bad value through a running station."""

import json
from pathlib import Path

import pytest

from daq.contract.link.wire import SCAN_FAST_ID, layouts, pack_scan
from daq.contract.recordings.reading import read_recording
from daq.transport.mavlink_codec import FrameDecoder, FrameEncoder, frames_of, message_types
from groundstation.receiver.storage.recording import out_of_line
from groundstation.receiver.timeline import NS
from tests.support.bad_values import BadFrame, bad_frames
from tests.support.link_rig import quiet_scan
from tests.unit.groundstation.test_quarantine import Sky

A_STEP = 40  # frames between two scans of the sound aircraft


def sound_payloads(folder: Path) -> dict[int, bytes]:
    """The last payload of each message that an aircraft sends of itself in its first seconds."""
    sky, decoder, payloads = Sky(folder), FrameDecoder(), dict[int, bytes]()
    for _ in range(60):
        sky.fly(1)
        for frame in frames_of(decoder.feed(sky.last_sent)):
            payloads[frame.msg_id] = bytes(frame.payload)
    sky.land()
    return payloads


@pytest.fixture(scope="module")
def frames(tmp_path_factory: pytest.TempPathFactory) -> list[BadFrame]:
    sound = sound_payloads(tmp_path_factory.mktemp("sound"))
    return [f for system in (1, 9) for f in bad_frames(FrameEncoder(system, 1), sound)]


def test_each_message_is_there_with_each_kind_of_value(frames: list[BadFrame]) -> None:
    words = " ".join(f.what for f in frames)
    assert all(f"{m.name} all 0" in words for m in message_types().values())
    assert all(f" {kind}" in words for kind in ("nan", "inf", "-inf", "huge", "negative", "control", "turned", "long"))
    assert len(frames) > 3000


def test_no_message_with_any_bad_value_costs_the_session_anything(tmp_path: Path, frames: list[BadFrame]) -> None:
    sky = Sky(tmp_path)
    sky.fly(40)
    for first in range(0, len(frames), A_STEP):
        sky.theirs.write(b"".join(f.data for f in frames[first : first + A_STEP]))
        sky.fly(1)
        wrong = [row for row in sky.receiver.summary()["quarantined"] if not str(row["what"]).startswith("fact ")]
        assert wrong == [], [f.what for f in frames[first : first + A_STEP]]
    before, quiet_from = sky.heard, sky.number
    sky.fly(60)
    sky.land()
    assert sky.heard - before >= 30
    json.dumps(sky.receiver.summary(), allow_nan=False)
    assert all(line.isprintable() for line in sky.lines)
    numbers = read_recording(tmp_path / "aircraft1_00_07.mcap").numbers  # one session, for all that was forged
    assert len([n for n in numbers if n >= quiet_from]) == sky.heard - before


@pytest.mark.parametrize(
    ("scans", "odd"),
    [
        ([(0, 5), (1, 10), (2, 20)], set()),
        ([(0, 300), (1, 10), (3, 20), (5, 30)], {0}),
        ([(1, 10), (2, 20), (3, 5), (4, 40), (5, 2000), (6, 60)], {3, 5}),
        ([(1, 10), (2, 10)], {2}),
    ],
)
def test_the_fewest_scans_are_left_out_of_a_recording(scans: list[tuple[int, int]], odd: set[int]) -> None:
    left_out = out_of_line(reversed(scans))
    assert len(left_out) == len(odd)
    rest = [time for number, time in scans if number not in left_out]
    assert rest == sorted(set(rest))


def test_a_scan_that_contradicts_its_neighbours_is_no_late_one(tmp_path: Path) -> None:
    sky = Sky(tmp_path)
    sky.fly(60)
    forged = FrameEncoder(1, 1)
    for number, time_ns in ((0, 3 * NS), (31, NS // 10), (2**32 - 1, 1)):
        forged_scan = quiet_scan(number, sky.rng, time_ns=time_ns)
        sky.theirs.write(forged.frame(SCAN_FAST_ID, pack_scan(layouts()[SCAN_FAST_ID], forged_scan, 7)))
    sky.fly(40)
    sky.land()
    recording = read_recording(tmp_path / "aircraft1_00_07.mcap")
    times = [scan.time_monotonic_ns for scan in recording.scans()]
    assert times == sorted(times)
    assert len(times) == sky.heard
    assert sky.receiver.summary()["scans_doubted"] >= 2  # one has a number that is there already: a copy
