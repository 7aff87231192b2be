"""Servo pulses from increments of the controls, the limits of both, and the check of a manoeuvre against them."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from daq.actuation.config import CONTROLS, SequencerConfig
from daq.contract.manoeuvre import Manoeuvre, ManoeuvreError, load_manoeuvre

Increments = tuple[float, ...]
"""One value for each of CONTROLS [rad]."""
STILL: Increments = (0.0,) * len(CONTROLS)


@dataclass(frozen=True, slots=True)
class ConfiguredServo:
    """One output: gains [us/rad] in the order of CONTROLS, limits of the pulse width [us] and of its rate [us/s].

    read_back: whether the pulses that reach the servo are measured.
    """

    name: str
    us_per_rad: tuple[float, ...]
    lowest_us: float
    highest_us: float
    slew_us_per_s: float
    read_back: bool = False

    def shift(self, increments: Increments) -> float:
        """Change of the pulse width [us]."""
        return sum(gain * value for gain, value in zip(self.us_per_rad, increments, strict=True))

    def limited(self, wanted_us: float, last_us: float, seconds: float) -> float:
        """The width nearest to `wanted_us` within slew rate and limits; where both cannot be met, within the limits."""
        step = self.slew_us_per_s * seconds
        slewed = min(max(wanted_us, last_us - step), last_us + step)
        return min(max(slewed, self.lowest_us), self.highest_us)


@dataclass(frozen=True, slots=True)
class ServoManoeuvre:
    """A manoeuvre as the sequencer flies it: increments (samples) at `time_step` [s]."""

    digest: str
    time_step: float
    increments: tuple[Increments, ...]

    @property
    def duration_s(self) -> float:
        """Duration [s], with one step for the last sample, which is zero."""
        return len(self.increments) * self.time_step

    def at(self, elapsed_s: float) -> Increments:
        """Increments `elapsed_s` after the start [rad], interpolated linearly between samples; zero outside.

        Linear, because frames jitter: steps of two samples could fall into one frame, which is twice the designed rate.
        """
        position = elapsed_s / self.time_step
        index = math.floor(position)
        if not 0 <= index < len(self.increments) - 1:
            return STILL
        fraction = position - index
        first, second = self.increments[index], self.increments[index + 1]
        return tuple(a + fraction * (b - a) for a, b in zip(first, second, strict=True))

    def reach(self, servo: ConfiguredServo) -> tuple[float, float]:
        """Smallest and largest change of a servo's pulse width [us]."""
        shifts = [servo.shift(i) for i in self.increments]
        return min(shifts), max(shifts)


def servos_of(config: SequencerConfig) -> tuple[ConfiguredServo, ...]:
    """The servos of a configuration, in its order; an autopilot reports the signal of every output."""
    return tuple(
        ConfiguredServo(
            name,
            tuple(o.us_per_rad.get(c, 0.0) for c in CONTROLS),  # type: ignore[call-overload]  # keys are CONTROLS
            o.lowest_us,
            o.highest_us,
            o.slew_us_per_s,
            o.readback > 0 or config.through != "pca9685",
        )
        for name, o in config.output.items()
    )


def plan_of(manoeuvre: Manoeuvre, config: SequencerConfig) -> ServoManoeuvre:
    """The manoeuvre as the sequencer flies it. Raises ManoeuvreError, naming control or output, value and limit, where this
    aircraft's limits forbid it."""
    largest = math.radians(config.limits.largest_deg)
    for name, values in manoeuvre.increments.items():
        peak = max(abs(v) for v in values)
        if peak > largest:
            raise ManoeuvreError(
                f"manoeuvre: {name} goes to {math.degrees(peak):.1f} deg, sequencer.limits.largest_deg allows "
                f"{config.limits.largest_deg:g}; design it with smaller limits"
            )
    zeros = (0.0,) * manoeuvre.samples
    rows = zip(*(manoeuvre.increments.get(c, zeros) for c in CONTROLS), strict=True)
    plan = ServoManoeuvre(manoeuvre.digest, manoeuvre.time_step, tuple(rows))
    for servo in servos_of(config):
        _check_servo(servo, plan)
    _check_moved(manoeuvre, servos_of(config))
    return plan


def _check_servo(servo: ConfiguredServo, plan: ServoManoeuvre) -> None:
    shifts = [servo.shift(i) for i in plan.increments]
    fastest = max((abs(b - a) for a, b in zip(shifts, shifts[1:], strict=False)), default=0.0) / plan.time_step
    if fastest > servo.slew_us_per_s:
        raise ManoeuvreError(
            f"manoeuvre: moves output {servo.name} at {fastest:.0f} us/s, its slew_us_per_s allows "
            f"{servo.slew_us_per_s:g}; design it with a lower rate_deg_s"
        )
    travel = servo.highest_us - servo.lowest_us
    if max(shifts) - min(shifts) > travel:
        raise ManoeuvreError(
            f"manoeuvre: output {servo.name} would need {max(shifts) - min(shifts):.0f} us, its limits leave {travel:.0f}"
        )


def _check_moved(manoeuvre: Manoeuvre, servos: Sequence[ConfiguredServo]) -> None:
    for index, control in enumerate(CONTROLS):
        if any(manoeuvre.increments.get(control, ())) and not any(s.us_per_rad[index] for s in servos):
            raise ManoeuvreError(
                f"manoeuvre: moves {control}, but no [sequencer.output] does; wire it or design without it"
            )


@dataclass(frozen=True, slots=True)
class TrialFinding:
    """Result of one check of a trial. what: the part checked; well: whether it passed; text: why, in words."""

    what: str
    well: bool
    text: str


def try_manoeuvre(config: SequencerConfig) -> TrialFinding:
    """Check the configured manoeuvre against this aircraft's limits."""
    try:
        plan = plan_of(load_manoeuvre(config.manoeuvre), config)
    except ManoeuvreError as error:
        return TrialFinding("manoeuvre", False, str(error))
    return TrialFinding("manoeuvre", True, f"{plan.digest[:6]}, {plan.duration_s:.1f} s, within this aircraft's limits")
