"""Between the sequencer and an output: what is seen in a frame, what is to be done, how an output proves itself first."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Protocol

from daq.actuation.motion import MotionState
from daq.actuation.servos import STILL, Increments
from daq.contract.scan import Scan
from daq.contract.sequencing import Reason, State, Switch


@dataclass(frozen=True, slots=True)
class OutputObservation:
    """What an output shows in a frame, of itself and of the pilot.

    pilot: his signal for each output [us], None while not seen. hidden: he cannot be seen, because what is put out stands in
    his place. watched: other channels of his, which he leaves alone unless he wants to fly [us]. loopback_us: a spare output
    as measured. fault: why the output cannot be used. readback: what became of each output [us], None where not seen.
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
    """What is known in a frame.

    late_ns: how late the frame began. link_s: since the ground was last heard, None where nobody listens. reached: whether the
    bound that the set is flown until is reached; None where nobody asks, or nobody has told lately.
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
    """What came of it: reason NONE when it is shown, else why not; detail in words."""

    reason: Reason = Reason.NONE
    detail: str = ""


class OutputTrial(ABC):
    """What an output has to show before it may move anything; the sequencer asks, whatever the output is.

    fault: what a fault of this output is called. unlike: what is to be looked for when it is not followed. scale: pulse width
    put out over the one asked for.
    """

    fault: Reason
    unlike: str
    scale = 1.0

    @property
    def trying(self) -> str:
        """What is still being tried at go, empty when it may start."""
        return ""

    def note(self, seen: FrameObservation) -> None:
        """Every frame, before anything is decided."""
        return

    @abstractmethod
    def begin(self) -> None:
        """Checking begins."""

    @abstractmethod
    def check(self, seen: FrameObservation, elapsed_s: float) -> OutputTrialResult | None:
        """While checking, so long after it began; None: not yet."""

    def rest(self) -> None:
        """Armed, and the switch is not at go."""
        return

    def at_go(self, seen: FrameObservation) -> OutputTrialResult | None:
        """Armed, and the switch is at go; None: not yet."""
        return OutputTrialResult()

    @abstractmethod
    def pulses(self, seen: FrameObservation) -> tuple[float, ...] | None:
        """What is put out while checking and armed [us], None for nothing."""


@dataclass(frozen=True, slots=True)
class SequencerCommand:
    """What to do. pulses: for each output [us], None for none. words: what to tell, empty without a transition."""

    state: State
    reason: Reason
    elapsed_s: float = 0.0
    increments: Increments = STILL
    pulses: tuple[float, ...] | None = None
    limited: bool = False
    words: str = ""


class Output(Protocol):
    """A way to the servos. proof: what it has to show before it may move anything."""

    @property
    def proof(self) -> OutputTrial: ...

    def look(self, scan: Scan, now_ns: int) -> OutputObservation:
        """What is seen in this frame, of the output and of the pilot."""
        ...

    def put(self, frame: SequencerCommand, now_ns: int) -> tuple[float, ...] | None:
        """Do what was decided; the pulses that went out [us], None when the pilot has the aircraft."""
        ...

    def close(self, now_ns: int) -> None:
        """Let go at the end."""
        ...
