"""Scans as arrays: one row per scan, one column per raw channel, NaN where a channel has no value.

This is the one place where readings of a sensor group that was not usable in a scan become NaN.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from itertools import islice
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.contract.channel_rows import RAW_LIMITS
from daq.contract.channels import CHANNEL_BY_NAME, CHANNELS, GROUP_NAMES
from daq.contract.scan import Scan
from groundstation.calibration.align import BRIDGED
from groundstation.calibration.schema import CalibrationError

Array = NDArray[np.float64]

_BREAK = 1000  # step of the new scan number at a gap: more than any channel's spacing


@dataclass(frozen=True)
class ScanTable:
    """Raw channels of many scans in order of time.

    number: (N,) scan counter. time: (N,) [s] on the aircraft's clock. raw: channel -> (N,) counts, NaN where absent or
    unusable. physical: the same at data-sheet scale. offset: group -> (N,) time of the group's sample after the scan's [s].
    usable: group -> (N,) whether its sensor worked in the scan (True where the group was not read).
    utc_offset: UTC [s since 1970] minus `time`, and its accuracy [s], from the scan with the best; None without UTC.
    bridged: whether the scans are renumbered by `bridged`.
    """

    number: NDArray[np.int64]
    time: Array
    raw: Mapping[str, Array]
    offset: Mapping[str, Array]
    usable: Mapping[str, NDArray[np.bool_]]
    notes: tuple[str, ...] = ()
    utc_offset: tuple[float, float] | None = None
    bridged: bool = False

    def __len__(self) -> int:
        return int(self.time.size)

    def known_offset(self, group: str) -> Array:
        """(N,) read offset of a group [s]; the group's median in scans without one, 0 without any."""
        offset = self.offset[group]
        missing = np.isnan(offset)
        if not missing.any():
            return offset
        return np.where(missing, 0.0 if missing.all() else float(np.median(offset[~missing])), offset)

    def clipped(self) -> dict[str, int]:
        """Channel -> number of samples at an end of the raw range, of the signed channels that have any."""
        counts = {}
        low, high = RAW_LIMITS["i16"]
        for name, values in self.raw.items():
            if CHANNEL_BY_NAME[name].raw_type == "i16" and CHANNEL_BY_NAME[name].group != "attitude":
                count = int(np.sum((values <= low) | (values >= high)))
                if count:
                    counts[name] = count
        return counts

    def part(self, rows: slice | NDArray[np.bool_]) -> "ScanTable":
        """The table with some of its rows."""

        def part_of(columns: Mapping[str, Any]) -> Mapping[str, Any]:
            return MappingProxyType({name: values[rows] for name, values in columns.items()})

        raw, offset, usable = (part_of(columns) for columns in (self.raw, self.offset, self.usable))
        return replace(self, number=self.number[rows], time=self.time[rows], raw=raw, offset=offset, usable=usable)


def bridged(table: ScanTable) -> ScanTable:
    """The table with new scan numbers, by which scans up to BRIDGED seconds apart are neighbours for the alignment."""
    steps = np.where(np.diff(table.time) <= BRIDGED, 1, _BREAK)
    return replace(table, number=np.concatenate([[0], np.cumsum(steps)]).astype(np.int64), bridged=True)


_UNKNOWN_ACCURACY_NS = 2**32  # 4 s: worse than any stated accuracy
_BLOCK = 4096  # scans converted to columns at a time: as objects they need ten times the memory


