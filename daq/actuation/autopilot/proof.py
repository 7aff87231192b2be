"""Trial of RC overrides before a manoeuvre: the autopilot must refuse them at arm, accept them at go, and end them both when
messages stop and when they are released.

The probe is the pilot's own signal plus PROBE_US (0.25 deg), which RC_CHANNELS shows to the microsecond. At arm the autopilot's
gate (RCn_OPTION 46) must refuse it. At go the gate opens after a debounce of 0.2 s; ArduPilot reads the switch ten times a
second. Then one override must lapse because no message follows, and a second one must end by a release.
"""

from collections import deque
from enum import Enum, auto
from statistics import median

from daq.actuation.output import FrameObservation, OutputTrial, OutputTrialResult
from daq.contract.sequencing import Reason

PROBE_US = 5
BASE_FRAMES = 5
"""Frames of the pilot's signals whose median the probe is added to: 0.1 s at 50 Hz."""
REFUSAL_S = 0.3
"""How long the override that must be refused is sent; an accepted one shows within 0.1 s."""
GATE_OPEN_S = 1.0
"""Longest time for the gate to open: debounce 0.2 s and two readings of the switch at 0.1 s, plus 0.1 s to show; doubled."""
ROUND_TRIP_S = 0.15
"""Longest delay from sending to RC_CHANNELS: two loops of the autopilot, its stream and one of our frames; doubled."""
RESTORED_US = 20.0
"""A stick counts as unchanged within this of its base: half of what ends a manoeuvre."""
BASE_TIMEOUT_S = 1.5
"""Longest time for BASE_FRAMES frames with RC_CHANNELS to arrive."""


class TrialStep(Enum):
    """Steps of the trial, in order; the first three run at arm."""

    BASE = auto()  # collect the pilot's signals
    REFUSED = auto()  # probe sent, must not show
    CLOSED = auto()  # passed: the gate is closed; wait for go
    TAKEN = auto()  # probe sent, must show
    SILENCE = auto()  # nothing sent: the override must lapse
    AGAIN = auto()  # probe sent again, must show
    RELEASE = auto()  # releases sent: the override must end
    SETTLE = auto()  # collect the pilot's signals again
    DONE = auto()


_PROBING = (TrialStep.REFUSED, TrialStep.TAKEN, TrialStep.AGAIN)


