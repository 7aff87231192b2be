"""Signing: forged, replayed and far-future frames change nothing; keys and state are guarded on disk."""

import os
from pathlib import Path

import numpy as np
import pytest

from daq.telemetry.config import DownlinkConfig
from daq.transport.mavlink_codec import FrameDecoder, FrameEncoder, MavlinkFrame
from daq.transport.signing import (
    SignatureVerdict,
    Signer,
    SigningError,
    SigningState,
    load_key,
    load_state,
    save_state,
    stamp_of,
)
from groundstation.receiver import events as ev
from groundstation.receiver.ports import LinkConfig
from groundstation.receiver.senders import SAVE_NS
from tests.support.link_rig import Rig, quiet_scan

KEY = bytes(range(32))
NOW = 1_795_000_000_000_000_000


def frame_of(data: bytes) -> MavlinkFrame:
    found = FrameDecoder().feed(data)[0]
    assert isinstance(found, MavlinkFrame)
    return found


def judge(signer: Signer, data: bytes) -> SignatureVerdict:
    f = frame_of(data)
    return signer.judge(f.signed_part, (f.system, f.component), f.signature)


def signed(count: int, now: int = NOW, key: bytes = KEY) -> list[bytes]:
    encoder = FrameEncoder(1, 1, Signer(key, lambda: now, link_id=1))
    return [encoder.message("HEARTBEAT", type=1) for _ in range(count)]


def test_stock_implementation_accepts_our_signature_and_we_accept_its() -> None:
    from daq.contract.link.dialect import sideslip_dialect

    stock = sideslip_dialect.MAVLink(None, srcSystem=1, srcComponent=1)
    stock.signing.secret_key = KEY
    stock.signing.sign_outgoing = True
    stock.signing.timestamp = stamp_of(NOW)
    stock.signing.link_id = 1
    theirs = stock.heartbeat_encode(1, 0, 0, 0, 4, 3).pack(stock)
    assert judge(Signer(KEY, lambda: NOW), bytes(theirs)) is SignatureVerdict.GOOD
    listener = sideslip_dialect.MAVLink(None)
    listener.signing.secret_key = KEY
    assert listener.parse_buffer(signed(1)[0])[0].get_type() == "HEARTBEAT"


def test_one_forged_far_future_packet_locks_nobody_out() -> None:
    receiver = Signer(KEY, lambda: NOW)
    good = signed(51)
    forged = good[0][:-12] + (2**48 - 1).to_bytes(6, "little") + bytes(6)
    assert judge(receiver, forged) is SignatureVerdict.FORGED
    assert [judge(receiver, f) for f in good] == [SignatureVerdict.GOOD] * 51


def test_replays_are_refused_also_after_a_restart_of_the_receiver(tmp_path: Path) -> None:
    state = tmp_path / "state"
    recorded = signed(5)
    receiver = Signer(KEY, lambda: NOW, state_path=state)
    assert all(judge(receiver, f).accepted for f in recorded)
    assert judge(receiver, recorded[2]) is SignatureVerdict.REPLAYED
    receiver.save()
    later = Signer(KEY, lambda: NOW + 3_600 * 10**9, state_path=state)
    assert [judge(later, f) for f in recorded] == [SignatureVerdict.REPLAYED] * 5
    assert judge(later, signed(1, NOW + 10**9)[0]) is SignatureVerdict.GOOD


def test_a_recorded_stream_under_another_sender_does_not_pass(tmp_path: Path) -> None:
    receiver = Signer(KEY, lambda: NOW)
    assert judge(receiver, signed(1)[0]) is SignatureVerdict.GOOD
    old = FrameEncoder(7, 1, Signer(KEY, lambda: NOW - 120 * 10**9)).message("HEARTBEAT", type=1)
    assert judge(receiver, old) is SignatureVerdict.REPLAYED


