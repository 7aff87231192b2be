"""The pilot's side of a flight with a sequencer: his receiver and switch, the servo driver, the multiplexer, the servos.

`Cockpit` stands between the simulated pilot and the servos. Where the multiplexer passes his signals he flies as ever; while
it passes the servo driver's he keeps his hands still, unless the scenario has him take over.

A monostable is kept up by edges of the heartbeat. It enables the servo driver (OE) and lets SEL pulses through to the
multiplexer, which goes by SEL alone: wide pulses choose its second source; lost pulses choose the first.
"""

from bisect import bisect_right
from collections.abc import Callable, Mapping
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from firmware_sim.hardware.registers.pca9685 import Pca9685Chip
from firmware_sim.physics.plant import Commands
from firmware_sim.tables import ScenarioError, SimulatorTable
from firmware_sim.world.scenario import Scenario
from firmware_sim.world.simulation import Wiring
from firmware_sim.world.truth import PULSE_CENTRE_US, PULSE_PER_RAD_US, THROTTLE_PULSE_US

MONOSTABLE_NS = 60_000_000
SEL_LOST_NS = 35_000_000
"""The multiplexer takes SEL for lost after so long. With the monostable's time: below 0.1 s."""
FRAME_NS = 20_000_000
THRESHOLD_US = 1700.0
_KEPT = 4096  # edges; at 50 a second more than anybody looks back


class Monostable:
    """Retriggerable, with a clear input; also the heartbeat as the software sees it. now_ns: of the clock edges come by."""

    def __init__(self, now_ns: Callable[[], int], width_ns: int = MONOSTABLE_NS) -> None:
        self._now = now_ns
        self._width_ns = width_ns
        self._edges: list[int] = []
        self._clears: list[int] = []
        self.broken = lambda time_ns: False  # whether the line is cut at a time [ns]

    def beat(self) -> None:
        """A rising edge."""
        now_ns = self._now()
        if not self.broken(now_ns):
            self._edges.append(now_ns)
            del self._edges[:-_KEPT]

    def release(self) -> None:
        """The clear input."""
        self._clears.append(self._now())
        del self._clears[:-_KEPT]

    def up(self, time_ns: int) -> bool:
        """Whether its output is up at a time [ns]."""
        last = bisect_right(self._edges, time_ns) - 1
        if last < 0 or time_ns - self._edges[last] >= self._width_ns:
            return False
        cleared = bisect_right(self._clears, time_ns) - 1
        return cleared < 0 or self._clears[cleared] < self._edges[last]

    @property
    def last_edge_ns(self) -> int | None:
        """When the last edge came; None before the first."""
        return self._edges[-1] if self._edges else None


class Multiplexer:
    """switch_us: width of the receiver's switch channel at a time [ns], 0 without pulses. gate: lets SEL pulses through."""

    def __init__(
        self, switch_us: Callable[[int], float], gate: Callable[[int], bool], sel_lost_ns: int = SEL_LOST_NS
    ) -> None:
        self._switch_us, self._gate = switch_us, gate
        self._sel_lost_ns = sel_lost_ns

    def selects_second(self, time_ns: int) -> bool:
        """Whether the second source, the servo driver, reaches the servos at a time [ns]."""
        frame = time_ns // FRAME_NS * FRAME_NS
        while frame >= 0 and time_ns - frame <= self._sel_lost_ns:
            width = self._switch_us(frame)
            if width > 0.0 and self._gate(frame):
                return width > THRESHOLD_US
            frame -= FRAME_NS
        return False


SWITCH_US: Mapping[str, float] = {"off": 1000.0, "arm": 1500.0, "go": 2000.0}
OUTPUTS = {"left": 0, "right": 1, "rudder": 2}
"""Channels of the servo driver, and inputs of the pilot's capture co-processor, of the three servos."""
LOOPBACK_CHANNEL = 3
_FRAMES_KEPT = 1000


class CockpitTable(SimulatorTable):
    """Scenario table `[sequencer]`. Times are seconds from the start of the recording.

    switch: when the pilot moves his switch where. take_over_s: he moves his sticks in spite of the switch. receiver_lost_s:
    his receiver goes silent. heartbeat_lost_s: the heartbeat's wire breaks. oscillator_error: of the servo driver, relative.
    autopilot: what stands between receiver and servos in place of driver and multiplexer; with it parameters: its own, beside
    `autopilots.arduplane.PARAMETERS`; modes: when it changes to which (0 MANUAL, 5 FBWA); line_lost_s: its line breaks;
    throttle_s: when the pilot moves his throttle.
    """

    switch: tuple[tuple[float, Literal["off", "arm", "go"]], ...] = ((0.0, "off"), (3.0, "arm"), (6.0, "go"))
    take_over_s: float | None = Field(default=None, ge=0.0)
    receiver_lost_s: float | None = Field(default=None, ge=0.0)
    heartbeat_lost_s: float | None = Field(default=None, ge=0.0)
    oscillator_error: float = Field(default=0.004, ge=-0.08, le=0.08)
    autopilot: Literal["ardupilot"] | None = None
    parameters: Mapping[str, float] = Field(default_factory=dict)
    modes: tuple[tuple[float, int], ...] = ()
    line_lost_s: float | None = Field(default=None, ge=0.0)
    throttle_s: float | None = Field(default=None, ge=0.0)


