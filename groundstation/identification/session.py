"""Live identification of one run of one aircraft's logger: scans in, state and history out."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from numpy.linalg import LinAlgError

from daq.identification.airframe import Sample
from daq.identification.estimates import LiveEstimates, joined
from daq.identification.in_order import OrderedEstimator
from daq.identification.monitor.monitor import Alarm
from daq.identification.movement import ManoeuvreDetector
from daq.identification.next_manoeuvre import ManoeuvreAdvice, next_manoeuvre
from daq.identification.point_quality import FlownPoint, PointMeter
from daq.identification.regression import LiveAircraft
from groundstation.calibration.apply import Calibrator
from groundstation.calibration.schema import CalibrationError
from groundstation.identification.alignment import ScanAlignment
from groundstation.identification.history import LiveHistory
from groundstation.identification.wanted import ExcitationMeter, TimeToBound, Together, together, wanted_bounds
from groundstation.identification.watching import LiveWatch

STATE_S = 0.9  # [s] of flight, at least, between two states: samples come in batches of a second
ADVICE_S = 5.0  # [s] of flight between two searches for the next manoeuvre, of some 20 ms each
REVISION_S = 5.0  # [s] of flight between two revisions by late scans, each of which repeats up to 30 s
SAMPLES_PER_CALL = 15  # late samples processed at a call, in some 5 ms, so that the receiver does not wait
ALL_SAMPLES = 1000  # processed at a call when nothing waits
RATE_S = 10.0  # [s] over which the rate of the scans is measured
RECENT_S = 10.0  # [s] over which excitation is measured: a manoeuvre

TROUBLES = (CalibrationError, LinAlgError, ArithmeticError, ValueError)
"""Errors that received numbers can cause in the arithmetic. They are reported once and stop the identification only."""


@dataclass(frozen=True)
class LiveState:
    """The result of live identification at `time` [s].

    wanted: derivative -> bound to be reached [1/rad]. to_go: derivative -> seconds of flight until then at the present gain of
    information, 0 when reached, inf without gain. excitation: control signal -> rms movement of the last seconds [rad]. together:
    pairs of correlated derivatives. late: number of late scans that are not in the estimates yet. point: the present test point,
    or the last; before: derivative -> std [1/rad] when it began. mass [kg], cg_x [m] ahead of the airframe's CG: as measured in
    flight, else NaN.
    """

    time: float
    aircraft: LiveAircraft
    estimates: LiveEstimates
    wanted: Mapping[str, float]
    to_go: Mapping[str, float]
    excitation: Mapping[str, float]
    together: tuple[Together, ...]
    advice: ManoeuvreAdvice | None
    late: int
    point: FlownPoint | None = None
    before: Mapping[str, float] = field(default_factory=dict)
    mass: float = math.nan
    cg_x: float = math.nan


class LiveIdentification:
    """The live estimator of one run of the logger: call `step` often, `finish` at the end. No received number makes them raise.

    wanted: bound to be reached, as a share of a derivative. alignment: the caller adds received scans to it, also before.
    stretches: selects the samples to identify from. watched: whether the gap monitor runs as well, after RATE_S. trouble: why
    the identification stopped; empty while it runs.
    """

    def __init__(
        self,
        aircraft: LiveAircraft,
        calibrator: Calibrator,
        wanted: float,
        alignment: ScanAlignment,
        stretches: ManoeuvreDetector,
        *,
        watched: bool = False,
    ) -> None:
        self.aircraft = aircraft
        self.trouble = ""
        self.history = LiveHistory(aircraft.derivatives)
        self._pitch = any("alpha" in r.states for r in aircraft.regressions)
        self._calibrator = calibrator
        self._alignment = alignment
        self.stretches = stretches
        self._estimators = self._new_estimators()
        self._share = wanted
        self._watched = watched
        self._first_time = math.nan
        self.watch: LiveWatch | None = None
        self._meters = {
            signal: ExcitationMeter(RECENT_S) for r in aircraft.regressions for signal in r.controls.values()
        }
        self._points = PointMeter(tuple(self._meters), aircraft.throws)
        self._bounds_before: dict[str, float] = {}
        self._time_to_bound = TimeToBound()
        self._last: Sample | None = None
        self._next_state = self._next_advice = self._next_revision = -math.inf
        self._advice: ManoeuvreAdvice | None = None
        self.state: LiveState | None = None

    def use(self, calibrator: Calibrator) -> None:
        """Take another calibration, and repeat the identification from the first scan on."""
        self._calibrator = calibrator
        self._alignment.restart()
        self._estimators = self._new_estimators()

    def step(self) -> LiveState | None:
        """Process some of the received scans; returns a new state about once a second of flight, else None."""
        if self.trouble:
            return None
        try:
            self._process(finish=False)
            if self._last is None or self._last.time < self._next_state:
                return None
            self._next_state = self._last.time + STATE_S
            self.state = self._new_state(self._last)
        except TROUBLES as error:
            self._stop(error)
            return None
        self.history.add(self.state.time, self.state.estimates)
        return self.state

    def finish(self) -> LiveState | None:
        """Process all received scans; returns the last state."""
        if self.trouble:
            return self.state
        try:
            self._process(finish=True)
            if self._last is not None:
                self.state = self._new_state(self._last)
                self.history.add(self.state.time, self.state.estimates)
        except TROUBLES as error:
            self._stop(error)
        return self.state

    def _stop(self, error: Exception) -> None:
        self.trouble = f"live identification rests: {error or type(error).__name__}"

    def new_alarms(self, *, finish: bool = False) -> list[Alarm]:
        """Alarms of the gap monitor that are new since the last call. finish: process all samples first."""
        return [] if self.watch is None else self.watch.step(finish=finish)

    def _process(self, *, finish: bool) -> None:
        """Pass new samples to the estimators; also those that late scans change, from time to time. finish: all of them."""
        revise = self._last is not None and self._last.time >= self._next_revision and not self._behind
        if revise and self._last is not None:
            self._next_revision = self._last.time + REVISION_S
        airframe = self.aircraft.airframe
        for sample in self._alignment.ready(
            self._calibrator, late=revise, finish=finish, pitch=self._pitch, airframe=airframe
        ):
            if self._last is None or sample.time > self._last.time:
                self._add_newest(sample)
            for identified in self.stretches.take(sample):
                for estimator in self._estimators:
                    estimator.revise(identified)
                if self.watch is not None:
                    self.watch.add(identified)
        for estimator in self._estimators:
            while not estimator.work(ALL_SAMPLES if finish else SAMPLES_PER_CALL) and finish:
                pass

    def _new_estimators(self) -> list[OrderedEstimator]:
        return [OrderedEstimator(self.aircraft.airframe, r) for r in self.aircraft.regressions]

    @property
    def _behind(self) -> int:
        """Samples that the slower of the estimators has not processed yet."""
        return max(e.behind for e in self._estimators)

    def _begin_watch(self, time: float) -> None:
        """Start the gap monitor once the rate of the scans is known."""
        if math.isnan(self._first_time):
            self._first_time = time
        elif time - self._first_time >= RATE_S:
            self.watch = LiveWatch(self.aircraft, len(self._alignment) / (time - self._first_time))

    def _add_newest(self, sample: Sample) -> None:
        """Count a sample that is later than all before it for excitation and test points."""
        if self._watched and self.watch is None:
            self._begin_watch(sample.time)
        if any(r.credible(sample) for r in self.aircraft.regressions):
            self._last = sample
            self._points.add(sample)
            for signal, meter in self._meters.items():
                meter.add(sample.time, getattr(sample, signal))

    def _new_state(self, last: Sample) -> LiveState:
        estimates = joined([e.estimates() for e in self._estimators])
        information = {c: i for e in self._estimators for c, i in e.estimator.information().items()}
        bounds = wanted_bounds(self.aircraft.airframe.beliefs, estimates.derivatives, self._share)
        to_go = self._time_to_bound.at(estimates, bounds)
        # without advice there was no solution yet, or all bounds were reached; both are quick to check again
        if last.time >= self._next_advice or self._advice is None:
            self._next_advice = last.time + ADVICE_S
            values = {n: self._value(n, estimates) for n in self.aircraft.derivatives}
            advice = [
                next_manoeuvre(self.aircraft.airframe, values, information, bounds, last, r)
                for r in self.aircraft.regressions
            ]
            self._advice = max((a for a in advice if a is not None), key=lambda a: a.now, default=None)
        point = self._points.point
        if point is not None and (
            self.state is None or self.state.point is None or self.state.point.begin != point.begin
        ):
            derivatives = {} if self.state is None else self.state.estimates.derivatives
            self._bounds_before = {n: d.std for n, d in derivatives.items()}
        return LiveState(
            last.time,
            self.aircraft,
            estimates,
            bounds,
            to_go,
            {signal: meter.rms for signal, meter in self._meters.items()},
            together(information),
            self._advice,
            self._alignment.late + self._behind,
            point,
            self._bounds_before,
            last.mass,
            last.cg_x,
        )

    def _value(self, name: str, estimates: LiveEstimates) -> float:
        """The estimate of a derivative, or the prior belief where it is not identified."""
        derivative = estimates.derivatives[name]
        return derivative.estimate if derivative.told else self.aircraft.airframe.believed(name)
