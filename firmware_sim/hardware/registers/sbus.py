"""SBUS receiver at byte level: a frame each 14 ms, behind the inverter. Inputs: six pulse widths [s]."""

from collections.abc import Callable

from firmware_sim.hardware.registers.chip import Inputs, to_counts

FRAME_NS = 14_000_000
MIDDLE = 992


def frame_of(widths_s: tuple[float, ...], flags: int) -> bytes:
    """The 25 bytes: channels in their order as one number, lowest bit first; unused channels stand in the middle."""
    counts = [to_counts((width * 1e6 - 1000.0) * 1.6 + 200.0, 0, 2047) for width in widths_s]
    bits = "".join(f"{count:011b}"[::-1] for count in (counts + [MIDDLE] * 16)[:16])
    payload = bytes(int(bits[i : i + 8][::-1], 2) for i in range(0, 176, 8))
    return bytes([0x0F, *payload, flags, 0x00])


class SbusReceiver:
    """A Talker. flags: those of a frame at a time [ns]; garble: changes the bytes of a frame on their way."""

    def __init__(self, inputs: Inputs, start_ns: int, flags: Callable[[int], int] = lambda now_ns: 0) -> None:
        self._inputs = inputs
        self._next_ns = start_ns + FRAME_NS
        self.flags = flags
        self.garble: Callable[[bytes, int], bytes] = lambda data, now_ns: data

    def bytes_until(self, now_ns: int) -> bytes:
        data = b""
        while self._next_ns <= now_ns:
            taken_ns = self._next_ns - 3_000_000  # 25 bytes of 12 bits take so long
            widths = tuple(float(w) for w in self._inputs(taken_ns))
            data += self.garble(frame_of(widths, self.flags(taken_ns)), taken_ns)
            self._next_ns += FRAME_NS
        return data

    def receive(self, data: bytes, now_ns: int) -> None:
        """Nobody talks to a receiver."""
