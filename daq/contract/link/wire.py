"""The packed scan messages of the downlink, laid out from the channel table.

Three messages carry a scan, each with the scan's number, its exact monotonic time and the boot id of the logger:

- SCAN_FAST: every channel with downlink "fast", with state and read offset of their groups. Sent at the downlink
  rate; its payload is at most 93 bytes so that a signed frame (118 bytes) fits one packet of a SiK radio with error
  correction.
- SCAN_SLOW: "slow" channels that have a value in every scan, and the rest of the scan's header (UTC, lateness).
- SCAN_RARE: "slow" channels that come less often than scans (GPS).

A fourth, SCAN_LABORATORY, carries what laboratory packages bring. To MAVLink it is a row of bytes, so that the dialect stays
the same for every ground station; a checksum of its channels in front of them says which they are.

Values are the raw counts as recorded. What does not fit is never clamped: the channel is marked missing, and if a read
offset does not fit, all channels of its group are. Three bytes suffice for the 24-bit converters and seven for the
time (two years); such fields are split into MAVLink's own types, low part first. Bits of a mask count from the least
significant one of byte 0. Fields that are zero in healthy flight come last, because MAVLink 2 leaves trailing zeros
out of the frame.
"""

import struct
import zlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from itertools import product
from operator import itemgetter
from typing import Any, NamedTuple

from daq.contract.channels import CHANNELS, Channel, Rate
from daq.contract.scan import GroupStatus, RawValue, Scan, SensorState
from daq.utilities.errors import UserError

SCAN_FAST_ID, SCAN_SLOW_ID, SCAN_RARE_ID, SCAN_LABORATORY_ID = 44100, 44101, 44102, 44108
SCAN_IDS = (SCAN_FAST_ID, SCAN_SLOW_ID, SCAN_RARE_ID, SCAN_LABORATORY_ID)
MAX_FAST_PAYLOAD = 93
MAX_LABORATORY_PAYLOAD = 200
"""Bytes of SCAN_LABORATORY in the dialect definition."""

_CODE = {"u8": "B", "u16": "H", "u32": "I", "u64": "Q", "i16": "h", "i32": "i", "f32": "f"}
_MAVLINK_TYPE = {**{k: f"{'u' * (k[0] == 'u')}int{k[1:]}_t" for k in _CODE if k != "f32"}, "f32": "float"}
_SIZE = {kind: struct.calcsize(code) for kind, code in _CODE.items()}

_CONVERTER_BITS = {"static_pressure": 24, "static_temperature": 24, "thrust_load": 24}
"""Channels whose chip delivers fewer bits than their raw type holds."""

_TIME_BITS = 56
_SPLIT = {24: ("u16", "u8"), 56: ("u32", "u16", "u8")}

NOT_IN_SCAN = -(2**15)
"""Offset of a group that the scan says nothing about [us]."""
UNFIT_OFFSET = -(2**15) + 1
"""Offset of a group whose offset does not fit; its channels are marked missing [us]."""

_OFFSET_LIMIT = 2**15 - 2
_STATE_BITS = 3


@dataclass(frozen=True, slots=True)
class WireField:
    """One field of a packed message: raw type and, for arrays, the number of elements."""

    name: str
    raw_type: str
    count: int = 0
    meaning: str = ""

    @property
    def mavlink_type(self) -> str:
        """The type as a dialect definition writes it."""
        base = _MAVLINK_TYPE[self.raw_type]
        return f"{base}[{self.count}]" if self.count else base


@dataclass(frozen=True, slots=True)
class _Packer:
    """A layout as `pack_scan` wants it: everything it would else have to look up for each scan.

    codec: takes arrays as bytes. pick: field name -> value, in wire order. blank: all fields zero. channels: bit in
    `missing`, name, group and limits. bits: bit in `bits` and channel. split: quantity, its bits, parts with their bits.
    """

    codec: struct.Struct
    pick: Callable[[Mapping[str, RawValue | bytes]], tuple[RawValue | bytes, ...]]
    blank: Mapping[str, RawValue | bytes]
    channels: tuple[tuple[int, str, str, float, float], ...]
    bits: tuple[tuple[int, str], ...]
    split: tuple[tuple[str, int, tuple[tuple[str, int], ...]], ...]
    offsets: struct.Struct  # of the groups' offsets


