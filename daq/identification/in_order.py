"""The recursive estimator for samples that come late, as by backfill: they are processed in the order of their time.

A late row cannot simply be added to the sums, because the simulated motion of all later rows depends on it. So all samples are
stored, and a copy of the estimator every COPY_EVERY seconds. From the last copy before a late sample all samples are processed
again, a few at each call, while the present estimates stay available. When that is done, the numbers are those of a record
without gaps.
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
"""How late [s] a sample may come; older samples and copies are discarded, so that an hour of flight takes no more memory than a
quarter of an hour. Backfill of what the radio lost comes within a minute or two."""
COPY_EVERY = 30.0  # s between two copies (some 50 kB each)


@dataclass
class _Replay:
    """A copy of the estimator that processes the samples again; `index`: of the next sample."""

    estimator: LiveEstimator
    index: int


class OrderedEstimator:
    """Takes samples in any order of time. A second sample of the same time is ignored."""

    def __init__(self, airframe: Airframe, regression: PlaneRegression = LATERAL) -> None:
        self._airframe = airframe
        self._regression = regression
        self._samples: list[Sample] = []
        self._times: list[float] = []
        self._copies: list[tuple[float, LiveEstimator]] = []  # time of the last sample in it
        self._estimator = LiveEstimator(airframe, regression)
        self._replay: _Replay | None = None
        self._discarded_until = -math.inf  # time up to which samples are in the oldest copy only
        self.too_late = 0

    def add(self, sample: Sample) -> None:
        """Take a sample: one in order of time is processed at once, a late one by `work`."""
        if not math.isfinite(sample.time):
            return
        if sample.time <= self._discarded_until:
            self.too_late += 1
            return
        if not self._times or sample.time > self._times[-1]:
            self._samples.append(sample)
            self._times.append(sample.time)
            self._estimator.add(sample)
            if self._replay is None:
                self._store_copy(sample.time, self._estimator)
                self._discard(sample.time - HORIZON)
            return
        index = bisect_left(self._times, sample.time)
        if self._times[index] == sample.time:
            return
        self._samples.insert(index, sample)
        self._times.insert(index, sample.time)
        if self._replay is None or index < self._replay.index:
            self._begin_replay(sample.time)

    def revise(self, sample: Sample) -> None:
        """Take a sample in place of the one of the same time, if any: a late scan changes its neighbours' aligned values."""
        if sample.time <= self._discarded_until:
            self.too_late += 1
            return
        index = bisect_left(self._times, sample.time)
        if index == len(self._times) or self._times[index] != sample.time:
            self.add(sample)
        elif self._samples[index] != sample and self._any_credible(sample, self._samples[index]):
            self._samples[index] = sample
            if self._replay is None or index < self._replay.index:
                self._begin_replay(sample.time)

    def _any_credible(self, *samples: Sample) -> bool:
        return any(self._regression.credible(sample) for sample in samples)

    @property
    def behind(self) -> int:
        """Samples still to be processed before all late ones are in the estimates; 0 when none waits."""
        return 0 if self._replay is None else len(self._samples) - self._replay.index

    def work(self, most: int = 200) -> bool:
        """Process at most so many samples again; True when every sample is in the estimates."""
        replay = self._replay
        if replay is None:
            return True
        for sample in self._samples[replay.index : replay.index + most]:
            replay.estimator.add(sample)
            replay.index += 1
            self._store_copy(sample.time, replay.estimator)
        if replay.index < len(self._samples):
            return False
        self._estimator, self._replay = replay.estimator, None
        return True

    def estimates(self) -> LiveEstimates:
        """The estimates from all samples processed so far."""
        return self._estimator.estimates()

    @property
    def estimator(self) -> LiveEstimator:
        """The estimator that `estimates` come from; another object after late samples were processed."""
        return self._estimator

    def _begin_replay(self, time: float) -> None:
        """Begin again from the last copy before `time`."""
        self._copies = [c for c in self._copies if c[0] < time]
        if self._copies:
            copy_time, copy = self._copies[-1]
            self._replay = _Replay(deepcopy(copy), bisect_right(self._times, copy_time))
        else:
            self._replay = _Replay(LiveEstimator(self._airframe, self._regression), 0)

    def _store_copy(self, time: float, estimator: LiveEstimator) -> None:
        copy_time = self._copies[-1][0] if self._copies else self._times[0] if self._times else time
        if time - copy_time >= COPY_EVERY:
            self._copies.append((time, deepcopy(estimator)))

    def _discard(self, before: float) -> None:
        """Discard all copies before a time but the last of them, and the samples that this one contains."""
        old_copies = sum(time < before for time, _ in self._copies)
        if old_copies < 2:
            return
        del self._copies[: old_copies - 1]
        self._discarded_until = self._copies[0][0]
        discarded = bisect_right(self._times, self._discarded_until)
        del self._times[:discarded]
        del self._samples[:discarded]
