"""One scan of all channels, and its protobuf form, both derived from the channel table.

A `Scan` is what the sampler makes twenty times a second, the recorder writes and the downlink packs. Its protobuf
schema is built from the table, so the recording opens in any MCAP reader with the channel names in it.
A channel that has no value in a scan (sensor absent, no new GPS fix) is simply not set in the message.
The last field of an encoded scan is its seal, a checksum over all the rest (`daq.contract.seal`).
"""

import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from functools import cache
from typing import Any, NamedTuple

from google.protobuf import descriptor_pb2
from google.protobuf.message import DecodeError

from daq.contract.channels import CHANNELS, GROUP_NAMES, GROUPS
from daq.contract.seal import SEAL_FIELD, SEAL_NUMBER, has_seal, message_class, seal, seal_holds
from daq.utilities.errors import UserError

SCHEMA_NAME = "sideslip.Scan"
SCAN_TOPIC = "/scan"

RawValue = int | float


class SensorState(IntEnum):
    """State of a sensor group in one scan, with the word a person reads."""

    OK = 0
    STALE = 1  # the chip answered but had no new sample
    OUT_OF_RANGE = 2  # a value outside what the sensor or the configuration allows
    STUCK = 3  # the same value for longer than noise permits
    ABSENT = 4  # the chip does not answer
    RECOVERING = 5  # answering again, not yet trusted
    FAULT = 6  # the chip itself reports a fault
    OFF = 7  # not fitted according to the configuration

    @property
    def words(self) -> str:
        return self.name.lower().replace("_", " ")

    @property
    def usable(self) -> bool:
        """Whether values of this state may be used for estimation."""
        return self is SensorState.OK


class ScanDecodeError(UserError):
    """Bytes that are not a scan of a known channel table."""


class GroupStatus(NamedTuple):
    """When within the scan a group was read, and how its sensor was."""

    state: SensorState
    offset_us: int = 0  # time of the group's sample after the scan's time [us]


@dataclass(frozen=True, slots=True)
class Scan:
    """All channels at one instant.

    number: 32-bit counter, one per scan slot, never reused within a recording session (a missed slot is a gap).
    time_monotonic_ns: start of the scan on the aircraft's monotonic clock.
    time_utc_ns: the same instant in UTC as well as known; 0 while unknown.
    utc_accuracy_ns: one-sigma accuracy of time_utc_ns; 0 while unknown.
    lateness_us: how late after its deadline the scan started.
    """

    number: int
    time_monotonic_ns: int
    time_utc_ns: int = 0
    utc_accuracy_ns: int = 0
    lateness_us: int = 0
    groups: Mapping[str, GroupStatus] = field(default_factory=dict)
    values: Mapping[str, RawValue] = field(default_factory=dict)  # only channels that have a value
    _encoded: bytes = field(default=b"", init=False, repr=False, compare=False)  # kept by `encode_scan`

    @property
    def time(self) -> float:
        """Monotonic time of the scan [s]."""
        return self.time_monotonic_ns * 1e-9


_HEADER = (
    ("number", "u32"),
    ("time_monotonic_ns", "u64"),
    ("time_utc_ns", "u64"),
    ("utc_accuracy_ns", "u32"),
    ("lateness_us", "u32"),
)

_CHANNEL_NAMES = tuple(c.name for c in CHANNELS)
_GROUP_FIELDS = tuple((g, f"{g}_state", f"{g}_offset_us") for g in GROUP_NAMES)
_STATES = tuple(SensorState)

_F = descriptor_pb2.FieldDescriptorProto
_PROTO_TYPE = {
    "bit": _F.TYPE_UINT32,
    "u8": _F.TYPE_UINT32,
    "u16": _F.TYPE_UINT32,
    "u32": _F.TYPE_UINT32,
    "u64": _F.TYPE_UINT64,
    "i16": _F.TYPE_SINT32,
    "i32": _F.TYPE_SINT32,
    "f32": _F.TYPE_FLOAT,
}


def _own_number(name: str) -> int:
    """Field number of a row that a laboratory's package brings: of its name alone, so that a recording is read right, or
    the row not at all, whatever packages are installed. Above the built-in numbers and those protobuf reserves."""
    return 1_000_000 + zlib.crc32(name.encode()) % 500_000_000


def _add_field(message: descriptor_pb2.DescriptorProto, name: str, kind: str, number: int, optional: bool) -> None:
    row = message.field.add(name=name, number=number, type=_PROTO_TYPE[kind], label=_F.LABEL_OPTIONAL)
    if optional:
        row.proto3_optional = True
        row.oneof_index = len(message.oneof_decl)
        message.oneof_decl.add(name=f"_{name}")


