"""The recursive estimator where scans come late: what a backfill brings is put where it belongs.

Sums cannot take a row in between, because the simulated motion runs through it. So samples are kept, and a copy of the
estimator at every so many seconds; late ones are worked in from the last copy before them, a few at a time, while the present
answer goes on with what it has. When all is worked in, the numbers are those of a record without gaps.
"""

import math
from bisect import bisect_left, bisect_right
from copy import deepcopy
from dataclasses import dataclass

from daq.identification.airframe import Airframe, Sample
from daq.identification.estimates import LiveEstimates
from daq.identification.live import LiveEstimator
from daq.identification.regression import LATERAL, PlaneRegression

HORIZON = 900.0
"""How late [s] a sample may come and still be worked in; samples and copies older than that are forgotten, so that an hour of
flight takes no more memory than a quarter of it. Backfill of what the radio lost comes within a minute or two."""
COPY_EVERY = 30.0  # s between two kept copies (some 50 kB each)


@dataclass
class _Rework:
    """A copy of the estimator on its way through the samples; `at`: index of the next."""

    estimator: LiveEstimator
    at: int


class OrderedEstimator:
    """Takes samples in any order of time. A second one of the same time is ignored: the first that came is the record."""

    def __init__(self, airframe: Airframe, regression: PlaneRegression = LATERAL) -> None:
        self._airframe = airframe
        self._regression = regression
        self._samples: list[Sample] = []
        self._times: list[float] = []
        self._copies: list[tuple[float, LiveEstimator]] = []  # time of the last sample in it
        self._estimator = LiveEstimator(airframe, regression)
        self._rework: _Rework | None = None
        self._forgotten = -math.inf  # time up to which samples are in the oldest copy only
        self.too_late = 0

    def add(self, sample: Sample) -> None:
        """One sample; in order it counts at once, late it waits for `work`."""
        if not math.isfinite(sample.time):
            return
        if sample.time <= self._forgotten:
            self.too_late += 1
            return
        if not self._times or sample.time > self._times[-1]:
            self._samples.append(sample)
            self._times.append(sample.time)
            self._estimator.add(sample)
            if self._rework is None:
                self._keep_copy(sample.time, self._estimator)
                self._forget(sample.time - HORIZON)
            return
        index = bisect_left(self._times, sample.time)
        if self._times[index] == sample.time:
            return
        self._samples.insert(index, sample)
        self._times.insert(index, sample.time)
        if self._rework is None or index < self._rework.at:
            self._go_back(sample.time)

    def revise(self, sample: Sample) -> None:
        """One sample, in place of that of the same time if there is one: a late scan changes what its neighbours measured."""
        if sample.time <= self._forgotten:
            self.too_late += 1
            return
        index = bisect_left(self._times, sample.time)
        if index == len(self._times) or self._times[index] != sample.time:
            self.add(sample)
        elif self._samples[index] != sample and self._matters(sample, self._samples[index]):
            self._samples[index] = sample
            if self._rework is None or index < self._rework.at:
                self._go_back(sample.time)

    def _matters(self, *samples: Sample) -> bool:
        return any(self._regression.credible(sample) for sample in samples)

    @property
    def behind(self) -> int:
        """Samples still to be gone through before late ones are in the numbers; 0 when all is in order."""
        return 0 if self._rework is None else len(self._samples) - self._rework.at

    def work(self, most: int = 200) -> bool:
        """Go through at most so many samples of what came late; True when everything is in the numbers."""
        rework = self._rework
        if rework is None:
            return True
        for sample in self._samples[rework.at : rework.at + most]:
            rework.estimator.add(sample)
            rework.at += 1
            self._keep_copy(sample.time, rework.estimator)
        if rework.at < len(self._samples):
            return False
        self._estimator, self._rework = rework.estimator, None
        return True

    def estimates(self) -> LiveEstimates:
        """As far as worked in."""
        return self._estimator.estimates()

    @property
    def estimator(self) -> LiveEstimator:
        """The estimator that holds what is worked in; another one after late samples were."""
        return self._estimator

    def _go_back(self, time: float) -> None:
        """Begin to work in what came late at `time` from the last copy before it."""
        self._copies = [c for c in self._copies if c[0] < time]
        if self._copies:
            copy_time, copy = self._copies[-1]
            self._rework = _Rework(deepcopy(copy), bisect_right(self._times, copy_time))
        else:
            self._rework = _Rework(LiveEstimator(self._airframe, self._regression), 0)

    def _keep_copy(self, time: float, estimator: LiveEstimator) -> None:
        copy_time = self._copies[-1][0] if self._copies else self._times[0] if self._times else time
        if time - copy_time >= COPY_EVERY:
            self._copies.append((time, deepcopy(estimator)))

    def _forget(self, before: float) -> None:
        """Drop copies that a later one replaces, and the samples that are in the oldest copy left."""
        old_copies = sum(time < before for time, _ in self._copies)
        if old_copies < 2:
            return
        del self._copies[: old_copies - 1]
        self._forgotten = self._copies[0][0]
        forgotten_samples = bisect_right(self._times, self._forgotten)
        del self._times[:forgotten_samples]
        del self._samples[:forgotten_samples]
