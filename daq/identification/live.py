"""The recursive estimator: takes scans and returns, at any time, derivatives with their bounds."""

import math
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from daq.identification.airframe import Airframe, Sample
from daq.identification.estimates import EquationInformation, LiveDerivative, LiveEstimates, joined, useful_bound
from daq.identification.movement import ControlSignal
from daq.identification.regression import LATERAL, Equation, PlaneRegression
from daq.identification.rows import RowMaker
from daq.identification.simulated_motion import DENSE, SteadiedVane, simulation_of
from daq.identification.solve import Block, RegressionSolution, Sums, solve

Array = NDArray[np.float64]

BLOCK = 30.0  # s over which the constants of the equations are assumed not to change
GAP = 1.0  # s without a complete scan after which a new stretch begins
SLOWEST = 3.0  # m/s; at lower airspeeds non-dimensional rates are meaningless
MOVE_IT = "move it on purpose (doublet or 3-2-1-1)"
NONE_MOVED = "no control has moved yet"
SHAPE, SHAPE_NO_LAG = 0.035, 0.05
"""Relative error of a derivative of a moment due to the unknown motion of the surfaces between scans 0.1 s apart, with known and
unknown lag of the servos; it grows with the square of the interval. From simulations without noise."""
LEARN = 1.0  # s between two updates of the derivatives with which the instruments are simulated


