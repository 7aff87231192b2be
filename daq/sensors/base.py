"""What a sensor driver is: a chip on a bus that can be set up, read and audited without ever holding up a scan.

A driver never sleeps. Where the chip needs time, in the set-up or between starting a conversion and collecting it, the
driver yields the time to wait, and the sampler does something else meanwhile. A driver lets `OSError` of the bus
pass and raises `SensorError` when the chip answers but is not what it should be; the sampler turns both into states.
"""

from abc import ABC, abstractmethod
from collections.abc import Generator, Mapping
from types import MappingProxyType
from typing import NamedTuple

from daq.contract.scan import RawValue, SensorState

Wait = int
"""Time until the driver wants to go on [ns]."""

US = 1_000
MS = 1_000_000
SECOND = 1_000_000_000


NO_VALUES: Mapping[str, RawValue] = MappingProxyType({})


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


class Driver(ABC):
    """One sensor group. Subclasses say in their docstring which datasheet revision they follow."""

    group: str
    max_rate_hz: float = 1000.0
    """Highest rate at which the chip, as configured, has a new sample for each reading [Hz]."""

    uses_i2c: bool = True
    repeated: int = 0
    """Transfers that the driver repeated by itself since the supervisor last looked; it sets this to 0 again."""

    needs: str = ""
    """Group that has to be set up before this one can be."""

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
