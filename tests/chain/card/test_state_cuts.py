"""The power goes between any two operations on a state file or a report: the old one or the new one is there, and usable.

Each test writes once and lets the power go after every single operation of that, in every way a cut can be.
"""

import errno
import json
from collections.abc import Callable
from pathlib import Path

import pytest

from daq.clock import SimulatedClock
from daq.contract.recordings.accounting import verify
from daq.contract.recordings.reading import read_recording
from daq.contract.recordings.recovery import recover
from daq.contract.scan import encode_scan
from daq.recorder.storage import RealStorage
from daq.service.preflight import _probe
from daq.transport.mavlink_codec import FrameDecoder, MavlinkFrame
from daq.transport.signing import SignatureVerdict, Signer, SigningState, load_state, save_state
from daq.utilities.durable import make_directories, whole, write_text
from groundstation.receiver import events as ev
from groundstation.receiver.storage.recording import SessionRecorder
from tests.chain.card.cuts import FLIGHT
from tests.chain.card.flight import CardFlight
from tests.chain.card.forgetting import CUTS, Cut
from tests.chain.card.mounted import MountedCard
from tests.chain.card.troubles import Troubles
from tests.unit.daq.synthetic import make_scan, write_recording

KEY = bytes(range(32))


def at_every_operation(
    card: MountedCard,
    *,
    before: Callable[[Path], None],
    write: Callable[[Path], object],
    check: Callable[[Path, bool], None],
    cuts: tuple[Cut, ...] = CUTS,
) -> int:
    """Cut the power after each operation of `write` in each way; `check` gets the folder and whether `write` had returned.

    Returns how many cuts there were.
    """
    trial = 0
    for cut in cuts:
        operations = 0
        finished = False
        while not finished:
            folder = card.path / f"trial{trial}"
            folder.mkdir()
            before(folder)
            card.secure()
            card.trip(operations)
            try:
                write(folder)
                finished = True
            except OSError:
                pass
            card.trip(None)
            card.cut(cut, trial)
            check(folder, finished)
            trial += 1
            operations += 1
    return trial


def state(number: int) -> SigningState:
    return SigningState(number, number + 1, {(1, 1, 1): number + 1})


@pytest.mark.parametrize("first", [False, True], ids=["over an old one", "the first"])
def test_signing_state(card: MountedCard, first: bool) -> None:
    old, new = SigningState() if first else state(1000), state(2000)

    def check(folder: Path, finished: bool) -> None:
        found = load_state(folder / "key.state")  # a state that cannot be loaded keeps the service from starting
        assert found == new if finished else found in (old, new)

    cuts = at_every_operation(
        card,
        before=lambda folder: None if first else save_state(old, folder / "key.state"),
        write=lambda folder: save_state(new, folder / "key.state"),
        check=check,
    )
    assert cuts > 4 * len(CUTS)


def test_no_timestamp_is_used_twice_and_none_is_accepted_twice(card: MountedCard) -> None:
    """A clock that stands still after the cut (no battery): what was sent or heard before stays behind it all the same."""
    now = 1_790_000_000 * 10**9
    air, ground = (card.path / name for name in ("air.state", "ground.state"))
    ours, theirs = Signer(KEY, lambda: now, state_path=air), Signer(KEY, lambda: now, state_path=ground)
    ours.save()
    sent = [ours.sign(b"frame") for _ in range(500)]
    assert theirs.judge(b"frame", (1, 1), sent[-1]) is SignatureVerdict.GOOD
    theirs.save()
    card.cut(CUTS[0])
    again = Signer(KEY, lambda: now, state_path=air).sign(b"frame")
    assert again[1:7][::-1] > max(s[1:7][::-1] for s in sent)
    assert Signer(KEY, lambda: now, state_path=ground).judge(b"frame", (1, 1), sent[-1]) is SignatureVerdict.REPLAYED


def test_the_service_starts_with_its_key_after_every_cut(card: MountedCard, tmp_path: Path) -> None:
    """The whole logger with a signed link, its state beside its recordings: it starts, and goes on behind what it has sent."""

    def key_in(folder: Path) -> Path:
        key = folder / "link.key"
        if not key.exists():
            folder.mkdir(parents=True)
            key.write_bytes(KEY)
            key.chmod(0o600)
            card.secure()
        return key

    flight = CardFlight(card.path / FLIGHT, key=key_in(card.path / FLIGHT))
    looks: list[Path] = []

    def look(taken: int) -> None:
        here = len(looks)
        looks.append(card.survivors(CUTS[here % len(CUTS)], tmp_path / str(here), here) / FLIGHT)

    for n in range(2 * len(CUTS)):
        flight.at(0.1 + 0.17 * n, look)
    flight.fly(3.0)
    card.cut(CUTS[0])
    before = stamps(flight)
    after = CardFlight(card.path / FLIGHT, key=key_in(card.path / FLIGHT))
    after.fly(1.0)
    assert min(stamps(after)) > max(before), "a timestamp was used twice"
    for folder in looks:
        key = folder / "link.key"
        key.chmod(0o600)
        assert CardFlight(folder, key=key).fly(0.5).closes