def switch_for(scenario: Scenario, manoeuvre_s: float) -> list[tuple[float, str]]:
    """A switch plan for a scenario that has none: armed 3 s after take-off, go 3 s later, off 2 s after the end.

    Raises ScenarioError when the flight is too short for that.
    """
    arm_s = scenario.takeoff_s + 3.0
    off_s = arm_s + 3.0 + manoeuvre_s + 2.0
    if off_s > scenario.takeoff_s + scenario.flight.duration_s:
        raise ScenarioError(
            f"scenario {scenario.name}: flies {scenario.flight.duration_s:g} s, the manoeuvre of {manoeuvre_s:g} s needs "
            f"{off_s - scenario.takeoff_s:.0f} s with arming it; raise flight.duration_s"
        )
    return [(0.0, "off"), (arm_s, "arm"), (arm_s + 3.0, "go"), (off_s, "off")]


class Transmitter(Wiring):
    """The pilot's switch and sticks as his receiver has them. takeoff_s: recording time of airborne zero."""

    def __init__(self, table: CockpitTable, takeoff_s: float) -> None:
        self.table, self.takeoff_s = table, takeoff_s
        self._frames: list[int] = []  # when the receiver's pulses changed [ns]
        self._wanted: list[Commands] = []

    def silent(self, time_ns: int) -> bool:
        """Whether the receiver is."""
        lost_s = self.table.receiver_lost_s
        return lost_s is not None and time_ns >= lost_s * 1e9

    def switch_us(self, time_ns: int) -> float:
        """Width of the switch's channel [us]; 0 while the receiver is silent."""
        if self.silent(time_ns):
            return 0.0
        position = "off"
        for start_s, next_position in self.table.switch:
            position = next_position if time_ns >= start_s * 1e9 else position
        return SWITCH_US[position]

    def note(self, time_ns: int, wanted: Commands) -> None:
        """From now on the sticks are so."""
        self._frames.append(time_ns)
        self._wanted.append(wanted)
        if len(self._frames) > 2 * _FRAMES_KEPT:
            del self._frames[:_FRAMES_KEPT], self._wanted[:_FRAMES_KEPT]

    def sticks(self, time_ns: int) -> Commands | None:
        """What the pilot wishes; None before he has touched them, and while the receiver is silent."""
        if self.silent(time_ns) or not self._frames:
            return None
        return self._wanted[max(bisect_right(self._frames, time_ns) - 1, 0)]

    def time_ns(self, airborne_s: float) -> int:
        """Recording time of an instant of free flight [ns]."""
        return round((airborne_s + self.takeoff_s) * 1e9)

    def takes_over(self, time_ns: int) -> bool:
        """Whether the pilot moves his sticks in spite of the switch."""
        take_over_s = self.table.take_over_s
        return take_over_s is not None and time_ns >= take_over_s * 1e9


class Cockpit(Transmitter):
    """Receiver, switch, servo driver, monostable, multiplexer and servos. takeoff_s: recording time of airborne zero."""

    def __init__(self, table: CockpitTable, monostable: Monostable, takeoff_s: float) -> None:
        super().__init__(table, takeoff_s)
        self.monostable = monostable
        self.chip = Pca9685Chip(table.oscillator_error, monostable.up)
        self.multiplexer = Multiplexer(self.switch_us, monostable.up)
        self._last: Commands | None = None
        if table.heartbeat_lost_s is not None:
            lost_ns = round(table.heartbeat_lost_s * 1e9)
            monostable.broken = lambda time_ns: time_ns >= lost_ns

    def receiver(self, time_ns: int) -> tuple[float, ...]:
        """What the pilot's capture co-processor sees: six widths [s] and five levels."""
        loopback = self.chip.width_us(LOOPBACK_CHANNEL, time_ns) * 1e-6
        quiet = (0.0,) * 5
        sticks = self.sticks(time_ns)
        if sticks is None:
            return (*quiet, loopback, *quiet)
        return (*(w * 1e-6 for w in _pulses(sticks)), self.switch_us(time_ns) * 1e-6, loopback, *quiet)

    def behind(self, time_ns: int, pulses: NDArray[np.float64]) -> NDArray[np.float64]:
        """Servo pulses behind the multiplexer [s], those of the pilot's wish given; 0 where the driver puts out none."""
        if self.multiplexer.selects_second(time_ns):
            pulses = pulses.copy()
            for channel in OUTPUTS.values():
                pulses[channel] = self.chip.width_us(channel, time_ns) * 1e-6
        return pulses

    # ---------------------------------------------------------------------------------------- for the world

    def hands_still(self, airborne_s: float) -> bool:
        """Whether the pilot leaves his sticks where they are."""
        time_ns = self.time_ns(airborne_s)
        return not self.takes_over(time_ns) and self.multiplexer.selects_second(time_ns)

    def route(self, airborne_s: float, wanted: Commands) -> Commands:
        """What the servos get: the pilot's wish, or the servo driver's pulses; without pulses a servo stays where it is."""
        time_ns = self.time_ns(airborne_s)
        self.note(time_ns, wanted)
        if not self.multiplexer.selects_second(time_ns):
            self._last = wanted
            return wanted
        last = self._last or wanted
        left, right, rudder = (self._angle(channel, time_ns, getattr(last, name)) for name, channel in OUTPUTS.items())
        self._last = Commands(left, right, rudder, wanted.throttle)
        return self._last

    def _angle(self, channel: int, time_ns: int, held: float) -> float:
        width = self.chip.width_us(channel, time_ns)
        return (width - PULSE_CENTRE_US) / PULSE_PER_RAD_US if width > 0.0 else held


def _pulses(wanted: Commands) -> tuple[float, ...]:
    idle, span = THROTTLE_PULSE_US
    surfaces = (wanted.left, wanted.right, wanted.rudder)
    return (*(PULSE_CENTRE_US + PULSE_PER_RAD_US * angle for angle in surfaces), idle + span * wanted.throttle)
