"""An autopilot on a serial line that reports its servo outputs, for aircraft without the capture co-processor.

HEARTBEAT once a second and SERVO_OUTPUT_RAW (MAVLink common.xml, messages 0 and 36) at its stream rate, MAVLink 2, whole
microseconds. The bytes leave at the speed of the line.
"""

import struct

from firmware_sim.hardware.radio import MAGIC_V2, x25
from firmware_sim.hardware.sensing.instruments import Instruments

HEARTBEAT_ID, HEARTBEAT_CRC = 0, 50
SERVO_ID, SERVO_CRC = 36, 222
BAUD = 115_200
STREAM_NS = 50_000_000


class Autopilot:
    """A Talker for the serial port of the `mavlink_servo` driver."""

    def __init__(self, instruments: Instruments) -> None:
        self._inputs = instruments.inputs(*(f"pwm_{i}" for i in range(1, 7)))
        self._next_ns = instruments.origin_ns
        self._sequence = 0
        self._on_line: list[tuple[int, bytes]] = []
        self._powered = True

    def set_power(self, on: bool, now_ns: int) -> None:
        """Power comes or goes."""
        self._powered = on

    def hear(self, data: bytes, now_ns: int) -> None:
        """Requests are ignored: the streams are set up in the autopilot."""

    def bytes_until(self, now_ns: int) -> bytes:
        while self._next_ns <= now_ns:
            if self._powered and now_ns - self._next_ns < 1_000_000_000:
                message = self._servo_output(self._next_ns)
                if self._next_ns % 1_000_000_000 < STREAM_NS:
                    message = (
                        self._frame(HEARTBEAT_ID, HEARTBEAT_CRC, struct.pack("<IBBBBB", 0, 1, 3, 81, 4, 3)) + message
                    )
                self._on_line.append((self._next_ns, message))
            self._next_ns += STREAM_NS
        arrived, left = b"", []
        for start_ns, data in self._on_line:
            count = min(len(data), int((now_ns - start_ns) * 1e-9 * BAUD / 10.0))
            arrived += data[:count]
            if count < len(data):
                left.append((start_ns + round(count * 10e9 / BAUD), data[count:]))
        self._on_line = left
        return arrived

    def _servo_output(self, time_ns: int) -> bytes:
        widths = [round(float(width) * 1e6) for width in self._inputs(time_ns)]
        payload = struct.pack("<I8HB", time_ns // 1000 & 0xFFFFFFFF, *widths, 0, 0, 0)
        return self._frame(SERVO_ID, SERVO_CRC, payload)

    def _frame(self, ident: int, crc_extra: int, payload: bytes) -> bytes:
        payload = payload.rstrip(b"\0") or b"\0"  # MAVLink 2 leaves trailing zeros out
        head = bytes([len(payload), 0, 0, self._sequence, 1, 1]) + ident.to_bytes(3, "little")
        self._sequence = (self._sequence + 1) & 0xFF
        body = head + payload
        return bytes([MAGIC_V2]) + body + x25(body + bytes([crc_extra])).to_bytes(2, "little")
