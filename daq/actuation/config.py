"""`[sequencer]`: servo driver, pilot's signals, limits and manoeuvre. Without this section nothing on board moves a control."""

import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Literal, NamedTuple

from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from daq.sensors.base import Address, NotNegative, Positive

LEAST_RATE_HZ = 50.0
"""Least rate of frames: manoeuvre files have a sample every 20 ms, and 10 Hz has been found too slow in flight (PX4 #25775)."""
PX4_WORDS = (
    "PX4 takes either the sticks or MANUAL_CONTROL (COM_RC_IN_MODE), all axes and the throttle together, so increments cannot be "
    'added to the pilot\'s own signals; use a servo driver behind a multiplexer (through = "pca9685")'
)
CONTROLS = ("delta_e", "delta_a", "delta_r")
"""Controls of a manoeuvre, in the order of recordings and messages."""


class _SequencerTable(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class ChipConfig(_SequencerTable):
    """`[sequencer.chip]`: the PCA9685. Not at 0x40, the address of the capture co-processor; 0x41 is strap A0 closed.

    oscillator_hz: of this chip, 23 to 27 MHz; measure it once on the bench (`docs/sequencer.md`). loopback_channel: output that
    is wired to a pulse input, by which the frequency is measured.
    """

    address: Address = 0x41
    frequency_hz: Annotated[float, Field(ge=40, le=200)] = 50.0
    oscillator_hz: Annotated[float, Field(ge=23e6, le=27e6)] = 25e6
    loopback_channel: Annotated[int, Field(ge=0, le=15)] = 3


class PilotConfig(_SequencerTable):
    """`[sequencer.pilot]`: a second capture co-processor at the receiver, before the multiplexer.

    switch_input: input of the switch's channel, which is also the multiplexer's SEL. loopback_input: input of the chip's
    loopback.
    """

    address: Address = 0x42
    timeout_ms: Annotated[int, Field(ge=10, le=250)] = 50
    switch_input: Annotated[int, Field(ge=1, le=6)] = 5
    loopback_input: Annotated[int, Field(ge=1, le=6)] = 6


class AutopilotConfig(_SequencerTable):
    """`[sequencer.autopilot]`: an ArduPlane that drives the servos, with `through = "ardupilot"`.

    port: as in `[downlink]`, such as serial:/dev/ttyAMA2:115200; no other program may read it. system_id: ours, from which the
    autopilot accepts overrides (MAV_GCS_SYSID). switch_channel: of the receiver, with RCn_OPTION 46. watch: channels, above all
    the throttle, that end a manoeuvre when moved by more than `stick_us`. longest_override_s: largest RC_OVERRIDE_TIME allowed.
    """

    port: str = ""
    system_id: Annotated[int, Field(ge=1, le=255)] = 255
    switch_channel: Annotated[int, Field(ge=1, le=16)] = 5
    watch: tuple[Annotated[int, Field(ge=1, le=16)], ...] = (3,)
    longest_override_s: Annotated[float, Field(ge=0.06, le=0.3)] = 0.1


class HeartbeatConfig(_SequencerTable):
    """`[sequencer.heartbeat]`: files of the two lines to the monostable, such as a gpio-leds device's `brightness`.

    line: a rising edge retriggers the monostable. clear: low ends it at once; None where not wired. The monostable's time plus
    the time in which the multiplexer detects the loss of SEL must be less than 0.1 s.
    """

    line: Path = Path("/sys/class/leds/sideslip-heartbeat/brightness")
    clear: Path | None = Path("/sys/class/leds/sideslip-clear/brightness")


class ServoOutputConfig(_SequencerTable):
    """`[sequencer.output.NAME]`: one servo. us_per_rad: control -> pulse width per radian.

    pilot_input: pulse input of the pilot's signal for this servo. readback: pulse input behind the multiplexer, 0 for none. With
    an autopilot an output is a stick: channel is that of the receiver, 1 to 8, and the other two are omitted.
    """

    channel: Annotated[int, Field(ge=0, le=15)]
    pilot_input: Annotated[int, Field(ge=0, le=6)] = 0
    readback: Annotated[int, Field(ge=0, le=6)] = 0
    us_per_rad: dict[Literal["delta_e", "delta_a", "delta_r"], float]
    lowest_us: Annotated[float, Field(ge=800, le=1500)] = 1100.0
    highest_us: Annotated[float, Field(ge=1500, le=2200)] = 1900.0
    slew_us_per_s: Annotated[float, Field(gt=0, le=20_000)] = 6000.0  # 300 deg/s where 1000 us are 50 deg

    @field_validator("us_per_rad")
    @classmethod
    def _moved(cls, table: dict[str, float]) -> dict[str, float]:
        if not any(table.values()):
            raise ValueError("no control moves this output; name one of delta_e, delta_a, delta_r")
        return table


Range = tuple[float, float]
_UNTIL = re.compile(r"\s*([A-Za-z][A-Za-z0-9_]{0,9})\s+(\d{1,2}(?:\.\d{1,3})?)\s*%\s*")


class WantedBound(NamedTuple):
    """The bound at which a manoeuvre ends: the standard deviation of a derivative is at most this share of its estimate."""

    name: str
    share: float

    @classmethod
    def read(cls, text: str) -> "WantedBound":
        """Parse a text such as `Cl_p 5 %`. Raises ValueError for anything else."""
        match = _UNTIL.fullmatch(text)
        if match is None or not float(match[2]) > 0.0:
            raise ValueError(f'{text!r} is no bound to be reached; write a derivative and a share, such as "Cl_p 5 %"')
        return cls(match[1], float(match[2]) / 100.0)

    def reached(self, known: Mapping[str, tuple[float, float]]) -> bool:
        """Whether the bound is reached. known: derivative -> estimate and standard deviation."""
        estimate, bound = known.get(self.name, (0.0, math.inf))
        return 0.0 < bound <= self.share * abs(estimate)


class EnvelopeConfig(_SequencerTable):
    """`[sequencer.limits]`: beyond these the pilot gets the aircraft. None: no limit.

    Motion is computed with nominal transfer functions, without calibration: leave a margin. link_s: longest silence of the
    ground. stick_us: a stick moved by more means that the pilot takes over.
    """

    bank_deg: Annotated[float, Field(gt=0, le=90)] | None = 60.0
    load_factor: Range | None = (0.0, 2.5)
    airspeed: Range | None = (12.0, 25.0)  # m/s, indicated
    alpha_deg: Range | None = (-6.0, 14.0)
    height_m: Range | None = (30.0, 150.0)  # above the field
    field_elevation_m: float = 0.0
    largest_deg: Annotated[float, Field(gt=0, le=30)] = 12.0  # increment of any control, whatever the file says
    link_s: Positive | None = None
    stale_ms: Annotated[float, Field(ge=20, le=100)] = 100.0
    gnss_stale_ms: Annotated[float, Field(ge=100, le=2000)] = (
        500.0  # ten fixes a second; height does not run away in 0.5 s
    )
    late_ms: Annotated[float, Field(gt=0, le=20)] = 10.0
    stick_us: Annotated[float, Field(ge=10, le=200)] = 40.0
    frequency_error: Annotated[float, Field(gt=0, le=0.05)] = 0.02

    @field_validator("load_factor", "airspeed", "alpha_deg", "height_m")
    @classmethod
    def _rising(cls, pair: Range | None) -> Range | None:
        if pair is not None and pair[0] >= pair[1]:
            raise ValueError("must be [lowest, highest]")
        return pair


class VaneConfig(_SequencerTable):
    """`[sequencer.alpha_vane]`: nominal transfer function of the angle-of-attack vane, as in its calibration file."""

    centre_v: float = 2.5
    rad_per_v: float = 0.8


class SequencerConfig(_SequencerTable):
    """`[sequencer]`.

    manoeuvre: file of `sideslip design`. through: a servo driver, or an autopilot. start: `switch`: the manoeuvre begins when the
    pilot switches to go; `ground`: by a signed command within wait_s after that. ramp_s: time in which the increments of an
    aborted manoeuvre fade. until: a bound such as `Cl_p 5 %`; the manoeuvre ends when identification on board reaches it, and is
    repeated until then, at most most_sets times and not beyond longest_s. Empty: flown once, to its end.
    """

    manoeuvre: Path
    through: Literal["pca9685", "ardupilot", "px4"] = "pca9685"
    start: Literal["switch", "ground"] = "switch"
    wait_s: Annotated[float, Field(gt=0, le=120)] = 30.0
    ramp_s: Annotated[float, Field(ge=0.02, le=1.0)] = 0.2
    until: str = ""
    most_sets: Annotated[int, Field(ge=1, le=10)] = 1
    longest_s: Annotated[float, Field(ge=1, le=600)] = 60.0
    chip: ChipConfig = ChipConfig()
    pilot: PilotConfig = PilotConfig()
    heartbeat: HeartbeatConfig = HeartbeatConfig()
    autopilot: AutopilotConfig = AutopilotConfig()
    output: dict[str, ServoOutputConfig]
    limits: EnvelopeConfig = EnvelopeConfig()
    alpha_vane: VaneConfig = VaneConfig()
    status_rate_hz: NotNegative = 2.0  # SEQUENCER_STATUS to the ground while not idle: 52 bytes each with a signature

    @field_validator("until")
    @classmethod
    def _bound(cls, text: str) -> str:
        if text:
            WantedBound.read(text)
        return text

    @property
    def wanted(self) -> WantedBound | None:
        """The bound of `until`; None where it is empty."""
        return WantedBound.read(self.until) if self.until else None

    @model_validator(mode="after")
    def _consistent(self) -> "SequencerConfig":
        if self.most_sets > 1 and not self.until:
            raise ValueError('most_sets is for a set that is flown until a bound is reached; set until = "Cl_p 5 %"')
        if not self.output:
            raise ValueError("output names no servo; add [sequencer.output.NAME]")
        if self.through == "px4":
            raise ValueError(PX4_WORDS)
        if self.through == "ardupilot":
            self._check_sticks()
        else:
            self._check_servos()
        return self

    def _check_sticks(self) -> None:
        if not self.autopilot.port:
            raise ValueError("autopilot.port is missing; name the serial port that leads to it")
        for name, output in self.output.items():
            if not 1 <= output.channel <= 8:
                raise ValueError(f"output {name}: channel {output.channel} cannot be released by 0; use 1 to 8")
            if output.pilot_input or output.readback:
                raise ValueError(f"output {name}: the autopilot shows the sticks; leave pilot_input and readback out")
        channels = [*(o.channel for o in self.output.values()), self.autopilot.switch_channel, *self.autopilot.watch]
        if len(set(channels)) < len(channels):
            raise ValueError(f"a channel of the receiver is used twice: {', '.join(map(str, channels))}")

    def _check_servos(self) -> None:
        unread = [name for name, o in self.output.items() if not o.pilot_input]
        if unread:
            raise ValueError(f"output {unread[0]}: pilot_input is missing; name the pulse input of the pilot's signal")
        channels = [o.channel for o in self.output.values()] + [self.chip.loopback_channel]
        inputs = [o.pilot_input for o in self.output.values()] + [self.pilot.switch_input, self.pilot.loopback_input]
        for kind, numbers in (("chip channel", channels), ("pilot input", inputs)):
            if len(set(numbers)) < len(numbers):
                raise ValueError(f"a {kind} is used twice: {', '.join(map(str, numbers))}")
        if max(channels) - min(channels) > 6:
            raise ValueError(
                "output and loopback channels must lie within seven neighbours: one block write carries them"
            )
