"""What the sequencer is told in a frame."""

from dataclasses import dataclass

from daq.actuation.motion import MotionState
from daq.contract.sequencing import Switch


@dataclass(frozen=True, slots=True)
class Glimpse:
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
class Seen:
    """What is known in a frame.

    late_ns: how late the frame began. link_s: since the ground was last heard, None where nobody listens.
    """

    now_ns: int
    late_ns: int
    motion: MotionState
    output: Glimpse
    recording: bool = True
    link_s: float | None = None
