"""The recursive estimator: scans in, derivatives with bounds out, at any moment."""

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

BLOCK = 30.0  # s in which constants are taken to stay the same
GAP = 1.0  # s without a whole scan after which a new stretch begins
SLOWEST = 3.0  # m/s; below, non-dimensional rates mean nothing
MOVE_IT = "move it on purpose (doublet or 3-2-1-1)"
NONE_MOVED = "no control has moved yet"
SHAPE, SHAPE_NO_LAG = 0.035, 0.05
"""Of a derivative of a moment: what an unknown way of the surfaces between scans 0.1 s apart is worth, where the servos' lag is
known and where it is not; it grows with the square of the interval. Found by simulation without noise."""
LEARN = 1.0  # s between two lookings at what the instruments are simulated with


class LiveEstimator:
    """Takes calibrated scans in order of time; any step length, scans may be missing.

    regression: what is estimated. Costs the same for every scan however long the flight is. Not thread safe. skipped: scans
    without a row, because a value was missing, time did not advance, or the aircraft hardly moves through the air.
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
        self._time, self._intervals = 0.0, 0  # between scans that belong together
        self.scans = 0
        self.skipped = 0

    def restart(self) -> None:
        """A new stretch begins: time may be any, and nothing leads over from before. What is known is kept."""
        for steadied in [] if self._vane is None else self._vane.restart():
            self._take_row(steadied)
        self._close_block()
        self._interrupt()
        self._levels.append(np.zeros(self._regression.total))
        self._last = self._learn_at = -math.inf

    def add(self, sample: Sample) -> None:
        """One scan. One that is not credible, or not later than the last, is counted in `skipped`."""
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
        self._take(sample)
        if sample.time >= self._learn_at:
            self._learn_at = sample.time + LEARN
            self._learn()

    def _take(self, sample: Sample) -> None:
        for steadied in [sample] if self._vane is None else self._vane.add(sample):
            self._take_row(steadied)

    def _take_row(self, sample: Sample) -> None:
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
        """What was flown so far tells of each equation that can be solved."""
        sums = self._sums()
        information = {}
        for coefficient, solution in self._solved().items():
            if solution is not None:
                pick = list(solution.columns)
                normal = sums.instruments[0][np.ix_(pick, pick)]
                information[coefficient] = EquationInformation(
                    solution.names, solution.columns, normal, solution.covariance
                )
        return information

    def solutions(self) -> dict[str, RegressionSolution | None]:
        """Each equation as far as the scans so far tell it."""
        share = self._between_scans
        return {
            c: solution
            if solution is None or not share or c in self._regression.forces_only
            else solution.widened(share)
            for c, solution in self._solved().items()
        }

    @property
    def _between_scans(self) -> float:
        """Share of a moment's derivatives by which they may be wrong for what surfaces do between scans."""
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
        """Every derivative as far as the scans so far tell it. stretches: those of which the constants are wanted."""
        sums, solutions, derivatives = self._sums(), self.solutions(), {}
        open_level = [*self._levels[:-1], self._levels[-1] + self._block.sums.cross[0]]
        level = np.sum(open_level[stretches], axis=0)
        for equation in self._regression.equations:
            solution = solutions[equation.coefficient]
            if self._all_still:  # what moves it then is gusts, which no column stands for
                solution = None
            derivatives.update({d.name: d for d in self._described(equation, solution, level)})
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

    def _described(
        self, equation: Equation, solution: RegressionSolution | None, level: Array
    ) -> Iterator[LiveDerivative]:
        if solution is None:
            yield from (self._untold(name, equation.terms.get(name, "0")) for name in equation.derivatives)
            return
        value, variance = solution.constant(level) if level[0] > 0.0 else (math.nan, math.inf)
        spread = math.sqrt(variance)
        yield self._judged(equation.constant, value, spread, spread)
        for name, column in equation.terms.items():
            if name not in solution.names:
                yield self._untold(name, column)
                continue
            index = solution.names.index(name)
            bound, white = (math.sqrt(c[index, index]) for c in (solution.covariance, solution.white))
            yield self._judged(name, float(solution.values[index]), bound, white)

    def _untold(self, name: str, column: str) -> LiveDerivative:
        """No number; where a control rests, the control is named."""
        if column in self._controls and not self._controls[column].moved:
            reason = f"{self._regression.controls[column]} has not moved: {MOVE_IT}"
        else:
            reason = NONE_MOVED if self._all_still else "not enough flown yet"
        return LiveDerivative(name, math.nan, math.inf, math.inf, reason)

    def _judged(self, name: str, value: float, bound: float, white: float) -> LiveDerivative:
        limit = useful_bound(value, self._airframe.beliefs.get(name))
        reason = "" if bound <= limit else f"bound {bound:.2g} is wider than {limit:.2g}: fly more that moves it"
        return LiveDerivative(name, value, bound, white, reason)

    def _learn(self) -> None:
        """Simulate the instruments with what is known by now: belief and estimate, each weighted by its bound.

        An equation without the column of a control that may have moved is wrong by more than its bound says, and so would be
        all rows that are made with a motion simulated from it. While all rest, gusts move it, which no column stands for.
        """
        if self._all_still:
            return
        doubtful = {c for c, signal in self._controls.items() if signal.doubtful}
        solutions = self._solved()
        for equation in self._regression.equations:
            solution = solutions[equation.coefficient]
            if solution is not None and not doubtful.intersection(equation.terms.values()):
                self._motion.values.update(self._check(solution))

    def _check(self, solution: RegressionSolution) -> dict[str, float]:
        beliefs = [self._airframe.beliefs.get(n) for n in solution.names]
        if any(b is None or not b.std > 0.0 for b in beliefs):
            return {}
        mean = np.array([b.value for b in beliefs if b is not None])
        spread = np.diag([b.std**2 for b in beliefs if b is not None])
        gain = spread @ np.linalg.inv(spread + solution.covariance)
        return dict(zip(solution.names, (mean + gain @ (solution.values - mean)).tolist(), strict=True))


class JointEstimator:
    """Estimators of several regressions over the same scans, as one: lateral and longitudinal motion of a six-dof model."""

    def __init__(self, airframe: Airframe, regressions: Sequence[PlaneRegression]) -> None:
        self.parts = tuple(LiveEstimator(airframe, r) for r in regressions)

    def restart(self) -> None:
        """As `LiveEstimator.restart`."""
        for part in self.parts:
            part.restart()

    def add(self, sample: Sample) -> None:
        """One scan."""
        for part in self.parts:
            part.add(sample)

    @property
    def stretches(self) -> int:
        """Number of the present stretch, of all parts together."""
        return max(part.stretches for part in self.parts)

    def solutions(self) -> dict[str, RegressionSolution | None]:
        """Each equation as far as the scans so far tell it."""
        return {c: solution for part in self.parts for c, solution in part.solutions().items()}

    def estimates(self, stretches: slice = slice(None)) -> LiveEstimates:
        """Every derivative of all parts."""
        return joined([part.estimates(stretches) for part in self.parts])