@dataclass(frozen=True, slots=True)
class _Unpacker:
    """A layout as `unpack_scan` wants it.

    codec: gives the arrays of bytes as bytes, all else as the layout's. names: of what `pick` picks, one field each. split: name,
    places of its low and high part, shift of the high one, and half of its range where it has a sign, else 0. time: places and
    shifts of the time's parts. groups: by place in `offsets`. rest: places of the rest of the header.
    The others are places of the field of that name, -1 where there is none.
    """

    codec: struct.Struct
    names: tuple[str, ...]
    pick: Callable[[Sequence[Any]], tuple[Any, ...]]
    split: tuple[tuple[str, int, int, int, int], ...]
    time: tuple[tuple[int, int], ...]
    bits: tuple[tuple[str, int], ...]
    channels: tuple[tuple[str, int], ...]
    groups: tuple[str, ...]
    boot: int
    number: int
    in_bits: int
    missing: int
    states: int
    offsets: slice
    table: int
    rest: tuple[int, ...]


@dataclass(frozen=True)
class ScanLayout:
    """A packed scan message: which channels it carries and where each byte is."""

    msg_id: int
    name: str
    meaning: str
    channels: tuple[Channel, ...]
    groups: tuple[str, ...]  # groups whose state and read offset travel in this message
    fields: tuple[WireField, ...]  # in wire order: larger types first, as MAVLink sorts them
    packer: _Packer = field(repr=False)
    unpacker: _Unpacker = field(repr=False)
    table: int = 0  # checksum of the channels of SCAN_LABORATORY

    @property
    def size(self) -> int:
        """Payload bytes before trailing zeros are left out."""
        return self.packer.codec.size


_HEADER = (
    *(
        WireField(f"time_monotonic_ns_{i}", kind, 0, f"start of the scan on the logger's monotonic clock, part {i}")
        for i, kind in enumerate(_SPLIT[_TIME_BITS])
    ),
    WireField("number", "u32", meaning="scan number"),
    WireField("boot", "u8", meaning="random number drawn when the logger started"),
)
_REST_OF_HEADER = (
    WireField("time_utc_ns", "u64", meaning="the same instant in UTC since 1970, 0 while unknown"),
    WireField("utc_accuracy_ns", "u32", meaning="one-sigma accuracy of the UTC time, 0 while unknown"),
    WireField("lateness_us", "u32", meaning="how late after its deadline the scan started"),
)
_WHICH_TABLE = (WireField("table", "u16", meaning="checksum of the channels in this message"),)


def _bytes_for(bits: int) -> int:
    return (bits + 7) // 8


def _channel_fields(channel: Channel) -> list[WireField]:
    bits = _CONVERTER_BITS.get(channel.name)
    if bits is None:
        return [WireField(channel.name, channel.raw_type, 0, channel.meaning)]
    return [
        WireField(f"{channel.name}_{i}", kind, 0, f"{channel.meaning}, part {i}") for i, kind in enumerate(_SPLIT[bits])
    ]


def _limits(channel: Channel) -> tuple[float, float]:
    bits = _CONVERTER_BITS.get(channel.name)
    if bits is None:
        return channel.limits()
    return (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1) if channel.raw_type.startswith("i") else (0, 2**bits - 1)


def _layout(
    msg_id: int, name: str, meaning: str, extra: Sequence[WireField], channels: Sequence[Channel], groups: Sequence[str]
) -> ScanLayout:
    bits = tuple(c for c in channels if c.raw_type == "bit")
    fields = [*_HEADER, *extra, *(f for c in channels if c.raw_type != "bit" for f in _channel_fields(c))]
    listed = ", ".join(groups)
    if groups:
        fields.append(WireField("offset_us", "i16", len(groups), f"read offset of groups {listed}"))
    if bits:
        fields.append(WireField("bits", "u8", _bytes_for(len(bits)), ", ".join(c.name for c in bits)))
    if groups:
        size = _bytes_for(_STATE_BITS * len(groups))
        fields.append(WireField("states", "u8", size, f"sensor state, 3 bits each, of groups {listed}"))
    fields.append(WireField("missing", "u8", _bytes_for(len(channels)), "1: channel has no value; table order"))
    ordered = tuple(sorted(fields, key=lambda f: -_SIZE[f.raw_type]))
    split = {c.name: _CONVERTER_BITS[c.name] for c in channels if c.name in _CONVERTER_BITS}
    split["time_monotonic_ns"] = _TIME_BITS
    limits = {c.name: _limits(c) for c in channels}
    packer = _packer(ordered, channels, bits, split, limits, len(groups))
    unpacker = _unpacker(ordered, channels, bits, split, limits, groups)
    return ScanLayout(msg_id, name, meaning, tuple(channels), tuple(groups), ordered, packer, unpacker)


