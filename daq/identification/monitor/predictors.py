"""Innovations of the model, and of the model with each effect of the bank in.

All predictors run side by side: x <- x + K (z - y) at each scan, with the same K. What a predictor with an effect says otherwise
than the model without is the effect's signature: as the aircraft had it, the model's innovations would hold that.
A scan is looked at when the next one has come, which tells what the surfaces did on the way to it.

Every quantity is an array that broadcasts to (models, flights): one model for the simulated flights, one for each effect of the
bank where the signatures are made. SI, rad.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from daq.identification.airframe import DERIVATIVES, Airframe
from daq.identification.monitor.bank import MonitoredEffect
from daq.identification.monitor.evidence import ORDER
from daq.identification.monitor.surfaces import BLIND, Kinds, Pair, SurfacesBetween, kind_of
from daq.utilities.constants import GRAVITY

Array = NDArray[np.float64]
LONGEST_STEP = 0.026  # s; as in `simulated_motion`


class Inputs(NamedTuple):
    """What is measured, (flights,) each: pitch rate, attitude, angle of attack, airspeed, density, surfaces."""

    q: Array
    theta: Array
    alpha: Array
    V: Array
    rho: Array
    delta_a: Array
    delta_r: Array

    def between(self, other: "Inputs", part: float) -> "Inputs":
        """On the straight line to another."""
        return Inputs(*(a + part * (b - a) for a, b in zip(self, other, strict=True)))


class LateralMotion:
    """Rates of beta, p, r, phi and the side force. values: derivative -> array, `DERIVATIVES` and perhaps Cn_da, CY_da."""

    def __init__(self, airframe: Airframe, values: Mapping[str, Array]) -> None:
        self._a = airframe
        zero = np.zeros(1)
        self._d = {n: np.asarray(values.get(n, zero), float) for n in (*DERIVATIVES, "Cn_da", "CY_da")}
        self._inertia = airframe.Ixx * airframe.Izz - airframe.Ixz**2

    def side_force(self, x: Array, u: Inputs, gust: Array | float = 0.0) -> Array:
        """Specific force ay [m/s2]. x: (4, models, flights); gust: sideslip that the air adds [rad]."""
        d, rate = self._d, self._a.span / (2.0 * u.V)
        CY = d["CY_0"] + d["CY_beta"] * (x[0] + gust) + rate * (d["CY_p"] * x[1] + d["CY_r"] * x[2])
        CY = CY + d["CY_dr"] * u.delta_r + d["CY_da"] * u.delta_a
        return np.asarray(0.5 * u.rho * u.V**2 * self._a.area / self._a.mass * CY)

    def rates(self, x: Array, u: Inputs, gust: Array | float = 0.0) -> Array:
        """(4, models, flights) of the state's rates."""
        a, d = self._a, self._d
        beta, p, r, phi = x
        rate = a.span / (2.0 * u.V)
        q_sb = 0.5 * u.rho * u.V**2 * a.area * a.span
        air = beta + gust
        Cl = d["Cl_0"] + d["Cl_beta"] * air + rate * (d["Cl_p"] * p + d["Cl_r"] * r)
        Cl = Cl + d["Cl_da"] * u.delta_a + d["Cl_dr"] * u.delta_r
        Cn = d["Cn_0"] + d["Cn_beta"] * air + rate * (d["Cn_p"] * p + d["Cn_r"] * r)
        Cn = Cn + d["Cn_dr"] * u.delta_r + d["Cn_da"] * u.delta_a
        roll = q_sb * Cl + a.Ixz * p * u.q - (a.Izz - a.Iyy) * u.q * r
        yaw = q_sb * Cn - a.Ixz * u.q * r - (a.Iyy - a.Ixx) * p * u.q
        side = self.side_force(x, u, gust) + GRAVITY * np.cos(u.theta) * np.sin(phi)
        return np.stack(
            np.broadcast_arrays(
                p * np.sin(u.alpha) - r * np.cos(u.alpha) + side / u.V,
                (a.Izz * roll + a.Ixz * yaw) / self._inertia,
                (a.Ixx * yaw + a.Ixz * roll) / self._inertia,
                p + np.tan(u.theta) * (u.q * np.sin(phi) + r * np.cos(phi)),
            )
        )

    def advance(self, x: Array, drive: Callable[[float], Inputs], dt: float, gust: Array | float = 0.0) -> Array:
        """The state `dt` seconds later: classical Runge-Kutta. drive: inputs where a part of the interval has passed."""
        steps = max(1, math.ceil(dt / LONGEST_STEP))
        h = dt / steps
        u2 = drive(0.0)
        for k in range(steps):
            u0, u1, u2 = u2, drive((k + 0.5) / steps), drive((k + 1.0) / steps)
            k1 = self.rates(x, u0, gust)
            k2 = self.rates(x + 0.5 * h * k1, u1, gust)
            k3 = self.rates(x + 0.5 * h * k2, u1, gust)
            k4 = self.rates(x + h * k3, u2, gust)
            x = x + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
        return x


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
        earlier, last, scan_now, following = (self._scans[0], *self._scans)[-4:]
        del self._scans[:-3]
        dt = scan_now.time - last.time
        surfaces_before, surfaces = self._between, self._surfaces_between((earlier, last, scan_now, following))
        self._between = surfaces
        drive = _Drive(
            last.inputs, scan_now.inputs, surfaces, surfaces_before, (self._delay_a / dt, self._delay_r / dt)
        )
        x = self._motion.advance(self._x, drive, dt)
        lag = np.maximum(self._vane_lag, SLOWEST_LAG)
        fade = np.where(self._vane_lag > 0.0, np.exp(-dt / lag), 0.0)
        mean_slope = (x[0] - self._x[0]) / dt
        # a first-order lag shown a ramp from x0 to x1, exactly
        vane = x[0] - lag * mean_slope * (1.0 - fade) + (self._vane - self._x[0]) * fade
        vane = np.where(self._vane_lag > 0.0, vane, x[0])
        predicted = np.stack([vane + self._vane_bias, x[1], x[2], x[3], self._motion.side_force(x, drive(1.0))])
        innovations = scan_now.measured[:, None, :] - predicted
        self._vane = vane + GAIN * innovations[0]
        self._x = x + GAIN * innovations[:4]
        kind = kind_of(dt, surfaces, surfaces_before)
        self._restart_where(kind == BLIND, scan_now)
        kind = np.where(self._blind > 0, BLIND, kind)
        return Innovation(scan_now.time, innovations[:, 0], innovations[:, :1] - innovations[:, 1:], kind)

    def _surfaces_between(self, scans: tuple[FlightsScan, FlightsScan, FlightsScan, FlightsScan]) -> Pair:
        """Aileron and rudder between the middle two."""
        t0, t1, t2, t3 = (s.time for s in scans)
        a, b, c, d = (s.inputs for s in scans)
        return (
            self._aileron.middle((t0, t1, t2, t3), (a.delta_a, b.delta_a, c.delta_a, d.delta_a)),
            self._rudder.middle((t0, t1, t2, t3), (a.delta_r, b.delta_r, c.delta_r, d.delta_r)),
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
        curve, delays = self._surfaces[which], self._late[which][:, 0]
        deflections = np.tile(curve.at(part), (delays.size, 1))
        curve_before = None if self._before is None else self._before[which]
        for model in np.flatnonzero(delays):
            delayed_part = part - float(delays[model])
            if delayed_part >= 0.0:
                deflections[model] = curve.at(delayed_part)
            else:
                deflections[model] = (
                    curve.first
                    if curve_before is None
                    else curve_before.at(max(1.0 + delayed_part * curve.h / curve_before.h, 0.0))
                )
        return deflections
