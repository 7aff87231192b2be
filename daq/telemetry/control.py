"""The interface through which the radio link commands the logger, and its stand-in after the logger has ended."""

from typing import Protocol

from daq.contract.manoeuvre import ManoeuvreCheck
from daq.contract.recordings.messages import EventMessage, Statistics


class Control(Protocol):
    """The logger's functions for commands from the ground; no call blocks."""

    @property
    def recording(self) -> bool:
        """Whether a recording is under way."""

    def start_recording(self) -> bool:
        """Begin a new recording; False when one is under way or cannot be begun."""

    def stop_recording(self) -> bool:
        """End the recording; False when none is under way."""

    def statistics(self) -> Statistics | None:
        """Counters of the current recording or, between recordings, of the last one."""

    def mark_event(self, text: str, origin: str) -> EventMessage:
        """Record an event at the present scan, and send it to the ground."""

    def request_sequencer(self, digest: int | None) -> str:
        """Start the manoeuvre whose digest begins with these 24 bits; None: stop. Returns why it is refused, or ""."""

    @property
    def check_manoeuvre(self) -> ManoeuvreCheck | None:
        """Checks a manoeuvre received by radio; None where there is no sequencer."""


class NoLogger:
    """Takes the place of a logger that has ended: commands fail or do nothing."""

    recording = False
    check_manoeuvre = None

    def start_recording(self) -> bool:
        return False

    def stop_recording(self) -> bool:
        return False

    def statistics(self) -> None:
        return None

    def mark_event(self, text: str, origin: str) -> EventMessage:
        return EventMessage(0, 0, 0, origin, text)

    def request_sequencer(self, digest: int | None) -> str:
        return "the logger has ended"