def scan_table(scans: Iterable[Scan]) -> ScanTable:
    """The table of `scans`, sorted by time, without repeated scans; notes say so. Raises CalibrationError without a scan."""
    remaining = iter(scans)
    blocks, offsets = [], []
    while block := list(islice(remaining, _BLOCK)):
        blocks.append(_columns(block))
        offsets.append(_utc_offset(block))
    if not blocks:
        raise CalibrationError("no scans in this recording; nothing to calibrate")
    number, time_ns = (np.concatenate([b[i] for b in blocks]) for i in ("number", "time_ns"))
    notes: list[str] = []
    order = np.lexsort((number, time_ns))
    if np.any(order[1:] < order[:-1]):
        notes.append("scans were not in order of time: sorted")
    repeated = np.diff(number[order]) == 0
    repeated &= np.diff(time_ns[order]) == 0
    rows = order[np.concatenate([[True], ~repeated])]
    if rows.size < order.size:
        notes.append(f"{order.size - rows.size} scans came more than once: the first of each kept")
    in_place = rows.size == order.size and not notes

    unmeasured = np.full(rows.size, np.nan)
    unmeasured.flags.writeable = False

    def column(name: str) -> NDArray[Any]:
        """One column of all blocks, removed from them to save memory."""
        if not any(name in b for b in blocks):
            return unmeasured  # the same array for all channels without a value
        parts = [b.pop(name, np.full(b["number"].size, np.nan)) for b in blocks]
        values = np.concatenate(parts) if len(parts) > 1 else parts[0]
        return values if in_place else values[rows]

    return ScanTable(
        number=number if in_place else number[rows],
        time=(time_ns if in_place else time_ns[rows]) * 1e-9,
        raw=MappingProxyType({c.name: column(c.name) for c in CHANNELS}),
        offset=MappingProxyType({g: column(f"{g} offset") for g in GROUP_NAMES}),
        usable=MappingProxyType({g: column(f"{g} usable") for g in GROUP_NAMES}),
        notes=tuple(notes),
        utc_offset=min(filter(None, offsets), key=lambda known: known[1], default=None),
    )


def _utc_offset(scans: list[Scan]) -> tuple[float, float] | None:
    """UTC minus monotonic time, and its accuracy [s], from the most accurate scan; None without UTC."""
    timed = [s for s in scans if s.time_utc_ns > 0]
    if not timed:
        return None
    most_accurate = min(timed, key=lambda s: s.utc_accuracy_ns or _UNKNOWN_ACCURACY_NS)
    accuracy = most_accurate.utc_accuracy_ns or _UNKNOWN_ACCURACY_NS
    return (most_accurate.time_utc_ns - most_accurate.time_monotonic_ns) * 1e-9, accuracy * 1e-9


def _columns(scans: list[Scan]) -> dict[str, NDArray[Any]]:
    """Some scans as columns, without channels and offsets that none of them has."""
    columns: dict[str, NDArray[Any]] = {
        "number": np.array([s.number for s in scans], np.int64),
        "time_ns": np.array([s.time_monotonic_ns for s in scans], np.uint64),
    }
    for g in GROUP_NAMES:
        columns[f"{g} usable"] = np.array([g not in s.groups or s.groups[g].state.usable for s in scans])
        offsets = [s.groups[g].offset_us if g in s.groups else np.nan for s in scans]
        if offsets.count(np.nan) < len(scans):  # count finds the NaN by identity
            columns[f"{g} offset"] = np.array(offsets, float) * 1e-6
    nan = float("nan")
    for channel in CHANNELS:
        readings = [s.values.get(channel.name, nan) for s in scans]
        if readings.count(nan) == len(scans):
            continue
        values = np.array(readings, float)
        columns[channel.name] = np.where(columns[f"{channel.group} usable"], values, np.nan)
    return columns


@dataclass(frozen=True)
class Readings:
    """Physical value of each instrument axis, with its delays.

    values: name -> (N,), SI. group: name -> sensor group. delay: name -> delay [s]. lag: name -> time constant [s] of the
    first-order low pass before the sensor. extrapolated, clipped: instrument or channel -> number of samples.
    """

    values: dict[str, Array]
    group: dict[str, str]
    delay: dict[str, float]
    lag: dict[str, float]
    extrapolated: dict[str, int]
    clipped: dict[str, int]
