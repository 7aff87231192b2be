"""Rows of the regression, one for each interval between scans.

A row is an increment, not a rate: the noise of a gyro's difference is then the same for every length of interval. Its equations
are those of a `PlaneRegression`.

Measured motion is integrated by the cubic through the four nearest scans. The error of that cubic for motion which settles
within a scan is taken from the simulated motion, whose integral and whose cubic through the same scans are both known. Equations
of forces hold at every instant: all their columns use the same cubic, whose error cancels.
"""

from collections import deque
from operator import attrgetter
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from daq.identification.airframe import Airframe, Sample
from daq.identification.regression import LATERAL, PlaneRegression
from daq.identification.simulated_motion import MotionState, PitchState, SimulatedPitch, Simulation
from daq.identification.surfaces import SurfaceCurves, cubic_weights

Array = NDArray[np.float64]


LONGEST_ROW = 0.21  # s; a cubic over more loses the roll mode (three scans of a 20 Hz grid in a row may be lost)


class Row(NamedTuple):
    """One row of all equations, over an interval of `span` [s] that ends at `time` [s]. measured: (total,) columns of the
    equations of increments, columns of those that hold at every instant, left sides; instruments: (width,)."""

    time: float
    span: float
    measured: Array
    instruments: Array


class MotionScan(NamedTuple):
    """A scan with the surfaces for the instruments [rad], the motion simulated at its time, its columns and left sides
    (`_integrands`), and the scales of its columns; each is used by four rows."""

    sample: Sample
    surfaces: tuple[float, ...]
    motion: MotionState
    integrands: Array
    scales: Array