def _unpacker(
    fields: Sequence[WireField],
    channels: Sequence[Channel],
    bits: Sequence[Channel],
    split: Mapping[str, int],
    limits: Mapping[str, tuple[float, float]],
    groups: Sequence[str],
) -> _Unpacker:
    places, place, codes = {}, 0, []
    for f in fields:
        places[f.name] = place
        as_bytes = f.count and f.raw_type == "u8"
        codes.append(f"{f.count}s" if as_bytes else f"{f.count or ''}{_CODE[f.raw_type]}")
        place += f.count if f.count and not as_bytes else 1
    names = tuple(c.name for c in channels if c.name in places)
    name_places = tuple(places[n] for n in names)
    pieces: dict[str, list[tuple[int, int]]] = {}
    for name, size in split.items():
        widths = [8 * _SIZE[kind] for kind in _SPLIT[size]]
        pieces[name] = [(places[f"{name}_{i}"], sum(widths[:i])) for i in range(len(widths))]
    time = tuple(pieces.pop("time_monotonic_ns"))
    half = {name: 1 << (split[name] - 1) if limits[name][0] < 0 else 0 for name in pieces}
    return _Unpacker(
        codec=struct.Struct("<" + "".join(codes)),
        names=names,
        pick=itemgetter(*name_places)
        if len(name_places) > 1
        else lambda numbers: tuple(numbers[i] for i in name_places),
        split=tuple((name, low, high, shift, half[name]) for name, ((low, _), (high, shift)) in pieces.items()),
        time=time,
        bits=tuple((c.name, i) for i, c in enumerate(bits)),
        channels=tuple((c.name, i) for i, c in enumerate(channels)),
        groups=tuple(groups),
        boot=places["boot"],
        number=places["number"],
        in_bits=places.get("bits", -1),
        missing=places["missing"],
        states=places.get("states", -1),
        offsets=slice(places.get("offset_us", 0), places.get("offset_us", 0) + len(groups)),
        table=places.get("table", -1),
        rest=tuple(places[f.name] for f in _REST_OF_HEADER) if _REST_OF_HEADER[0].name in places else (),
    )


def _packer(
    fields: Sequence[WireField],
    channels: Sequence[Channel],
    bits: Sequence[Channel],
    split: Mapping[str, int],
    limits: Mapping[str, tuple[float, float]],
    groups: int,
) -> _Packer:
    codes = (f"{f.count * _SIZE[f.raw_type]}s" if f.count else _CODE[f.raw_type] for f in fields)
    return _Packer(
        codec=struct.Struct("<" + "".join(codes)),
        pick=itemgetter(*(f.name for f in fields)),
        blank={f.name: bytes(f.count * _SIZE[f.raw_type]) if f.count else 0 for f in fields},
        channels=tuple((1 << i, c.name, c.group, *limits[c.name]) for i, c in enumerate(channels)),
        bits=tuple((1 << i, c.name) for i, c in enumerate(bits)),
        split=tuple(
            (name, n, tuple((f"{name}_{i}", 8 * _SIZE[kind]) for i, kind in enumerate(_SPLIT[n])))
            for name, n in split.items()
        ),
        offsets=struct.Struct(f"<{groups}h"),
    )


