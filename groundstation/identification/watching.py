"""The gap monitor of live identification: whether the beliefs of the aircraft file, or a model, still describe the flight.

Its thresholds are calibrated by simulated flights in a thread, which takes half a minute of processor time; samples wait for it.
"""

import math
import threading

import numpy as np
from numpy.linalg import LinAlgError

from daq.identification.airframe import Sample
from daq.identification.monitor import FALSE_ALARMS
from daq.identification.monitor.bank import PLANES, MonitoredPlane, bank
from daq.identification.monitor.monitor import Alarm, GapMonitor, GapMonitors
from daq.identification.monitor.nulls import FINEST_S, NEARLY, NullConditions, watched_step
from daq.identification.monitor.threshold import calibrated
from daq.identification.regression import LiveAircraft

SEED = 1  # of the simulated flights, so that thresholds repeat
HOURS = 2.5  # of simulated manoeuvring, from which the thresholds are calibrated
LOST = 0.05  # share of scans that a radio loses
ON_BOARD_HZ, SLOWER_HZ = 20, 17.0  # smallest rate of the logger's scans; below the second the scans come by radio
SAMPLES_PER_CALL = 60  # processed at a call, so that the receiver does not wait


def conditions_at(rate: float) -> NullConditions:
    """Conditions of the simulated flights for a rate of scans [Hz]: below SLOWER_HZ those of a radio that loses scans."""
    if rate < SLOWER_HZ:
        return NullConditions(rate=rate, loss=LOST)
    grid = watched_step(1.0 / max(ON_BOARD_HZ, round(rate)))
    return NullConditions(rate=1.0 / grid, grid=grid)


class LiveWatch:
    """The gap monitor over samples of manoeuvring flight. rate: of the scans [Hz]. trouble: why there is no monitor, or empty."""

    def __init__(self, aircraft: LiveAircraft, rate: float) -> None:
        self._airframe = aircraft.airframe if aircraft.modelled is None else aircraft.modelled
        self._conditions = conditions_at(rate)
        self._planes = [PLANES[r.name] for r in aircraft.regressions]
        self._monitor: GapMonitors | None = None
        self._waiting: list[Sample] = []
        self._last = -math.inf
        self._shortest = NEARLY * self._conditions.grid if rate * FINEST_S > 1.0 else 0.0
        self._reported: list[str] = []  # effect with which each alarm was last reported
        self.trouble = ""
        self._thread = threading.Thread(target=self._calibrate, name="gap monitor", daemon=True)
        self._thread.start()

    def add(self, sample: Sample) -> None:
        """Add a sample, in order of time; one that follows within the monitor's step is left out."""
        if sample.time - self._last >= self._shortest:
            self._last = sample.time
            self._waiting.append(sample)

    def step(self, *, finish: bool = False) -> list[Alarm]:
        """Process some samples; returns alarms that are new or have another leading effect than reported before. finish: wait for
        the thresholds, and process all."""
        if finish:
            self._thread.join()
        if self._monitor is None:
            return []
        count = len(self._waiting) if finish else SAMPLES_PER_CALL
        batch, self._waiting = self._waiting[:count], self._waiting[count:]
        for sample in batch:
            self._monitor.add(sample)
        names = [a.leading[0].effect if a.leading else "" for a in self._monitor.alarms]
        reported = [*self._reported, *[None] * (len(names) - len(self._reported))]
        new = [a for a, name, previous in zip(self._monitor.alarms, names, reported, strict=True) if name != previous]
        self._reported = names
        return new

    @property
    def alarms(self) -> tuple[Alarm, ...]:
        """All alarms so far."""
        return () if self._monitor is None else tuple(self._monitor.alarms)

    @property
    def watched(self) -> float:
        """Time of manoeuvring that was monitored [s]."""
        return 0.0 if self._monitor is None else self._monitor.watched

    def _calibrate(self) -> None:
        """Simulate the thresholds and start the monitor (in the thread)."""
        try:
            self._monitor = GapMonitors([self._monitor_of(plane) for plane in self._planes])
        except (LinAlgError, ArithmeticError, ValueError) as error:  # by these beliefs the aircraft cannot fly
            self.trouble = f"no gap monitor: its thresholds cannot be simulated from these beliefs ({error})"

    def _monitor_of(self, plane: MonitoredPlane) -> GapMonitor:
        """The monitor of one plane; the allowed rate of false alarms is divided among the planes."""
        beliefs = {n: b for n, b in self._airframe.beliefs.items() if n in plane.parameters}
        values = {n: b.value for n, b in beliefs.items()}
        effects = bank(values, {n: b.std for n, b in beliefs.items() if b.std > 0.0}, plane)
        rng, rate = np.random.default_rng([SEED, len(effects)]), FALSE_ALARMS / len(self._planes)
        calibration = calibrated(
            self._airframe, values, effects, self._conditions, rng=rng, hours=HOURS, rate=rate, plane=plane
        )
        return GapMonitor(self._airframe, values, effects, calibration, plane)
