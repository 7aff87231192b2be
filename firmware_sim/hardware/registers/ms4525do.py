"""MS4525DO differential pressure sensor at byte level (TE Connectivity MS4525DO, rev. 4/2019), type A, +-1 psi.

Inputs: differential pressure [Pa] and die temperature [K]. There are no registers: a read returns up to four bytes,
status and pressure first. A second read before the next measurement returns the old value marked stale.
"""

from daq.utilities.constants import PSI, ZERO_CELSIUS
from firmware_sim.hardware.registers.chip import Inputs, PoweredChip, to_counts

UPDATE_NS = 500_000
START_UP_NS = 8_400_000  # from power to the first valid data
STATUS_OK, STATUS_STALE, STATUS_FAULT = 0, 2, 3


class Ms4525doChip(PoweredChip):
    """An MS4525DO of type A (10 to 90 % of 14 bits over its range); faulty: report a diagnostic fault."""

    def __init__(self, inputs: Inputs, range_psi: tuple[float, float] = (-1.0, 1.0)) -> None:
        super().__init__()
        self._inputs = inputs
        self._low_pa = range_psi[0] * PSI
        self._span_pa = (range_psi[1] - range_psi[0]) * PSI
        self.faulty = False
        self._powered_ns = -START_UP_NS
        self._read_tick = -1
        self._bytes = bytes(4)

    def reset(self, now_ns: int) -> None:
        self._powered_ns = now_ns
        self._read_tick = -1

    def answers(self, now_ns: int) -> bool:
        return self.powered and now_ns - self._powered_ns >= START_UP_NS

    def write(self, data: bytes, now_ns: int) -> None:
        """A write starts a measurement on the low-power version; on this one it does nothing."""

    def read(self, count: int, now_ns: int) -> bytes:
        tick = now_ns // UPDATE_NS
        fresh = tick > self._read_tick
        if fresh:
            self._read_tick = tick
            self._bytes = self._measure(tick * UPDATE_NS)
        status = STATUS_FAULT if self.faulty else STATUS_OK if fresh else STATUS_STALE
        answer = bytes([status << 6 | self._bytes[0]]) + self._bytes[1:]
        return (answer + b"\xff" * count)[:count]

    def _measure(self, time_ns: int) -> bytes:
        pressure, temperature = self._inputs(time_ns)
        fraction = 0.1 + 0.8 * (pressure - self._low_pa) / self._span_pa
        p = to_counts(fraction * 16383.0, 0, 16383)
        t = to_counts((temperature - ZERO_CELSIUS + 50.0) / 200.0 * 2047.0, 0, 2047)
        return (p << 16 | t << 5).to_bytes(4, "big")
