"""A pair of telemetry radios: two byte ports with a slow, delayed and lossy link between them.

Bytes written at one end pass its serial line, are packed frame by frame as by a SiK radio in MAVLink mode, are sent at the rate
of the air, and arrive at the other end late, damaged, or not at all. Like a SiK radio it reports the link to each side
(RADIO_STATUS) once a second after a HEARTBEAT. All times are simulated; each direction has one seeded random generator. The fate
of every packet is counted.
"""

import math
import struct
import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from firmware_sim.tables import SimulatorTable

Share = Annotated[float, Field(ge=0.0, le=1.0)]
NotNegative = Annotated[float, Field(ge=0.0)]

MAGIC_V1, MAGIC_V2, SIGNED_FLAG = 0xFE, 0xFD, 0x01
HEARTBEAT_ID, RADIO_STATUS_ID, RADIO_STATUS_CRC = 0, 109, 185
RADIO_SYSTEM, RADIO_COMPONENT = ord("3"), ord("D")
LONGEST_FRAME = 280
PIECE = 64  # longest packet of bytes that are no MAVLink frame
TTY_BYTES = 4096  # the operating system's buffer for the serial line
FLUSH_NS = 50_000_000  # an incomplete frame is sent after this


class RadioModel(SimulatorTable):
    """Scenario table `[radio]`. drop, duplicate: shares of packets. bit_error_rate, byte_drop_rate: per bit and byte on the
    air."""

    drop: Share = 0.0
    duplicate: Share = 0.0
    reorder: Share = Field(default=0.0, description="share of packets that arrive behind the next one")
    bit_error_rate: Share = 0.0
    byte_drop_rate: Share = 0.0
    burst_every_s: NotNegative = Field(
        0.0, description="mean time between bursts in which nothing gets through; 0: none"
    )
    burst_s: NotNegative = Field(default=0.2, description="mean length of a burst")
    latency_ms: NotNegative = 60.0
    jitter_ms: NotNegative = Field(default=40.0, description="further delay, uniform, packets staying in order")
    serial_baud: Annotated[int, Field(gt=0)] = 57_600
    air_bytes_per_s: Annotated[float, Field(gt=0.0)] = Field(
        default=3283.0, description="fair half of 64 kbit/s, no ECC"
    )
    buffer_bytes: Annotated[int, Field(gt=300)] = 2048
    status_period_s: NotNegative = Field(default=1.0, description="RADIO_STATUS after a HEARTBEAT; 0: never")
    status_protocol: Literal[1, 2] = 1
    rssi: Annotated[int, Field(ge=0, le=254)] = 190
    noise: Annotated[int, Field(ge=0, le=254)] = 40


@dataclass(slots=True)
class PacketCounts:
    """Packets of one direction: sent = lost + delivered; damaged ones are among those delivered, duplicates are extra."""

    sent: int = 0
    lost: int = 0
    damaged: int = 0
    delivered: int = 0
    duplicated: int = 0
    refused_bytes: int = 0  # that found the radio's buffer full


class RadioPort:
    """One end of the link, a serial port for the program there; reads and writes never block."""

    def __init__(self, link: "SimulatedRadioLink", side: int) -> None:
        self._link = link
        self._side = side
        self.timeout: float | None = 0.0
        self.is_open = True

    @property
    def in_waiting(self) -> int:
        """Bytes that can be read at once."""
        return self._link.waiting(self._side)

    def read(self, limit: int = 65536) -> bytes:
        """At most `limit` bytes that have arrived."""
        return self._link.read_side(self._side, limit)

    def write(self, data: bytes) -> int:
        """Send bytes; returns how many the serial line's buffer has taken."""
        return self._link.write_side(self._side, bytes(data))

    def flush(self) -> None:
        """Do nothing: written bytes are with the radio already."""

    def close(self) -> None:
        """Close the port."""
        self.is_open = False


