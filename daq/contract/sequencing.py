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
    """Why a state was left."""

    NONE = 0
    COMPLETE = 1
    SWITCH = 2
    STICK = 3
    GROUND = 4
    BANK = 10
    LOAD_FACTOR = 11
    AIRSPEED = 12
    ALPHA = 13
    HEIGHT = 14
    SENSOR = 20
    PILOT_SIGNALS = 21
    LINK = 22
    LATE = 23
    MISSED = 24
    CHIP = 25
    NOT_FOLLOWED = 26
    RECORDING = 27
    AUTOPILOT = 28
    FREQUENCY = 30
    STICKS_NOT_STILL = 31
    NO_ROOM = 32
    TOO_EARLY = 33
    WAITED = 34
    OVERRIDES = 35

    @property
    def exit(self) -> Exit:
        """How this reason ends a manoeuvre that is running."""
        return Exit.RAMP if self in _RAMPED else Exit.DROP

    @property
    def words(self) -> str:
        return _WORDS[self]


_RAMPED = frozenset(
    {
        Reason.GROUND,
        Reason.BANK,
        Reason.LOAD_FACTOR,
        Reason.AIRSPEED,
        Reason.ALPHA,
        Reason.HEIGHT,
        Reason.LINK,
        Reason.RECORDING,
    }
)
_WORDS: Mapping[Reason, str] = {
    Reason.NONE: "",
    Reason.COMPLETE: "flown to its end",
    Reason.SWITCH: "pilot's switch",
    Reason.STICK: "pilot moved a stick",
    Reason.GROUND: "stopped from the ground",
    Reason.BANK: "bank limit",
    Reason.LOAD_FACTOR: "load factor limit",
    Reason.AIRSPEED: "airspeed limit",
    Reason.ALPHA: "angle-of-attack limit",
    Reason.HEIGHT: "height limit",
    Reason.SENSOR: "a sensor it relies on is stale",
    Reason.PILOT_SIGNALS: "pilot's signals are not seen",
    Reason.LINK: "link to the ground lost",
    Reason.LATE: "loop late",
    Reason.MISSED: "frames missed",
    Reason.CHIP: "servo driver does not answer as set",
    Reason.NOT_FOLLOWED: "servo pulses are not those put out",
    Reason.RECORDING: "nothing is recorded",
    Reason.AUTOPILOT: "autopilot does not do as it must",
    Reason.FREQUENCY: "output frequency is wrong",
    Reason.STICKS_NOT_STILL: "sticks are not still",
    Reason.NO_ROOM: "pulses would leave their limits",
    Reason.TOO_EARLY: "switched to go before it was armed",
    Reason.WAITED: "no start came",
    Reason.OVERRIDES: "overrides do not come and go as they must",
}

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
