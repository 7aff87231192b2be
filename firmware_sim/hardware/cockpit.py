"""The hardware between pilot and servos in a flight with a sequencer: receiver, switch, servo driver, multiplexer.

While the multiplexer passes the pilot's signals he flies as usual; while it passes the servo driver's he does not move his
sticks, unless the scenario makes him take over.

The heartbeat retriggers a monostable, which enables the servo driver (OE) and passes SEL pulses to the multiplexer. The
multiplexer goes by SEL alone: wide pulses select its second source, narrow or lost ones the first.
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
"""Time without pulses after which SEL counts as lost; with the monostable's less than 0.1 s."""
FRAME_NS = 20_000_000
THRESHOLD_US = 1700.0  # of SEL
_EDGES = 4096  # edges in memory: 80 s at 50 a second


class Monostable:
    """A retriggerable monostable with a clear input, and the heartbeat line that drives it. now_ns: returns the time of an edge
    [ns]."""

    def __init__(self, now_ns: Callable[[], int], width_ns: int = MONOSTABLE_NS) -> None:
        self._now = now_ns
        self._width_ns = width_ns
        self._edges: list[int] = []
        self._clears: list[int] = []
        self.broken = lambda time_ns: False  # whether the line is cut at a time [ns]

    def beat(self) -> None:
        """Take a rising edge."""
        now_ns = self._now()
        if not self.broken(now_ns):
            self._edges.append(now_ns)
            del self._edges[:-_EDGES]

    def release(self) -> None:
        """Take a pulse of the clear input."""
        self._clears.append(self._now())
        del self._clears[:-_EDGES]

    def up(self, time_ns: int) -> bool:
        """Whether its output is high at a time [ns]."""
        last = bisect_right(self._edges, time_ns) - 1
        if last < 0 or time_ns - self._edges[last] >= self._width_ns:
            return False
        cleared = bisect_right(self._clears, time_ns) - 1
        return cleared < 0 or self._clears[cleared] < self._edges[last]

    @property
    def last_edge_ns(self) -> int | None:
        """Time of the last edge [ns]; None before the first."""
        return self._edges[-1] if self._edges else None


class Multiplexer:
    """switch_us: time [ns] -> width of the receiver's switch channel [us], 0 without pulses. gate: time [ns] -> whether SEL
    pulses pass."""

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
_FRAMES_REMEMBERED = 1000


class CockpitTable(SimulatorTable):
    """Scenario table `[sequencer]`. Times are seconds from the start of the recording.

    switch: times and positions of the pilot's switch. take_over_s: the pilot moves his sticks whatever the switch.
    receiver_lost_s: the receiver goes silent. heartbeat_lost_s: the heartbeat's wire breaks. oscillator_error: of the servo
    driver, relative. autopilot: replaces driver and multiplexer; with it parameters: in addition to
    `autopilots.arduplane.PARAMETERS`; modes: times and modes (0 MANUAL, 5 FBWA); line_lost_s: its line breaks; throttle_s: the
    pilot moves his throttle.
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
    """The pilot's switch and sticks at the receiver. takeoff_s: recording time at which the simulated flight begins [s]."""

    def __init__(self, table: CockpitTable, takeoff_s: float) -> None:
        self.table, self.takeoff_s = table, takeoff_s
        self._frames: list[int] = []  # when the receiver's pulses changed [ns]
        self._commands: list[Commands] = []

    def silent(self, time_ns: int) -> bool:
        """Whether the receiver is silent at a time [ns]."""
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

    def note(self, time_ns: int, commands: Commands) -> None:
        """Set the sticks from `time_ns` on."""
        self._frames.append(time_ns)
        self._commands.append(commands)
        if len(self._frames) > 2 * _FRAMES_REMEMBERED:
            del self._frames[:_FRAMES_REMEMBERED], self._commands[:_FRAMES_REMEMBERED]

    def sticks(self, time_ns: int) -> Commands | None:
        """The pilot's commands at a time [ns]; None before the first, and while the receiver is silent."""
        if self.silent(time_ns) or not self._frames:
            return None
        return self._commands[max(bisect_right(self._frames, time_ns) - 1, 0)]

    def time_ns(self, airborne_s: float) -> int:
        """Recording time [ns] of a time of the simulated flight [s]."""
        return round((airborne_s + self.takeoff_s) * 1e9)

    def takes_over(self, time_ns: int) -> bool:
        """Whether the pilot moves his sticks whatever the switch."""
        take_over_s = self.table.take_over_s
        return take_over_s is not None and time_ns >= take_over_s * 1e9


class Cockpit(Transmitter):
    """Receiver, switch, servo driver, monostable and multiplexer. takeoff_s: as of `Transmitter`."""

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
        """Inputs of the pilot's capture co-processor: six widths [s] and five levels."""
        loopback = self.chip.width_us(LOOPBACK_CHANNEL, time_ns) * 1e-6
        quiet = (0.0,) * 5
        sticks = self.sticks(time_ns)
        if sticks is None:
            return (*quiet, loopback, *quiet)
        return (*(w * 1e-6 for w in _pulses(sticks)), self.switch_us(time_ns) * 1e-6, loopback, *quiet)

    def behind(self, time_ns: int, pulses: NDArray[np.float64]) -> NDArray[np.float64]:
        """Servo pulses behind the multiplexer [s], 0 where the driver sends none. pulses: those of the pilot's commands [s]."""
        if self.multiplexer.selects_second(time_ns):
            pulses = pulses.copy()
            for channel in OUTPUTS.values():
                pulses[channel] = self.chip.width_us(channel, time_ns) * 1e-6
        return pulses

    # ---------------------------------------------------------------------------------------- Wiring

    def hands_still(self, airborne_s: float) -> bool:
        """Whether the pilot does not move his sticks."""
        time_ns = self.time_ns(airborne_s)
        return not self.takes_over(time_ns) and self.multiplexer.selects_second(time_ns)

    def route(self, airborne_s: float, commands: Commands) -> Commands:
        """Commands that reach the servos: the pilot's, or the servo driver's; without pulses a servo holds its position."""
        time_ns = self.time_ns(airborne_s)
        self.note(time_ns, commands)
        if not self.multiplexer.selects_second(time_ns):
            self._last = commands
            return commands
        last = self._last or commands
        left, right, rudder = (self._angle(channel, time_ns, getattr(last, name)) for name, channel in OUTPUTS.items())
        self._last = Commands(left, right, rudder, commands.throttle)
        return self._last

    def _angle(self, channel: int, time_ns: int, last_angle: float) -> float:
        width = self.chip.width_us(channel, time_ns)
        return (width - PULSE_CENTRE_US) / PULSE_PER_RAD_US if width > 0.0 else last_angle


def _pulses(commands: Commands) -> tuple[float, ...]:
    idle, span = THROTTLE_PULSE_US
    surfaces = (commands.left, commands.right, commands.rudder)
    return (*(PULSE_CENTRE_US + PULSE_PER_RAD_US * angle for angle in surfaces), idle + span * commands.throttle)