class SimulatedRadioLink:
    """Both radios and the air between them; `air` is the aircraft's port, `ground` the ground station's.

    monotonic_ns: returns simulated time [ns]. lost: time [ns] -> whether nothing gets through (an outage of the scenario). Ports
    may be used from different threads.
    """

    def __init__(
        self,
        model: RadioModel,
        monotonic_ns: Callable[[], int],
        seed: int = 0,
        lost: Callable[[int], bool] = lambda now_ns: False,
    ) -> None:
        self.model = model
        self.air = RadioPort(self, 0)
        self.ground = RadioPort(self, 1)
        self._now = monotonic_ns
        self._lock = threading.Lock()
        self._directions = tuple(
            _Direction(model, np.random.default_rng([seed, 0x5AD10, side]), lost) for side in (0, 1)
        )
        self._heartbeat_ns: int | None = None
        self._status_ns = 0
        self._sequence = 0

    @property
    def down(self) -> PacketCounts:
        """Counts of the direction from the aircraft to the ground."""
        return self._directions[0].counts

    @property
    def up(self) -> PacketCounts:
        """Counts of the direction from the ground to the aircraft."""
        return self._directions[1].counts

    def write_side(self, side: int, data: bytes) -> int:
        """Write bytes at one side; returns how many were taken."""
        with self._lock:
            now_ns = self._now()
            direction = self._directions[side]
            capacity = direction.capacity(now_ns)
            for packet in direction.accept(data[:capacity], now_ns):
                if _message_id(packet) == HEARTBEAT_ID:
                    self._heartbeat_ns = now_ns
            return min(capacity, len(data))

    def waiting(self, side: int) -> int:
        """Bytes that a side can read now."""
        with self._lock:
            self._arrive()
            return len(self._directions[1 - side].inbox)

    def read_side(self, side: int, size: int) -> bytes:
        """Read bytes at one side."""
        with self._lock:
            self._arrive()
            inbox = self._directions[1 - side].inbox
            data = bytes(inbox[:size])
            del inbox[:size]
            return data

    def _arrive(self) -> None:
        now_ns = self._now()
        for direction in self._directions:
            direction.arrive(now_ns)
        self._report(now_ns)

    def _report(self, now: int) -> None:
        """Put a RADIO_STATUS into both inboxes, between the packets that arrive over the air."""
        period = round(self.model.status_period_s * 1e9)
        if not period or self._heartbeat_ns is None or now - self._status_ns < period:
            return
        if now - self._heartbeat_ns > 5 * period:
            return
        self._status_ns = now
        for side in (0, 1):
            free = self._directions[side].free_percent(now)
            frame = radio_status(self.model, free, self._directions[1 - side].counts.damaged, self._sequence)
            self._directions[1 - side].inject(frame)
        self._sequence = (self._sequence + 1) & 0xFF


class _Direction:
    """One direction, from the serial line of one radio to that of the other."""

    def __init__(self, model: RadioModel, rng: np.random.Generator, lost: Callable[[int], bool]) -> None:
        self.counts = PacketCounts()
        self.inbox = bytearray()
        self._model = model
        self._rng = rng
        self._outage = lost
        self._pending = bytearray()  # an incomplete frame
        self._pending_ns = 0
        self._line_until = 0  # the serial line is busy until then
        self._sent_until = 0  # the air is busy until then
        self._last_arrival = 0
        self._under_way: deque[tuple[int, bytes]] = deque()
        self._burst = (0, 0)

    def capacity(self, now: int) -> int:
        """Free bytes of the serial line's buffer."""
        queued = max(0, self._line_until - now) * 1e-9 * self._model.serial_baud / 10.0
        return max(0, TTY_BYTES - math.ceil(queued))

    def accept(self, data: bytes, now: int) -> list[bytes]:
        """Take bytes from the serial line and send the complete packets; returns these."""
        if not self._pending:
            self._pending_ns = now
        self._line_until = max(self._line_until, now) + round(len(data) * 10e9 / self._model.serial_baud)
        self._pending += data
        packets = _packets(self._pending, flush=False)
        for packet in packets:
            self._send(packet, now)
        return packets

    def arrive(self, now: int) -> None:
        """Move what has arrived by now into the inbox."""
        if self._pending and now - self._pending_ns > FLUSH_NS:
            for packet in _packets(self._pending, flush=True):
                self._send(packet, now)
        while self._under_way and self._under_way[0][0] <= now:
            self.inbox += self._under_way.popleft()[1]

    def inject(self, frame: bytes) -> None:
        """Append a frame of the radio itself to the inbox."""
        self.inbox += frame

    def free_percent(self, now: int) -> int:
        """Free share of the radio's buffer [%]."""
        backlog = max(0, self._sent_until - now) * 1e-9 * self._model.air_bytes_per_s
        return round(100.0 * max(0.0, 1.0 - backlog / self._model.buffer_bytes))

    def _send(self, packet: bytes, now: int) -> None:
        m = self._model
        ready = max(self._line_until, now)  # when the packet has passed the serial line
        backlog = max(0, self._sent_until - ready) * 1e-9 * m.air_bytes_per_s
        if backlog + len(packet) > m.buffer_bytes:
            self.counts.refused_bytes += len(packet)
            return
        self.counts.sent += 1
        self._sent_until = max(self._sent_until, ready) + round(len(packet) * 1e9 / m.air_bytes_per_s)
        if self._outage(now) or self._in_burst(now) or self._rng.random() < m.drop:
            self.counts.lost += 1
            return
        damaged = self._damage(packet)
        if not damaged:
            self.counts.lost += 1
            return
        self.counts.delivered += 1
        if damaged != packet:
            self.counts.damaged += 1
        delay = (m.latency_ms + m.jitter_ms * self._rng.random()) * 1e6
        arrival = max(self._sent_until + round(delay), self._last_arrival + 1)
        self._last_arrival = arrival
        self._deliver(arrival, damaged)
        if self._rng.random() < m.duplicate:
            self.counts.duplicated += 1
            self._deliver(arrival, damaged)

    def _deliver(self, arrival: int, packet: bytes) -> None:
        if self._under_way and self._rng.random() < self._model.reorder:
            last_arrival, last = self._under_way.pop()
            self._under_way.append((last_arrival, packet))
            self._under_way.append((arrival, last))
        else:
            self._under_way.append((arrival, packet))

    def _in_burst(self, now: int) -> bool:
        m = self._model
        if m.burst_every_s <= 0.0:
            return False
        while now >= self._burst[1]:
            start = self._burst[1] + round(self._rng.exponential(m.burst_every_s) * 1e9)
            self._burst = (start, start + round(self._rng.exponential(m.burst_s) * 1e9) + 1)
        return now >= self._burst[0]

    def _damage(self, packet: bytes) -> bytes:
        m = self._model
        if m.bit_error_rate > 0.0:
            bits = np.unpackbits(np.frombuffer(packet, np.uint8))
            flips = self._rng.random(bits.size) < m.bit_error_rate
            packet = np.packbits(bits ^ flips).tobytes()
        if m.byte_drop_rate > 0.0:
            data = np.frombuffer(packet, np.uint8)
            packet = data[self._rng.random(data.size) >= m.byte_drop_rate].tobytes()
        return packet