def stamps(flight: CardFlight) -> list[int]:
    """The signing timestamps of everything that was sent."""
    found = [f for f in FrameDecoder().feed(flight.ground.read(1 << 20)) if isinstance(f, MavlinkFrame)]
    return [int.from_bytes(f.signature[1:7], "little") for f in found if f.signature is not None]


def test_report(card: MountedCard) -> None:
    old, new = json.dumps({"scans": 1}), json.dumps({"scans": [2] * 3000})

    def check(folder: Path, finished: bool) -> None:
        found = (folder / "ground.json").read_text()
        assert found == new if finished else found in (old, new)

    at_every_operation(
        card,
        before=lambda folder: write_text(folder / "ground.json", old),
        write=lambda folder: write_text(folder / "ground.json", new),
        check=check,
    )


def test_recovered_recording(card: MountedCard, tmp_path: Path) -> None:
    torn = tmp_path / "torn.mcap"
    write_recording(torn, scans=60)
    torn.write_bytes(torn.read_bytes()[:-3000])
    expected = verify(torn).scans

    def check(folder: Path, finished: bool) -> None:
        out = folder / "whole.mcap"
        if finished or out.exists():
            assert verify(out).ok, verify(out).text
            assert verify(out).scans == expected

    at_every_operation(
        card, before=lambda folder: None, write=lambda folder: recover(torn, folder / "whole.mcap"), check=check
    )


def test_received_recording(card: MountedCard) -> None:
    """The recording is written again at the end of a session, over one that was asked for before; the journal keeps the scans."""
    session = ev.Session(1, 7, 0)
    name = f"{session.name}.mcap"
    made: list[SessionRecorder] = []

    def before(folder: Path) -> None:
        recorder = SessionRecorder(folder, session)
        made.append(recorder)
        for n in range(20):
            recorder.complete(encode_scan(make_scan(n)))
        recorder.write()
        for n in range(20, 40):
            recorder.complete(encode_scan(make_scan(n)))
        recorder.journal.file.flush()

    def check(folder: Path, finished: bool) -> None:
        with pytest.raises(OSError):
            made.pop().close()  # its file died with the power
        numbers = read_recording(folder / name).numbers
        assert numbers in ([list(range(40))] if finished else [list(range(20)), list(range(40))])
        again = SessionRecorder(folder, session)
        assert len(again.journal.complete) == 40
        again.write()
        again.close()
        assert read_recording(folder / name).numbers == list(range(40))

    at_every_operation(card, before=before, write=lambda folder: made[-1].write(), check=check, cuts=CUTS[:3])


def test_preflight_probe_left_behind_does_not_forbid_the_next_flight(card: MountedCard) -> None:
    clock = SimulatedClock()

    def check(folder: Path, finished: bool) -> None:
        assert _probe(RealStorage(), clock, folder / ".preflight") >= 0.0
        assert not (folder / ".preflight").exists()

    at_every_operation(
        card,
        before=lambda folder: None,
        write=lambda folder: _probe(RealStorage(), clock, folder / ".preflight"),
        check=check,
        cuts=CUTS[:2],
    )


def test_directories_are_safe_or_not_there(card: MountedCard) -> None:
    """A name that the card refused is taken back, or the next try would take it for safe."""
    deep = card.path / "a" / "b" / "c"
    card.trouble(Troubles(fails={"sync": errno.EIO}))
    with pytest.raises(OSError):
        make_directories(deep)
    assert list(card.path.iterdir()) == []
    card.trouble(Troubles())
    make_directories(deep)
    card.cut(CUTS[0])
    assert deep.is_dir()
    make_directories(deep)


def test_text_goes_through_a_link_and_leaves_the_old_one_when_it_fails(tmp_path: Path) -> None:
    target, link = tmp_path / "target", tmp_path / "link"
    link.symlink_to(target)
    write_text(link, "through")
    assert (link.is_symlink(), target.read_text()) == (True, "through")
    with pytest.raises(OSError), whole(target) as new:
        new.write_text("half")
        raise OSError(errno.ENOSPC, "no space")
    assert target.read_text() == "through"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["link", "target"]
