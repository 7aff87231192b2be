"""Training and estimation samples from a flight, in the published one-step form and in the interval form; instruments.

Published form (`point`): inputs motion(k) and coefficients at k, outputs motion(k+1) and acceleration(k+1). The
coefficients need p_dot and r_dot at k, from the spline through the de-noised rates. Where the time constant of the roll mode is
about a sample interval, that derivative is too small and too early, and the rolling-moment derivatives come out 3-15 % low.

Interval form: the coefficient that moves the aircraft from k to k+n is its mean over the interval, and the mean of a moment is
exactly the increment of angular momentum, so no derivative is needed: C_l = [Ixx dp - Ixz dr - ...] / (n dt mean(q) S b). The
model's coefficients are averaged in the same way.

Noise in the signals would still make every derivative too small (errors in variables). An instrument is a signal that moves like
the regressor but does not share its noise: here the motion of a linear one-step predictor, fitted to the de-noised flight and
driven by the measured controls alone, restarted every RESTART_S. It need not be exact, only similar and independent: a
difference costs spread, never bias. Refined instrumental variables: Young (2011), Recursive Estimation and Time-Series Analysis,
ch. 6-7. The trained network itself as predictor was worse: its errors grow from step to step outside its training data, and the
estimates scatter three to ten times more.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from estimation.errors import DataError
from estimation.estimators.neural_gauss_newton.axes import Axis, dynamic_pressure
from estimation.signals.denoise import denoise_many
from groundstation.flight import Array, Flight
from groundstation.flight.arrays import true_runs

Form = Literal["point", "interval"]

INTERVAL_S = 0.2  # of the interval form
RESTART_S = 3.0  # of the predictor of instruments
SHORTEST = 20  # samples in a stretch that is used
COSTLY = 0.1  # of a flight's samples: a column that would exclude more is left out


@dataclass(frozen=True)
class SampleStretch:
    """Samples of one gap-free stretch.

    u: (M, n_motion + 3) measured inputs; z: (M, n_outputs) outputs; first: index in the flight of each row; signals: from which
    the model's coefficients are computed; smooth: the same de-noised; window: samples averaged over, 0 for the published form.
    """

    u: Array
    z: Array
    first: NDArray[np.int64]
    signals: dict[str, Array]
    smooth: dict[str, Array]
    window: int

    def model_coefficients(self, axis: Axis, theta: Array, s: dict[str, Array]) -> tuple[Array, Array]:
        """(M, 3) coefficients with parameters theta and their derivatives (M, 3, n), averaged like the measured ones.

        s: signals, measured or de-noised, or instruments.
        """
        value, slope = axis.aerodynamic(s, theta)
        if self.window == 0:
            return value[:-1], slope[:-1]
        pressure = dynamic_pressure(s)
        mean = window_mean(pressure, self.window)
        averaged = window_mean(pressure[:, None] * value, self.window) / mean[:, None]
        return averaged, window_mean(pressure[:, None, None] * slope, self.window) / mean[:, None, None]


def window_mean(values: Array, steps: int) -> Array:
    """Mean of the cubic spline through samples k .. k+steps, (M, ...) from (M + steps, ...).

    The time constant of a roll mode is about a 20 Hz sample interval: by the trapezoidal rule, on flights without noise, roll
    derivatives come out 1 % and yaw derivatives 0.5-0.9 % too large, with the spline 0.1 %.
    """
    integral = CubicSpline(np.arange(len(values)), values, axis=0).antiderivative()(np.arange(len(values)))
    return np.asarray(integral[steps:] - integral[:-steps]) / steps


def require_columns(axis: Axis, flight: Flight) -> None:
    """MissingColumnError naming the columns that the axis requires and the flight lacks."""
    required = [c for c in axis.columns if c not in axis.optional]
    flight.require(required, f"Neural Gauss-Newton, {axis.name} axis")


def missing_optional(axis: Axis, flights: Sequence[Flight]) -> tuple[str, ...]:
    """Optional motion variables to leave out: those that would exclude COSTLY of the samples of some flight."""
    required = [c for c in axis.columns if c not in axis.optional]

    def costs(flight: Flight, column: str) -> bool:
        if not flight.measured(column):
            return True
        usable = np.isfinite(np.column_stack([flight[c] for c in required])).all(axis=1)
        return float(np.isfinite(flight[column])[usable].sum()) < (1.0 - COSTLY) * float(usable.sum())

    return tuple(c for c in axis.optional if any(costs(f, c) for f in flights))


def training_stretches(axis: Axis, flight: Flight, form: Form, motion: tuple[str, ...]) -> list[SampleStretch]:
    """All usable stretches, cut at gaps in time and where a needed column is not measured. DataError where none is long
    enough."""
    columns = [c for c in axis.columns if c not in axis.optional or c in motion]
    table = np.column_stack([flight[c] for c in columns])
    complete = np.asarray(np.isfinite(table).all(axis=1))
    sample_stretches = []
    for start, stop in true_runs(complete, flight.segments):
        if stop - start >= SHORTEST:
            signals = {c: flight[c][start:stop] for c in columns}
            sample_stretches.append(_stretch(axis, signals, flight.time[start:stop], start, form, motion))
    if not sample_stretches:
        raise DataError(
            f"{flight.name}: no stretch of {SHORTEST} samples in a row with all of {', '.join(columns)}; "
            "Neural Gauss-Newton needs one"
        )
    return sample_stretches


def _stretch(
    axis: Axis, signals: dict[str, Array], time: Array, first: int, form: Form, motion: tuple[str, ...]
) -> SampleStretch:
    if "psi" in signals:
        signals = {**signals, "psi": np.unwrap(signals["psi"])}
    return (_point if form == "point" else _interval)(axis, signals, time, first, motion)


def _point(axis: Axis, raw: dict[str, Array], time: Array, first: int, motion: tuple[str, ...]) -> SampleStretch:
    """The published form: values and spline derivatives of de-noised signals at each sample."""
    dt = float(np.median(np.diff(time)))
    s = _without_noise(axis, raw, motion=1)
    steps = np.arange(len(time))
    slopes = {c: CubicSpline(steps, s[c])(steps, 1) / dt for c in axis.angular_rates}
    u = np.column_stack([*(s[c] for c in motion), axis.inertial(s, slopes) / dynamic_pressure(s)[:, None]])[:-1]
    z = np.column_stack([s[c] for c in (*motion, *axis.accelerations)])[1:]
    return SampleStretch(u, z, first + np.arange(len(u)), s, s, 0)


def _without_noise(axis: Axis, raw: dict[str, Array], motion: int) -> dict[str, Array]:
    """Signals de-noised with sharp edges: straight pieces for controls, pieces of order `motion` for the others.

    Parabolas follow motion better, and the interval form uses them. In the published form they leave so much noise in the
    derivatives of the rates that Cn_r scatters by 15 % from flight to flight; with straight pieces it is 7 %.
    """
    smooth = dict(raw)
    for names, order in (
        ([c for c in raw if c in axis.controls], 1),
        ([c for c in raw if c not in axis.controls], motion),
    ):
        smooth |= {c: d.values for c, d in zip(names, denoise_many([raw[c] for c in names], order=order), strict=True)}
    return smooth


def _interval(axis: Axis, raw: dict[str, Array], time: Array, first: int, motion: tuple[str, ...]) -> SampleStretch:
    """The interval form, over the number of samples nearest to INTERVAL_S."""
    dt = float(np.median(np.diff(time)))
    steps = max(1, min(round(INTERVAL_S / dt), len(time) // 4))
    smooth = _without_noise(axis, raw, motion=2)
    no_derivatives = {c: np.zeros(len(time)) for c in axis.angular_rates}
    increments = {c: (raw[c][steps:] - raw[c][:-steps]) / (steps * dt) for c in axis.angular_rates}
    zeros = {c: np.zeros(len(time) - steps) for c in raw}
    # inertial loads are linear in the rate derivatives: the mean of the other terms, plus those of the exact increments
    loads = window_mean(axis.inertial(raw, no_derivatives), steps) + axis.inertial(zeros, increments)
    u = np.column_stack(
        [*(raw[c][:-steps] for c in motion), loads / window_mean(dynamic_pressure(raw), steps)[:, None]]
    )
    accelerations = [window_mean(raw[c], steps) for c in axis.accelerations]
    z = np.column_stack([*(raw[c][steps:] for c in motion), *accelerations])
    return SampleStretch(u, z, first + np.arange(len(u)), raw, smooth, steps)


def predicted_signals(
    axis: Axis, stretches: list[SampleStretch], motion: tuple[str, ...], step: float
) -> list[dict[str, Array]]:
    """De-noised signals of each stretch with the motion replaced by that of the predictor. step: sample interval [s]."""
    tables = [_table(axis, s, motion) for s in stretches]
    inputs = np.vstack([t[0][:-1] for t in tables])
    drives = np.vstack([t[1] for t in tables])
    targets = np.vstack([t[0][1:] for t in tables])
    regressors = np.hstack([inputs, drives])
    scale = np.where(regressors.std(axis=0) > 0, regressors.std(axis=0), 1.0)
    predictor = np.linalg.lstsq(regressors / scale, targets, rcond=1e-8)[0] / scale[:, None]
    block = max(2, round(RESTART_S / step))
    result = []
    for stretch, (x, drive) in zip(stretches, tables, strict=True):
        predicted = x.copy()
        starts = np.arange(0, len(x) - 1, block)
        state, rows = x[starts], starts
        for _ in range(block):
            keep = rows + 1 < len(x)
            rows, state = rows[keep], state[keep]
            if not rows.size:
                break
            state = np.hstack([state, drive[rows]]) @ predictor
            rows = rows + 1
            inside = ~np.isin(rows, starts)  # a restart begins from the de-noised motion
            predicted[rows[inside]] = state[inside]
        result.append({**stretch.smooth, **{c: predicted[:, i] for i, c in enumerate(motion)}})
    return result


def _table(axis: Axis, stretch: SampleStretch, motion: tuple[str, ...]) -> tuple[Array, Array]:
    """(N, n_motion) de-noised motion, and (N - 1, ...) controls at both ends of each step with a constant."""
    x = np.column_stack([stretch.smooth[c] for c in motion])
    controls = np.column_stack([stretch.smooth[c] for c in axis.controls])
    return x, np.hstack([controls[:-1], controls[1:], np.ones((len(x) - 1, 1))])
