"""The onboard sequencer on simulated hardware without a world: frames at 50 Hz, whatever a test lets happen to it."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

from daq.actuation.actuation import Actuation, Devices, output_of
from daq.actuation.config import SequencerConfig
from daq.actuation.pwm.heartbeat import HeartbeatLine
from daq.actuation.servos import ServoManoeuvre, plan_of
from daq.clock import SimulatedClock
from daq.contract.manoeuvre import Manoeuvre
from daq.contract.recordings.messages import EventMessage, LogLevel, SequencerFrame
from daq.contract.scan import GroupStatus, RawValue, Scan, SensorState
from daq.contract.sequencing import Reason, State
from daq.sensors.config import SensorsConfig
from daq.sensors.ms4525do import nominal_transfer
from firmware_sim.hardware.bus import BusModel, Disturbance, SimulatedBus
from firmware_sim.hardware.cockpit import Cockpit, CockpitTable, Monostable
from firmware_sim.hardware.registers.capture import CaptureChip
from firmware_sim.physics.plant import Commands
from tests.unit.daq.cdfp_fit import cdfp_sensors

PERIOD_NS = 20_000_000
GROUPS = ("imu", "attitude", "analog_a", "pitot", "capture", "gnss")
US_PER_RAD = 1145.916
SENSORS: SensorsConfig = cdfp_sensors()

OUTPUTS: Mapping[str, dict[str, object]] = {
    "elevon_left": {
        "channel": 0,
        "pilot_input": 1,
        "readback": 1,
        "us_per_rad": {"delta_e": US_PER_RAD, "delta_a": -US_PER_RAD},
    },
    "elevon_right": {
        "channel": 1,
        "pilot_input": 2,
        "readback": 2,
        "us_per_rad": {"delta_e": US_PER_RAD, "delta_a": US_PER_RAD},
    },
    "rudder": {"channel": 2, "pilot_input": 3, "readback": 3, "us_per_rad": {"delta_r": US_PER_RAD}},
}


def sequencer_config(**changes: object) -> SequencerConfig:
    """Three outputs with the defaults; `changes` replace keys."""
    return SequencerConfig.model_validate({"manoeuvre": "unused.toml", "output": OUTPUTS, **changes})


def short_manoeuvre(seconds: float = 1.5, peak_deg: float = 5.0) -> Manoeuvre:
    """One period of a sine on the aileron, two on the rudder; begins and ends at zero."""
    count = round(seconds / 0.02) + 1
    peak = math.radians(peak_deg)
    turns = [2.0 * math.pi * i / (count - 1) for i in range(count)]
    aileron = [peak * math.sin(t) for t in turns]
    rudder = [0.6 * peak * math.sin(2.0 * t) for t in turns]
    return Manoeuvre("test", 0.02, {"delta_a": tuple(aileron), "delta_r": tuple(rudder)})


@dataclass
class Book:
    """A reporter that keeps everything."""

    recording: bool = True
    room: bool = True
    frames: list[SequencerFrame] = field(default_factory=list)
    sent: int = 0
    words: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)

    def say(self, level: LogLevel, name: str, text: str) -> None:
        if level >= LogLevel.WARNING:
            self.warnings.append(text)

    def mark_event(self, text: str, origin: str) -> EventMessage:
        self.words.append(text)
        return EventMessage(0, 0, 0, origin, text)

    def record_sequencer(self, frame: SequencerFrame, *, send: bool) -> bool:
        self.frames.append(frame)
        self.sent += send
        return self.room


@dataclass
class Flying:
    """What the scan shows of the aircraft; groups not named in `absent` are well."""

    bank_deg: float = 0.0
    load_factor: float = 1.0
    airspeed: float = 17.0
    alpha_deg: float = 2.0
    height: float = 60.0
    absent: frozenset[str] = frozenset()


class Cabin(Cockpit):
    """A cockpit whose switch is a function of time [us]; 0 without pulses."""

    def __init__(self, monostable: Monostable, switch_us: Callable[[int], float], oscillator_error: float) -> None:
        super().__init__(CockpitTable(oscillator_error=oscillator_error), monostable, 0.0)
        self._position = switch_us

    def switch_us(self, time_ns: int) -> float:
        return self._position(time_ns)


class Rig:
    """switch_us: of the time [ns]. disturb: of bus transfers. also: the heartbeat, made from the monostable."""

    def __init__(
        self,
        switch_us: Callable[[int], float],
        *,
        config: SequencerConfig | None = None,
        manoeuvre: Manoeuvre | None = None,
        oscillator_error: float = 0.004,
        disturb: Callable[[int, int], Disturbance | None] = lambda address, now_ns: None,
        also: Callable[[Monostable], HeartbeatLine] = lambda monostable: monostable,
    ) -> None:
        self.clock = SimulatedClock()
        self.config = config or sequencer_config()
        self.monostable = Monostable(self.clock.monotonic_ns)
        self.cabin = Cabin(self.monostable, switch_us, oscillator_error)
        self.receiver = CaptureChip(self.cabin.receiver)
        chips = {0x41: self.cabin.chip, 0x42: self.receiver}
        self.bus = SimulatedBus(self.clock, chips, BusModel(), disturb)
        self.plan: ServoManoeuvre = plan_of(manoeuvre or short_manoeuvre(), self.config)
        self.book = Book()
        self.flying = Flying()
        self.sticks = (0.0, 0.0, 0.0)
        self.link_s: float | None = 0.1
        self.commands = Commands(0.0, 0.0, 0.0, 0.5)
        output = output_of(self.config, Devices(self.bus, also(self.monostable), self.clock))
        self.actuation = Actuation(self.config, self.plan, SENSORS, output, self.clock, PERIOD_NS * 1e-9)
        self.actuation.link_s = lambda now_ns: self.link_s
        self.number = 0
        self.alive = True

    @property
    def state(self) -> State:
        return self.actuation.sequencer.state

    @property
    def reason(self) -> Reason:
        return self.actuation.sequencer.reason

    @property
    def now(self) -> int:
        return self.clock.monotonic_ns()

    def frame(self, late_ns: int = 0) -> None:
        """One frame: the receiver's pulses, the servos, a scan, the sequencer (while alive), then the rest of the period."""
        start = self.number * PERIOD_NS
        self.clock.advance_to(start + late_ns)
        self.commands = self.cabin.route(start * 1e-9, Commands(*self.sticks, 0.5))
        if self.alive:
            self.actuation.frame(self.scan(late_ns), self.book)
        self.number = max(self.number + 1, -(-self.now // PERIOD_NS))

    def run(self, seconds: float, each: Callable[[], None] = lambda: None) -> None:
        """So long."""
        until = self.now + round(seconds * 1e9)
        while self.number * PERIOD_NS < until:
            self.frame()
            each()

    def scan(self, late_ns: int) -> Scan:
        """A scan that shows `flying`, and the servo pulses behind the multiplexer."""
        c = self.commands
        pulses = {f"pwm_{i + 1}": round(15000 + 10 * US_PER_RAD * a) for i, a in enumerate((c.left, c.right, c.rudder))}
        return scan_of(self.number, self.now, self.flying, late_ns, pulses)


def scan_of(
    number: int, now_ns: int, flying: Flying, late_ns: int = 0, pulses: Mapping[str, RawValue] = MappingProxyType({})
) -> Scan:
    """A scan that shows an aircraft flying so, and servo pulses."""
    f = flying
    per_count, at_zero = nominal_transfer(SENSORS.pitot)
    half = math.radians(f.bank_deg) / 2.0
    values: dict[str, RawValue] = {
        "accel_z": round(-4096 * f.load_factor),
        "quaternion_w": round(32767 * math.cos(half)),
        "quaternion_x": round(32767 * math.sin(half)),
        "quaternion_y": 0,
        "quaternion_z": 0,
        "alpha_vane": round((2.5 + math.radians(f.alpha_deg) / 0.8) / 4.096 * 32768),
        "pitot_pressure": round((0.5 * 1.225 * f.airspeed**2 - at_zero) / per_count),
        "height_msl_mm": round(1000 * f.height),
        **pulses,
    }
    states = {g: SensorState.ABSENT if g in f.absent else SensorState.OK for g in GROUPS}
    groups = {g: GroupStatus(state) for g, state in states.items()}
    return Scan(number, now_ns, lateness_us=late_ns // 1000, groups=groups, values=values)


def switch_plan(*steps: tuple[float, float]) -> Callable[[int], float]:
    """Width by time from (seconds, us) pairs."""

    def at(time_ns: int) -> float:
        width = 1000.0
        for second, chosen in steps:
            width = chosen if time_ns >= second * 1e9 else width
        return width

    return at


OFF, ARM, GO = 1000.0, 1500.0, 2000.0
USUAL = ((0.0, OFF), (0.2, ARM), (1.2, GO))
"""Off, armed at 0.2 s (about 0.9 s with the measuring), go at 1.2 s."""
