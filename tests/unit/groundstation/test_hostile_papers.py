"""What an aircraft, or somebody in its place, says of its recording: anything at all may come, and the session goes on."""

import hashlib
import json
import zlib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from daq.contract.recordings.reading import read_recording
from daq.transport.mavlink_codec import FrameDecoder, FrameEncoder, frames_of
from daq.transport.ports import MemoryPort, memory_pair
from daq.utilities.errors import UserError
from groundstation.live.config import GroundConfig
from groundstation.live.handover import hand_over
from groundstation.live.station import Station
from groundstation.receiver import events as ev
from groundstation.receiver.backfill import PAPERS_PART_BYTES, BackfillClient
from groundstation.receiver.link_accounting import SessionAccounting
from groundstation.receiver.ports import LinkConfig
from groundstation.receiver.receive import Receiver
from groundstation.receiver.storage.recording import SessionRecorder
from groundstation.receiver.timeline import NS
from tests.support.link_rig import Rig, quiet_scan, random_scan

SOUND: dict[str, Any] = {
    "session": "flight1",
    "source": "simulated",
    "aircraft": "cdfp",
    "scan_rate_hz": 20.0,
    "started_utc_ns": 1_795_000_000_000_000_000,
    "software": "0.1.0",
    "details": {"static.t1": "27504"},
    "events": [[5, 6, 1, "switch", "here"]],
    "archive_bytes": 0,
    "archive_sha256": hashlib.sha256(b"").hexdigest(),
}


def altered(**changes: Any) -> bytes:
    return json.dumps({**SOUND, **changes}).encode()


UNSOUND: dict[str, bytes] = {
    "a number": b"7",
    "null": b"null",
    "a list": b"[]",
    "a text": b'"papers"',
    "nesting": b"[" * 100_000,
    "nested details": b'{"details":' * 50_000,
    "details as a list": altered(details=["static.t1"]),
    "details with numbers": altered(details={"static.t1": 27504}),
    "an infinite rate": altered(scan_rate_hz=1e400),
    "no rate at all": json.dumps({**SOUND, "scan_rate_hz": float("nan")}).encode(),
    "an infinite start": json.dumps({**SOUND, "started_utc_ns": float("inf")}).encode(),
    "a negative start": altered(started_utc_ns=-1),
    "an event before time": altered(events=[[-1, 0, 0, "switch", "x"]]),
    "an event at no time": altered(events=[[None, 0, 0, "switch", "x"]]),
    "an event at infinity": json.dumps({**SOUND, "events": [[float("inf"), 0, 0, "s", "x"]]}).encode(),
    "events as a number": altered(events=5),
    "an event too long": altered(events=[[1, 2, 3, "a", "b", "c"]]),
    "a number beyond 32 bits": altered(events=[[1, 2, 2**40, "a", "b"]]),
    "a lone surrogate": altered(session="\ud800"),
    "a lone surrogate in an event": altered(events=[[1, 2, 3, "\udfff", "x"]]),
    "a huge archive": altered(archive_bytes=10**18),
    "a negative archive": altered(archive_bytes=-5),
    "an archive of words": altered(archive_bytes="many"),
    "a very long number": b'{"session":' + b"9" * 10_000 + b"}",
    "a huge text": altered(session="x" * 1_000_000),
    "a thousand events": altered(events=[[1, 1, 1, "s", str(i)] for i in range(5000)]),
    "no session": json.dumps({k: v for k, v in SOUND.items() if k != "session"}).encode(),
    "a boolean start": altered(started_utc_ns=True),
    "bytes that are no text": b"\xff\xfe\x00",
    "nothing": b"",
}


@contextmanager
def recorder(folder: Path) -> Iterator[SessionRecorder]:
    made = SessionRecorder(folder, ev.Session(1, 7, 0))
    try:
        yield made
    finally:
        made.close()


@pytest.mark.parametrize("what", UNSOUND)
def test_unsound_papers_are_refused_and_leave_the_sound_ones(tmp_path: Path, what: str) -> None:
    with recorder(tmp_path) as kept:
        assert kept.take_papers(zlib.compress(altered()))
        assert not kept.take_papers(zlib.compress(UNSOUND[what]))
        assert kept.info().session == "flight1"
        assert kept.archive_bytes == 0


def test_papers_that_unpack_to_more_than_any_papers_are_not_unpacked(tmp_path: Path) -> None:
    import tracemalloc

    bomb = zlib.compress(bytes(100_000_000), 9)
    tracemalloc.start()
    with recorder(tmp_path) as kept:
        assert not kept.take_papers(bomb)
        assert not kept.take_archive(bomb)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 40_000_000


def test_parts_of_an_archive_keep_the_window_of_requests_full(tmp_path: Path) -> None:
    with recorder(tmp_path) as session_recorder:
        assert session_recorder.take_papers(zlib.compress(altered(archive_bytes=8 * PAPERS_PART_BYTES)))
        client = BackfillClient(session_recorder, SessionAccounting(session_recorder.session), "all")
        assert [fields["first_number"] for _, fields in client.due(0)] == [1, 2, 3, 4]
        part = b"part 1"
        answer = {"first_number": 1, "wanted": 0, "fragment": 0, "fragments": 1, "length": len(part), "data": part}
        client.take_data({**answer, "checksum": zlib.crc32(part)}, 1)
        assert [fields["first_number"] for _, fields in client.due(2)] == [5]


