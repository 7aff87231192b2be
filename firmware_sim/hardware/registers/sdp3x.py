"""SDP3x at byte level (Sensirion SDP3x-Digital, V0.8). Inputs: differential pressure [Pa], temperature [K], ambient [Pa].

It measures mass flow: its output is the pressure difference times ambient pressure over 966 hPa. It does not acknowledge a read
before the command to measure.
"""

import errno

from daq.utilities.constants import ZERO_CELSIUS
from firmware_sim.hardware.registers.chip import Inputs, PoweredChip, to_counts

MEASURE, STOP = b"\x36\x15", b"\x3f\xf9"
FIRST_NS = 8_000_000
CALIBRATED_PA = 96_600.0


def checksum(word: bytes) -> int:
    """CRC-8 bit by bit: polynomial 0x31, initial value 0xFF."""
    register = 0xFF
    for byte in word:
        register ^= byte
        for _ in range(8):
            register = (register << 1 ^ (0x131 if register & 0x80 else 0)) & 0x1FF
            register &= 0xFF
    return register


class Sdp3xChip(PoweredChip):
    """An SDP3x. scale: counts a pascal. broken_bit: bit of the pressure that is flipped on the wire, None for none."""

    def __init__(self, inputs: Inputs, scale: int = 20) -> None:
        super().__init__()
        self._inputs, self._scale = inputs, scale
        self.broken_bit: int | None = None
        self.reset(0)

    def reset(self, now_ns: int) -> None:
        self._since_ns: int | None = None

    def write(self, data: bytes, now_ns: int) -> None:
        if data == MEASURE:
            self._since_ns = now_ns
        elif data == STOP:
            self._since_ns = None

    def read(self, count: int, now_ns: int) -> bytes:
        if self._since_ns is None or now_ns - self._since_ns < FIRST_NS:
            raise OSError(errno.EREMOTEIO, "no result: not acknowledged")
        difference, kelvin, ambient = self._inputs(now_ns)
        counts = to_counts(difference * ambient / CALIBRATED_PA * self._scale, -32768, 32767)
        words = (counts, round((kelvin - ZERO_CELSIUS) * 200.0), self._scale)
        answer = b"".join(w + bytes([checksum(w)]) for w in ((v & 0xFFFF).to_bytes(2, "big") for v in words))
        if self.broken_bit is not None:
            answer = bytes([answer[0], answer[1] ^ 1 << self.broken_bit]) + answer[2:]
        return answer[:count]
