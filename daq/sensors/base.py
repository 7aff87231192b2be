"""What a sensor driver is: a chip on a bus that can be set up, read and audited without ever holding up a scan.

A driver never sleeps. Where the chip needs time, in the set-up or between starting a conversion and collecting it, the
driver yields the time to wait, and the sampler does something else meanwhile. A driver lets `OSError` of the bus
pass and raises `SensorError` when the chip answers but is not what it should be; the sampler turns both into states.
"""

import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Generator, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Annotated, Any, ClassVar, NamedTuple

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from daq.contract.scan import RawValue, SensorState
from daq.sensors.bus import I2cBus, SerialPortCalls
from daq.sensors.timebase import TimeBase
from daq.utilities.errors import UserError

Wait = int
"""Time until the driver wants to go on [ns]."""

US = 1_000
MS = 1_000_000
SECOND = 1_000_000_000
NO_VALUES: Mapping[str, RawValue] = MappingProxyType({})

Address = Annotated[int, Field(ge=0x08, le=0x77, description="7-bit I2C address")]
Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]


def one_of(*choices: float) -> AfterValidator:
    """A validator that accepts the listed values only."""

    def check(value: float) -> float:
        if value not in choices:
            raise ValueError(f"must be one of {', '.join(f'{c:g}' for c in choices)}")
        return value

    return AfterValidator(check)


class SensorConfigSection(BaseModel):
    """Base of the configuration's sections: unknown keys are mistakes, values do not change after reading."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class SensorSection(SensorConfigSection):
    """What the sections of all sensors have in common.

    driver: the class that reads it, by its name. every: read in every n-th scan; left out, the smallest n at which the chip can
    deliver a new sample each time. required: a flight is refused by the preflight check while this sensor is not well.
    """

    every: Annotated[int, Field(ge=1, le=100_000)] | None = None
    required: bool = True
    driver: str


class SensorError(Exception):
    """A chip that answers but cannot be used; the message goes into the recording and the preflight table."""


class WrongChipError(SensorError):
    """The identity register does not hold what the configured chip would show."""

    def __init__(self, chip: str, address: int, expected: int, found: int) -> None:
        super().__init__(
            f"expected a {chip} at I2C address 0x{address:02x} with identity 0x{expected:02x} but read 0x{found:02x};"
            " check the wiring and the configured driver"
        )


class SelfTestError(SensorError):
    """The chip answers with the right identity but does not take its settings or does not measure."""


class Reading(NamedTuple):
    """One sample of a sensor group.

    values: raw counts by channel name. state: the chip's own verdict (ok, stale, out of range, fault).
    time_ns: monotonic time the sample belongs to; None for the moment it was read [ns].
    events: monotonic times of event-switch edges seen since the last reading [ns].
    """

    values: Mapping[str, RawValue] = NO_VALUES
    state: SensorState = SensorState.OK
    detail: str = ""
    time_ns: int | None = None
    events: tuple[int, ...] = ()


class DriverConfigError(UserError):
    """A driver that the configuration asks for but that cannot be had."""


@dataclass(frozen=True, slots=True)
class Surroundings:
    """What drivers are connected to. autopilot: the serial port to one. section: of a group, or None. rate_hz: of the scan.
    shared: what drivers of one device have in common."""

    bus: I2cBus | None
    gnss: SerialPortCalls | None
    autopilot: SerialPortCalls | None
    now_ns: Callable[[], int]
    timebase: TimeBase
    section: Callable[[str], Any]
    rate_hz: float = 20.0
    shared: dict[str, Any] = field(default_factory=dict)

    def need_bus(self, group: str) -> I2cBus:
        """The bus. Raises DriverConfigError when there is none."""
        if self.bus is None:
            raise DriverConfigError(f"sensors.{group} needs an I2C bus and none was opened; set sensors.bus.device")
        return self.bus

    def need_port(self, port: SerialPortCalls | None, group: str) -> SerialPortCalls:
        """The serial port. Raises DriverConfigError when there is none."""
        if port is None:
            raise DriverConfigError(
                f"sensors.{group} needs a serial port and none was opened; set sensors.{group}.device"
            )
        return port


class Driver(ABC):
    """One sensor group. Subclasses say in their docstring which datasheet revision they follow."""

    name: ClassVar[str] = ""
    """How the configuration calls it."""

    groups: ClassVar[tuple[str, ...]] = ()
    """Groups that it can serve."""

    precedence: ClassVar[int] = 99
    """On the bus: lower ones first."""

    begun_first: ClassVar[bool] = False
    """Begun before any converter is served again."""

    stuck_s: ClassVar[Mapping[str, float]] = {}
    """Longest time that channels show one and the same value while all is well [s]: many times the longest run of equal codes
    that a quiet chip's own noise permits."""

    max_step: Mapping[str, float] = {}
    """Largest change of channels from one sample to the next [counts at 20 Hz]: far beyond what a 3 kg aircraft does in 50 ms,
    far below what a broken wire does."""

    group: str
    max_rate_hz: float = 1000.0
    """Highest rate at which the chip, as configured, has a new sample for each reading [Hz]."""

    uses_i2c: bool = True
    repeated: int = 0
    """Transfers that the driver repeated by itself since the supervisor last looked; it sets this to 0 again."""

    refusal: str = ""
    """What the device would not do as it was asked, in words; empty where nothing."""

    needs: str = ""
    """Group that has to be set up before this one can be."""

    def __init__(
        self, section: Any, bus: I2cBus, now_ns: Callable[[], int] = time.monotonic_ns, group: str = ""
    ) -> None:
        self.group = group or self.groups[0]
        self._config: Any = section
        self._address: int = section.address
        self._bus = bus
        self._now = now_ns
        self._adopt_settings()

    def _adopt_settings(self) -> None:
        """What follows from the section once for all; `self._config` and `self.group` are known."""
        return

    @classmethod
    def build(cls, group: str, around: Surroundings) -> "Driver":
        """The driver of a group. Raises DriverConfigError where its bus or port was not opened."""
        return cls(around.section(group), around.need_bus(group), around.now_ns, group)

    @abstractmethod
    def initialise(self) -> Generator[Wait, None, None]:
        """Reset, identify, configure and self-test, yielding the waits. Raises OSError or SensorError."""

    @abstractmethod
    def read(self) -> Reading:
        """One sample, now. Raises OSError when the chip does not answer."""

    def stages(self) -> Generator[Wait, None, Reading]:
        """One sample in stages, yielding the waits between them; by default a single `read`."""
        yield from ()
        return self.read()

    def intact(self) -> bool:
        """Whether the chip still has the settings it was given; one short transaction. Raises OSError."""
        return True

    def keep_timing(self) -> None:
        """The sample just taken was timed as in flight, among all the others: keep that for `metadata`."""
        return

    def metadata(self) -> dict[str, str]:
        """What the ground needs to know about this chip to make use of the counts."""
        return {}


def signed(value: int, bits: int) -> int:
    """Two's complement of an unsigned field."""
    return value - (1 << bits) if value >> (bits - 1) else value
