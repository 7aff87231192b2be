"""The interface between sequencer and output: observation and command of a frame, and the trial before anything moves."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Protocol

from daq.actuation.motion import MotionState
from daq.actuation.servos import STILL, Increments
from daq.contract.scan import Scan
from daq.contract.sequencing import Reason, State, Switch


@dataclass(frozen=True, slots=True)
class OutputObservation:
    """What an output measures in a frame, of itself and of the pilot.

    switch: the pilot's switch. pilot: his pulse width for each output [us], None while not measured. hidden: his signals cannot
    be measured, because the output's own replace them. watched: his other channels, which he moves only to take over [us].
    loopback_us: pulse width measured on a spare output. fault: why the output cannot be used, empty when it can. readback: pulse
    width measured behind each output [us], None where not measured.
    """

    switch: Switch = Switch.UNKNOWN
    pilot: tuple[float, ...] | None = None
    hidden: bool = False
    watched: tuple[float, ...] = ()
    loopback_us: float | None = None
    fault: str = ""
    readback: tuple[float | None, ...] = ()


@dataclass(frozen=True, slots=True)
class FrameObservation:
    """All inputs of the sequencer in a frame.

    late_ns: delay of the frame against its schedule. recording: a recording is under way. link_s: time since the last message
    from the ground [s], None where there was none. reached: whether the estimates have reached the bound at which the manoeuvre
    ends; None where no bound is set, or the estimates are out of date.
    """

    now_ns: int
    late_ns: int
    motion: MotionState
    output: OutputObservation
    recording: bool = True
    link_s: float | None = None
    reached: bool | None = None


@dataclass(frozen=True, slots=True)
class OutputTrialResult:
    """Result of a trial. reason: NONE when passed, otherwise why it failed; detail: in words."""

    reason: Reason = Reason.NONE
    detail: str = ""


class OutputTrial(ABC):
    """The trial that an output must pass before it may move a surface; the sequencer runs it, whatever the output is.

    fault: the reason under which a fault of this output is reported. not_followed_hint: where to look when the servo pulses are
    not those sent. scale: true pulse width over the commanded one.
    """

    fault: Reason
    not_followed_hint: str
    scale = 1.0

    @property
    def pending(self) -> str:
        """Which part of the trial is not finished while the switch is at go; empty when the manoeuvre may start."""
        return ""

    def note(self, frame: FrameObservation) -> None:
        """Take in a frame; called in every state, before the decision."""
        return

    @abstractmethod
    def begin(self) -> None:
        """Restart the trial: the state CHECKING has been entered."""

    @abstractmethod
    def check(self, frame: FrameObservation, elapsed_s: float) -> OutputTrialResult | None:
        """One frame of CHECKING, `elapsed_s` after it began; None while undecided."""

    def at_arm(self) -> None:
        """One frame of ARMED with the switch not at go."""
        return

    def at_go(self, frame: FrameObservation) -> OutputTrialResult | None:
        """One frame of ARMED with the switch at go; None while undecided."""
        return OutputTrialResult()

    @abstractmethod
    def pulses(self, frame: FrameObservation) -> tuple[float, ...] | None:
        """Pulse widths for the outputs in CHECKING and ARMED [us], None for none."""


@dataclass(frozen=True, slots=True)
class SequencerCommand:
    """The sequencer's decision for a frame.

    elapsed_s: since the state was entered. increments: of the controls [rad]. pulses: width for each output [us], None for none.
    limited: slew or limits changed a pulse. words: the transition in words, empty without one.
    """

    state: State
    reason: Reason
    elapsed_s: float = 0.0
    increments: Increments = STILL
    pulses: tuple[float, ...] | None = None
    limited: bool = False
    words: str = ""


class Output(Protocol):
    """A way to the servos. proof: the trial that it must pass before it may move a surface."""

    @property
    def proof(self) -> OutputTrial: ...

    def observe(self, scan: Scan, now_ns: int) -> OutputObservation:
        """Measure output and pilot in this frame; `scan` holds the pulses behind the output."""
        ...

    def apply(self, command: SequencerCommand, now_ns: int) -> tuple[float, ...] | None:
        """Carry out the command; returns the pulses sent [us], None when the pilot has the aircraft."""
        ...

    def close(self, now_ns: int) -> None:
        """Release the servos to the pilot."""
        ...
