"""DLVR differential pressure sensor at byte level (All Sensors DS-0300): that of an MS4525DO, 10 to 90 % of 16384 counts.

Inputs: differential pressure [Pa] and die temperature [K].
"""

from daq.utilities.constants import ZERO_CELSIUS
from firmware_sim.hardware.registers.chip import Inputs, to_counts
from firmware_sim.hardware.registers.ms4525do import Ms4525doChip


class DlvrChip(Ms4525doChip):
    """A DLVR that measures up to span_pa to both sides."""

    def __init__(self, inputs: Inputs, span_pa: float = 2490.9) -> None:
        super().__init__(inputs)
        self._reach_pa = span_pa

    def _measure(self, time_ns: int) -> bytes:
        pressure, kelvin = self._inputs(time_ns)
        count = to_counts(8192 + 0.8 * 8192 * pressure / self._reach_pa, 0, 16383)
        warmth = to_counts((kelvin - ZERO_CELSIUS + 50.0) * 2047.0 / 200.0, 0, 2047)
        return bytes((count >> 8, count & 0xFF, warmth >> 3, (warmth & 7) << 5))