@cache
def layouts(channels: tuple[Channel, ...] = CHANNELS) -> Mapping[int, ScanLayout]:
    """The packed scan messages of a channel table, by message id."""
    laboratory_channels = [c for c in channels if c.downlink != "none" and c.package]
    standard_channels = [c for c in channels if c.downlink != "none" and not c.package]
    fast = [c for c in standard_channels if c.downlink == "fast"]
    slow = [c for c in standard_channels if c.downlink == "slow" and c.rate is Rate.SCAN]
    rare = [c for c in standard_channels if c.downlink == "slow" and c.rate is Rate.SLOW]
    # A group's state and offset travel with the most frequent message that has a channel of it.
    groups: list[list[str]] = []
    placed_groups: set[str] = set()
    for part in (fast, slow, rare):
        groups.append(list(dict.fromkeys(c.group for c in part if c.group not in placed_groups)))
        placed_groups.update(groups[-1])
    texts = (
        "One scan: the channels sent at the full downlink rate.",
        "One scan: slowly varying channels and the rest of its header.",
        "One scan: channels renewed less often than scans.",
    )
    standard = (
        _layout(SCAN_FAST_ID, "SCAN_FAST", texts[0], (), fast, groups[0]),
        _layout(SCAN_SLOW_ID, "SCAN_SLOW", texts[1], _REST_OF_HEADER, slow, groups[1]),
        _layout(SCAN_RARE_ID, "SCAN_RARE", texts[2], (), rare, groups[2]),
    )
    laboratory = (_laboratory_layout(laboratory_channels, placed_groups),) if laboratory_channels else ()
    return {layout.msg_id: layout for layout in (*standard, *laboratory)}


def _laboratory_layout(channels: Sequence[Channel], seen: Iterable[str]) -> ScanLayout:
    """SCAN_LABORATORY; UserError when it would be too long for a frame."""
    text = "One scan: the channels that laboratory packages bring."
    groups = list(dict.fromkeys(c.group for c in channels if c.group not in set(seen)))
    layout = _layout(SCAN_LABORATORY_ID, "SCAN_LABORATORY", text, _WHICH_TABLE, channels, groups)
    if layout.size > MAX_LABORATORY_PAYLOAD:
        raise UserError(
            f"the channels of laboratory packages take {layout.size} bytes of a frame, {MAX_LABORATORY_PAYLOAD} at most can be"
            ' sent down; set downlink = "none" for some of them in channels.toml'
        )
    rows = [(c.name, c.group, c.raw_type) for c in channels]
    return replace(layout, table=zlib.crc32(repr(rows).encode()) & 0xFFFF)


def pack_scan(layout: ScanLayout, scan: Scan, boot: int) -> bytes:
    """The payload of one packed message of a scan; never raises for values a Scan can hold."""
    packer = layout.packer
    fields = dict(packer.blank)
    fields["boot"], fields["number"], fields["time_monotonic_ns"] = boot, scan.number, scan.time_monotonic_ns
    unfit = _pack_groups(layout, scan.groups, fields)
    values, missing = scan.values, 0
    for bit, name, group, low, high in packer.channels:
        value = values.get(name)
        if value is None or group in unfit or not low <= value <= high:
            missing |= bit
        else:
            fields[name] = value
    fields["missing"] = missing.to_bytes(_bytes_for(len(packer.channels)), "little")
    if packer.bits:
        word = sum(bit for bit, name in packer.bits if fields.get(name))
        fields["bits"] = word.to_bytes(_bytes_for(len(packer.bits)), "little")
    for name, bits, parts in packer.split:
        word = int(fields.get(name, 0)) % 2**bits
        for part, size in parts:
            fields[part] = word & (1 << size) - 1
            word >>= size
    if layout.msg_id == SCAN_LABORATORY_ID:
        fields["table"] = layout.table
    elif layout.msg_id == SCAN_SLOW_ID:
        fields["time_utc_ns"], fields["utc_accuracy_ns"] = scan.time_utc_ns, scan.utc_accuracy_ns
        fields["lateness_us"] = scan.lateness_us
    return packer.codec.pack(*packer.pick(fields))


def _pack_groups(
    layout: ScanLayout, groups: Mapping[str, GroupStatus], fields: dict[str, RawValue | bytes]
) -> Sequence[str]:
    """Put states and offsets into `fields`; returns the groups whose offset does not fit."""
    if not layout.groups:
        return ()
    states, shift = 0, 0
    offsets, unfit = [], []
    for group in layout.groups:
        status = groups.get(group)
        offset = NOT_IN_SCAN
        if status is not None:
            states |= status.state << shift
            offset = status.offset_us
            if not -_OFFSET_LIMIT <= offset <= _OFFSET_LIMIT:
                offset = UNFIT_OFFSET
                unfit.append(group)
        offsets.append(offset)
        shift += _STATE_BITS
    fields["offset_us"] = layout.packer.offsets.pack(*offsets)
    fields["states"] = states.to_bytes(_bytes_for(shift), "little")
    return unfit