def _packets(pending: bytearray, *, flush: bool) -> list[bytes]:
    """Remove complete MAVLink frames, and pieces of anything else, from the front of `pending`, and return them."""
    packets = []
    while pending:
        length = _frame_length(pending)
        if length is None:  # no frame starts here: everything up to the next magic, or a piece
            end = min(
                (i for i in (pending.find(MAGIC_V2, 1), pending.find(MAGIC_V1, 1)) if i > 0), default=len(pending)
            )
            length = min(end, PIECE)
        elif length > len(pending):
            if not flush:
                break
            length = len(pending)
        packets.append(bytes(pending[:length]))
        del pending[:length]
    return packets


def _frame_length(data: bytearray) -> int | None:
    """Length of the MAVLink frame at the start of `data`, LONGEST_FRAME while its header is incomplete; None without a frame."""
    if data[0] == MAGIC_V1:
        return data[1] + 8 if len(data) > 1 else LONGEST_FRAME
    if data[0] == MAGIC_V2:
        if len(data) < 3:
            return LONGEST_FRAME
        return data[1] + 12 + (13 if data[2] & SIGNED_FLAG else 0)
    return None


def _message_id(packet: bytes) -> int | None:
    if len(packet) >= 8 and packet[0] == MAGIC_V1:
        return packet[5]
    if len(packet) >= 12 and packet[0] == MAGIC_V2:
        return int.from_bytes(packet[7:10], "little")
    return None


def radio_status(model: RadioModel, free_percent: int, errors: int, sequence: int) -> bytes:
    """An unsigned RADIO_STATUS frame (MAVLink common.xml, message 109). free_percent: of the radio's buffer; errors: damaged
    packets so far."""
    payload = struct.pack(
        "<HHBBBBB", min(errors, 65535), 0, model.rssi, model.rssi, free_percent, model.noise, model.noise
    )
    if model.status_protocol == 1:
        head = bytes([len(payload), sequence, RADIO_SYSTEM, RADIO_COMPONENT, RADIO_STATUS_ID])
        magic = MAGIC_V1
    else:
        ident = RADIO_STATUS_ID.to_bytes(3, "little")
        head = bytes([len(payload), 0, 0, sequence, RADIO_SYSTEM, RADIO_COMPONENT]) + ident
        magic = MAGIC_V2
    body = head + payload
    return bytes([magic]) + body + x25(body + bytes([RADIO_STATUS_CRC])).to_bytes(2, "little")


def x25(data: bytes) -> int:
    """CRC-16/MCRF4XX, the checksum of MAVLink."""
    crc = 0xFFFF
    for byte in data:
        mixed = byte ^ (crc & 0xFF)
        mixed = (mixed ^ mixed << 4) & 0xFF
        crc = (crc >> 8 ^ mixed << 8 ^ mixed << 3 ^ mixed >> 4) & 0xFFFF
    return crc
