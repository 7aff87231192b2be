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

LOOK_S = 0.9  # s of flight between two entries of the history: samples come in batches of a second
ADVISE_S = 5.0  # s of flight between two looks for what to fly next: some 20 ms each
REVISE_S = 5.0  # s of flight between two workings-in of late scans: each goes back by up to 30 s
WORK = 15  # late samples worked in at a call, so that the receiver never waits: some 5 ms
PACE_S = 10.0  # s of scans that tell how many come a second
RECENT_S = 10.0  # s over which excitation counts as that of now

TROUBLES = (CalibrationError, LinAlgError, ArithmeticError, ValueError)
"""What numbers from outside can provoke in the arithmetic; told once, and identification rests, nothing else does."""


@dataclass(frozen=True)
class LiveState:
    """Everything that is shown at `time` [s].

    wanted: derivative -> bound to be reached [1/rad]. to_go: derivative -> seconds of manoeuvring as of now until then, 0 when
    there, inf where nothing is gained. excitation: control -> rms movement of the last seconds [rad], as signals. together: pairs
    that are not told apart. late: scans that came late and are not in the numbers yet. point: the test point under way,
    or the last; before: bounds [1/rad] when it began. mass [kg], cg_x [m] ahead of the airframe's CG: as measured in flight,
    NaN where nobody does.
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
    """Call `step` often, `finish` at the end. It never raises for what the numbers are.

    wanted: bound to be reached as a share of a derivative. alignment: filled by the owner with the scans that come; some may be
    there already. stretches: decides what is identified from.
    watched: with the gap monitor beside it, from ten seconds on. trouble: why it rests; empty while it works.
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
        self._begun = math.nan
        self.watch: LiveWatch | None = None
        self._meters = {
            signal: ExcitationMeter(RECENT_S) for r in aircraft.regressions for signal in r.controls.values()
        }
        self._points = PointMeter(tuple(self._meters), aircraft.throws)
        self._bounds_before: dict[str, float] = {}
        self._pace = TimeToBound()
        self._last: Sample | None = None
        self._look_at = self._advise_at = self._revise_at = -math.inf
        self._advice: ManoeuvreAdvice | None = None
        self.state: LiveState | None = None

    def use(self, calibrator: Calibrator) -> None:
        """Another calibration, from the first scan on."""
        self._calibrator = calibrator
        self._alignment.again()
        self._estimators = self._new_estimators()

    def step(self) -> LiveState | None:
        """Work in some of what has come; the state where there is a new one, once a second of flight."""
        if self.trouble:
            return None
        try:
            self._work(finish=False)
            if self._last is None or self._last.time < self._look_at:
                return None
            self._look_at = self._last.time + LOOK_S
            self.state = self._look(self._last)
        except TROUBLES as error:
            self.trouble = f"live identification rests: {error or type(error).__name__}"
            return None
        self.history.add(self.state.time, self.state.estimates)
        return self.state

    def finish(self) -> LiveState | None:
        """Everything that has come into the numbers; the last state."""
        if self.trouble:
            return self.state
        try:
            self._work(finish=True)
            if self._last is not None:
                self.state = self._look(self._last)
                self.history.add(self.state.time, self.state.estimates)
        except TROUBLES as error:
            self.trouble = f"live identification rests: {error or type(error).__name__}"
        return self.state

    def new_alarms(self, *, finish: bool = False) -> list[Alarm]:
        """What the gap monitor has to say since it was last asked. finish: after going through all that has come."""
        return [] if self.watch is None else self.watch.step(finish=finish)

    def _work(self, *, finish: bool) -> None:
        revise = self._last is not None and self._last.time >= self._revise_at and not self._behind
        if revise and self._last is not None:
            self._revise_at = self._last.time + REVISE_S
        airframe = self.aircraft.airframe
        for sample in self._alignment.ready(
            self._calibrator, late=revise, all_of_it=finish, pitch=self._pitch, airframe=airframe
        ):
            if self._last is None or sample.time > self._last.time:
                self._newest(sample)
            for identified in self.stretches.take(sample):
                for estimator in self._estimators:
                    estimator.revise(identified)
                if self.watch is not None:
                    self.watch.add(identified)
        for estimator in self._estimators:
            while not estimator.work(1000 if finish else WORK) and finish:
                pass

    def _new_estimators(self) -> list[OrderedEstimator]:
        return [OrderedEstimator(self.aircraft.airframe, r) for r in self.aircraft.regressions]

    @property
    def _behind(self) -> int:
        return max(e.behind for e in self._estimators)

    def _begin_watch(self, time: float) -> None:
        """Once the pace of the scans is known."""
        if math.isnan(self._begun):
            self._begun = time
        elif time - self._begun >= PACE_S:
            self.watch = LiveWatch(self.aircraft, len(self._alignment) / (time - self._begun))

    def _newest(self, sample: Sample) -> None:
        if self._watched and self.watch is None:
            self._begin_watch(sample.time)
        if any(r.credible(sample) for r in self.aircraft.regressions):
            self._last = sample
            self._points.add(sample)
            for signal, meter in self._meters.items():
                meter.add(sample.time, getattr(sample, signal))

    def _look(self, last: Sample) -> LiveState:
        estimates = joined([e.estimates() for e in self._estimators])
        information = {c: i for e in self._estimators for c, i in e.estimator.information().items()}
        bounds = wanted_bounds(self.aircraft.airframe.beliefs, estimates.derivatives, self._share)
        to_go = self._pace.at(estimates, bounds)
        # Without advice nothing was solved yet, or nothing is left to be done: either may be over by now, and is quickly seen.
        if last.time >= self._advise_at or self._advice is None:
            self._advise_at = last.time + ADVISE_S
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
        derivative = estimates.derivatives[name]
        return derivative.estimate if derivative.told else self.aircraft.airframe.believed(name)
