"""The pitot zeroed by the logger itself: on the ground, before motion, each time from what the aircraft read at rest.

A differential sensor of this kind rests at 30 to 140 Pa, which is 7 to 15 m/s, and drifts by some pascals as it warms up. The
newest zero before flight counts, so the last one before the aircraft moves is the one that calibration takes.
"""

from collections import deque
from statistics import fmean

from daq.contract.link.commands import pitot_zero_text
from daq.contract.scan import Scan
from daq.telemetry.flight_state import flight_evidence, ground_speed

REST_S = 5.0  # s of rest that a zero is taken from: the sensor's noise averages to a tenth of a pascal
AGAIN_S = 30.0  # s between zeros: warming up takes minutes
SETTLING_S = 2.0  # s left out at the end of the rest, in which the aircraft may have begun to move


class PitotZero:
    """Looks at scans, and asks for a zero where the aircraft rests: GPS speed known and none, gyros still, pressure steady."""

    def __init__(self, rate_hz: float) -> None:
        self._rest: deque[Scan] = deque(maxlen=round((REST_S + SETTLING_S) * rate_hz))
        self._settling = round(SETTLING_S * rate_hz)
        self._again = round(AGAIN_S * rate_hz)
        self._next = 0

    def look(self, scan: Scan) -> str | None:
        """Text of the event that records a zero; None where there is none to record now."""
        self._rest.append(scan)
        full = len(self._rest) == self._rest.maxlen
        if not full or scan.number < self._next:
            return None
        scans = list(self._rest)
        if ground_speed(scans) is None or flight_evidence(scans) is not None:
            return None
        self._next = scan.number + self._again
        counts = [s.values["pitot_pressure"] for s in scans[: -self._settling] if "pitot_pressure" in s.values]
        return pitot_zero_text(fmean(counts), len(counts))
