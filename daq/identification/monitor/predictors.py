"""Innovations of the model, and of the model with each effect of the bank in.

All predictors run side by side: x <- x + K (z - y) at each scan, with the same K. What a predictor with an effect says otherwise
than the model without is the effect's signature: as the aircraft had it, the model's innovations would hold that.
A scan is looked at when the next one has come, which tells what the surfaces did on the way to it.

Arrays are as in `motions`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from daq.identification.airframe import Airframe
from daq.identification.monitor.bank import LATERAL_PLANE, MonitoredEffect, MonitoredPlane
from daq.identification.monitor.evidence import ORDER
from daq.identification.monitor.motions import AnyInputs, between, instants, motion_of
from daq.identification.monitor.surfaces import BLIND, Kinds, SurfaceBetween, SurfacesBetween, kind_of

Array = NDArray[np.float64]
GAIN = 0.3  # of the states towards what is measured in GAIN_S or more; more forgets what an effect has done
GAIN_S = 0.05  # s
SLOWEST_LAG = 1e-3  # s; a vane's lag is at least that, for an exponential's sake


class FlightsScan:
    """One scan of several flights at once. time [s]; measured: (5, flights) of the plane's channels; inputs: the rest."""

    __slots__ = ("inputs", "measured", "time")

    def __init__(self, time: float, measured: Array, inputs: AnyInputs) -> None:
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

    def __init__(
        self,
        airframe: Airframe,
        values: Mapping[str, float],
        effects: Sequence[MonitoredEffect],
        plane: MonitoredPlane = LATERAL_PLANE,
    ) -> None:
        self._effects = tuple(effects)
        self._plane = plane
        models, vane = 1 + len(effects), plane.channels[0]
        table = {n: np.full((models, 1), values.get(n, 0.0)) for n in plane.parameters}
        self._delays = [np.zeros((models, 1)) for _ in plane.delays]
        self._vane_lag, self._vane_bias = np.zeros((models, 1)), np.zeros((models, 1))
        places = {
            **dict(zip(plane.delays, self._delays, strict=True)),
            f"{vane}_lag": self._vane_lag,
            f"{vane}_bias": self._vane_bias,
        }
        for k, effect in enumerate(effects, start=1):
            for name, change in (effect.moves or {effect.name: effect.step}).items():
                (table[name] if name in table else places[name])[k, 0] += change
        self._motion = motion_of(plane, airframe, table)
        self._scans: list[FlightsScan] = []  # the last three
        self._surfaces = [SurfacesBetween(airframe.servo_lag) for _ in plane.surfaces]
        self._between: tuple[SurfaceBetween, ...] | None = None
        self._blind = np.zeros(0, dtype=np.intp)  # scans for which a flight says nothing yet
        self._x = self._vane = np.zeros(0)

    def restart(self) -> None:
        """Nothing leads over from before."""
        self._scans.clear()
        self._between = None
        for surface in self._surfaces:
            surface.restart()

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
        u = self._driven(last.inputs, scan_now.inputs, surfaces, surfaces_before, dt)
        x = self._motion.advance(self._x, u, dt)  # type: ignore[arg-type]  # inputs of the same plane
        lag = np.maximum(self._vane_lag, SLOWEST_LAG)
        fade = np.where(self._vane_lag > 0.0, np.exp(-dt / lag), 0.0)
        mean_slope = (x[0] - self._x[0]) / dt
        # a first-order lag shown a ramp from x0 to x1, exactly
        vane = x[0] - lag * mean_slope * (1.0 - fade) + (self._vane - self._x[0]) * fade
        vane = np.where(self._vane_lag > 0.0, vane, x[0])
        forces = self._motion.forces(x, type(u)(*(a[-1] for a in u)))  # type: ignore[arg-type]
        predicted = np.concatenate([(vane + self._vane_bias)[None], x[1:], forces])
        innovations = scan_now.measured[:, None, :] - predicted
        gain = 1.0 - (1.0 - GAIN) ** min(1.0, dt / GAIN_S)  # as much in the same time where scans are faster
        self._vane = vane + gain * innovations[0]
        self._x = x + gain * innovations[: len(x)]
        kind = kind_of(dt, surfaces, surfaces_before)
        self._restart_where(kind == BLIND, scan_now)
        kind = np.where(self._blind > 0, BLIND, kind)
        return Innovation(scan_now.time, innovations[:, 0], innovations[:, :1] - innovations[:, 1:], kind)

    def _surfaces_between(
        self, scans: tuple[FlightsScan, FlightsScan, FlightsScan, FlightsScan]
    ) -> tuple[SurfaceBetween, ...]:
        """Each surface between the middle two."""
        t0, t1, t2, t3 = (s.time for s in scans)
        return tuple(
            surface.middle((t0, t1, t2, t3), tuple(getattr(s.inputs, name) for s in scans))  # type: ignore[arg-type]
            for surface, name in zip(self._surfaces, self._plane.surfaces, strict=True)
        )

    def _driven(
        self,
        first: AnyInputs,
        last: AnyInputs,
        surfaces: Sequence[SurfaceBetween],
        before: Sequence[SurfaceBetween] | None,
        dt: float,
    ) -> AnyInputs:
        """Inputs at the instants of an interval, surfaces as late as each model has them: (instants, models, flights)."""
        parts = instants(dt)
        moved = {
            name: _late(surface, None if before is None else before[k], parts, self._delays[k] / dt)
            for k, (name, surface) in enumerate(zip(self._plane.surfaces, surfaces, strict=True))
        }
        return between(first, last, parts)._replace(**moved)  # type: ignore[type-var, arg-type]

    def _begin(self, scan: FlightsScan) -> None:
        models = len(self._effects) + 1
        states = self._plane.states
        shape = (states, models, scan.measured.shape[1])
        self._x = np.broadcast_to(scan.measured[:states, None, :], shape).copy()
        self._x[0] -= self._vane_bias  # a vane that has slipped shows so much more than there is
        self._vane = self._x[0].copy()
        self._blind = np.zeros(shape[2], dtype=np.intp)

    def _restart_where(self, blind: NDArray[np.bool_], scan: FlightsScan) -> None:
        """Flights whose prediction says nothing begin again at what is measured."""
        self._blind = np.where(blind, 1 + ORDER, np.maximum(self._blind - 1, 0))
        if blind.any():
            self._x[:, :, blind] = scan.measured[: self._plane.states, None, blind]
            self._x[0][:, blind] -= self._vane_bias
            self._vane[:, blind] = self._x[0][:, blind]


def _late(curve: SurfaceBetween, before: SurfaceBetween | None, parts: Array, late: Array) -> Array:
    """(instants, models, flights) of a surface that each model has `late` (models, 1) parts of the interval later."""
    deflections = np.repeat(curve.at(parts), late.size, axis=1)
    delayed = np.flatnonzero(late)
    if delayed.size:
        part = parts - late[delayed]
        earlier = curve.first if before is None else before.at(np.clip(1.0 + part * curve.h / before.h, 0.0, 1.0))
        deflections[:, delayed] = np.where(part >= 0.0, curve.at(np.maximum(part, 0.0)), earlier)
    return deflections