class OverrideProof(OutputTrial):
    """longest_s: longest time that an override may last after the last message [s] (RC_OVERRIDE_TIME)."""

    fault = Reason.AUTOPILOT
    not_followed_hint = "the autopilot does not show the overrides: cleared by switch or stick, or refused"

    def __init__(self, longest_s: float) -> None:
        self._longest_s = longest_s
        self._step, self._since_ns = TrialStep.BASE, 0
        self._visible: deque[tuple[float, ...]] = deque(maxlen=BASE_FRAMES)  # the pilot's latest signals [us]
        self._base: tuple[float, ...] = ()  # his signals that the probe is added to [us]
        self._seconds = 0.0  # in this step

    @property
    def pending(self) -> str:
        """A sentence while the trial is not finished, otherwise empty."""
        return "" if self._step is TrialStep.DONE else "overrides are being tried out"

    @property
    def silent(self) -> bool:
        """Whether nothing may be sent, not even releases, so that the override can end only by lapsing."""
        return self._step is TrialStep.SILENCE

    def note(self, frame: FrameObservation) -> None:
        """Collect the pilot's signals; a frame without them, not merely hidden, empties the collection."""
        self._seconds = (frame.now_ns - self._since_ns) * 1e-9
        if frame.output.pilot is not None:
            self._visible.append(frame.output.pilot)
        elif not frame.output.hidden:
            self._visible.clear()

    def begin(self) -> None:
        """Restart the trial."""
        self._step, self._since_ns = TrialStep.BASE, -1
        self._visible.clear()

    def check(self, frame: FrameObservation, elapsed_s: float) -> OutputTrialResult | None:
        """At arm: collect the pilot's signals, then send a probe that must be refused."""
        if self._step is TrialStep.BASE:
            if len(self._visible) == BASE_FRAMES:
                self._probe_at(TrialStep.REFUSED, frame)
                return None
            return OutputTrialResult(Reason.OVERRIDES, "no steady RC_CHANNELS") if elapsed_s > BASE_TIMEOUT_S else None
        if self._shows_probe(frame):
            detail = "they are taken though the switch is not at go: leave it at off for half a second"
            return OutputTrialResult(Reason.OVERRIDES, detail)
        if self._seconds <= REFUSAL_S:
            return None
        self._enter(TrialStep.CLOSED, frame)
        return OutputTrialResult(detail="autopilot refuses overrides off go")

    def at_arm(self) -> None:
        """The switch is not at go: the part of the trial at go starts over."""
        self._step = TrialStep.CLOSED

    def at_go(self, frame: FrameObservation) -> OutputTrialResult | None:
        """At go: probe accepted, lapsed, accepted again, released; then the pilot's signals collected again."""
        step = self._step
        if step is TrialStep.DONE:
            return OutputTrialResult()
        if step is TrialStep.CLOSED:
            if len(self._visible) < BASE_FRAMES:
                return None  # an earlier probe still hides them
            self._probe_at(TrialStep.TAKEN, frame)
        elif step is TrialStep.TAKEN:
            return self._advance_when(
                self._shows_probe(frame), GATE_OPEN_S, TrialStep.SILENCE, "they are not taken at go", frame
            )
        elif step is TrialStep.SILENCE:
            limit = self._longest_s + ROUND_TRIP_S
            return self._advance_when(
                self._restored(frame), limit, TrialStep.AGAIN, "one outlived RC_OVERRIDE_TIME", frame
            )
        elif step is TrialStep.AGAIN:
            return self._advance_when(
                self._shows_probe(frame), ROUND_TRIP_S, TrialStep.RELEASE, "they are not taken again", frame
            )
        elif step is TrialStep.RELEASE:
            self._visible.clear()
            return self._advance_when(
                self._restored(frame), ROUND_TRIP_S, TrialStep.SETTLE, "one was not released", frame
            )
        elif len(self._visible) == BASE_FRAMES:
            self._enter(TrialStep.DONE, frame)
            return OutputTrialResult()
        return None

    def pulses(self, frame: FrameObservation) -> tuple[float, ...] | None:
        """The probe in the steps that send one."""
        return tuple(b + PROBE_US for b in self._base) if self._step in _PROBING else None

    def _probe_at(self, step: TrialStep, frame: FrameObservation) -> None:
        self._base = tuple(float(round(median(c))) for c in zip(*self._visible, strict=True))
        self._enter(step, frame)

    def _enter(self, step: TrialStep, frame: FrameObservation) -> None:
        self._step, self._since_ns = step, frame.now_ns

    def _advance_when(
        self, condition: bool, limit_s: float, next_step: TrialStep, failure: str, frame: FrameObservation
    ) -> OutputTrialResult | None:
        """Enter the next step once the condition holds; fail where it does not within `limit_s`."""
        if condition:
            self._enter(next_step, frame)
            return None
        return (
            OutputTrialResult(Reason.OVERRIDES, f"{failure} within {limit_s:.2g} s")
            if self._seconds > limit_s
            else None
        )

    def _shows_probe(self, frame: FrameObservation) -> bool:
        return all(w == b + PROBE_US for w, b in zip(frame.output.readback, self._base, strict=True))

    def _restored(self, frame: FrameObservation) -> bool:
        """Whether every channel is back at its base, and none at the probe."""
        pairs = zip(frame.output.readback, self._base, strict=True)
        return all(w is not None and w != b + PROBE_US and abs(w - b) <= RESTORED_US for w, b in pairs)
