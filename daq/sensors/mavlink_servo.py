"""Servo pulse widths as an autopilot reports them: MAVLink SERVO_OUTPUT_RAW on a serial port.

The alternative to the capture co-processor where an autopilot drives the servos. Message 36 of common.xml (MAVLink 1 and 2):
u32 time [us], 8 x u16 width [us], u8 port; recorded in the co-processor's 0.1 us counts, though the resolution is 1 us. There
are no digital inputs on this path and they stay unset. The autopilot has to be told to stream the message
(SRn_RC_CHAN, or MAV_CMD_SET_MESSAGE_INTERVAL).

Self-test: one message within two seconds. Plausibility: the checksum; widths of 0 mean "not driven" and stay unset; no message
for 0.5 s is stale.
"""

from collections.abc import Callable, Generator, Iterator
from struct import Struct

from fastcrc import crc16

from daq.contract.scan import RawValue, SensorState
from daq.sensors.base import MS, SECOND, Driver, Reading, SelfTestError, Surroundings, Wait
from daq.sensors.bus import SerialPortCalls
from daq.sensors.capture import CaptureConfig

SERVO_OUTPUT_RAW, CRC_EXTRA = 36, 222
V1, V2 = 0xFE, 0xFD
_PAYLOAD = Struct("<I8HB")
_STALE = SECOND // 2


def servo_frames(buffer: bytearray) -> Iterator[bytes]:
    """Payloads of the undamaged SERVO_OUTPUT_RAW frames in `buffer`, which is left with the unfinished rest."""
    while buffer:
        if buffer[0] not in (V1, V2):
            del buffer[0]
            continue
        header = 10 if buffer[0] == V2 else 6
        if len(buffer) < header:
            return
        end = header + buffer[1] + 2
        if len(buffer) < end:
            return
        message = int.from_bytes(buffer[7:10], "little") if header == 10 else buffer[5]
        if message == SERVO_OUTPUT_RAW:
            checksum = buffer[end - 2] | buffer[end - 1] << 8
            if crc16.mcrf4xx(bytes(buffer[1 : end - 2]) + bytes((CRC_EXTRA,))) == checksum:
                yield bytes(buffer[header : end - 2])
                del buffer[:end]
                continue
        del buffer[0]  # another message or damage: only its first byte is surely not the start of ours


class MavlinkServo(Driver):
    """Pulse widths [0.1 us] of outputs 1 to 6."""

    name, groups, group = "mavlink_servo", ("capture",), "capture"
    uses_i2c = False
    max_rate_hz = 50.0

    def __init__(self, config: CaptureConfig, port: SerialPortCalls, now_ns: Callable[[], int]) -> None:
        self._config = config
        self._port = port
        self._now = now_ns
        self._buffer = bytearray()
        self._newest: tuple[int, ...] | None = None
        self._newest_ns = 0

    @classmethod
    def build(cls, group: str, around: Surroundings) -> Driver:
        return cls(around.section(group), around.need_port(around.autopilot, group), around.now_ns)

    def initialise(self) -> Generator[Wait, None, None]:
        asked_ns = self._now()
        for _ in range(40):
            self._receive()
            if self._newest_ns > asked_ns:
                return
            yield 50 * MS
        raise SelfTestError(
            f"no SERVO_OUTPUT_RAW from the autopilot on {self._config.device} in 2 s; set its stream rate and baud rate"
        )

    def _receive(self) -> None:
        available = min(self._port.in_waiting, 4096)
        if not available:
            return
        self._buffer += self._port.read(available)
        for payload in servo_frames(self._buffer):
            full = payload[: _PAYLOAD.size].ljust(_PAYLOAD.size, b"\0")  # MAVLink 2 trims trailing zeros
            _, *widths, port = _PAYLOAD.unpack(full)
            if port == 0:
                self._newest, self._newest_ns = tuple(widths[:6]), self._now()

    def read(self) -> Reading:
        self._receive()
        if self._newest is None or self._now() - self._newest_ns > _STALE:
            return Reading(state=SensorState.STALE, detail="autopilot sends no servo outputs")
        values: dict[str, RawValue] = {f"pwm_{i + 1}": w * 10 for i, w in enumerate(self._newest) if w}
        silent = [f"pwm_{i + 1}" for i in range(self._config.pwm_inputs) if not self._newest[i]]
        if silent:
            detail = f"autopilot does not drive {', '.join(silent)}"
            return Reading(values, SensorState.OUT_OF_RANGE, detail, self._newest_ns)
        return Reading(values, time_ns=self._newest_ns)

    def metadata(self) -> dict[str, str]:
        return {"chip": "MAVLink SERVO_OUTPUT_RAW", "scale_s": "1e-07"}
