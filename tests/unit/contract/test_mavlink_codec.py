"""The decoder loses exactly the damaged frames, accounts for every byte, and nothing makes it raise."""

import zlib
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from daq.contract.link.dialect import sideslip_dialect
from daq.contract.link.wire import SCAN_FAST_ID, layouts, pack_scan
from daq.transport import mavlink_codec
from daq.transport.mavlink_codec import FrameDecoder, FrameEncoder, Junk, MavlinkFrame, frames_of, message_types
from tests.support.link_rig import random_scan


def stream(count: int, seed: int = 1, noise: bool = True) -> list[bytes]:
    rng = np.random.default_rng(seed)
    encoder = FrameEncoder(1, 1)
    layout = layouts()[SCAN_FAST_ID]
    constant = random_scan(0, rng)
    return [
        encoder.frame(SCAN_FAST_ID, pack_scan(layout, random_scan(n, rng) if noise else constant, 9))
        for n in range(count)
    ]


def decode(data: bytes, sizes: int = 64) -> list[MavlinkFrame | Junk]:
    decoder = FrameDecoder()
    out: list[MavlinkFrame | Junk] = []
    for at in range(0, len(data), sizes):
        out += decoder.feed(data[at : at + sizes])
    out += decoder.finish()
    counts = decoder.counts
    assert counts.frame_bytes + counts.discarded_bytes == counts.received_bytes == len(data)
    assert b"".join(f.raw for f in out) == data  # nothing invented, nothing swallowed
    return out


def flip(frame: bytes, rng: np.random.Generator) -> bytes:
    at = int(rng.integers(len(frame)))
    return frame[:at] + bytes([frame[at] ^ 1 << int(rng.integers(8))]) + frame[at + 1 :]


def drop_byte(frame: bytes, rng: np.random.Generator) -> bytes:
    at = int(rng.integers(len(frame)))
    return frame[:at] + frame[at + 1 :]


def drop_burst(frame: bytes, rng: np.random.Generator) -> bytes:
    at = int(rng.integers(len(frame) - 20))
    return frame[:at] + frame[at + 20 :]


@pytest.mark.parametrize("damage", [flip, drop_byte, drop_burst])
@pytest.mark.parametrize("share", [0.001, 0.01, 0.1])
@pytest.mark.parametrize("noise", [True, False], ids=["flying", "parked"])
def test_lost_frames_are_exactly_the_damaged_ones(
    damage: Callable[[bytes, np.random.Generator], bytes], share: float, noise: bool
) -> None:
    # Seeded by name: a frame that ends in 0xFD and loses that byte is whole again with the next one's first, and the
    # next is the lost one. No decoder can tell; one random stream in a hundred has it. So it is with a damaged frame whose
    # checksum of 16 bits comes right by chance, as one has with seed 3.
    rng = np.random.default_rng(zlib.crc32(f"{damage.__name__} {share}".encode()) if noise else 4)
    sent = stream(2000, noise=noise)
    hit = rng.random(len(sent)) < share
    on_air = [damage(f, rng) if h else f for f, h in zip(sent, hit, strict=True)]
    found = [f.raw for f in frames_of(decode(b"".join(on_air)))]
    assert found == [f for f, h in zip(sent, hit, strict=True) if not h]


@pytest.mark.parametrize("size", [1, 7, 16, 280, 4096])
def test_pieces_of_any_size_give_the_same_frames(size: int) -> None:
    sent = stream(60)
    assert [f.raw for f in frames_of(decode(b"".join(sent), size))] == sent


@given(st.binary(max_size=2000), st.integers(1, 300))
@settings(max_examples=150, deadline=None)
def test_hostile_bytes_never_raise_and_are_all_accounted(data: bytes, size: int) -> None:
    decode(data, size)


@given(st.integers(0, 2**24 - 1), st.binary(max_size=255), st.integers(0, 255))
@settings(max_examples=150, deadline=None)
def test_hostile_headers_never_raise(msg_id: int, payload: bytes, flags: int) -> None:
    head = bytes([0xFD, len(payload), flags, 0, 1, 1, 1]) + msg_id.to_bytes(3, "little")
    good = stream(2)
    found = frames_of(decode(good[0] + head + payload + good[1]))
    assert found[0].raw == good[0]
    assert found[-1].raw == good[1]


def test_stock_parser_reads_what_the_encoder_makes() -> None:
    encoder = FrameEncoder(3, 4)
    stock = sideslip_dialect.MAVLink(None)
    frame = encoder.message("STATUSTEXT", severity=3, text="low airspeed", id=0)
    message = stock.parse_buffer(frame)[0]
    assert (message.get_type(), message.text, message.get_srcSystem()) == ("STATUSTEXT", "low airspeed", 3)


