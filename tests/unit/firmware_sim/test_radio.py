"""The radio link: what goes in comes out late, damaged or not at all, and every packet is accounted for."""

import pytest
from pymavlink.dialects.v20 import common

from firmware_sim.hardware.radio import RadioModel, SimulatedRadioLink, radio_status, x25
from firmware_sim.tables import ScenarioError, checked
from tests.unit.firmware_sim.hardware import CountingClock

PERFECT = {"latency_ms": 0.0, "jitter_ms": 0.0, "status_period_s": 0.0}


def frames(count: int) -> list[bytes]:
    """Different MAVLink 2 frames as pymavlink packs them."""
    mav = common.MAVLink(None, srcSystem=1, srcComponent=1)
    return [mav.attitude_encode(k, 0.1 * k, 0.2, 0.3, 0.4, 0.5, 0.6).pack(mav) for k in range(count)]


def heartbeat() -> bytes:
    mav = common.MAVLink(None, srcSystem=1, srcComponent=1)
    return bytes(mav.heartbeat_encode(1, 0, 0, 0, 4, 3).pack(mav))


def sent_through(
    model: RadioModel, packets: list[bytes], spacing_ms: float = 50.0, seed: int = 1
) -> tuple[SimulatedRadioLink, bytes]:
    clock = CountingClock()
    link = SimulatedRadioLink(model, clock.monotonic_ns, seed)
    received = b""
    for packet in packets:
        assert link.air.write(packet) == len(packet)
        clock.wait_ms(spacing_ms)
        received += link.ground.read()
    clock.wait_ms(10_000)
    return link, received + link.ground.read()


def test_a_perfect_link_changes_nothing() -> None:
    packets = frames(50)
    link, received = sent_through(RadioModel(**PERFECT), packets)
    assert received == b"".join(packets)
    assert (link.down.sent, link.down.delivered, link.down.lost) == (50, 50, 0)


def test_bytes_in_pieces_are_put_together() -> None:
    data = b"".join(frames(20))
    _, received = sent_through(RadioModel(**PERFECT), [data[i : i + 7] for i in range(0, len(data), 7)], 1.5)
    assert received == data


def test_what_is_no_frame_goes_through_too() -> None:
    noise = bytes(range(1, 250)) * 4
    _, received = sent_through(RadioModel(**PERFECT), [noise])
    assert received == noise


def test_loss_takes_whole_frames_and_is_counted() -> None:
    packets = frames(2000)
    link, received = sent_through(RadioModel(**PERFECT, drop=0.05), packets)
    assert link.down.sent == link.down.lost + link.down.delivered == 2000
    assert link.down.lost == pytest.approx(100, abs=35)
    assert sum(packet in received for packet in packets) == link.down.delivered


def test_bit_errors_damage_the_expected_share() -> None:
    packets = frames(1500)
    rate = 2e-4
    link, received = sent_through(RadioModel(**PERFECT, bit_error_rate=rate), packets)
    expected = 1.0 - (1.0 - rate) ** (8 * len(packets[0]))
    assert link.down.damaged / 1500 == pytest.approx(expected, abs=0.02)
    assert sum(packet in received for packet in packets) == 1500 - link.down.damaged


def expected_loss(model: RadioModel, packet_bytes: int) -> float:
    """Share of packets of this size that do not arrive whole, bursts apart."""
    whole = (1.0 - model.bit_error_rate) ** (8 * packet_bytes) * (1.0 - model.byte_drop_rate) ** packet_bytes
    return 1.0 - (1.0 - model.drop) * whole


def test_expected_loss_of_all_kinds_together() -> None:
    packets = frames(1500)
    model = RadioModel(**PERFECT, drop=0.03, bit_error_rate=5e-5, byte_drop_rate=2e-4)
    _, received = sent_through(model, packets)
    whole = sum(packet in received for packet in packets)
    assert 1.0 - whole / 1500 == pytest.approx(expected_loss(model, len(packets[0])), abs=0.025)


def test_bursts_lose_neighbours() -> None:
    link, _ = sent_through(RadioModel(**PERFECT, burst_every_s=5.0, burst_s=1.0), frames(2000))
    assert link.down.lost / 2000 == pytest.approx(1.0 / 6.0, abs=0.08)