class LiveEstimator:
    """Estimates the derivatives of a regression from calibrated scans in order of time, at any interval, with gaps.

    Every scan takes the same time, however long the flight. Not thread safe. scans: how many were added; skipped: those not used,
    because a value was missing or implausible, time did not advance, or the airspeed was below SLOWEST.
    """

    def __init__(self, airframe: Airframe, regression: PlaneRegression = LATERAL) -> None:
        self._airframe = airframe
        self._regression = regression
        self._motion = simulation_of(regression, airframe)
        self._vane = SteadiedVane(airframe, dict(self._motion.values)) if "alpha" in regression.states else None
        self._rows = RowMaker(airframe, self._motion, regression)
        self._controls = {c: ControlSignal() for c in regression.controls}
        self._closed = Sums.empty(regression.width, regression.total, regression.lags)
        self._block = Block(regression)
        self._block_start = math.nan
        self._last = -math.inf
        self._learn_at = -math.inf
        self._levels = [np.zeros(regression.total)]
        self._time, self._intervals = 0.0, 0  # sum and number of the intervals between scans of one stretch
        self.scans = 0
        self.skipped = 0

    def restart(self) -> None:
        """Begin a new stretch at any time, without continuity with the last scan; the estimates so far stay."""
        for steadied in [] if self._vane is None else self._vane.restart():
            self._add_row(steadied)
        self._close_block()
        self._interrupt()
        self._levels.append(np.zeros(self._regression.total))
        self._last = self._learn_at = -math.inf

    def add(self, sample: Sample) -> None:
        """Add a scan; one that cannot be used is counted in `skipped`."""
        self.scans += 1
        if not self._regression.credible(sample) or sample.V < SLOWEST or sample.time <= self._last:
            self.skipped += 1
            return
        if sample.time - self._last > GAP and math.isfinite(self._last):
            self.restart()
        if math.isfinite(self._last):
            self._time += sample.time - self._last
            self._intervals += 1
        self._last = sample.time
        self._add_sample(sample)
        if sample.time >= self._learn_at:
            self._learn_at = sample.time + LEARN
            self._learn()

    def _add_sample(self, sample: Sample) -> None:
        for steadied in [sample] if self._vane is None else self._vane.add(sample):
            self._add_row(steadied)

    def _add_row(self, sample: Sample) -> None:
        signals = self._regression.controls
        surfaces = tuple(control.add(getattr(sample, signals[c])) for c, control in self._controls.items())
        row = self._rows.add(sample, surfaces)
        if row is None:
            if not self._rows.partial:
                self._block.interrupt()
            return
        if not row.time - self._block_start <= BLOCK:
            self._close_block()
            self._block_start = row.time
        self._block.add(row)

    def _interrupt(self) -> None:
        self._rows.restart()
        self._block.interrupt()
        for control in self._controls.values():
            control.restart()

    def _close_block(self) -> None:
        self._closed = self._closed.plus(self._block.sums.without_constant())
        self._levels[-1] += self._block.sums.cross[0]
        self._block = Block(self._regression)
        self._block_start = math.nan

    # ------------------------------------------------------------------------------------------------ answers

    @property
    def still(self) -> tuple[str, ...]:
        """Controls that have not moved yet, by the names of their signals."""
        return tuple(self._regression.controls[c] for c, signal in self._controls.items() if not signal.moved)

    @property
    def stretches(self) -> int:
        """Number of the present stretch: how often `restart` was called."""
        return len(self._levels) - 1

    def information(self) -> dict[str, "EquationInformation"]:
        """Coefficient -> information on its derivatives so far, for each equation that can be solved."""
        sums = self._sums()
        information = {}
        for coefficient, solution in self._solved().items():
            if solution is not None:
                columns = list(solution.columns)
                normal = sums.instruments[0][np.ix_(columns, columns)]
                information[coefficient] = EquationInformation(
                    solution.names, solution.columns, normal, solution.covariance
                )
        return information

    def solutions(self) -> dict[str, RegressionSolution | None]:
        """Coefficient -> the solution of its equation, None where the scans so far do not identify it."""
        share = self._between_scans
        return {
            c: solution
            if solution is None or not share or c in self._regression.forces_only
            else solution.widened(share)
            for c, solution in self._solved().items()
        }

    @property
    def _between_scans(self) -> float:
        """Relative error of the derivatives of moments due to the motion of the surfaces between scans."""
        interval = self._time / max(self._intervals, 1)
        if interval <= DENSE or (self._airframe.servo_lag is not None and self._regression.name == LATERAL.name):
            return 0.0  # lateral bounds were found to hold where the lag is known
        return (SHAPE if self._airframe.servo_lag is not None else SHAPE_NO_LAG) * (interval / 0.1) ** 2

    def _solved(self) -> dict[str, RegressionSolution | None]:
        sums = self._sums()
        return {
            equation.coefficient: solve(sums, self._regression, number, self._names(equation))
            for number, equation in enumerate(self._regression.equations)
        }

    def estimates(self, stretches: slice = slice(None)) -> LiveEstimates:
        """The present estimates of all derivatives. stretches: those over which the constants are averaged."""
        sums, solutions, derivatives = self._sums(), self.solutions(), {}
        open_level = [*self._levels[:-1], self._levels[-1] + self._block.sums.cross[0]]
        level = np.sum(open_level[stretches], axis=0)
        for equation in self._regression.equations:
            solution = solutions[equation.coefficient]
            if self._all_still:  # only gusts move the aircraft then, and no column represents them
                solution = None
            derivatives.update({d.name: d for d in self._derivatives(equation, solution, level)})
        return LiveEstimates(self._last, sums.span, sums.rows, derivatives, self.still)

    def _sums(self) -> Sums:
        return self._closed.plus(self._block.sums.without_constant())

    @property
    def _all_still(self) -> bool:
        return not any(signal.moved for signal in self._controls.values())

    def _names(self, equation: Equation) -> tuple[str, ...]:
        """Derivatives of an equation without those by controls at rest."""
        return tuple(
            name
            for name, column in equation.terms.items()
            if column not in self._controls or self._controls[column].moved
        )

    def _derivatives(
        self, equation: Equation, solution: RegressionSolution | None, level: Array
    ) -> Iterator[LiveDerivative]:
        if solution is None:
            yield from (self._without_estimate(name, equation.terms.get(name, "0")) for name in equation.derivatives)
            return
        value, variance = solution.constant(level) if level[0] > 0.0 else (math.nan, math.inf)
        spread = math.sqrt(variance)
        yield self._with_verdict(equation.constant, value, spread, spread)
        for name, column in equation.terms.items():
            if name not in solution.names:
                yield self._without_estimate(name, column)
                continue
            index = solution.names.index(name)
            bound, white = (math.sqrt(c[index, index]) for c in (solution.covariance, solution.white))
            yield self._with_verdict(name, float(solution.values[index]), bound, white)

    def _without_estimate(self, name: str, column: str) -> LiveDerivative:
        """A derivative without an estimate, and why; a control that has not moved is named."""
        if column in self._controls and not self._controls[column].moved:
            reason = f"{self._regression.controls[column]} has not moved: {MOVE_IT}"
        else:
            reason = NONE_MOVED if self._all_still else "not enough flown yet"
        return LiveDerivative(name, math.nan, math.inf, math.inf, reason)

    def _with_verdict(self, name: str, value: float, bound: float, white: float) -> LiveDerivative:
        limit = useful_bound(value, self._airframe.beliefs.get(name))
        reason = "" if bound <= limit else f"bound {bound:.2g} is wider than {limit:.2g}: fly more that moves it"
        return LiveDerivative(name, value, bound, white, reason)

    def _learn(self) -> None:
        """Update the derivatives with which the instruments are simulated: prior and estimate, weighted by their covariances.

        Equations that lack the column of a control that may have moved are not used, for their errors exceed their bounds, and so
        would those of all rows made with a motion simulated from them; nor is any while all controls rest.
        """
        if self._all_still:
            return
        doubtful = {c for c, signal in self._controls.items() if signal.doubtful}
        solutions = self._solved()
        for equation in self._regression.equations:
            solution = solutions[equation.coefficient]
            if solution is not None and not doubtful.intersection(equation.terms.values()):
                self._motion.values.update(self._posterior(solution))

    def _posterior(self, solution: RegressionSolution) -> dict[str, float]:
        """Derivative -> mean of the posterior; empty where one lacks a prior."""
        beliefs = [self._airframe.beliefs.get(n) for n in solution.names]
        if any(b is None or not b.std > 0.0 for b in beliefs):
            return {}
        mean = np.array([b.value for b in beliefs if b is not None])
        spread = np.diag([b.std**2 for b in beliefs if b is not None])
        gain = spread @ np.linalg.inv(spread + solution.covariance)
        return dict(zip(solution.names, (mean + gain @ (solution.values - mean)).tolist(), strict=True))


class JointEstimator:
    """Estimators of several regressions over the same scans as one, for lateral and longitudinal motion of a six-dof model."""

    def __init__(self, airframe: Airframe, regressions: Sequence[PlaneRegression]) -> None:
        self.parts = tuple(LiveEstimator(airframe, r) for r in regressions)

    def restart(self) -> None:
        """As `LiveEstimator.restart`."""
        for part in self.parts:
            part.restart()

    def add(self, sample: Sample) -> None:
        """Add a scan to all parts."""
        for part in self.parts:
            part.add(sample)

    @property
    def stretches(self) -> int:
        """Number of the present stretch: the largest of the parts."""
        return max(part.stretches for part in self.parts)

    def solutions(self) -> dict[str, RegressionSolution | None]:
        """As `LiveEstimator.solutions`, of all parts."""
        return {c: solution for part in self.parts for c, solution in part.solutions().items()}

    def estimates(self, stretches: slice = slice(None)) -> LiveEstimates:
        """As `LiveEstimator.estimates`, of all parts."""
        return joined([part.estimates(stretches) for part in self.parts])
