"""Instruments against noise in the regressors: motion predicted over many steps from the controls alone.

The model's coefficients are computed from measured motion, and its noise makes every derivative too small (errors in
variables). An instrument is a signal that moves like the regressor but does not share its noise. Here it is the motion
that a linear one-step predictor, fitted to the de-noised flight, gives when it runs by itself driven by the measured
controls, restarted every RESTART_S. It need not be exact, only alike and independent: what is not alike costs spread,
never bias. Refined instrumental variables: Young (2011), Recursive Estimation and Time-Series Analysis, ch. 6-7.

Tried and left: the trained network itself as the predictor. Its errors grow from step to step outside the data it was
trained on, and the estimates scatter three to ten times more.
"""

import numpy as np
from numpy.typing import NDArray

from estimation.estimators.neural_gauss_newton.axes import Axis
from estimation.estimators.neural_gauss_newton.samples import SampleStretch

Array = NDArray[np.float64]

RESTART_S = 3.0


def predicted_signals(
    axis: Axis, stretches: list[SampleStretch], motion: tuple[str, ...], step: float
) -> list[dict[str, Array]]:
    """Signals of each stretch with the motion replaced by the prediction. step: sample interval [s]."""
    tables = [_table(axis, s, motion) for s in stretches]
    inputs = np.vstack([t[0][:-1] for t in tables])
    drives = np.vstack([t[1] for t in tables])
    targets = np.vstack([t[0][1:] for t in tables])
    both = np.hstack([inputs, drives])
    scale = np.where(both.std(axis=0) > 0, both.std(axis=0), 1.0)
    map_ = np.linalg.lstsq(both / scale, targets, rcond=1e-8)[0] / scale[:, None]
    block = max(2, round(RESTART_S / step))
    result = []
    for stretch, (x, drive) in zip(stretches, tables, strict=True):
        out = x.copy()
        starts = np.arange(0, len(x) - 1, block)
        now, at = x[starts], starts
        for _ in range(block):
            keep = at + 1 < len(x)
            at, now = at[keep], now[keep]
            if not at.size:
                break
            now = np.hstack([now, drive[at]]) @ map_
            at = at + 1
            fresh = ~np.isin(at, starts)
            out[at[fresh]] = now[fresh]
        result.append({**stretch.smooth, **{c: out[:, i] for i, c in enumerate(motion)}})
    return result


def _table(axis: Axis, stretch: SampleStretch, motion: tuple[str, ...]) -> tuple[Array, Array]:
    """(N, n_motion) de-noised motion, and (N - 1, ...) controls at both ends of each step with a constant."""
    x = np.column_stack([stretch.smooth[c] for c in motion])
    controls = np.column_stack([stretch.smooth[c] for c in axis.controls])
    return x, np.hstack([controls[:-1], controls[1:], np.ones((len(x) - 1, 1))])
