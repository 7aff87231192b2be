"""The sequencer's states, reasons and switch positions, and which transitions there are. `docs/sequencer.md` explains them.

Numbers go into recordings and over the radio: never renumber, only add.
"""

from collections.abc import Mapping
from enum import IntEnum


class State(IntEnum):
    """Who has the aircraft, and how far the sequencer is."""

    IDLE = 0  # nothing is put out; waits for the pilot's switch
    CHECKING = 1  # the pilot flies; the chip repeats his signals while its output frequency is measured
    ARMED = 2  # checked; the chip repeats the pilot's signals, waits for the start
    RUNNING = 3  # the pilot's signals as they were at the start, plus increments
    RAMPING = 4  # the increments fade; then released
    RELEASED = 5  # the pilot has the aircraft; nothing more happens until his switch has been off

    @property
    def words(self) -> str:
        return self.name.lower()

    @property
    def beats(self) -> bool:
        """Whether the heartbeat is kept up, without which neither chip nor multiplexer can reach the servos."""
        return self in (State.CHECKING, State.ARMED, State.RUNNING, State.RAMPING)


class Exit(IntEnum):
    """How a reason ends a manoeuvre."""

    DROP = 0  # heartbeat ends in the same frame
    RAMP = 1  # increments fade first: the aircraft is sound and what is measured can be trusted


class Reason(IntEnum):
    """Why a state was left: number, words for a person, and how it ends a manoeuvre that is running."""

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
"""Every transition there is; staying is always possible, except in RAMPING, which ends by itself."""


class Switch(IntEnum):
    """The pilot's three-position switch, by the pulse width on its channel."""

    UNKNOWN = 0  # no pulses, or a width that the multiplexer may read either way
    OFF = 1
    ARM = 2
    GO = 3


def switch_position(pulse_us: float | None) -> Switch:
    """The position by pulse width [us].

    The multiplexer selects its second source above 1700 +-64 us; so near to that the position is not known.
    """
    if pulse_us is None or not 800.0 <= pulse_us <= 2200.0:
        return Switch.UNKNOWN
    if pulse_us < 1300.0:
        return Switch.OFF
    if pulse_us <= 1600.0:
        return Switch.ARM
    return Switch.GO if pulse_us >= 1800.0 else Switch.UNKNOWN
