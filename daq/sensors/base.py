"""The interface of a sensor driver: a chip on a bus that is set up, read and audited without delaying a scan.

A driver never sleeps. Where the chip needs time, in the set-up or between starting a conversion and collecting it, the driver
yields the time to wait, and the sampler uses it for others. A driver lets `OSError` of the bus pass and raises `SensorError` when
the chip answers but cannot be used; the supervisor turns both into states.
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
"""Time until the driver can continue [ns]."""

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
    """Base of the configuration's sections: unknown keys are errors, and values are immutable."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class SensorSection(SensorConfigSection):
    """Keys common to the sections of all sensors.

    driver: name of the driver. every: read in every n-th scan; by default the smallest n at which the chip has a new sample each
    time. required: the preflight check fails while this sensor does.
    """

    every: Annotated[int, Field(ge=1, le=100_000)] | None = None
    required: bool = True
    driver: str


class SensorError(Exception):
    """A chip that answers but cannot be used; the message goes into the recording and the preflight table."""


class WrongChipError(SensorError):
    """The identity register does not hold the value of the configured chip."""

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
    """A driver of the configuration that is not available."""


@dataclass(frozen=True, slots=True)
class DriverContext:
    """What drivers are built from. bus, gnss, autopilot: opened ports, None where not opened. now_ns: the monotonic clock.
    section: group -> its configuration, or None. rate_hz: of the scans. shared: objects shared by drivers of one device."""

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
    """Driver of one sensor group. Subclasses state the revision of the data sheet that they follow."""

    name: ClassVar[str] = ""
    """Name in the configuration."""

    groups: ClassVar[tuple[str, ...]] = ()
    """Groups that it can serve."""

    precedence: ClassVar[int] = 99
    """Order on the bus: lower first."""

    starts_first: ClassVar[bool] = False
    """Whether its sample begins before any sample under way continues."""

    stuck_s: ClassVar[Mapping[str, float]] = {}
    """Channel -> longest time without a change of a working sensor [s]: many times the longest run of equal codes that a quiet
    chip's noise permits."""

    max_step: Mapping[str, float] = {}
    """Channel -> largest change from one sample to the next [counts at 20 Hz]: far beyond that of a 3 kg aircraft in 50 ms, far
    below that of a broken wire."""

    group: str
    max_rate_hz: float = 1000.0
    """Highest rate at which the chip, as configured, has a new sample for each reading [Hz]."""

    uses_i2c: bool = True
    repeated: int = 0
    """Transfers that the driver itself repeated; the supervisor reads it and resets it to 0."""

    refusal: str = ""
    """Which request the device refused, in words; empty without one."""

    needs: str = ""
    """Group that must be set up before this one."""

    def __init__(
        self, section: Any, bus: I2cBus, now_ns: Callable[[], int] = time.monotonic_ns, group: str = ""
    ) -> None:
        self.group = group or self.groups[0]
        self._config: Any = section
        self._address: int = section.address
        self._bus = bus
        self._now = now_ns
        self._derive_settings()

    def _derive_settings(self) -> None:
        """Compute what follows from the section, once; `self._config` and `self.group` are set."""
        return

    @classmethod
    def build(cls, group: str, context: DriverContext) -> "Driver":
        """The driver of a group. Raises DriverConfigError where its bus or port was not opened."""
        return cls(context.section(group), context.need_bus(group), context.now_ns, group)

    @abstractmethod
    def initialise(self) -> Generator[Wait, None, None]:
        """Reset, identify, configure and self-test the chip, yielding the waits. Raises OSError or SensorError."""

    @abstractmethod
    def read(self) -> Reading:
        """Read one sample now. Raises OSError when the chip does not answer."""

    def stages(self) -> Generator[Wait, None, Reading]:
        """Read one sample in stages, yielding the waits between them; by default a single `read`."""
        yield from ()
        return self.read()

    def intact(self) -> bool:
        """Whether the chip still has its settings; one short transaction. Raises OSError."""
        return True

    def store_timing(self) -> None:
        """Store the timing of the last sample, which was taken among all others as in flight, for `metadata`."""
        return

    def metadata(self) -> dict[str, str]:
        """What is needed to interpret the counts of this chip, key -> text."""
        return {}


def signed(value: int, bits: int) -> int:
    """Two's complement of an unsigned field."""
    return value - (1 << bits) if value >> (bits - 1) else value
