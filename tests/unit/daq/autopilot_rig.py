"""The onboard sequencer through a simulated ArduPlane, without a world: frames at 50 Hz, whatever a test lets happen to it."""

from collections.abc import Callable, Mapping

from daq.actuation.actuation import Actuation, Devices, output_of
from daq.actuation.autopilot.output import ArduPilotOutput
from daq.actuation.config import SequencerConfig
from daq.actuation.servos import ServoManoeuvre, plan_of
from daq.clock import SimulatedClock
from daq.contract.manoeuvre import Manoeuvre
from daq.contract.sequencing import Reason, State
from firmware_sim.hardware.autopilots.arduplane import ArduPlane
from firmware_sim.hardware.serial import SimulatedSerial
from tests.unit.daq.sequencer_rig import (
    ARM,
    GO,
    OFF,
    PERIOD_NS,
    SENSORS,
    US_PER_RAD,
    Book,
    Flying,
    scan_of,
    short_manoeuvre,
)

STICKS: Mapping[str, dict[str, object]] = {
    "roll": {"channel": 1, "us_per_rad": {"delta_a": US_PER_RAD}},
    "pitch": {"channel": 2, "us_per_rad": {"delta_e": US_PER_RAD}},
    "yaw": {"channel": 4, "us_per_rad": {"delta_r": US_PER_RAD}},
}
USUAL = ((0.0, OFF), (1.6, ARM), (2.6, GO))
"""Off while the parameters come in, armed at 1.6 s, go at 2.6 s; running about 0.9 s later."""


def autopilot_config(**changes: object) -> SequencerConfig:
    """Three sticks with the defaults; `changes` replace keys."""
    table = {"manoeuvre": "unused.toml", "through": "ardupilot", "output": STICKS, "autopilot": {"port": "simulated"}}
    return SequencerConfig.model_validate({**table, **changes})


class AutopilotRig:
    """switch_us: of the time [ns], 0 where the receiver is silent. parameters: of the autopilot."""

    def __init__(
        self,
        switch_us: Callable[[int], float],
        *,
        config: SequencerConfig | None = None,
        manoeuvre: Manoeuvre | None = None,
        parameters: Mapping[str, float] | None = None,
    ) -> None:
        self.clock = SimulatedClock()
        self.config = config or autopilot_config()
        self._switch = switch_us
        self.sticks = (1510, 1490, 1500)  # roll, pitch, yaw
        self.throttle = 1600
        self.plane = ArduPlane(self.receiver, parameters)
        self.port = SimulatedSerial(self.plane, self.clock.monotonic_ns)
        self.plan: ServoManoeuvre = plan_of(manoeuvre or short_manoeuvre(), self.config)
        self.book = Book()
        self.flying = Flying()
        self.link_s: float | None = 0.1
        output = output_of(self.config, Devices(None, None, self.clock, self.port))
        assert isinstance(output, ArduPilotOutput)
        self.output = output
        self.actuation = Actuation(self.config, self.plan, SENSORS, output, self.clock, PERIOD_NS * 1e-9)
        self.actuation.link_s = lambda now_ns: self.link_s
        self.number = 0
        self.alive = True

    def receiver(self, time_ns: int) -> tuple[int, ...] | None:
        """The pilot's channels at a time [us]."""
        switch = self._switch(time_ns)
        roll, pitch, yaw = self.sticks
        return (roll, pitch, self.throttle, yaw, round(switch), 1500, 1500, 1500) if switch else None

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
        """One frame: a scan, the sequencer (while alive), then the rest of the period."""
        self.clock.advance_to(self.number * PERIOD_NS + late_ns)
        if self.alive:
            self.actuation.frame(scan_of(self.number, self.now, self.flying, late_ns), self.book)
        self.plane.run_to(self.now)
        self.number = max(self.number + 1, -(-self.now // PERIOD_NS))

    def run(self, seconds: float, each: Callable[[], None] = lambda: None) -> None:
        """So long."""
        until = self.now + round(seconds * 1e9)
        while self.number * PERIOD_NS < until:
            self.frame()
            each()

    def run_until(self, state: State, limit_s: float = 6.0) -> None:
        """To the first frame in a state; fails when it does not come."""
        until = self.now + round(limit_s * 1e9)
        while self.state is not state:
            assert self.now < until, f"still {self.state.words} ({self.reason.words}): {self.book.words}"
            self.frame()

    def pilots_outputs(self, time_ns: int) -> tuple[int, ...]:
        """What the servos get when nothing is overridden, the sticks as they are [us]."""
        twin = ArduPlane(lambda t: self.receiver(time_ns))
        return twin.outputs_us(100_000_000)[:3]
