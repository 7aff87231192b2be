"""Scans as arrays: one row per scan, one column per raw channel, NaN where a channel has no value.

This is the only door through which an unusable reading becomes "not measured": a value of a sensor group that was not
in order in that scan is NaN from here on.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from daq.contract.channels import CHANNELS, GROUP_NAMES
from daq.contract.scan import Scan
from groundstation.calibration.errors import CalibrationError

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ScanTable:
    """Raw channels of many scans in order of time.

    number: (N,) scan counter. time: (N,) [s] on the aircraft's clock. raw: channel -> (N,) counts, NaN where absent or
    unusable. physical: the same at data-sheet scale. offset: group -> (N,) time of the group's sample after the scan's [s].
    usable: group -> (N,) whether its sensor was in order in the scan (a group not read in a scan counts as in order).
    utc_offset: UTC [s since 1970] minus `time` and its accuracy [s], from the scan that knew it best; None: never known.
    """

    number: NDArray[np.int64]
    time: Array
    raw: Mapping[str, Array]
    offset: Mapping[str, Array]
    usable: Mapping[str, NDArray[np.bool_]]
    notes: tuple[str, ...] = ()
    utc_offset: tuple[float, float] | None = None

    def __len__(self) -> int:
        return int(self.time.size)

    def part(self, rows: slice | NDArray[np.bool_]) -> "ScanTable":
        """A range of rows."""
        return ScanTable(
            self.number[rows],
            self.time[rows],
            MappingProxyType({k: v[rows] for k, v in self.raw.items()}),
            MappingProxyType({k: v[rows] for k, v in self.offset.items()}),
            MappingProxyType({k: v[rows] for k, v in self.usable.items()}),
            self.notes,
            self.utc_offset,
        )


def scan_table(scans: Iterable[Scan]) -> ScanTable:
    """The table of `scans`, sorted by time; a scan number that comes again is dropped and counted.

    Raises CalibrationError when there is no scan.
    """
    rows = list(scans)
    if not rows:
        raise CalibrationError("no scans in this recording; nothing to calibrate")
    notes: list[str] = []
    ordered = sorted(rows, key=lambda s: (s.time_monotonic_ns, s.number))
    if any(a is not b for a, b in zip(rows, ordered, strict=True)):
        notes.append("scans were not in order of time: sorted")
    kept: list[Scan] = []
    seen: set[tuple[int, int]] = set()
    for scan in ordered:
        key = (scan.number, scan.time_monotonic_ns)
        if key not in seen:
            seen.add(key)
            kept.append(scan)
    if len(kept) < len(ordered):
        notes.append(f"{len(ordered) - len(kept)} scans came more than once: the first of each kept")
    return _columns(kept, notes)


def _columns(scans: list[Scan], notes: list[str]) -> ScanTable:
    usable = {g: np.array([g not in s.groups or s.groups[g].state.usable for s in scans]) for g in GROUP_NAMES}
    offset = {
        g: np.array([s.groups[g].offset_us if g in s.groups else np.nan for s in scans], float) * 1e-6
        for g in GROUP_NAMES
    }
    nan = float("nan")
    raw = {}
    for channel in CHANNELS:
        name = channel.name
        values = np.array([s.values.get(name, nan) for s in scans], float)
        raw[name] = np.where(usable[channel.group], values, np.nan)
    return ScanTable(
        number=np.array([s.number for s in scans], np.int64),
        time=np.array([s.time_monotonic_ns * 1e-9 for s in scans]),
        raw=MappingProxyType(raw),
        offset=MappingProxyType(offset),
        usable=MappingProxyType(usable),
        notes=tuple(notes),
        utc_offset=_utc_offset(scans),
    )


def _utc_offset(scans: list[Scan]) -> tuple[float, float] | None:
    known = [s for s in scans if s.time_utc_ns > 0]
    if not known:
        return None
    best = min(known, key=lambda s: s.utc_accuracy_ns or 2**32)  # 0: accuracy unknown
    return (best.time_utc_ns - best.time_monotonic_ns) * 1e-9, best.utc_accuracy_ns * 1e-9
