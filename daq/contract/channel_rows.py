"""What a row of the channel table is: a group of channels read together, a raw channel, a calibrated flight column."""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Literal, NamedTuple

RawType = Literal["bit", "u8", "u16", "u32", "u64", "i16", "i32", "f32"]
Downlink = Literal["fast", "slow", "none"]


class Rate(StrEnum):
    """How often a channel carries a new value."""

    SCAN = "scan"  # once a scan, 20 Hz by default
    SLOW = "slow"  # slower than the scan (GPS, temperatures): absent from scans without a new value


@dataclass(frozen=True, slots=True)
class ChannelGroup:
    """Channels read together in one bus conversation: one read offset and one sensor state for all of them."""

    name: str
    title: str
    device: str
    package: str = ""  # the laboratory's package that brings it; empty for what is built in


@dataclass(frozen=True, slots=True)
class Channel:
    """One raw channel as recorded.

    `scale` and `offset` turn the count into `unit` where the transfer function is fixed by the datasheet at the
    default range (physical = count * scale + offset); it is None where a calibration file decides.
    `columns` names the calibrated flight columns the channel contributes to.
    """

    name: str
    group: str
    raw_type: RawType
    unit: str
    meaning: str
    scale: float | None = None
    offset: float = 0.0
    rate: Rate = Rate.SCAN
    logged: bool = True
    downlink: Downlink = "fast"
    columns: tuple[str, ...] = ()
    package: str = ""  # the laboratory's package that brings it; empty for what is built in

    def limits(self) -> tuple[float, float]:
        """Smallest and largest raw value the raw type can carry."""
        return RAW_LIMITS[self.raw_type]

    def count_of(self, value: float) -> int:
        """The count that stands for a value in `unit`; only for a channel with a `scale`."""
        assert self.scale is not None
        return round((value - self.offset) / self.scale)


@dataclass(frozen=True, slots=True)
class FlightColumn:
    """One calibrated flight column: SI, radians, body axes."""

    name: str
    unit: str
    meaning: str
    entity: str  # path of the viewer entity that carries it; columns sharing an entity are drawn together
    plausible: tuple[float, float]
    title: str = ""


class TableRows(NamedTuple):
    """Groups, channels and columns of a table, or of the part of it that one package brings."""

    groups: tuple[ChannelGroup, ...]
    channels: tuple[Channel, ...]
    columns: tuple[FlightColumn, ...]


RAW_LIMITS: Mapping[str, tuple[float, float]] = {
    "bit": (0, 1),
    "u8": (0, 2**8 - 1),
    "u16": (0, 2**16 - 1),
    "u32": (0, 2**32 - 1),
    "u64": (0, 2**64 - 1),
    "i16": (-(2**15), 2**15 - 1),
    "i32": (-(2**31), 2**31 - 1),
    "f32": (-3.4e38, 3.4e38),
}