def test_every_message_of_the_dialect_packs_to_the_same_bytes_as_the_stock_class() -> None:
    for made in message_types().values():
        stock = sideslip_dialect.mavlink_map[made.msg_id]
        zeros = {n: ("" if t else 0) for n, t in zip(made.fields, made.text, strict=True)}
        assert made.codec.format == stock.unpacker.format
        assert made.unpack(made.pack({})).keys() == zeros.keys()


def test_only_the_radio_s_own_version_1_message_is_accepted() -> None:
    link = sideslip_dialect.MAVLink(None, srcSystem=ord("3"), srcComponent=ord("D"))
    radio = sideslip_dialect.MAVLink_radio_status_message(190, 180, 55, 40, 41, 7, 2).pack(link, force_mavlink1=True)
    beat = sideslip_dialect.MAVLink_heartbeat_message(1, 0, 0, 0, 4, 3).pack(link, force_mavlink1=True)
    sent = stream(3)
    found = frames_of(decode(sent[0] + radio + sent[1] + beat + sent[2]))
    assert [f.raw for f in found] == [sent[0], radio, sent[1], sent[2]]
    assert found[1].fields()["txbuf"] == 55
    link.srcSystem = 9
    stranger = sideslip_dialect.MAVLink_radio_status_message(190, 180, 55, 40, 41, 7, 2).pack(link, force_mavlink1=True)
    assert frames_of(decode(stranger)) == []


def test_sound_frames_of_other_dialects_are_recognised_and_left_alone() -> None:
    from pymavlink.dialects.v20 import ardupilotmega

    foreign = ardupilotmega.MAVLink_set_mode_message(1, 1, 0).pack(ardupilotmega.MAVLink(None, 255, 190))
    sent = stream(2)
    found = frames_of(decode(sent[0] + foreign + sent[1]))
    assert [f.known for f in found] == [True, False, True]


def test_values_that_do_not_fit_are_a_programming_fault() -> None:
    with pytest.raises(ValueError, match="does not fit"):
        FrameEncoder(1, 1).message("HEARTBEAT", type=300)
    with pytest.raises(ValueError, match="no field tpye"):
        FrameEncoder(1, 1).message("HEARTBEAT", tpye=3)


_AWKWARD = st.lists(
    st.one_of(
        st.sampled_from(
            [b"\xfd", b"\xfe", b"\xfd\x01\x00", b"\xfd\x09\x01", b"\xfe\x09\x00\x33\x44\x6d", b"\x00", b"\xfd\x00"]
        ),
        st.sampled_from(stream(4)),
        st.sampled_from(stream(2)).map(lambda frame: frame[:-1]),
        st.binary(max_size=6),
    ),
    max_size=30,
)


@given(_AWKWARD, st.integers(1, 40))
@settings(max_examples=300, deadline=None)
def test_pieces_of_any_size_give_the_same_frames_and_damage(parts: list[bytes], size: int) -> None:
    """Where a buffer ends within the head of a frame decides nothing."""
    data = b"".join(parts)
    whole, pieces = FrameDecoder(), FrameDecoder()
    at_once = frames_of([*whole.feed(data), *whole.finish()])
    in_pieces = [f for at in range(0, len(data), size) for f in pieces.feed(data[at : at + size])]
    assert frames_of([*in_pieces, *pieces.finish()]) == at_once
    assert (pieces.counts.frames, pieces.counts.discarded_bytes) == (whole.counts.frames, whole.counts.discarded_bytes)


@pytest.mark.parametrize(
    ("noise", "looks"),
    [(b"\xfd", 0.001), (b"\xfe", 0.001), (b"\xfd\xfe", 0.001), (b"\xfd\xff", 0.001), (b"\xfd\x10\x00", 0.35)],
)
def test_noise_of_magic_bytes_is_passed_over_without_examining_each(
    monkeypatch: pytest.MonkeyPatch, noise: bytes, looks: float
) -> None:
    examined: list[int] = []
    for name in ("_frame_at", "_sik_frame_at"):
        real = getattr(mavlink_codec, name)
        monkeypatch.setattr(mavlink_codec, name, lambda *a, real=real: (examined.append(1), real(*a))[1])
    decoder = FrameDecoder()
    data = noise * (60_000 // len(noise))
    decoder.feed(data)
    decoder.finish()
    assert decoder.counts.discarded_bytes == len(data)
    assert len(examined) <= looks * len(data)
