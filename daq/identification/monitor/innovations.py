"""Innovations of the model, and of the model with each effect of the bank in.

All predictors run side by side: x <- x + K (z - y) at each scan, with the same K. What a predictor with an effect says otherwise
than the model without is the effect's signature: as the aircraft had it, the model's innovations would hold that.
A scan is looked at when the next one has come, which tells what the surfaces did on the way to it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from daq.identification.airframe import DERIVATIVES, Airframe
from daq.identification.monitor.bank import MonitoredEffect
from daq.identification.monitor.intervals import BLIND, Kinds, Pair, kind_of
from daq.identification.monitor.motion import Inputs, LateralMotion
from daq.identification.monitor.surfaces import SurfacesBetween
from daq.identification.monitor.whitening import ORDER

Array = NDArray[np.float64]

GAIN = 0.3  # of beta, p, r, phi towards what is measured; more forgets what an effect has done
SLOWEST_LAG = 1e-3  # s; a vane's lag is at least that, for an exponential's sake


class FlightsScan:
    """One scan of several flights at once. time [s]; measured: (5, flights) of CHANNELS; inputs: the rest."""

    __slots__ = ("inputs", "measured", "time")

    def __init__(self, time: float, measured: Array, inputs: Inputs) -> None:
        self.time, self.measured, self.inputs = time, measured, inputs


@dataclass(frozen=True, slots=True)
class Innovation:
    """What was wrong at one scan. time: of the scan [s]; wrong: (5, flights) of the model; signatures: (5, effects, flights);
    kind: (flights,) of the interval that led to it, for whitening."""

    time: float
    wrong: Array
    signatures: Array
    kind: Kinds


class PredictorBank:
    """Feed scans in order of time; `restart` where one is missing for long."""

    def __init__(self, airframe: Airframe, values: Mapping[str, float], effects: Sequence[MonitoredEffect]) -> None:
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
        self._scans: list[FlightsScan] = []  # the last three
        self._aileron, self._rudder = SurfacesBetween(airframe.servo_lag), SurfacesBetween(airframe.servo_lag)
        self._between: Pair | None = None
        self._blind = np.zeros(0, dtype=np.intp)  # scans for which a flight says nothing yet
        self._x = self._vane = np.zeros(0)

    def restart(self) -> None:
        """Nothing leads over from before."""
        self._scans.clear()
        self._between = None
        self._aileron.restart()
        self._rudder.restart()

    def innovation(self, scan: FlightsScan) -> Innovation | None:
        """Of the scan before this one; None for the first two, with which it begins."""
        self._scans.append(scan)
        if len(self._scans) == 1:
            self._begin(scan)
            return None
        if len(self._scans) == 2:
            return None
        earlier, last, now, following = (self._scans[0], *self._scans)[-4:]
        del self._scans[:-3]
        dt = now.time - last.time
        before, surfaces = self._between, self._surfaces_between((earlier, last, now, following))
        self._between = surfaces
        drive = _Drive(last.inputs, now.inputs, surfaces, before, (self._delay_a / dt, self._delay_r / dt))
        x = self._motion.advance(self._x, drive, dt)
        lag = np.maximum(self._vane_lag, SLOWEST_LAG)
        fade = np.where(self._vane_lag > 0.0, np.exp(-dt / lag), 0.0)
        mean_slope = (x[0] - self._x[0]) / dt
        # a first-order lag shown a ramp from x0 to x1, exactly
        vane = x[0] - lag * mean_slope * (1.0 - fade) + (self._vane - self._x[0]) * fade
        vane = np.where(self._vane_lag > 0.0, vane, x[0])
        shown = np.stack([vane + self._vane_bias, x[1], x[2], x[3], self._motion.side_force(x, drive(1.0))])
        wrong = now.measured[:, None, :] - shown
        self._vane = vane + GAIN * wrong[0]
        self._x = x + GAIN * wrong[:4]
        kind = kind_of(dt, surfaces, before)
        self._restart_where(kind == BLIND, now)
        kind = np.where(self._blind > 0, BLIND, kind)
        return Innovation(now.time, wrong[:, 0], wrong[:, :1] - wrong[:, 1:], kind)

    def _surfaces_between(self, scans: tuple[FlightsScan, FlightsScan, FlightsScan, FlightsScan]) -> Pair:
        """Aileron and rudder between the middle two."""
        one, two, three, four = (s.time for s in scans)
        a, b, c, d = (s.inputs for s in scans)
        return (
            self._aileron.middle((one, two, three, four), (a.delta_a, b.delta_a, c.delta_a, d.delta_a)),
            self._rudder.middle((one, two, three, four), (a.delta_r, b.delta_r, c.delta_r, d.delta_r)),
        )

    def _begin(self, scan: FlightsScan) -> None:
        models = len(self._effects) + 1
        shape = (4, models, scan.measured.shape[1])
        self._x = np.broadcast_to(scan.measured[:4, None, :], shape).copy()
        self._x[0] -= self._vane_bias  # a vane that has slipped shows so much more than there is
        self._vane = self._x[0].copy()
        self._blind = np.zeros(shape[2], dtype=np.intp)

    def _restart_where(self, blind: NDArray[np.bool_], scan: FlightsScan) -> None:
        """Flights whose prediction says nothing begin again at what is measured."""
        self._blind = np.where(blind, 1 + ORDER, np.maximum(self._blind - 1, 0))
        if blind.any():
            self._x[:, :, blind] = scan.measured[:4, None, blind]
            self._x[0][:, blind] -= self._vane_bias
            self._vane[:, blind] = self._x[0][:, blind]


class _Drive:
    """Inputs over an interval, surfaces as late as each model has them."""

    def __init__(
        self,
        first: Inputs,
        last: Inputs,
        surfaces: Pair,
        before: Pair | None,
        late: tuple[Array, Array],
    ) -> None:
        """late: (models, 1) parts of the interval."""
        self._first, self._last, self._surfaces, self._before, self._late = first, last, surfaces, before, late

    def __call__(self, part: float) -> Inputs:
        return self._first.between(self._last, part)._replace(
            delta_a=self._surface(0, part), delta_r=self._surface(1, part)
        )

    def _surface(self, which: int, part: float) -> Array:
        """(models, flights)."""
        curve, late = self._surfaces[which], self._late[which][:, 0]
        found = np.tile(curve.at(part), (late.size, 1))
        before = None if self._before is None else self._before[which]
        for model in np.flatnonzero(late):
            at = part - float(late[model])
            if at >= 0.0:
                found[model] = curve.at(at)
            else:
                found[model] = curve.first if before is None else before.at(max(1.0 + at * curve.h / before.h, 0.0))
        return found