@cache
def file_descriptor_set() -> descriptor_pb2.FileDescriptorSet:
    """The protobuf schema of a scan, built from the channel table.

    Header fields take numbers 1-14, the seal 15, groups 16-127 (state and offset in turn), channels 128 on, in table
    order; rows of laboratory packages take numbers of their own (`_own_number`).
    """
    file = descriptor_pb2.FileDescriptorProto(name="sideslip/scan.proto", package="sideslip", syntax="proto3")
    message = file.message_type.add(name="Scan")
    for i, (name, kind) in enumerate(_HEADER):
        _add_field(message, name, kind, 1 + i, optional=False)
    message.field.add(name=SEAL_FIELD, number=SEAL_NUMBER, type=_F.TYPE_FIXED32, label=_F.LABEL_OPTIONAL)
    for i, group in enumerate(GROUPS):
        for k, (name, kind) in enumerate(((f"{group.name}_state", "u8"), (f"{group.name}_offset_us", "i32"))):
            _add_field(message, name, kind, _own_number(name) if group.package else 16 + 2 * i + k, optional=True)
    for i, channel in enumerate(CHANNELS):
        number = _own_number(channel.name) if channel.package else 128 + i
        _add_field(message, channel.name, channel.raw_type, number, optional=True)
    return descriptor_pb2.FileDescriptorSet(file=[file])


@cache
def scan_message_class() -> Any:
    """The protobuf message class of `file_descriptor_set`."""
    return message_class(SCHEMA_NAME, file_descriptor_set())


def encode_scan(scan: Scan) -> bytes:
    """A scan as sealed protobuf bytes; made once, for recorder and radio link need the same."""
    if scan._encoded:
        return scan._encoded
    fields: dict[str, RawValue] = {name: getattr(scan, name) for name, _ in _HEADER}
    for group, status in scan.groups.items():
        fields[f"{group}_state"] = int(status.state)
        fields[f"{group}_offset_us"] = status.offset_us
    fields.update(scan.values)
    encoded = seal(SCHEMA_NAME, scan_message_class()(**fields).SerializeToString(deterministic=True))
    object.__setattr__(scan, "_encoded", encoded)
    return encoded


def decode_scan(data: bytes) -> Scan:
    """A scan from protobuf bytes.

    Raises ScanDecodeError when the bytes are not a scan or their seal shows that they were altered.
    """
    if has_seal(data) and not seal_holds(SCHEMA_NAME, data):
        raise ScanDecodeError(f"{len(data)} bytes of a scan fail their checksum; the recording is damaged there")
    message = _message(data)
    # A field takes two bytes and more: of few bytes the few fields are listed, which beats asking for each of seventy where
    # a hostile file holds scans by the hundred thousand; of a usual scan asking is faster.
    sparse = len(data) < 2 * len(CHANNELS)
    is_set = {field.name for field, _ in message.ListFields()}.__contains__ if sparse else message.HasField
    try:
        groups = _groups(message, is_set)
    except ValueError as error:
        raise ScanDecodeError(f"scan {message.number} has an unknown sensor state ({error})") from error
    values = {name: getattr(message, name) for name in _CHANNEL_NAMES if is_set(name)}
    return Scan(**{name: getattr(message, name) for name, _ in _HEADER}, groups=groups, values=values)


def scan_stamp(data: bytes) -> tuple[int, int, int]:
    """Number, monotonic and UTC time [ns] of an encoded scan whose seal has been checked, without decoding the rest.

    Raises ScanDecodeError when the bytes are not a scan.
    """
    message = _message(data)
    return message.number, message.time_monotonic_ns, message.time_utc_ns


def _message(data: bytes) -> Any:
    try:
        return scan_message_class().FromString(data)
    except DecodeError as error:
        raise ScanDecodeError(f"{len(data)} bytes are not a scan ({error}); the recording is damaged there") from error


def _groups(message: Any, is_set: Callable[[str], bool]) -> dict[str, GroupStatus]:
    return {
        group: GroupStatus(_sensor_state(getattr(message, state)), getattr(message, offset))
        for group, state, offset in _GROUP_FIELDS
        if is_set(state)
    }


def _sensor_state(number: int) -> SensorState:
    """What the number stands for, without the search of an enumeration. Raises ValueError for a number without meaning."""
    return _STATES[number] if 0 <= number < len(_STATES) else SensorState(number)