def test_latency_and_order() -> None:
    clock = CountingClock()
    link = SimulatedRadioLink(RadioModel(latency_ms=100.0, jitter_ms=200.0, status_period_s=0.0), clock.monotonic_ns, 3)
    packets = frames(100)
    received = b""
    link.air.write(packets[0])
    clock.wait_ms(99)
    assert link.ground.read() == b""
    for packet in packets[1:]:
        link.air.write(packet)
        clock.wait_ms(40)
        received += link.ground.read()
    clock.wait_ms(1000)
    assert received + link.ground.read() == b"".join(packets)


def test_air_rate_limits_and_the_buffer_overflows() -> None:
    clock = CountingClock()
    model = RadioModel(latency_ms=0.0, jitter_ms=0.0, status_period_s=0.0, air_bytes_per_s=1000.0, buffer_bytes=1000)
    link = SimulatedRadioLink(model, clock.monotonic_ns)
    data = b"".join(frames(200))
    taken = link.air.write(data)
    assert taken == 4096  # the operating system's buffer of the serial line
    clock.wait_ms(3000)
    first = len(link.ground.read())
    clock.wait_ms(60_000)
    total = first + len(link.ground.read())
    assert total <= 1000.0 + 0.72 * 1000.0 + 100  # a buffer full, and what was sent while the line delivered 4096 bytes
    assert total + link.down.refused_bytes == pytest.approx(taken, abs=80)


def test_status_only_after_a_heartbeat_and_readable_by_pymavlink() -> None:
    for protocol in (1, 2):
        clock = CountingClock()
        link = SimulatedRadioLink(
            RadioModel(latency_ms=0.0, jitter_ms=0.0, status_protocol=protocol), clock.monotonic_ns
        )
        link.air.write(frames(1)[0])
        clock.wait_ms(2000)
        parser = common.MAVLink(None)
        assert [m.get_type() for m in parser.parse_buffer(link.ground.read()) or []] == ["ATTITUDE"]
        assert link.air.read() == b""
        link.air.write(heartbeat())
        clock.wait_ms(1500)
        names = [m.get_type() for m in common.MAVLink(None).parse_buffer(link.ground.read())]
        assert sorted(names) == ["HEARTBEAT", "RADIO_STATUS"]
        (status,) = common.MAVLink(None).parse_buffer(link.air.read())
        assert (status.get_type(), status.txbuf, status.rssi) == ("RADIO_STATUS", 100, 190)


def test_status_reports_a_filling_buffer() -> None:
    clock = CountingClock()
    model = RadioModel(latency_ms=0.0, jitter_ms=0.0, air_bytes_per_s=400.0)
    link = SimulatedRadioLink(model, clock.monotonic_ns)
    for packet in frames(60):
        link.air.write(packet)
        clock.wait_ms(20)
    link.air.write(heartbeat())
    clock.wait_ms(1000)
    statuses = [m for m in common.MAVLink(None).parse_buffer(link.air.read()) or [] if m.get_type() == "RADIO_STATUS"]
    assert statuses
    assert statuses[-1].txbuf < 60


def test_outage_of_a_scenario() -> None:
    clock = CountingClock()
    link = SimulatedRadioLink(RadioModel(**PERFECT), clock.monotonic_ns, lost=lambda now: 1e9 <= now < 2e9)
    for packet in frames(60):
        link.air.write(packet)
        clock.wait_ms(50)
    assert link.down.lost == 20


def test_same_seed_same_link() -> None:
    packets = frames(300)
    model = RadioModel(drop=0.2, bit_error_rate=1e-4, duplicate=0.05, reorder=0.05)
    assert sent_through(model, packets, seed=4)[1] == sent_through(model, packets, seed=4)[1]
    assert sent_through(model, packets, seed=4)[1] != sent_through(model, packets, seed=5)[1]


def test_checksum_check_value() -> None:
    assert x25(b"123456789") == 0x6F91  # CRC-16/MCRF4XX
    assert len(radio_status(RadioModel(), 50, 0, 0)) == 17


def test_mistakes_are_named() -> None:
    with pytest.raises(ScenarioError, match=r"radio\.drop"):
        checked(RadioModel, {"drop": 2.0}, "test", "radio")