@pytest.mark.parametrize(
    "content",
    [b"3", b"null", b"[" * 90_000, b'{"config.toml": 7}', b'{"config.toml": "zz"}', b'{"config.toml": "ff"}', b"{}x",
     b'{"calibration/a.toml": "c328"}', b'{"\\ud800": "00"}'],
)  # fmt: skip
def test_an_unsound_archive_is_refused(tmp_path: Path, content: bytes) -> None:
    with recorder(tmp_path) as kept:
        assert not kept.take_archive(zlib.compress(content))
        assert kept.info().attachments == {}
    with recorder(tmp_path) as again:
        assert again.info().attachments == {}


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(st.characters(codec=None, exclude_categories=())),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=5), inner, max_size=4),
    max_leaves=8,
)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(changes=st.dictionaries(st.sampled_from(sorted(SOUND)), JSON, min_size=1, max_size=3))
def test_whatever_papers_say_a_recording_can_be_written_and_read(
    tmp_path_factory: pytest.TempPathFactory, changes: dict[str, Any]
) -> None:
    folder = tmp_path_factory.mktemp("papers")
    rng = np.random.default_rng(1)
    with recorder(folder) as kept:
        kept.take_papers(zlib.compress(altered(**changes)))
        scan = quiet_scan(1, rng, time_ns=10**9)
        kept.scan(ev.ScanReceived(kept.session, scan, 0, 0, None))
        path = kept.write()
    assert path is not None
    assert read_recording(path).numbers == [1]
    with recorder(folder) as again:
        assert again.has_scans


class Impostor:
    """Answers whatever the ground station asks of aircraft 1 with what it is told to."""

    def __init__(self, receiver_folder: Path, answer: bytes, rig: Rig) -> None:
        self.answer, self.rig = answer, rig
        self.encoder = FrameEncoder(1, 1)
        self.heard = FrameDecoder()

    def reply(self, port: MemoryPort) -> None:
        for frame in frames_of(self.heard.feed(port.read(1 << 20))):
            if frame.name != "BACKFILL_REQUEST":
                continue
            f = frame.fields()
            pieces = [self.answer[i : i + 190] for i in range(0, len(self.answer), 190)]
            for index, piece in enumerate(pieces[:255]):
                data = self.encoder.message(
                    "BACKFILL_DATA",
                    wanted=f["wanted"],
                    first_number=f["first_number"],
                    checksum=zlib.crc32(self.answer),
                    boot=f["boot"],
                    fragment=index,
                    fragments=len(pieces),
                    length=len(piece),
                    data=piece,
                )
                port.write(data)


@pytest.mark.parametrize("what", UNSOUND)
def test_the_session_goes_on_and_closes_whatever_papers_come(tmp_path: Path, what: str) -> None:
    rig = Rig(None, ground=LinkConfig(ports=("memory",), transmit=False))
    rng = np.random.default_rng(2)
    ours, theirs = memory_pair()
    receiver = Receiver(LinkConfig(ports=("m",), backfill="all"), {"m": ours}, rig.clock, folder=tmp_path)
    station = Station(GroundConfig(), receiver, rig.clock, tmp_path)
    impostor = Impostor(tmp_path, zlib.compress(UNSOUND[what], 9), rig)
    heard = 0
    for i in range(60):
        rig.clock.advance(NS // 20)
        rig.link.offer(quiet_scan(i, rng, time_ns=rig.clock.monotonic_ns()))
        rig.link.service(rig.clock.monotonic_ns())
        theirs.write(rig._air.read(1 << 20))
        heard += sum(isinstance(e, ev.ScanReceived) for e in station.step())
        impostor.reply(theirs)
    station.close()
    rig.close()
    assert heard >= 30
    assert receiver.port_faults == {}
    (path,) = tmp_path.glob("*.mcap")
    assert len(read_recording(path).numbers) == sum(b.received for b in receiver.accounting())


FACTS = {
    "static.nvm": ("", "x", "00" * 21, "ff" * 21),
    "imu.gyro_scale_rad_s": ("inf", "nan", "1e308", "-1", "0"),
    "mag.scale_t": ("inf", "1e3", "many"),
    "pitot.zero_count": ("nan", "65535", ""),
    "imu.accel_delay_s": ("-0", "1.0", "1e999"),
}


@pytest.mark.parametrize("seed", range(16))
def test_the_end_of_a_flight_is_handed_over_or_refused_in_words_whatever_was_said_of_it(
    tmp_path: Path, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    details = {k: str(rng.choice(v)) for k, v in FACTS.items() if rng.random() < 0.3}
    text = str(rng.choice(["pitot_zero count=..... scans=3", "pitot_zero count=0 scans=0", "landed", ""]))
    said = altered(details=details, events=[[2**63 - 1, 0, 0, "logger", text]], started_utc_ns=2**63 - 1)
    step = int(rng.choice([1, NS // 20, NS // 20, 10**13]))
    with recorder(tmp_path) as kept:
        assert kept.take_papers(zlib.compress(said))
        for number in range(int(rng.choice([1, 2, 5, 60]))):
            scan = random_scan(number * int(rng.choice([1, 1, 50])), rng, time_ns=2**55 + number * step)
            kept.scan(ev.ScanReceived(kept.session, scan, 0, 0, None))
        path = kept.write()
    assert path is not None
    with suppress(UserError):  # a sentence; anything else fails here
        hand_over(path, tmp_path, origin="a test")
