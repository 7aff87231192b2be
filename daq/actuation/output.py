"""What the sequencer puts out through, and what is seen there."""

from typing import Protocol

from daq.actuation.proof import OutputTrial
from daq.actuation.seen import Glimpse
from daq.actuation.sequencer import SequencerCommand
from daq.contract.scan import Scan


class Output(Protocol):
    """A way to the servos. proof: what it has to show before it may move anything."""

    @property
    def proof(self) -> OutputTrial: ...

    def look(self, scan: Scan, now_ns: int) -> Glimpse:
        """What is seen in this frame, of the output and of the pilot."""
        ...

    def put(self, frame: SequencerCommand, now_ns: int) -> tuple[float, ...] | None:
        """Do what was decided; the pulses that went out [us], None when the pilot has the aircraft."""
        ...

    def close(self, now_ns: int) -> None:
        """Let go at the end."""
        ...
