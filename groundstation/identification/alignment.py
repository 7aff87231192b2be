"""Scans as they come down, brought to one instant each.

Within a scan each sensor is read at an instant of its own and has a delay of its own; left there, the rolling derivatives
come out 15 to 25 % small. Here the calibration of recorded flights works on a sliding window of whatever has come: scans up
to `BRIDGED` seconds apart, the estimator's own longest row, count as neighbours. Of a stretch that came whole the samples
are those of the recorded flight.
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

NEIGHBOURS = 8  # scans to each side that a sample depends on: slopes of rates, undone lags and interpolation together
HELD = 21  # scans before that: slow channels are held for a second at 20 Hz
BATCH_S = 1.0  # s of scans that are calibrated at once: a window costs 10 ms whether one scan of it is new or twenty
BLOCK = 2000  # scans calibrated at once where very many are wanted
MOST, SPARE = 20_000, 1000
"""Scans that are kept, a quarter of an hour at 20 Hz and more: as long as `daq.identification.in_order.HORIZON` works late ones
in. They are dropped by the thousand."""
AT_ONCE = 40  # samples given at a call, so that a backlog is worked off in pieces of some 30 ms


class ScanAlignment:
    """Keeps encoded scans of one run of the logger (some 300 bytes each), and gives the aligned samples of them.

    A late scan changes its neighbours: `ready` gives their samples again. batch_s: seconds of scans that are calibrated at once.
    """

    def __init__(self, batch_s: float = BATCH_S) -> None:
        self._batch = batch_s
        self._scans: dict[int, bytes] = {}
        self._numbers: list[int] = []
        self._done = 0  # scans from the front of which samples were given
        self._oldest = 0  # number before which scans are forgotten
        self._dirty: set[int] = set()  # numbers of late scans among those
        self._loading = [math.nan, math.nan]  # mass [kg], CG ahead [m] as last read: more seldom than scans come
        self._latest = self._worked = -math.inf  # time [s] of the latest scan; what it was when samples were last made

    def __len__(self) -> int:
        return len(self._numbers)

    @property
    def late(self) -> int:
        """Scans that came late and are not in the samples yet."""
        return len(self._dirty)

    def add(self, scan: Scan | bytes) -> None:
        """A scan as received, or in the aircraft's own bytes as fetched; these replace what was received."""
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
        self._forget()

    def _forget(self) -> None:
        """Scans that are worked in and so old that nothing late changes them any more."""
        if len(self._numbers) < MOST + SPARE:
            return
        old_scans = min(len(self._numbers) - MOST, self._done - NEIGHBOURS - HELD)
        if old_scans <= 0:
            return
        for number in self._numbers[:old_scans]:
            del self._scans[number]
        del self._numbers[:old_scans]
        self._done -= old_scans
        self._oldest = self._numbers[0]
        self._dirty = {n for n in self._dirty if n >= self._oldest}

    def again(self) -> None:
        """Give every sample once more: the calibration has changed."""
        self._done, self._worked = 0, -math.inf
        self._dirty.clear()

    def ready(
        self,
        calibrator: Calibrator,
        *,
        late: bool = False,
        all_of_it: bool = False,
        pitch: bool = False,
        airframe: Airframe | None = None,
    ) -> Iterator[Sample]:
        """New samples in order of time, as far as their neighbours are there; then, if asked, those that late scans change.

        late: also these. all_of_it: the last ones too, although none will follow. pitch: with what the pitching plane needs.
        airframe: whose CG may move, with the motion as it is there. Raises CalibrationError.
        """
        available = len(self._numbers) if all_of_it else len(self._numbers) - NEIGHBOURS
        end = available if all_of_it else min(available, self._done + AT_ONCE)
        if end > self._done and (end < available or all_of_it or self._latest - self._worked >= self._batch):
            first, self._done, self._worked = self._done, end, self._latest
            yield from self._samples(first, end, calibrator, pitch, airframe)
        if late or all_of_it:
            for first, last in self._changed():
                yield from self._samples(first, last, calibrator, pitch, airframe)
            self._dirty.clear()

    def _changed(self) -> Iterator[tuple[int, int]]:
        """Ranges of rows among those given that late scans have to do with."""
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
        signals = (*SIGNALS, *PITCH_SIGNALS) if pitch else SIGNALS
        for begin in range(first, last, BLOCK):
            end = min(last, begin + BLOCK)
            low = max(0, begin - NEIGHBOURS - HELD)
            numbers = self._numbers[low : end + NEIGHBOURS]
            table = bridged(scan_table(decode_scan(self._scans[n]) for n in numbers))
            columns, _ = calibrator.columns(table, aligned=True)
            # of sensors of one's own
            mass, cg_x = (_held(columns.get(n), len(table), v) for n, v in zip((MASS, CG), self._loading, strict=True))
            self._loading = [mass[end - low - 1], cg_x[end - low - 1]]
            if airframe is not None and np.isfinite(cg_x).any():
                ahead = np.array([airframe.cg_ahead(value) for value in cg_x.tolist()])
                columns = {**columns, **at_moved_cg(columns, table.time, ahead)}
            rows = np.stack([table.time, *(columns[n] for n in signals), mass, cg_x], axis=1)
            for *row, mass_now, cg_now in rows[begin - low : end - low].tolist():
                yield Sample(*row)._replace(mass=mass_now, cg_x=cg_now)


def _held(values: NDArray[np.float64] | None, size: int, last: float) -> NDArray[np.float64]:
    """What is read more seldom than scans come, the last value until the next; last: the one before these."""
    if values is None:
        return np.full(size, last)
    known = np.maximum.accumulate(np.where(np.isfinite(values), np.arange(1, size + 1), 0))
    return np.asarray(np.concatenate([[last], values])[known])
