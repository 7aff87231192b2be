"""Signing: forged, replayed and far-future frames change nothing; keys and state are guarded on disk."""

from pathlib import Path

import numpy as np
import pytest

from daq.telemetry.config import DownlinkConfig
from daq.transport.mavlink_codec import Frame, FrameDecoder, FrameEncoder
from daq.transport.signing import (
    Signer,
    SigningError,
    SigningState,
    Verdict,
    load_key,
    load_state,
    save_state,
    stamp_of,
)
from groundstation.receiver import events as ev
from groundstation.receiver.link_config import LinkConfig
from tests.link_rig import Rig, quiet_scan

KEY = bytes(range(32))
NOW = 1_795_000_000_000_000_000


def frame_of(data: bytes) -> Frame:
    found = FrameDecoder().feed(data)[0]
    assert isinstance(found, Frame)
    return found


def judge(signer: Signer, data: bytes) -> Verdict:
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
    assert judge(Signer(KEY, lambda: NOW), bytes(theirs)) is Verdict.GOOD
    listener = sideslip_dialect.MAVLink(None)
    listener.signing.secret_key = KEY
    assert listener.parse_buffer(signed(1)[0])[0].get_type() == "HEARTBEAT"


def test_one_forged_far_future_packet_locks_nobody_out() -> None:
    receiver = Signer(KEY, lambda: NOW)
    good = signed(51)
    forged = good[0][:-12] + (2**48 - 1).to_bytes(6, "little") + bytes(6)
    assert judge(receiver, forged) is Verdict.FORGED
    assert [judge(receiver, f) for f in good] == [Verdict.GOOD] * 51


def test_replays_are_refused_also_after_a_restart_of_the_receiver(tmp_path: Path) -> None:
    state = tmp_path / "state"
    recorded = signed(5)
    receiver = Signer(KEY, lambda: NOW, state_path=state)
    assert all(judge(receiver, f).accepted for f in recorded)
    assert judge(receiver, recorded[2]) is Verdict.REPLAYED
    receiver.save()
    later = Signer(KEY, lambda: NOW + 3_600 * 10**9, state_path=state)
    assert [judge(later, f) for f in recorded] == [Verdict.REPLAYED] * 5
    assert judge(later, signed(1, NOW + 10**9)[0]) is Verdict.GOOD


def test_a_recorded_stream_under_another_sender_does_not_pass(tmp_path: Path) -> None:
    receiver = Signer(KEY, lambda: NOW)
    assert judge(receiver, signed(1)[0]) is Verdict.GOOD
    old = FrameEncoder(7, 1, Signer(KEY, lambda: NOW - 120 * 10**9)).message("HEARTBEAT", type=1)
    assert judge(receiver, old) is Verdict.REPLAYED


def test_any_changed_bit_of_a_signed_frame_is_noticed() -> None:
    good = signed(1)[0]
    f = frame_of(good)
    for at in range(len(good) * 8):
        data = bytearray(good)
        data[at // 8] ^= 1 << at % 8
        receiver = Signer(KEY, lambda: NOW)
        verdict = receiver.judge(bytes(data[:-13]), (f.system, f.component), bytes(data[-13:]))
        assert verdict is Verdict.FORGED, at
        assert receiver.state.streams == {}


def test_outgoing_timestamps_rise_across_restarts_even_with_a_clock_at_zero(tmp_path: Path) -> None:
    state = tmp_path / "state"
    first = Signer(KEY, lambda: NOW, state_path=state)
    first.save()
    receiver = Signer(KEY, lambda: NOW)
    encoder = FrameEncoder(1, 1, first)
    assert judge(receiver, encoder.message("HEARTBEAT", type=1)) is Verdict.GOOD
    dead_clock = FrameEncoder(1, 1, Signer(KEY, lambda: 0, state_path=state))
    assert judge(receiver, dead_clock.message("HEARTBEAT", type=1)) is Verdict.GOOD


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
    for frame in (m.raw for data in overheard[:20] for m in FrameDecoder().feed(data) if isinstance(m, Frame)):
        rig._ground.write(frame)  # replayed
    far = Signer(bytes(32), lambda: NOW + 10**18, link_id=1)
    for _ in range(7):
        rig._ground.write(FrameEncoder(1, 1).message("STATUSTEXT", severity=0, text="unsigned"))
        rig._ground.write(FrameEncoder(1, 1, far).message("STATUSTEXT", severity=0, text="badly signed"))
    fly(2)
    rig._ground.write(FrameEncoder(1, 1).message("STATUSTEXT", severity=0, text="once more"))
    fly(160)
    refused = [e for e in rig.events if isinstance(e, ev.Refused)]
    assert sum(e.count for e in refused) == rig.ground.summary()["unsigned_rejected"]
    told = {why: sum(e.count for e in refused if e.why == why) for why in {e.why for e in refused}}
    assert (told["unsigned"], told["badly signed"]) == (8, 7)
    assert told["replayed"] >= 20
    assert not [e for e in rig.events if isinstance(e, ev.StatusText)]
    (books,) = rig.ground.accounting()
    assert books.received == len(rig.link.downlink.sent)
    assert books.lost == []
    rig.close()
