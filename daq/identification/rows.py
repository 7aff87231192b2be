"""Rows of the regression: what the scans about one interval say of it.

A row is an increment, not a rate: the noise of a gyro's difference is then the same for every length of interval. With
Q(x) = integral of the dynamic pressure times x over the interval, the equations are linear in the derivatives:

    CY:  m / S  integral of ay                                                   = Q(1) CY_0 + Q(beta) CY_beta + ...
    Cl:  (Ixx dp - Ixz dr + integral of (Izz - Iyy) q r - Ixz p q) / (S b)       = Q(1) Cl_0 + ...
    Cn:  (Izz dr - Ixz dp + integral of (Iyy - Ixx) p q + Ixz q r) / (S b)       = Q(1) Cn_0 + ...

Measured motion is integrated by the cubic through the four nearest scans. What such a cubic misses of a motion that settles
within a scan is taken from the simulated motion, of which both the integral and the cubic through the same scans are known.
The side force holds at every instant, so that all its columns are left to the one cubic, which then cancels.
"""

from collections import deque
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from daq.identification.airframe import COLUMNS, EQUATIONS, Airframe, Sample
from daq.identification.simulated_motion import LateralState, SimulatedMotion
from daq.identification.surfaces import SurfaceCurves

Array = NDArray[np.float64]


def cubic_weights(t0: float, t1: float, t2: float, t3: float) -> Array:
    """(4,) weights [s]: their product with samples at t0 < t1 < t2 < t3 is the integral from t1 to t2."""
    h = t2 - t1
    a, b = (t0 - t1) / h, (t3 - t1) / h  # the outer scans where the inner ones are 0 and 1
    ends = -1.0 / 12.0
    return h * np.array(
        [
            (ends + b / 6.0) / (a * (a - 1.0) * (a - b)),
            (ends + (a + b) / 6.0 - a * b / 2.0) / (-a * b),
            (0.25 - (a + b) / 3.0 + a * b / 2.0) / ((1.0 - a) * (1.0 - b)),
            (ends + a / 6.0) / (b * (b - 1.0) * (b - a)),
        ]
    )


WIDTH = len(COLUMNS)
LEFT = len(EQUATIONS)
TOTAL = 2 * WIDTH + LEFT  # of a row: columns of the moments, of the side force, left sides
LONGEST_ROW = 0.21  # s; a cubic over more loses the roll mode (three scans of a 20 Hz grid in a row may be lost)
MOTION = slice(1, 4)  # columns of beta, p, r
SURFACES = slice(4, 6)  # columns of aileron, rudder


class Row(NamedTuple):
    """One row of all three equations, of an interval of `span` seconds up to `time`. measured: (TOTAL,) columns of the
    moments, of the side force, left sides of CY Cl Cn; instruments: (WIDTH,)."""

    time: float
    span: float
    measured: Array
    instruments: Array


class MotionScan(NamedTuple):
    """A scan with its surfaces as the instruments take them [rad] and the motion simulated at its time."""

    sample: Sample
    surfaces: tuple[float, float]
    motion: LateralState


