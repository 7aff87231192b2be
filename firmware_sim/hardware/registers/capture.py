"""The capture co-processor at register level, as its register map in docs/sensors.md specifies it.

Inputs: pulse widths of channels 1 to 6 [s] (0 where no pulse comes) and levels of digital inputs 1 to 5.
"""

import struct

from firmware_sim.hardware.registers.chip import Inputs, RegisterChip, to_counts

ID, MAP_VERSION, FIRMWARE, CONTROL, TIMEOUT, DEBOUNCE, SNAPSHOT = 0x00, 0x01, 0x02, 0x04, 0x05, 0x06, 0x10
SNAPSHOT_FORMAT = "<H6HB6BBBBHB"  # without the CRC
FRAME_NS = 20_000_000  # servo frames come at 50 Hz
START_UP_NS = 30_000_000
_CHANNEL_STAGGER_NS = 2_500_000  # receivers send the channels one after another
_WATCH_NS = 1_000_000
_COARSE_NS = 5_000_000  # while nothing moves; inputs are known on this grid
_FORGET_NS = 500_000_000


class CaptureChip(RegisterChip):
    """The co-processor; its loop looks at the inputs every millisecond."""

    def __init__(self, inputs: Inputs) -> None:
        super().__init__()
        self._inputs = inputs
        self.dead = False  # the capture loop has stopped; the bus side still answers
        self.reset(0)
        self._reset_ns = -START_UP_NS
        self._status = 0x01

    def reset(self, now_ns: int) -> None:
        self._registers = {TIMEOUT: 50, DEBOUNCE: 10}
        self._reset_ns = now_ns
        self._watched_ns = now_ns
        self._widths = [0.0] * 6
        self._ended = [-1] * 6
        self._latched = self._level = 0
        self._edges = 0
        self._edge_ns = -1
        self._steady_since = now_ns
        self._debounced = 0
        self._status = 0x01
        self._snapshot = bytes(28)

    def answers(self, now_ns: int) -> bool:
        return self.powered and now_ns - self._reset_ns >= START_UP_NS

    def write_register(self, register: int, value: int, now_ns: int) -> None:
        if register == CONTROL:
            if value & 0x80:
                self.reset(now_ns)
            elif value & 0x01:
                self._status &= ~0x01
        elif register in (TIMEOUT, DEBOUNCE):
            self._registers[register] = value

    def read(self, count: int, now_ns: int) -> bytes:
        if self._pointer == SNAPSHOT:
            self._take_snapshot(now_ns)
        return super().read(count, now_ns)

    def read_register(self, register: int, now_ns: int) -> int:
        if SNAPSHOT <= register < SNAPSHOT + 28:
            return self._snapshot[register - SNAPSHOT]
        fixed = {ID: 0x5C, MAP_VERSION: 1, FIRMWARE: 3, FIRMWARE + 1: 1, CONTROL: 0}
        return fixed.get(register, self._registers.get(register, 0))

    def _take_snapshot(self, now_ns: int) -> None:
        if not self.dead:
            self._watch(now_ns)
        ages = [_age_ms(end, now_ns, 255) for end in self._ended]
        valid = 0
        for i, (width, age) in enumerate(zip(self._widths, ages, strict=True)):
            fresh = self._ended[i] >= 0 and age <= self._registers[TIMEOUT]
            valid |= (fresh and 500e-6 <= width <= 2500e-6) << i
        body = struct.pack(
            SNAPSHOT_FORMAT,
            self._watched_ns // 1_000_000 & 0xFFFF,
            *(to_counts(width * 1e7, 0, 65535) for width in self._widths),
            valid,
            *ages,
            self._level,
            self._latched | self._level,
            self._edges & 0xFF,
            _age_ms(self._edge_ns, now_ns, 65535),
            self._status,
        )
        self._snapshot = body + bytes([crc8(body)])
        self._latched = 0

    def _watch(self, now_ns: int) -> None:
        """Look at the inputs since the last look, as the capture loop did every millisecond."""
        start = max(self._watched_ns + _WATCH_NS, now_ns - _FORGET_NS)
        steady = self._debounced == self._level & 1 and start - self._steady_since > 256_000_000
        step = _COARSE_NS if steady else _WATCH_NS
        time_ns = start
        while time_ns <= now_ns:
            level = self._levels(time_ns)
            if step > _WATCH_NS and level != self._level:  # something happened since: look again, closely
                time_ns -= step - _WATCH_NS
                step = _WATCH_NS
                continue
            self._look(time_ns, level)
            self._watched_ns = time_ns
            time_ns += step
        for channel in range(6):
            self._last_pulse(channel, now_ns)

    def _levels(self, time_ns: int) -> int:
        level = 0
        for i, high in enumerate(self._inputs(time_ns)[6:]):
            level |= bool(high > 0.5) << i
        return level

    def _look(self, time_ns: int, level: int) -> None:
        if (level ^ self._level) & 1:
            self._steady_since = time_ns
        self._level = level
        self._latched |= level
        if time_ns - self._steady_since >= self._registers[DEBOUNCE] * 1_000_000:
            switch = level & 1
            if switch and not self._debounced:
                self._edges += 1
                self._edge_ns = time_ns
            self._debounced = switch

    def _last_pulse(self, channel: int, now_ns: int) -> None:
        offset = channel * _CHANNEL_STAGGER_NS
        frame = (now_ns - offset) // FRAME_NS
        for start in (frame * FRAME_NS + offset, (frame - 1) * FRAME_NS + offset):
            width = float(self._inputs(start)[channel])
            end = start + round(width * 1e9)
            if width > 0.0 and self._reset_ns <= start and end <= now_ns:
                self._widths[channel], self._ended[channel] = width, end
                return


def _age_ms(event_ns: int, now_ns: int, limit: int) -> int:
    return limit if event_ns < 0 else min((now_ns - event_ns) // 1_000_000, limit)


def crc8(data: bytes) -> int:
    """CRC-8/SMBUS: polynomial 0x07, start 0x00."""
    crc = 0
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = (crc << 1 ^ 0x07 if crc & 0x80 else crc << 1) & 0xFF
    return crc
