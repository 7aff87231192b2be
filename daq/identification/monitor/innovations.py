"""Innovations of the model, and of the model with each effect of the bank in.

All predictors run side by side: x <- x + K (z - y) at each scan, with the same K. What a predictor with an effect says otherwise
than the model without is the effect's signature: as the aircraft had it, the model's innovations would hold that.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from daq.identification.airframe import DERIVATIVES, Airframe
from daq.identification.monitor.bank import Effect
from daq.identification.monitor.motion import Inputs, LateralMotion

Array = NDArray[np.float64]

GAIN = 0.3  # of beta, p, r, phi towards what is measured; 0.95 notices the same effects equally soon
SLOWEST_LAG = 1e-3  # s; a vane's lag is at least that, for an exponential's sake


class Scan:
    """One scan of several flights at once. time [s]; measured: (5, flights) of CHANNELS; inputs: the rest."""

    __slots__ = ("inputs", "measured", "time")

    def __init__(self, time: float, measured: Array, inputs: Inputs) -> None:
        self.time, self.measured, self.inputs = time, measured, inputs


class PredictorBank:
    """Feed scans in order of time; `restart` where one is missing for long."""

    def __init__(self, airframe: Airframe, values: Mapping[str, float], effects: Sequence[Effect]) -> None:
        self._effects = tuple(effects)
        models = 1 + len(effects)
        table = {n: np.full((models, 1), values.get(n, 0.0)) for n in DERIVATIVES}
        table.update({n: np.zeros((models, 1)) for n in ("Cn_da", "CY_da")})
        self._delay_a, self._delay_r, self._vane_lag, self._vane_bias = (np.zeros((models, 1)) for _ in range(4))
        places = {
            "aileron_delay": self._delay_a,
            "rudder_delay": self._delay_r,
            "beta_lag": self._vane_lag,
            "beta_bias": self._vane_bias,
        }
        for k, effect in enumerate(effects, start=1):
            (table[effect.name] if effect.name in table else places[effect.name])[k, 0] += effect.step
        self._motion = LateralMotion(airframe, table)
        self._last: Scan | None = None
        self._before: Inputs | None = None
        self._x = self._vane = np.zeros(0)

    def restart(self) -> None:
        """Nothing leads over from before."""
        self._last = self._before = None

    def innovations(self, scan: Scan) -> tuple[Array, Array] | None:
        """(5, flights) of the model; (5, effects, flights) signatures; None for the first scan, which only begins."""
        last = self._last
        if last is None:
            models = len(self._effects) + 1
            shape = (4, models, scan.measured.shape[1])
            self._x = np.broadcast_to(scan.measured[:4, None, :], shape).copy()
            self._x[0] -= self._vane_bias  # a vane that has slipped shows so much more than there is
            self._vane = self._x[0].copy()
            self._last, self._before = scan, scan.inputs
            return None
        dt = scan.time - last.time
        first, second = (
            self._delayed(last.inputs, self._before or last.inputs, dt),
            self._delayed(scan.inputs, last.inputs, dt),
        )
        x = self._motion.advance(self._x, first, second, dt)
        lag = np.maximum(self._vane_lag, SLOWEST_LAG)
        fade = np.where(self._vane_lag > 0.0, np.exp(-dt / lag), 0.0)
        mean_slope = (x[0] - self._x[0]) / dt
        # a first-order lag shown a ramp from x0 to x1, exactly
        vane = x[0] - lag * mean_slope * (1.0 - fade) + (self._vane - self._x[0]) * fade
        vane = np.where(self._vane_lag > 0.0, vane, x[0])
        shown = np.stack([vane + self._vane_bias, x[1], x[2], x[3], self._motion.side_force(x, second)])
        wrong = scan.measured[:, None, :] - shown
        self._vane = vane + GAIN * wrong[0]
        self._x = x + GAIN * wrong[:4]
        self._before, self._last = last.inputs, scan
        return wrong[:, 0], wrong[:, :1] - wrong[:, 1:]

    def _delayed(self, now: Inputs, before: Inputs, dt: float) -> Inputs:
        """Surfaces as late as each model has them, on the straight line between two scans."""
        part_a, part_r = np.minimum(self._delay_a / dt, 1.0), np.minimum(self._delay_r / dt, 1.0)
        return now._replace(
            delta_a=now.delta_a + part_a * (before.delta_a - now.delta_a),
            delta_r=now.delta_r + part_r * (before.delta_r - now.delta_r),
        )