class RowMaker:
    """Takes scans one by one; gives the row of an interval two scans late."""

    def __init__(self, airframe: Airframe, simulated: SimulatedMotion) -> None:
        self._airframe = airframe
        self._simulated = simulated
        self._curves = [SurfaceCurves(airframe.servo_lag) for _ in range(4)]  # as `_surfaces` has them
        self._scans: deque[MotionScan] = deque(maxlen=5)
        self._integrals: deque[tuple[Array, Array, bool]] = deque(maxlen=2)  # simulated motion, surfaces; known well

    def restart(self) -> None:
        """Forget the scans so far: no interval leads over from them to the next."""
        self._scans.clear()
        self._integrals.clear()
        for curves in self._curves:
            curves.restart()

    def add(self, sample: Sample, surfaces: tuple[float, float]) -> Row | None:
        """The row that this scan completes, None while there are too few or where the interval is too long.

        surfaces: aileron and rudder as the instruments take them [rad].
        """
        if len(self._scans) < 2:
            self._simulated.restart(sample)
        self._scans.append(MotionScan(sample, surfaces, self._simulated.motion))
        if len(self._scans) >= 4:
            self._simulate()
        if len(self._scans) < 5:
            return None
        scans, (_, _, sure) = list(self._scans)[:4], self._integrals[0]
        if not sure or scans[2].sample.time - scans[1].sample.time > LONGEST_ROW:
            return None
        return self._row(scans)

    def _simulate(self) -> None:
        """Carry the simulated motion to the last scan but one, whose surfaces' slopes are known now."""
        four = list(self._scans)[-4:]
        times = (four[0].sample.time, four[1].sample.time, four[2].sample.time, four[3].sample.time)
        curves = [
            surface.middle(times, values)
            for surface, values in zip(self._curves, zip(*(_surfaces(s) for s in four), strict=True), strict=True)
        ]
        integral = self._simulated.advance(four[1].sample, four[2].sample, curves[2], curves[3])
        self._scans[-2] = four[2]._replace(motion=self._simulated.motion)
        simulated = np.array([*integral[:3], curves[2].integral, curves[3].integral])
        surfaces = np.array([curves[0].integral, curves[1].integral])
        self._integrals.append((simulated, surfaces, all(c.sure for c in self._curves)))

    def _row(self, scans: list[MotionScan]) -> Row:
        weights = cubic_weights(*(s.sample.time for s in scans))
        first_sample, last_sample = scans[1].sample, scans[2].sample
        measured = weights @ np.stack([self._integrands(s.sample) for s in scans])
        scales = 0.5 * (self._scales(first_sample) + self._scales(last_sample))
        simulated, surfaces, _ = self._integrals[0]
        cubic = weights @ np.array([s.motion[:3] for s in scans])
        moments = measured[:WIDTH].copy()
        moments[MOTION] += scales[MOTION] * (simulated[:3] - cubic)
        moments[SURFACES] = scales[SURFACES] * surfaces
        instruments = np.concatenate([measured[:1], scales[1:] * simulated])
        self._add_increments(measured, first_sample, last_sample)
        return Row(
            last_sample.time, last_sample.time - first_sample.time, np.concatenate([moments, measured]), instruments
        )

    def _scales(self, s: Sample) -> Array:
        """(WIDTH,) what turns a signal into its column: dynamic pressure [Pa], times b / 2V for rates."""
        pressure = 0.5 * s.rho * s.V * s.V
        rate = pressure * self._airframe.span / (2.0 * s.V)
        return np.array([pressure, pressure, rate, rate, pressure, pressure])

    def _integrands(self, s: Sample) -> Array:
        """(WIDTH + LEFT,) columns and left sides at one scan, without increments."""
        a = self._airframe
        per_span = 1.0 / (a.area * a.span)
        left_sides = (
            a.mass * s.ay / a.area,
            ((a.Izz - a.Iyy) * s.q * s.r - a.Ixz * s.p * s.q) * per_span,
            ((a.Iyy - a.Ixx) * s.p * s.q + a.Ixz * s.q * s.r) * per_span,
        )
        return np.concatenate([self._scales(s) * np.array([1.0, s.beta, s.p, s.r, s.delta_a, s.delta_r]), left_sides])

    def _add_increments(self, measured: Array, before: Sample, after: Sample) -> None:
        """What the rates gained over the interval, on the left sides of the moments."""
        a = self._airframe
        dp, dr, per_span = after.p - before.p, after.r - before.r, 1.0 / (a.area * a.span)
        measured[WIDTH + 1] += (a.Ixx * dp - a.Ixz * dr) * per_span
        measured[WIDTH + 2] += (a.Izz * dr - a.Ixz * dp) * per_span


def _surfaces(scan: MotionScan) -> tuple[float, float, float, float]:
    """Aileron and rudder as measured, then as the instruments take them."""
    return scan.sample.delta_a, scan.sample.delta_r, *scan.surfaces
