"""The gap monitor beside live identification: does what the aircraft file believes, or a model, still describe what is flown?

Its thresholds come from simulated flights, half a minute of processor time, so they are made in a thread; samples wait for them.
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

SEED = 1
HOURS = 2.5  # of simulated manoeuvring behind the thresholds
LOST = 0.05  # of what a radio sends
ON_BOARD_HZ, SLOWER_HZ = 20, 17.0  # scans a second of the logger; from which on below they are taken to come by radio
AT_ONCE = 60  # samples that have waited, worked off at a call


def conditions_at(rate: float) -> NullConditions:
    """What thresholds are simulated for, by the scans a second that come: on board 20 or some more; fewer are what a radio
    delivers of 20."""
    if rate < SLOWER_HZ:
        return NullConditions(rate=rate, loss=LOST)
    grid = watched_step(1.0 / max(ON_BOARD_HZ, round(rate)))
    return NullConditions(rate=1.0 / grid, grid=grid)


class LiveWatch:
    """Give it samples of manoeuvring flight; `alarms` are those told so far. rate: scans a second that come."""

    def __init__(self, aircraft: LiveAircraft, rate: float) -> None:
        self._airframe = aircraft.airframe if aircraft.modelled is None else aircraft.modelled
        self._conditions = conditions_at(rate)
        self._planes = [PLANES[r.name] for r in aircraft.regressions]
        self._monitor: GapMonitors | None = None
        self._waiting: list[Sample] = []
        self._last = -math.inf
        self._shortest = NEARLY * self._conditions.grid if rate * FINEST_S > 1.0 else 0.0
        self._told: list[str] = []  # what each alarm was last said to be
        self.trouble = ""
        self._thread = threading.Thread(target=self._calibrate, name="gap monitor", daemon=True)
        self._thread.start()

    def add(self, sample: Sample) -> None:
        """One sample, in order of time; one that comes sooner after the last than is looked at is left out."""
        if sample.time - self._last >= self._shortest:
            self._last = sample.time
            self._waiting.append(sample)

    def step(self, *, finish: bool = False) -> list[Alarm]:
        """Alarms that are new, or may be something else than was said. finish: wait for the thresholds, and go through all."""
        if finish:
            self._thread.join()
        if self._monitor is None:
            return []
        count = len(self._waiting) if finish else AT_ONCE
        batch, self._waiting = self._waiting[:count], self._waiting[count:]
        for sample in batch:
            self._monitor.add(sample)
        names = [a.leading[0].effect if a.leading else "" for a in self._monitor.alarms]
        told_names = [*self._told, *[None] * (len(names) - len(self._told))]
        news = [
            a for a, name, known_name in zip(self._monitor.alarms, names, told_names, strict=True) if name != known_name
        ]
        self._told = names
        return news

    @property
    def alarms(self) -> tuple[Alarm, ...]:
        """All so far."""
        return () if self._monitor is None else tuple(self._monitor.alarms)

    @property
    def watched(self) -> float:
        """Seconds of manoeuvring that were watched."""
        return 0.0 if self._monitor is None else self._monitor.watched

    def _calibrate(self) -> None:
        try:
            self._monitor = GapMonitors([self._monitor_of(plane) for plane in self._planes])
        except (LinAlgError, ArithmeticError, ValueError) as error:  # an aircraft that does not fly by its beliefs
            self.trouble = f"no gap monitor: its thresholds cannot be simulated from these beliefs ({error})"

    def _monitor_of(self, plane: MonitoredPlane) -> GapMonitor:
        """All planes together have the allowed false alarms."""
        beliefs = {n: b for n, b in self._airframe.beliefs.items() if n in plane.parameters}
        values = {n: b.value for n, b in beliefs.items()}
        effects = bank(values, {n: b.std for n, b in beliefs.items() if b.std > 0.0}, plane)
        rng, each = np.random.default_rng([SEED, len(effects)]), FALSE_ALARMS / len(self._planes)
        calibration = calibrated(
            self._airframe, values, effects, self._conditions, rng=rng, hours=HOURS, rate=each, plane=plane
        )
        return GapMonitor(self._airframe, values, effects, calibration, plane)
