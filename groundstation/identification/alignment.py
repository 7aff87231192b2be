"""Aligned samples from scans as they are received.

Within a scan each sensor is read at a different instant and has a different delay; without alignment the rolling derivatives are
15 to 25 % too small. The calibration of recorded flights is applied to a sliding window of received scans. Scans up to `BRIDGED`
seconds apart, the longest interval of the estimator, count as neighbours. Without losses the samples equal those of the recorded
flight.
"""

import math
from bisect import bisect_left, bisect_right, insort
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from daq.contract.scan import Scan, decode_scan, encode_scan
from daq.identification.airframe import CG, MASS, PITCH_SIGNALS, SIGNALS, Airframe, Sample
from daq.identification.moved_cg import at_moved_cg
from groundstation.calibration.apply import Calibrator
from groundstation.calibration.scan_table import bridged, scan_table

NEIGHBOURS = 8  # scans on each side that affect a sample, by derivatives of rates, corrected lags and interpolation
HELD_SCANS = 21  # scans before those: slow channels are held for a second at 20 Hz
BATCH_S = 1.0  # [s] of scans that are calibrated together: a window takes 10 ms for one new scan or for twenty
BLOCK = 2000  # scans calibrated together at most
MOST_SCANS, SPARE_SCANS = 20_000, 1000
"""Scans in memory, over a quarter of an hour at 20 Hz: `daq.identification.in_order.HORIZON`, within which late ones change
estimates. The oldest are dropped by the thousand."""
SAMPLES_PER_CALL = 40  # so that a backlog is processed in pieces of some 30 ms


class ScanAlignment:
    """Stores the encoded scans of one run of the logger (some 300 bytes each), and yields their aligned samples.

    A late scan changes the samples next to it, which `ready` then yields again. batch_s: [s] of scans calibrated at once.
    """

    def __init__(self, batch_s: float = BATCH_S) -> None:
        self._batch = batch_s
        self._scans: dict[int, bytes] = {}
        self._numbers: list[int] = []
        self._done = 0  # number of scans, from the first, that were yielded as samples
        self._oldest = 0  # scan number below which scans were dropped
        self._dirty: set[int] = set()  # numbers of late scans among the yielded ones
        self._loading = [math.nan, math.nan]  # last mass [kg] and CG ahead [m], which are read less often than scans
        self._latest = self._batch_at = -math.inf  # time [s] of the latest scan, and its value at the last batch

    def __len__(self) -> int:
        return len(self._numbers)

    @property
    def late(self) -> int:
        """Number of late scans that are not in the samples yet."""
        return len(self._dirty)

    def add(self, scan: Scan | bytes) -> None:
        """Add a received scan, or the bytes of a recorded one from backfill, which replaces the received one."""
        decoded = decode_scan(scan) if isinstance(scan, bytes) else scan
        data = scan if isinstance(scan, bytes) else encode_scan(scan)
        previous = self._scans.get(decoded.number)
        if previous == data or decoded.number < self._oldest:
            return
        self._scans[decoded.number] = data
        if previous is None:
            index = bisect_right(self._numbers, decoded.number)
            insort(self._numbers, decoded.number)
            if index < self._done:
                self._done += 1
                self._dirty.add(decoded.number)
        elif bisect_left(self._numbers, decoded.number) < self._done:
            self._dirty.add(decoded.number)
        self._latest = max(self._latest, decoded.time)
        self._drop_old()

    def _drop_old(self) -> None:
        """Drop scans that were yielded and are too old for late ones to change."""
        if len(self._numbers) < MOST_SCANS + SPARE_SCANS:
            return
        old_scans = min(len(self._numbers) - MOST_SCANS, self._done - NEIGHBOURS - HELD_SCANS)
        if old_scans <= 0:
            return
        for number in self._numbers[:old_scans]:
            del self._scans[number]
        del self._numbers[:old_scans]
        self._done -= old_scans
        self._oldest = self._numbers[0]
        self._dirty = {n for n in self._dirty if n >= self._oldest}

    def restart(self) -> None:
        """Yield every sample again, since the calibration has changed."""
        self._done, self._batch_at = 0, -math.inf
        self._dirty.clear()

    def ready(
        self,
        calibrator: Calibrator,
        *,
        late: bool = False,
        finish: bool = False,
        pitch: bool = False,
        airframe: Airframe | None = None,
    ) -> Iterator[Sample]:
        """New samples in order of time, once NEIGHBOURS scans follow them; then, with `late`, those that late scans change.

        finish: also the last samples and those that late scans change. pitch: with the signals of the pitching plane. airframe:
        refers samples to its moving CG, where that is measured. Raises CalibrationError.
        """
        available = len(self._numbers) if finish else len(self._numbers) - NEIGHBOURS
        end = available if finish else min(available, self._done + SAMPLES_PER_CALL)
        if end > self._done and (end < available or finish or self._latest - self._batch_at >= self._batch):
            first, self._done, self._batch_at = self._done, end, self._latest
            yield from self._samples(first, end, calibrator, pitch, airframe)
        if late or finish:
            for first, last in self._changed():
                yield from self._samples(first, last, calibrator, pitch, airframe)
            self._dirty.clear()

    def _changed(self) -> Iterator[tuple[int, int]]:
        """Ranges [first, last) of yielded scans whose samples late ones change."""
        ranges: list[tuple[int, int]] = []
        for number in sorted(self._dirty):
            index = bisect_left(self._numbers, number)
            first, last = max(0, index - NEIGHBOURS), min(self._done, index + NEIGHBOURS + 1)
            if ranges and first <= ranges[-1][1]:
                ranges[-1] = (ranges[-1][0], last)
            else:
                ranges.append((first, last))
        yield from ranges

    def _samples(
        self, first: int, last: int, calibrator: Calibrator, pitch: bool, airframe: Airframe | None
    ) -> Iterator[Sample]:
        """The samples of the stored scans [first, last)."""
        signals = (*SIGNALS, *PITCH_SIGNALS) if pitch else SIGNALS
        for begin in range(first, last, BLOCK):
            end = min(last, begin + BLOCK)
            low = max(0, begin - NEIGHBOURS - HELD_SCANS)
            numbers = self._numbers[low : end + NEIGHBOURS]
            table = bridged(scan_table(decode_scan(self._scans[n]) for n in numbers))
            columns, _ = calibrator.columns(table, aligned=True)
            # mass and CG are channels of additional sensors, which few aircraft have
            mass, cg_x = (_held(columns.get(n), len(table), v) for n, v in zip((MASS, CG), self._loading, strict=True))
            self._loading = [mass[end - low - 1], cg_x[end - low - 1]]
            if airframe is not None and np.isfinite(cg_x).any():
                ahead = np.array([airframe.cg_ahead(value) for value in cg_x.tolist()])
                columns = {**columns, **at_moved_cg(columns, table.time, ahead)}
            rows = np.stack([table.time, *(columns[n] for n in signals), mass, cg_x], axis=1)
            for *row, mass_now, cg_now in rows[begin - low : end - low].tolist():
                yield Sample(*row)._replace(mass=mass_now, cg_x=cg_now)


def _held(values: NDArray[np.float64] | None, size: int, last: float) -> NDArray[np.float64]:
    """(size,) a slow channel with its last value held until the next. last: value before the first; values: None without it."""
    if values is None:
        return np.full(size, last)
    known = np.maximum.accumulate(np.where(np.isfinite(values), np.arange(1, size + 1), 0))
    return np.asarray(np.concatenate([[last], values])[known])
