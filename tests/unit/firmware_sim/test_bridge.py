"""A simulated radio joined to a real port carries bytes both ways, and outlives a port that is away."""

from daq.clock import SimulatedClock
from daq.transport.mavlink_codec import FrameDecoder, FrameEncoder
from daq.transport.ports import MemoryPort, memory_pair
from firmware_sim.hardware.bridge import PortBridge
from firmware_sim.hardware.radio import RadioModel, SimulatedRadioLink


class UnreliablePort:
    """A port that can be away, or slow."""

    def __init__(self, port: MemoryPort) -> None:
        self.port, self.away, self.room = port, False, 1 << 20

    def read(self, limit: int = 65536) -> bytes:
        if self.away:
            raise OSError("away")
        return self.port.read(limit)

    def write(self, data: bytes) -> int:
        if self.away:
            raise OSError("away")
        return self.port.write(data[: self.room])

    def close(self) -> None:
        self.port.close()


def test_bytes_go_both_ways_and_a_port_that_is_away_costs_only_what_is_sent_meanwhile() -> None:
    clock = SimulatedClock(0)
    radio = SimulatedRadioLink(RadioModel(status_period_s=0), clock.monotonic_ns)
    ours, theirs = memory_pair()
    port = UnreliablePort(ours)
    bridge = PortBridge(radio.ground, port)
    encoder = FrameEncoder(1, 1)
    frames = [encoder.message("STATUSTEXT", text=f"number {i}") for i in range(30)]

    def send(some: list[bytes]) -> None:
        for frame in some:
            radio.air.write(frame)
            for _ in range(10):
                clock.advance(50_000_000)
                bridge.pump(clock.monotonic_ns())

    send(frames[:10])
    port.away = True
    send(frames[10:20])
    port.away, port.room = False, 7
    send(frames[20:])
    port.room = 1 << 20
    bridge.pump(clock.monotonic_ns())
    texts = [str(f.fields()["text"]) for f in FrameDecoder().feed(theirs.read()) if hasattr(f, "fields")]
    assert texts == [f"number {i}" for i in (*range(10), *range(20, 30))]
    theirs.write(frames[0])
    for _ in range(10):
        bridge.pump(clock.monotonic_ns())
        clock.advance(50_000_000)
    assert radio.air.read() == frames[0]
