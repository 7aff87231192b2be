"""SBUS of a radio-control receiver as pulse widths, over a UART at 100,000 baud, 8 bits, even parity, 2 stop bits.

Futaba's protocol as ArduPilot's (AP_RCProtocol_SBUS.cpp) and PX4's (sbus.cpp) drivers have it: 25 bytes each 7 or 14 ms, 0x0F,
sixteen channels of 11 bits, lowest bit first, flags (4: a frame was lost on the air, 8: failsafe) and an end byte; 200 to 1800
counts are 1000 to 2000 us. The signal is inverted: an inverter (one transistor), or a UART that can, stands before the port.
When a frame arrived between two polls is not known: it is dated half a frame interval back, with an error of 7 ms.

Self-test: a frame within 2 s; other bytes mean that the signal is not inverted. Plausibility: both flags, silence. After a lost
byte the parser waits for two frames in a row.
"""

from collections.abc import Generator, Iterator
from typing import NamedTuple

from daq.contract.scan import RawValue, SensorState
from daq.sensors.base import MS, SECOND, Driver, DriverContext, Reading, SelfTestError, Wait
from daq.sensors.bus import SerialPortCalls
from daq.sensors.capture import CaptureConfig

BAUD, FRAMING = 100_000, {"parity": "E", "stopbits": 2}
START, ENDS, LENGTH = 0x0F, frozenset((0x00, 0x04, 0x14, 0x24, 0x34)), 25
LOST, FAILSAFE = 0x04, 0x08
_OUTPUTS = 6
_FRAME_TIME = 3 * MS  # 25 bytes of 12 bits at BAUD
_LONGEST_INTERVAL = 14 * MS  # between the begins of two frames
_SILENT = SECOND // 2  # without a frame: the receiver counts as absent
_READ_LIMIT = 4096


class SbusFrame(NamedTuple):
    """Sixteen channels [counts]; lost: the receiver lost a frame on the air; failsafe: it hears no transmitter."""

    channels: tuple[int, ...]
    lost: bool
    failsafe: bool


def parse_frame(data: bytes) -> SbusFrame | None:
    """The frame of 25 bytes; None for other bytes."""
    if data[0] != START or data[24] not in ENDS or data[23] & 0xF0:
        return None
    bits = int.from_bytes(data[1:23], "little")
    channels = tuple(bits >> 11 * i & 0x7FF for i in range(16))
    return SbusFrame(channels, bool(data[23] & LOST), bool(data[23] & FAILSAFE))


class SbusParser:
    """Frames out of a stream without visible pauses: synchronised where two frames follow each other."""

    def __init__(self) -> None:
        self._buffer = bytearray()
        self._synchronised = False

    def feed(self, data: bytes) -> Iterator[SbusFrame]:
        """The frames that are complete with these bytes."""
        self._buffer += data
        while len(self._buffer) >= (LENGTH if self._synchronised else 2 * LENGTH):
            frame = parse_frame(bytes(self._buffer[:LENGTH]))
            follows = self._synchronised or parse_frame(bytes(self._buffer[LENGTH : 2 * LENGTH])) is not None
            self._synchronised = frame is not None and follows
            del self._buffer[: LENGTH if self._synchronised else 1]
            if frame is not None and follows:
                yield frame


class Sbus(Driver):
    """The first six channels as pulse widths [0.1 us]."""

    name, groups, uses_i2c = "sbus", ("capture",), False
    max_rate_hz = 65.0

    def __init__(self, config: CaptureConfig, port: SerialPortCalls, context: DriverContext) -> None:
        self.group = self.groups[0]
        self._config, self._port, self._now = config, port, context.now_ns
        self._parser = SbusParser()
        self._newest: SbusFrame | None = None
        self._bytes_came = False
        self._newest_ns = 0

    @classmethod
    def build(cls, group: str, context: DriverContext) -> Driver:
        return cls(context.section(group), context.need_port(context.autopilot, group), context)

    def initialise(self) -> Generator[Wait, None, None]:
        self._newest, self._bytes_came = None, False
        for _ in range(40):
            if self._poll():
                return
            yield 50 * MS
        what = (
            "bytes that are no SBUS: is the signal inverted?"
            if self._bytes_came
            else "no byte: check wiring and supply"
        )
        raise SelfTestError(f"from the SBUS receiver on {self._config.device} came {what}")

    def _poll(self) -> bool:
        """Whether a frame has come."""
        data = self._port.read(min(self._port.in_waiting, _READ_LIMIT))
        self._bytes_came = self._bytes_came or bool(data)
        frames = list(self._parser.feed(data))
        if frames:
            self._newest, self._newest_ns = frames[-1], self._now()
        return bool(frames)

    def read(self) -> Reading:
        new_frame = self._poll()
        frame, now_ns = self._newest, self._now()
        if frame is None or now_ns - self._newest_ns > _SILENT:
            return Reading(state=SensorState.ABSENT, detail="SBUS receiver is silent")
        if not new_frame or (frame.lost and not frame.failsafe):
            words = "SBUS receiver lost a frame" if new_frame else "no new SBUS frame"
            return Reading(state=SensorState.STALE, detail=words)
        values: dict[str, RawValue] = {
            f"pwm_{i + 1}": round((count * 0.625 + 875.0) * 10) for i, count in enumerate(frame.channels[:_OUTPUTS])
        }
        time_ns = now_ns - _FRAME_TIME - _LONGEST_INTERVAL // 2
        if frame.failsafe:
            return Reading(values, SensorState.OUT_OF_RANGE, "receiver in failsafe: no transmitter heard", time_ns)
        return Reading(values, time_ns=time_ns)

    def metadata(self) -> dict[str, str]:
        return {"chip": "SBUS", "scale_s": "1e-07"}