def test_any_changed_bit_of_a_signed_frame_is_noticed() -> None:
    good = signed(1)[0]
    f = frame_of(good)
    for at in range(len(good) * 8):
        data = bytearray(good)
        data[at // 8] ^= 1 << at % 8
        receiver = Signer(KEY, lambda: NOW)
        verdict = receiver.judge(bytes(data[:-13]), (f.system, f.component), bytes(data[-13:]))
        assert verdict is SignatureVerdict.FORGED, at
        assert receiver.state.streams == {}


def test_outgoing_timestamps_rise_across_restarts_even_with_a_clock_at_zero(tmp_path: Path) -> None:
    state = tmp_path / "state"
    first = Signer(KEY, lambda: NOW, state_path=state)
    first.save()
    receiver = Signer(KEY, lambda: NOW)
    encoder = FrameEncoder(1, 1, first)
    assert judge(receiver, encoder.message("HEARTBEAT", type=1)) is SignatureVerdict.GOOD
    dead_clock = FrameEncoder(1, 1, Signer(KEY, lambda: 0, state_path=state))
    assert judge(receiver, dead_clock.message("HEARTBEAT", type=1)) is SignatureVerdict.GOOD


@pytest.mark.parametrize("mode", [0o640, 0o604, 0o644, 0o660])
def test_key_readable_by_others_is_refused(tmp_path: Path, mode: int) -> None:
    path = tmp_path / "key"
    path.write_bytes(KEY)
    path.chmod(mode)
    with pytest.raises(SigningError, match="chmod 600"):
        load_key(path)


def test_key_forms(tmp_path: Path) -> None:
    path = tmp_path / "key"
    path.write_text(KEY.hex() + "\n")
    path.chmod(0o600)
    assert load_key(path) == KEY
    path.write_text("secret")
    with pytest.raises(SigningError, match="64 hexadecimal"):
        load_key(path)
    with pytest.raises(SigningError, match="cannot be read"):
        load_key(tmp_path / "nowhere")


def test_damaged_state_is_not_taken_for_a_new_one(tmp_path: Path) -> None:
    path = tmp_path / "state"
    save_state(SigningState(5, 6, {(1, 1, 1): 6}), path)
    assert load_state(path) == SigningState(5, 6, {(1, 1, 1): 6})
    assert path.stat().st_mode & 0o777 == 0o600
    path.write_text(path.read_text()[:-4])
    with pytest.raises(SigningError, match="not a signing state"):
        load_state(path)


def test_forged_frames_do_nothing_at_the_ground_and_every_one_is_told_of(tmp_path: Path) -> None:
    key = tmp_path / "key"
    key.write_bytes(KEY)
    key.chmod(0o600)
    overheard: list[bytes] = []

    def overhear(data: bytes) -> bytes:
        overheard.append(data)
        return data

    rig = Rig(
        tmp_path / "ground",
        down=overhear,
        aircraft=DownlinkConfig(budget_bytes_per_s=20_000, key_file=key, signing_state=tmp_path / "air"),
        ground=LinkConfig(ports=("memory",), key_file=key, signing_state=tmp_path / "state", backfill="off"),
    )
    rng = np.random.default_rng(1)

    def fly(scans: int) -> None:
        rig.fly(scans, lambda n: quiet_scan(n, rng, time_ns=rig.clock.monotonic_ns()))

    fly(100)
    for frame in (m.raw for data in overheard[:20] for m in FrameDecoder().feed(data) if isinstance(m, MavlinkFrame)):
        rig._ground.write(frame)  # replayed
    far = Signer(bytes(32), lambda: NOW + 10**18, link_id=1)
    for _ in range(7):
        rig._ground.write(FrameEncoder(1, 1).message("STATUSTEXT", severity=0, text="unsigned"))
        rig._ground.write(FrameEncoder(1, 1, far).message("STATUSTEXT", severity=0, text="badly signed"))
    fly(2)
    rig._ground.write(FrameEncoder(1, 1).message("STATUSTEXT", severity=0, text="once more"))
    fly(160)
    refused = rig.findings(ev.ReceptionFindingKind.REFUSED)
    assert sum(e.count for e in refused) == rig.ground.summary()["unsigned_rejected"]
    told = {why: sum(e.count for e in refused if e.detail == why) for why in {e.detail for e in refused}}
    assert (told["unsigned"], told["badly signed"]) == (8, 7)
    assert told["replayed"] >= 20
    assert not [e for e in rig.events if isinstance(e, ev.StatusText)]
    (books,) = rig.ground.accounting()
    assert books.received == len(rig.link.downlink.sent)
    assert books.lost == []
    rig.close()


def key_file(tmp_path: Path, data: bytes = KEY) -> Path:
    path = tmp_path / "key"
    path.write_bytes(data)
    path.chmod(0o600)
    return path


@pytest.mark.parametrize("data", [bytes(32), b"0" * 64, b"0" * 64 + b"\n"], ids=["bytes", "digits", "a line of digits"])
def test_a_key_of_zeros_is_no_secret(tmp_path: Path, data: bytes) -> None:
    with pytest.raises(SigningError, match="is the same"):
        load_key(key_file(tmp_path, data))


def test_what_is_no_file_is_no_key_and_is_not_waited_for(tmp_path: Path) -> None:
    fifo = tmp_path / "fifo"
    os.mkfifo(fifo, 0o600)
    device = Path("/dev/zero")
    folder = tmp_path / "folder"
    folder.mkdir(mode=0o700)
    for path in (fifo, device, folder):
        with pytest.raises(SigningError, match="not a regular file"):
            load_key(path)
        with pytest.raises(SigningError, match="not a regular file"):
            load_state(path)


def test_a_huge_file_is_no_key_and_is_not_read(tmp_path: Path) -> None:
    path = key_file(tmp_path)
    os.truncate(path, 1 << 40)
    with pytest.raises(SigningError, match="64 hexadecimal"):
        load_key(path)


UNSOUND_STATES = {
    "infinity": '{"sent": Infinity, "heard": 1, "streams": []}',
    "an overflow": '{"sent": 1e400, "heard": 1, "streams": []}',
    "a fraction": '{"sent": 1.5, "heard": 1, "streams": []}',
    "nesting": "[" * 50_000,
    "a list": "[]",
    "null": "null",
    "below zero": '{"sent": -1, "heard": 1, "streams": []}',
    "beyond 48 bits": '{"sent": 281474976710656, "heard": 1, "streams": []}',
    "a boolean": '{"sent": true, "heard": 1, "streams": []}',
    "a stream of words": '{"sent": 1, "heard": 1, "streams": ["abcd"]}',
    "a stream beyond its range": '{"sent": 1, "heard": 1, "streams": [[256, 1, 1, 1]]}',
    "more streams than kept": f'{{"sent": 1, "heard": 1, "streams": {[[1, 1, 1, 1]] * 300}}}',
    "a very long number": f'{{"sent": {"9" * 9000}, "heard": 1, "streams": []}}',
    "a huge file": " " * 3_000_000,
    "no text": "\udcff",
}


@pytest.mark.parametrize("what", UNSOUND_STATES)
def test_an_unsound_state_is_set_aside_with_a_sentence_and_opens_no_door(tmp_path: Path, what: str) -> None:
    state = tmp_path / "state"
    text = UNSOUND_STATES[what].encode("utf-8", "surrogateescape")
    state.write_bytes(text)
    with pytest.raises(SigningError, match="not a signing state"):
        load_state(state)
    receiver = Signer(KEY, lambda: NOW, state_path=state)
    assert "set aside" in receiver.notice
    assert (tmp_path / "state.unusable").read_bytes() == text
    assert judge(receiver, signed(1, NOW - 120 * 10**9)[0]) is SignatureVerdict.REPLAYED
    assert judge(receiver, signed(1, NOW + 1)[0]) is SignatureVerdict.GOOD
    receiver.save()
    assert Signer(KEY, lambda: NOW, state_path=state).notice == ""


def test_an_unsound_state_stops_a_station_whose_clock_knows_nothing(tmp_path: Path) -> None:
    state = tmp_path / "state"
    state.write_text("[]")
    with pytest.raises(SigningError, match="clock"):
        Signer(KEY, lambda: 10**9, state_path=state)
    assert state.read_text() == "[]"


def test_saving_follows_no_link_that_somebody_has_planted(tmp_path: Path) -> None:
    treasure = tmp_path / "treasure"
    treasure.write_text("keep me")
    state = tmp_path / "private" / "state"
    state.parent.mkdir()
    for name in ("state", "state.new", "state.tmp"):
        (state.parent / name).symlink_to(treasure)
    save_state(SigningState(5, 6, {}), state)
    assert treasure.read_text() == "keep me"
    assert not state.is_symlink()
    assert state.stat().st_mode & 0o777 == 0o600
    assert load_state(state) == SigningState(5, 6, {})
    assert {p.name for p in state.parent.iterdir()} == {"state", "state.new", "state.tmp"}


def test_a_failed_save_leaves_the_old_state_and_nothing_else(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    state = tmp_path / "state"
    save_state(SigningState(5, 6, {}), state)

    def full(_: int) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch, pytest.raises(OSError, match="No space"):
        patch.setattr(os, "fsync", full)
        save_state(SigningState(7, 8, {}), state)
    assert load_state(state) == SigningState(5, 6, {})
    assert [p.name for p in tmp_path.iterdir()] == ["state"]


def test_after_a_crash_recorded_frames_count_for_seconds_only(tmp_path: Path) -> None:
    key = key_file(tmp_path)
    heard: list[tuple[int, bytes]] = []
    rig = Rig(
        None,
        down=lambda data: (heard.append((rig.clock.utc_ns(), data)), data)[1],  # type: ignore[func-returns-value]
        aircraft=DownlinkConfig(budget_bytes_per_s=20_000, key_file=key, signing_state=tmp_path / "air"),
        ground=LinkConfig(ports=("memory",), key_file=key, signing_state=tmp_path / "state", backfill="off"),
    )
    rng = np.random.default_rng(1)
    worst = 0.0
    for i in range(420):
        rig.fly(1, lambda n: quiet_scan(n, rng, time_ns=rig.clock.monotonic_ns()))
        gate = rig.ground._gate
        if gate._saving is not None:
            gate._saving.result()  # the disk of this test is fast
        if i % 19 == 0 and (tmp_path / "state").exists():
            after_crash = Signer(KEY, rig.clock.utc_ns, state_path=tmp_path / "state")
            counts = (
                at
                for at, data in heard
                for f in FrameDecoder().feed(data)
                if isinstance(f, MavlinkFrame) and judge(after_crash, f.raw).accepted
            )
            worst = max(worst, (rig.clock.utc_ns() - next(counts, rig.clock.utc_ns())) * 1e-9)
    rig.close()
    assert 0.0 < worst <= SAVE_NS * 1e-9 + 0.1


def test_a_bad_state_is_told_by_the_ground_station(tmp_path: Path) -> None:
    (tmp_path / "state").write_text("[]")
    config = LinkConfig(ports=("memory",), key_file=key_file(tmp_path), signing_state=tmp_path / "state")
    rig = Rig(None, ground=config)
    told = [e for e in rig.look() if isinstance(e, ev.Trouble)]
    assert [e.what for e in told] == ["signing state"]
    assert "set aside" in (told[0].words or "")
    rig.close()
