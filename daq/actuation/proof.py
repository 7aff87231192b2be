"""What an output has to show before it may move anything; the sequencer asks, whatever the output is."""

from dataclasses import dataclass
from statistics import fmean
from typing import Protocol

from daq.actuation.seen import Seen
from daq.contract.sequencing import Reason

SETTLE_S = 0.1
"""After waking, the chip's first pulses are not looked at: it starts within a cycle, the co-processor keeps 50 ms."""
SAMPLES = 25
"""Loopback pulses averaged: half a second; jitter of 10 us then leaves 0.2 % of a 1500 us pulse."""
MEASURE_S = 1.5
"""So long they may take to come."""


@dataclass(frozen=True, slots=True)
class OutputTrialResult:
    """What came of it: reason NONE when it is shown, else why not; detail in words."""

    reason: Reason = Reason.NONE
    detail: str = ""


class OutputTrial(Protocol):
    """scale: pulse width put out over the one asked for. fault: what a fault of this output is called. unlike: what is to
    be looked for when it is not followed. trying: what is still being tried at go, empty when it may start.
    """

    scale: float
    fault: Reason
    unlike: str

    @property
    def trying(self) -> str: ...

    def note(self, seen: Seen) -> None:
        """Every frame, before anything is decided."""
        ...

    def begin(self) -> None:
        """Checking begins."""
        ...

    def check(self, seen: Seen, elapsed_s: float) -> OutputTrialResult | None:
        """While checking, so long after it began; None: not yet."""
        ...

    def rest(self) -> None:
        """Armed, and the switch is not at go."""
        ...

    def at_go(self, seen: Seen) -> OutputTrialResult | None:
        """Armed, and the switch is at go; None: not yet."""
        ...

    def pulses(self, seen: Seen) -> tuple[float, ...] | None:
        """What is put out while checking and armed [us], None for nothing."""
        ...


class FrequencyProof:
    """A servo driver whose oscillator is measured on a spare output; meanwhile it repeats the pilot's signals.

    loopback_us, frequency_hz: width put out there, and the frequency, if the oscillator is as configured. error: allowed.
    """

    fault = Reason.CHIP
    unlike = "multiplexer or wiring"
    trying = ""

    def __init__(self, loopback_us: float, frequency_hz: float, error: float) -> None:
        self.scale = 1.0
        self._loopback_us, self._frequency_hz, self._error = loopback_us, frequency_hz, error
        self._measured: list[float] = []

    def note(self, seen: Seen) -> None:
        """Nothing to note."""

    def begin(self) -> None:
        """Forget what was measured."""
        self._measured, self.scale = [], 1.0

    def check(self, seen: Seen, elapsed_s: float) -> OutputTrialResult | None:
        """Average the loopback pulses."""
        if elapsed_s < SETTLE_S:
            return None
        if seen.output.loopback_us is not None:
            self._measured.append(seen.output.loopback_us)
        if len(self._measured) >= SAMPLES:
            return self._frequency()
        return OutputTrialResult(Reason.FREQUENCY, "no pulses come back") if elapsed_s > MEASURE_S else None

    def _frequency(self) -> OutputTrialResult:
        scale = fmean(self._measured) / self._loopback_us
        detail = f"{self._frequency_hz / scale:.2f} Hz measured, {self._frequency_hz:.2f} expected"
        if abs(1.0 / scale - 1.0) > self._error:
            return OutputTrialResult(Reason.FREQUENCY, detail)
        self.scale = scale
        return OutputTrialResult(detail=detail)

    def rest(self) -> None:
        """Nothing changes."""

    def at_go(self, seen: Seen) -> OutputTrialResult | None:
        """Everything was shown while checking."""
        return OutputTrialResult()

    def pulses(self, seen: Seen) -> tuple[float, ...] | None:
        """The pilot's signals."""
        return seen.output.pilot
