"""What a command from the ground may do to the logger."""

from collections.abc import Callable
from typing import Protocol

from daq.contract.manoeuvre import Manoeuvre
from daq.contract.recordings.messages import EventMessage

Weigh = Callable[[Manoeuvre], Callable[[], str]]
"""Weighs a manoeuvre against the aircraft's limits, in any thread; raises ManoeuvreError. What it returns puts the manoeuvre in
place, in the scan loop, and says why not, empty when it is taken."""


class Control(Protocol):
    """Everything returns at once."""

    @property
    def recording(self) -> bool:
        """Whether a recording is under way."""
        ...

    def start_recording(self) -> bool:
        """Begin a new recording; False when one is under way or none can be made."""
        ...

    def stop_recording(self) -> bool:
        """End the recording; False when none is under way."""
        ...

    def mark_event(self, text: str, origin: str) -> EventMessage:
        """Record an event at the present scan, and tell the ground."""
        ...

    def ask_sequencer(self, digest: int | None) -> str:
        """Start the manoeuvre whose digest begins with these 24 bits, or (None) stop; why not, empty when it is taken."""
        ...

    @property
    def weigh(self) -> Weigh | None:
        """For manoeuvres that come up the link; None where there is no sequencer."""
        ...
