"""An autopilot on a serial line that reports its servo outputs, for aircraft without the capture co-processor.

HEARTBEAT once a second and SERVO_OUTPUT_RAW at its stream rate, in whole microseconds. The bytes leave at the speed of the line.
"""

from firmware_sim.hardware.autopilots.frames import HEARTBEAT, SERVO_OUTPUT_RAW, Packer
from firmware_sim.hardware.autopilots.looped import LossyLine
from firmware_sim.hardware.sensing.instruments import Instruments

STREAM_NS = 50_000_000


class Autopilot:
    """A Talker for the serial port of the `mavlink_servo` driver."""

    def __init__(self, instruments: Instruments) -> None:
        self._inputs = instruments.inputs(*(f"pwm_{i}" for i in range(1, 7)))
        self._next_ns = instruments.origin_ns
        self._packer, self._line = Packer(), LossyLine()
        self._powered = True

    def set_power(self, on: bool, now_ns: int) -> None:
        """Power comes or goes."""
        self._powered = on

    def hear(self, data: bytes, now_ns: int) -> None:
        """Requests are ignored: the streams are set up in the autopilot."""

    def bytes_until(self, now_ns: int) -> bytes:
        while self._next_ns <= now_ns:
            if self._powered and now_ns - self._next_ns < 1_000_000_000:
                self._report(self._next_ns)
            self._next_ns += STREAM_NS
        return self._line.arrived(now_ns)

    def _report(self, time_ns: int) -> None:
        data = b""
        if time_ns % 1_000_000_000 < STREAM_NS:
            data = self._packer.pack(HEARTBEAT, 0, 1, 3, 81, 4, 3)
        widths = [round(float(width) * 1e6) for width in self._inputs(time_ns)]
        data += self._packer.pack(SERVO_OUTPUT_RAW, time_ns // 1000 & 0xFFFFFFFF, *widths, 0, 0, 0)
        self._line.send(data, time_ns)