class ScanPart(NamedTuple):
    """What one packed message says about a scan. A tuple, for it is made for each frame that comes down."""

    msg_id: int
    boot: int
    number: int
    time_monotonic_ns: int
    values: Mapping[str, RawValue]
    groups: Mapping[str, GroupStatus]
    time_utc_ns: int = 0
    utc_accuracy_ns: int = 0
    lateness_us: int = 0


def unpack_scan(layout: ScanLayout, payload: bytes) -> ScanPart:
    """The inverse of `pack_scan`; `payload` has its trailing zeros restored.

    Raises ValueError for a payload of the wrong length or mark: a frame made from another channel table.
    """
    u = layout.unpacker  # each line here is done for each frame that comes down: what can be looked up or mapped is
    if len(payload) != u.codec.size:
        raise ValueError(f"{layout.name} payload has {len(payload)} bytes, not {u.codec.size}")
    numbers = u.codec.unpack(payload)
    if u.table >= 0 and numbers[u.table] != layout.table:
        raise ValueError(f"{layout.name} is of another table of laboratory channels")
    values = dict(zip(u.names, u.pick(numbers), strict=True))
    for name, low, high, shift, half in u.split:
        values[name] = ((numbers[low] | numbers[high] << shift) ^ half) - half  # two's complement; half 0: no sign
    time_ns = 0
    for place, shift in u.time:
        time_ns |= numbers[place] << shift
    if u.in_bits >= 0:
        word = int.from_bytes(numbers[u.in_bits], "little")
        for name, bit in u.bits:
            values[name] = word >> bit & 1
    missing = int.from_bytes(numbers[u.missing], "little")
    if missing:
        for name, bit in u.channels:
            if missing >> bit & 1:
                del values[name]
    groups: dict[str, GroupStatus] = {}
    if u.groups:
        word, offsets = int.from_bytes(numbers[u.states], "little"), numbers[u.offsets]
        states = _FOUR_STATES[word & _FOUR]
        while len(states) < len(offsets):
            word >>= 4 * _STATE_BITS
            states += _FOUR_STATES[word & _FOUR]
        pairs = zip(states, offsets, strict=False)
        groups = {g: _new_tuple(GroupStatus, pair) for g, pair in zip(u.groups, pairs, strict=True)}
        if min(offsets) <= UNFIT_OFFSET:
            _mark_unread(groups)
    rest = [numbers[place] for place in u.rest] if u.rest else _NO_REST
    return _new_tuple(ScanPart, (layout.msg_id, numbers[u.boot], numbers[u.number], time_ns, values, groups, *rest))


def _mark_unread(groups: dict[str, GroupStatus]) -> None:
    """Leave out groups that are not in the scan; an offset that did not fit becomes 0."""
    for group, (state, offset) in list(groups.items()):
        if offset == NOT_IN_SCAN:
            del groups[group]
        elif offset == UNFIT_OFFSET:
            groups[group] = GroupStatus(state, 0)


_FOUR = (1 << 4 * _STATE_BITS) - 1
_FOUR_STATES = tuple(states[::-1] for states in product(SensorState, repeat=4))
"""States of four groups by their bits, for it is looked up for each scan."""
_NO_REST = (0, 0, 0)
_new_tuple: Callable[..., Any] = tuple.__new__
"""A named tuple without the function that gives its fields names: a third of the time, for each group of each scan."""


def join_parts(parts: Iterable[ScanPart]) -> Scan:
    """One scan from the parts of it that arrived; all of the same number and boot."""
    first, *later_parts = parts
    if not later_parts and first.msg_id != SCAN_SLOW_ID:
        return Scan(first.number, first.time_monotonic_ns, 0, 0, 0, first.groups, first.values)
    groups: dict[str, GroupStatus] = {}
    values: dict[str, RawValue] = {}
    utc = accuracy = lateness = 0
    for part in (first, *later_parts):
        groups.update(part.groups)
        values.update(part.values)
        if part.msg_id == SCAN_SLOW_ID:
            utc, accuracy, lateness = part.time_utc_ns, part.utc_accuracy_ns, part.lateness_us
    return Scan(first.number, first.time_monotonic_ns, utc, accuracy, lateness, groups, values)
