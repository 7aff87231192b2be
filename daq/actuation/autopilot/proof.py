"""Overrides tried out before anything is moved: refused off go, taken at go, gone by silence, gone by release.

What is tried is the pilot's own signal plus PROBE_US, 0.25 deg, exact to the microsecond in RC_CHANNELS. While the switch is at
arm the autopilot's own gate (RCn_OPTION 46) must refuse it; at go it opens after its debounce of 0.2 s, looked at
ten times a second. Then one override must lapse in silence, and another be released.
"""

from collections import deque
from enum import Enum, auto
from statistics import median

from daq.actuation.output import FrameObservation, OutputTrial, OutputTrialResult
from daq.contract.sequencing import Reason

PROBE_US = 5
BASE_FRAMES = 5
REFUSED_S = 0.3
"""So long an override is tried that must be refused; one that is taken shows after 0.1 s at most."""
OPENS_S = 1.0
"""So long the autopilot's switch may take: debounce 0.2 s, looked at every 0.1 s, twice; and what is shown comes 0.1 s later."""
SHOWN_S = 0.15
"""What is sent shows in RC_CHANNELS so much later: two of the autopilot's loops, its stream, one of our frames; twice that."""
BACK_US = 20.0
"""So near to where it was a stick is when it is shown again: half of what ends a manoeuvre."""
BASE_S = 1.5


class TrialStep(Enum):
    """Where the trial is."""

    BASE = auto()
    REFUSED = auto()
    CLOSED = auto()  # shown: at arm nothing is taken
    TAKEN = auto()
    SILENCE = auto()
    AGAIN = auto()
    RELEASE = auto()
    SETTLE = auto()
    DONE = auto()


_PROBING = (TrialStep.REFUSED, TrialStep.TAKEN, TrialStep.AGAIN)


class OverrideProof(OutputTrial):
    """longest_s: how long an override may outlive the last message."""

    fault = Reason.AUTOPILOT
    unlike = "the autopilot does not show the overrides: cleared by switch or stick, or refused"

    def __init__(self, longest_s: float) -> None:
        self._longest_s = longest_s
        self._step, self._since_ns = TrialStep.BASE, 0
        self._visible: deque[tuple[float, ...]] = deque(maxlen=BASE_FRAMES)
        self._base: tuple[float, ...] = ()
        self._seconds = 0.0  # in this step

    @property
    def trying(self) -> str:
        """What is still being tried at go."""
        return "" if self._step is TrialStep.DONE else "overrides are being tried out"

    @property
    def silent(self) -> bool:
        """Nothing at all may be sent, not even releases: silence alone must end an override."""
        return self._step is TrialStep.SILENCE

    def note(self, seen: FrameObservation) -> None:
        """Keep the pilot's signals of late."""
        self._seconds = (seen.now_ns - self._since_ns) * 1e-9
        if seen.output.pilot is not None:
            self._visible.append(seen.output.pilot)
        elif not seen.output.hidden:
            self._visible.clear()

    def begin(self) -> None:
        """From the beginning."""
        self._step, self._since_ns = TrialStep.BASE, -1
        self._visible.clear()

    def check(self, seen: FrameObservation, elapsed_s: float) -> OutputTrialResult | None:
        """At arm: see the sticks, then see an override refused."""
        if self._step is TrialStep.BASE:
            if len(self._visible) == BASE_FRAMES:
                self._probe_at(TrialStep.REFUSED, seen)
                return None
            return OutputTrialResult(Reason.OVERRIDES, "no steady RC_CHANNELS") if elapsed_s > BASE_S else None
        if self._shows_probe(seen):
            words = "they are taken though the switch is not at go: leave it at off for half a second"
            return OutputTrialResult(Reason.OVERRIDES, words)
        if self._seconds <= REFUSED_S:
            return None
        self._go(TrialStep.CLOSED, seen)
        return OutputTrialResult(detail="autopilot refuses overrides off go")

    def rest(self) -> None:
        """The switch has left go: all over again."""
        self._step = TrialStep.CLOSED

    def at_go(self, seen: FrameObservation) -> OutputTrialResult | None:
        """At go: taken, gone by silence, taken again, gone by release, and the sticks seen anew."""
        step = self._step
        if step is TrialStep.DONE:
            return OutputTrialResult()
        if step is TrialStep.CLOSED:
            if len(self._visible) < BASE_FRAMES:
                return None  # still hidden by what was tried before
            self._probe_at(TrialStep.TAKEN, seen)
        elif step is TrialStep.TAKEN:
            return self._until(self._shows_probe(seen), OPENS_S, TrialStep.SILENCE, "they are not taken at go", seen)
        elif step is TrialStep.SILENCE:
            limit = self._longest_s + SHOWN_S
            return self._until(self._back(seen), limit, TrialStep.AGAIN, "one outlived RC_OVERRIDE_TIME", seen)
        elif step is TrialStep.AGAIN:
            return self._until(self._shows_probe(seen), SHOWN_S, TrialStep.RELEASE, "they are not taken again", seen)
        elif step is TrialStep.RELEASE:
            self._visible.clear()
            return self._until(self._back(seen), SHOWN_S, TrialStep.SETTLE, "one was not released", seen)
        elif len(self._visible) == BASE_FRAMES:
            self._go(TrialStep.DONE, seen)
            return OutputTrialResult()
        return None

    def pulses(self, seen: FrameObservation) -> tuple[float, ...] | None:
        """The probe, while one is tried."""
        return tuple(b + PROBE_US for b in self._base) if self._step in _PROBING else None

    def _probe_at(self, step: TrialStep, seen: FrameObservation) -> None:
        self._base = tuple(float(round(median(c))) for c in zip(*self._visible, strict=True))
        self._go(step, seen)

    def _go(self, step: TrialStep, seen: FrameObservation) -> None:
        self._step, self._since_ns = step, seen.now_ns

    def _until(
        self, there: bool, limit_s: float, then: TrialStep, words: str, seen: FrameObservation
    ) -> OutputTrialResult | None:
        if there:
            self._go(then, seen)
            return None
        return (
            OutputTrialResult(Reason.OVERRIDES, f"{words} within {limit_s:.2g} s") if self._seconds > limit_s else None
        )

    def _shows_probe(self, seen: FrameObservation) -> bool:
        return all(w == b + PROBE_US for w, b in zip(seen.output.readback, self._base, strict=True))

    def _back(self, seen: FrameObservation) -> bool:
        """Every channel is where the stick was, and none at the probe."""
        pairs = zip(seen.output.readback, self._base, strict=True)
        return all(w is not None and w != b + PROBE_US and abs(w - b) <= BACK_US for w, b in pairs)