class RowMaker:
    """Makes rows from scans added one by one; the row of an interval needs two further scans."""

    def __init__(self, airframe: Airframe, simulated: Simulation, regression: PlaneRegression = LATERAL) -> None:
        self._airframe = airframe
        self._regression = regression
        self._simulated = simulated
        self._controls = attrgetter("time", *regression.controls.values())
        states, controls = len(regression.states), len(regression.controls)
        self._motion = slice(1, 1 + states)
        self._surfaces = slice(1 + states, 1 + states + controls)
        self._linear = 1 + states + controls
        self._curves = [SurfaceCurves(airframe.servo_lag) for _ in range(2 * controls)]  # as `_deflections` has them
        lengths = [getattr(airframe, name) if name else 0.0 for name in regression.states.values()]
        self._lengths = [0.0, *lengths, *[0.0] * controls]
        self._scans: deque[MotionScan] = deque(maxlen=5)
        self._integrals: deque[tuple[Array, Array, bool]] = deque(maxlen=2)  # simulated motion, surfaces; known well
        self._part: Row | None = None  # of a row

    def restart(self) -> None:
        """Begin after a gap: no interval connects earlier scans with the next."""
        self._scans.clear()
        self._integrals.clear()
        self._part = None
        for curves in self._curves:
            curves.restart()

    def add(self, sample: Sample, surfaces: tuple[float, ...]) -> Row | None:
        """Add a scan, and return the row that it completes; None while there are too few scans, the row is too short, or the
        interval too long.

        surfaces: the controls for the instruments, in the order of the regression [rad].
        """
        if len(self._scans) < 2:
            self._simulated.restart(sample)
        scales = self._scales(sample)
        integrands = self._integrands(_flow_at_stated_cg(self._airframe, sample), scales)
        self._scans.append(MotionScan(sample, surfaces, self._simulated.motion, integrands, scales))
        if len(self._scans) >= 4:
            self._simulate()
        if len(self._scans) < 5:
            return None
        scans, (_, _, sure) = list(self._scans)[:4], self._integrals[0]
        if not sure or scans[2].sample.time - scans[1].sample.time > LONGEST_ROW:
            self._part = None
            return None
        return self._joined(self._row(scans))

    @property
    def partial(self) -> bool:
        """Whether a row has begun that is still too short."""
        return self._part is not None

    def _joined(self, row: Row) -> Row | None:
        """The row together with earlier ones that were too short; None while the sum is too short."""
        if self._part is not None:
            part = self._part
            row = Row(row.time, part.span + row.span, part.measured + row.measured, part.instruments + row.instruments)
        self._part = row if row.span < self._regression.shortest_row else None
        return row if self._part is None else None

    def _simulate(self) -> None:
        """Advance the simulated motion to the last scan but one, at which the slopes of the surfaces are known now."""
        four = list(self._scans)[-4:]
        times = (four[0].sample.time, four[1].sample.time, four[2].sample.time, four[3].sample.time)
        curves = [
            surface.middle(times, values)
            for surface, values in zip(self._curves, zip(*map(self._deflections, four), strict=True), strict=True)
        ]
        measured, smoothed = curves[: len(curves) // 2], curves[len(curves) // 2 :]
        integral = self._simulated.advance(four[1].sample, four[2].sample, *smoothed)
        self._scans[-2] = four[2]._replace(motion=self._simulated.motion)
        simulated = np.array([*integral[: len(self._regression.states)], *(c.integral for c in smoothed)])
        surfaces = np.array([c.integral for c in measured])
        self._integrals.append((simulated, surfaces, all(c.sure for c in self._curves)))

    def _deflections(self, scan: MotionScan) -> tuple[float, ...]:
        """Controls as measured, then as smoothed for the instruments [rad]."""
        return *self._controls(scan.sample)[1:], *scan.surfaces

    def _row(self, scans: list[MotionScan]) -> Row:
        r = self._regression
        weights = cubic_weights(*(s.sample.time for s in scans))
        first_sample, last_sample = scans[1].sample, scans[2].sample
        measured = weights @ np.array([s.integrands for s in scans])
        scales = 0.5 * (scans[1].scales + scans[2].scales)
        simulated, surfaces, _ = self._integrals[0]
        cubic = weights @ np.array([s.motion[: len(r.states)] for s in scans])
        moments = measured[: r.width].copy()
        moments[self._motion] += scales[self._motion] * (simulated[: len(r.states)] - cubic)
        moments[self._surfaces] = scales[self._surfaces] * surfaces
        instruments = np.concatenate([measured[:1], scales[1:] * simulated])
        if r.square_of_lift:
            instruments = np.append(instruments, weights @ np.array([self._simulated_square(s) for s in scans]))
        measured[r.width :] += r.gains(self._airframe, first_sample, last_sample)
        return Row(
            last_sample.time, last_sample.time - first_sample.time, np.concatenate([moments, measured]), instruments
        )

    def _scales(self, s: Sample) -> Array:
        """(linear columns,) factors from signals to columns: dynamic pressure [Pa], times length / 2V for rates."""
        pressure = 0.5 * s.rho * s.V * s.V
        return np.array([pressure * length / (2.0 * s.V) if length else pressure for length in self._lengths])

    def _integrands(self, s: Sample, scales: Array) -> Array:
        """(width + equations,) columns and left sides at one scan, without increments."""
        forces = self._regression.forces(self._airframe, s)
        linear = scales * np.array(self._regression.linear_values(s))
        if not self._regression.square_of_lift:
            return np.concatenate([linear, forces])
        pressure = 0.5 * s.rho * s.V * s.V
        return np.concatenate([linear, [forces[0] ** 2 / pressure], forces])

    def _simulated_square(self, scan: MotionScan) -> float:
        """Dynamic pressure times the square of the simulated lift coefficient."""
        s = scan.sample
        assert isinstance(self._simulated, SimulatedPitch)
        assert isinstance(scan.motion, PitchState)
        return 0.5 * s.rho * s.V * s.V * self._simulated.lift_coefficient(scan.motion, s.V, scan.surfaces[0]) ** 2


def _flow_at_stated_cg(airframe: Airframe, sample: Sample) -> Sample:
    """A sample with the flow angles at the CG of the aircraft file, to which all derivatives refer, `CL_q` and `CY_r` included.
    sample: at the present CG."""
    ahead = airframe.cg_ahead(sample.cg_x)
    if ahead == 0.0:
        return sample
    per_speed = ahead / sample.V
    return sample._replace(alpha=sample.alpha + per_speed * sample.q, beta=sample.beta - per_speed * sample.r)
