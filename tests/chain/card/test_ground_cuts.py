"""The power goes on the ground: what was received is kept up to the last second, and the station goes on in its folder."""

import errno
import time
from pathlib import Path

import numpy as np
import pytest

from daq.contract.recordings.reading import read_recording
from daq.contract.scan import Scan, decode_scan, encode_scan
from groundstation.flight import read_flight
from groundstation.live.handover import hand_over
from groundstation.receiver.ports import LinkConfig
from groundstation.receiver.storage.session_log import SessionLog
from groundstation.receiver.tlog import read_tlog
from tests.chain.card.cuts import ONE_SECOND
from tests.chain.card.forgetting import CUTS
from tests.chain.card.mounted import MountedCard
from tests.chain.card.troubles import Troubles
from tests.support.link_rig import Rig, quiet_scan

LISTEN = LinkConfig(ports=("memory",), backfill="off")
SESSION = "session"


def fly(rig: Rig, scans: int, seed: int = 1) -> None:
    """Fly, the disk keeping up with every step."""
    rng = np.random.default_rng(seed)

    def made(number: int) -> Scan:
        return quiet_scan(number, rng, time_ns=rig.clock.monotonic_ns())

    for _ in range(scans):
        rig.fly(1, made)
        deadline = time.monotonic() + 30.0
        while rig.ground._disk.busy:
            assert time.monotonic() < deadline
            time.sleep(0.0005)


def journal_of(folder: Path) -> Path:
    (path,) = folder.glob("*.journal")
    return path


def test_reception_goes_on_where_it_was(card: MountedCard, tmp_path: Path) -> None:
    rig = Rig(card.path / SESSION, ground=LISTEN)
    frames: list[bytes] = []
    rig.down = lambda data: (frames.append(data), data)[1]
    looks: list[tuple[str, int, Path]] = []
    for number, scans in enumerate((43, 71, 58, 90)):
        fly(rig, scans, seed=number)
        for kind, cut in enumerate(CUTS):
            so_far = len(rig.received())
            looks.append((cut.name, so_far, card.survivors(cut, tmp_path / f"{number}_{kind}", number) / SESSION))
    received = rig.received()
    rig.close()
    stream = b"".join(frames)
    for name, so_far, folder in looks:
        kept = SessionLog(journal_of(folder))
        data = {decode_scan(d).number: d for d in kept.scans()}
        versions = {(e.scan.number, encode_scan(e.scan)) for e in received}
        assert set(data.items()) <= versions, f"{name}: a scan that was never received like that"
        lost = len({e.scan.number for e in received[:so_far]} - set(data))
        assert lost <= ONE_SECOND, f"{name}: {lost} of {so_far} received scans lost"
        kept.close()
        assert all(frame in stream for _, frame in read_tlog(folder / "telemetry.tlog"))
        again = Rig(folder, ground=LISTEN)
        fly(again, 30)
        assert not again.ground.port_faults
        new = {e.scan.number for e in again.received()}
        again.close()
        recordings = [read_recording(p) for p in folder.glob("*.mcap")]
        assert any(new <= set(r.numbers) for r in recordings), f"{name}: the next session is not there"


def test_a_session_ended_in_order_is_there(card: MountedCard) -> None:
    rig = Rig(card.path / SESSION, ground=LISTEN)
    fly(rig, 60)
    received = {e.scan.number for e in rig.received()}
    rig.close()
    card.cut(CUTS[0])
    folder = card.path / SESSION
    assert set(read_recording(journal_of(folder).with_suffix(".mcap")).numbers) == received
    assert sum(1 for _ in read_tlog(folder / "telemetry.tlog")) >= 60


def test_a_disk_that_fails_is_told(card: MountedCard) -> None:
    rig = Rig(card.path / SESSION, ground=LISTEN)
    fly(rig, 30)
    card.trouble(Troubles(fails={"sync": errno.EIO}))
    fly(rig, 60)
    assert "disk" in rig.ground.port_faults
    card.trouble(Troubles())
    fly(rig, 60)
    assert rig.ground.port_faults == {}
    rig.close()


def test_a_flight_handed_over_is_there(card: MountedCard, root: Path) -> None:
    folder = card.path / SESSION
    folder.mkdir()
    card.secure()
    handed = hand_over(root / "recordings" / "cdfp_ld1_raw.mcap", folder, origin="the onboard recording")
    card.cut(CUTS[0])
    assert len(read_flight(folder / "flight.mcap")) == len(handed.flight)
    assert (folder / "flight.json").read_text().startswith("{")
    assert sorted(p.name for p in folder.iterdir() if ".new" in p.name) == []


@pytest.mark.parametrize("length", [0, 3, 4, 17, 4096])
def test_a_journal_of_which_only_the_name_or_zeros_are_left(tmp_path: Path, length: int) -> None:
    path = tmp_path / "s.journal"
    path.write_bytes(bytes(length))
    journal = SessionLog(path)
    journal.add_received(decode_scan(encode_scan(quiet_scan(3, np.random.default_rng(1), time_ns=150_000_000))))
    journal.close()
    again = SessionLog(path)
    assert 3 in again.received
    again.close()
