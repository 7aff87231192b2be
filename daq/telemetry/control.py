"""The logger as its radio link sees it: what commands from the ground may do to it, and what they find when it has ended."""

from typing import Protocol

from daq.contract.manoeuvre import Weigh
from daq.contract.recordings.messages import EventMessage, Statistics


class Control(Protocol):
    """Everything returns at once."""

    @property
    def recording(self) -> bool:
        """Whether a recording is under way."""

    def start_recording(self) -> bool:
        """Begin a new recording; False when one is under way or none can be made."""

    def stop_recording(self) -> bool:
        """End the recording; False when none is under way."""

    def statistics(self) -> Statistics | None:
        """The statistics of the recording, or of the last one."""

    def mark_event(self, text: str, origin: str) -> EventMessage:
        """Record an event at the present scan, and tell the ground."""

    def ask_sequencer(self, digest: int | None) -> str:
        """Start the manoeuvre whose digest begins with these 24 bits, or (None) stop; why not, empty when it is taken."""

    @property
    def weigh(self) -> Weigh | None:
        """For manoeuvres that come up the link; None where there is no sequencer."""


class NoLogger:
    """Stands for a logger that has ended: commands to it fail or do nothing."""

    recording = False
    weigh = None

    def start_recording(self) -> bool:
        return False

    def stop_recording(self) -> bool:
        return False

    def statistics(self) -> None:
        return None

    def mark_event(self, text: str, origin: str) -> EventMessage:
        return EventMessage(0, 0, 0, origin, text)

    def ask_sequencer(self, digest: int | None) -> str:
        return "the logger has ended"
