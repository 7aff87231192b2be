"""The sequencer's states, reasons, switch positions and transitions; `docs/sequencer.md` explains them.

Numbers go into recordings and over the radio: never renumber, only add.
"""

from collections.abc import Mapping
from enum import IntEnum


class State(IntEnum):
    """State of the sequencer, which decides who controls the servos."""

    IDLE = 0  # no output; the switch is awaited
    CHECKING = 1  # the pilot flies while the output passes its trial
    ARMED = 2  # trial passed; the pilot flies, the start is awaited
    RUNNING = 3  # the pilot's signals as they were at the start, plus increments
    RAMPING = 4  # the increments fade to zero
    RELEASED = 5  # the pilot flies; nothing happens until his switch is at off

    @property
    def words(self) -> str:
        return self.name.lower()

    @property
    def beats(self) -> bool:
        """Whether the heartbeat runs in this state; without it neither chip nor multiplexer passes pulses to the servos."""
        return self in (State.CHECKING, State.ARMED, State.RUNNING, State.RAMPING)


class Exit(IntEnum):
    """How a manoeuvre ends."""

    DROP = 0  # the heartbeat ends in the same frame
    RAMP = 1  # increments fade first: the aircraft works and its measurements can be trusted


class Reason(IntEnum):
    """Why a state ended: number, words, and how it ends a manoeuvre in flight."""

    words: str
    exit: Exit

    def __new__(cls, number: int, words: str, exit: Exit = Exit.DROP) -> "Reason":
        reason = int.__new__(cls, number)
        reason._value_, reason.words, reason.exit = number, words, exit
        return reason

    NONE = 0, ""
    COMPLETE = 1, "flown to its end"
    SWITCH = 2, "pilot's switch"
    STICK = 3, "pilot moved a stick"
    GROUND = 4, "stopped from the ground", Exit.RAMP
    REACHED = 5, "wanted bound reached", Exit.RAMP
    BANK = 10, "bank limit", Exit.RAMP
    LOAD_FACTOR = 11, "load factor limit", Exit.RAMP
    AIRSPEED = 12, "airspeed limit", Exit.RAMP
    ALPHA = 13, "angle-of-attack limit", Exit.RAMP
    HEIGHT = 14, "height limit", Exit.RAMP
    SENSOR = 20, "a sensor it relies on is stale"
    PILOT_SIGNALS = 21, "pilot's signals are not seen"
    LINK = 22, "link to the ground lost", Exit.RAMP
    LATE = 23, "loop late"
    MISSED = 24, "frames missed"
    CHIP = 25, "servo driver does not answer as set"
    NOT_FOLLOWED = 26, "servo pulses are not those put out"
    RECORDING = 27, "nothing is recorded", Exit.RAMP
    AUTOPILOT = 28, "autopilot does not do as it must"
    FREQUENCY = 30, "output frequency is wrong"
    STICKS_NOT_STILL = 31, "sticks are not still"
    NO_ROOM = 32, "pulses would leave their limits"
    TOO_EARLY = 33, "switched to go before it was armed"
    WAITED = 34, "no start came"
    OVERRIDES = 35, "overrides do not come and go as they must"


TRANSITIONS: Mapping[State, frozenset[State]] = {
    State.IDLE: frozenset({State.CHECKING}),
    State.CHECKING: frozenset({State.ARMED, State.RELEASED, State.IDLE}),
    State.ARMED: frozenset({State.RUNNING, State.RELEASED, State.IDLE}),
    State.RUNNING: frozenset({State.RAMPING, State.RELEASED}),
    State.RAMPING: frozenset({State.RELEASED}),
    State.RELEASED: frozenset({State.IDLE}),
}
"""All transitions; each state but RAMPING may last without limit."""


class Switch(IntEnum):
    """The pilot's three-position switch, by the pulse width on its channel."""

    UNKNOWN = 0  # no pulses, or a width that the multiplexer may read either way
    OFF = 1
    ARM = 2
    GO = 3


def switch_position(pulse_us: float | None) -> Switch:
    """The position by pulse width [us], UNKNOWN near the threshold of the multiplexer, which selects its second source above
    1700 +-64 us."""
    if pulse_us is None or not 800.0 <= pulse_us <= 2200.0:
        return Switch.UNKNOWN
    if pulse_us < 1300.0:
        return Switch.OFF
    if pulse_us <= 1600.0:
        return Switch.ARM
    return Switch.GO if pulse_us >= 1800.0 else Switch.UNKNOWN
