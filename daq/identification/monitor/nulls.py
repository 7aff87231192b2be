"""Simulated flights of a model, and what the monitor's statistics do on them while nothing is wrong.

Each flight is another aircraft within what the model states of its own errors; hands fly multi-steps, air and instruments are
as configured; scans are those of the aircraft's grid, all of them or those that a radio delivers.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from daq.identification.airframe import Airframe
from daq.identification.monitor.bank import LATERAL_PLANE, MonitoredEffect, MonitoredPlane
from daq.identification.monitor.motions import (
    AnyInputs,
    ElevatorInputs,
    Inputs,
    LateralMotion,
    PitchMotion,
    between,
    instants,
    motion_of,
)
from daq.identification.monitor.predictors import FlightsScan
from daq.utilities.constants import GRAVITY

Array = NDArray[np.float64]

LEVEL_BANK, LEVEL_RATE = (
    0.15,
    0.05,
)  # rad of aileron per rad of bank and per rad/s of roll: a pilot keeps the wings level
HOLD_PITCH, HOLD_RATE = 0.25, 0.05
"""rad of elevator per rad of attitude and per rad/s of pitching: a pilot holds his attitude."""
DENSITY = 1.2  # kg/m3
GUST_TIME = 1.0  # s, correlation time of gusts: some 17 m
UPWARD, UPWARD_LENGTH, ROLLING = 0.7, 30.0, 1.9
"""Gusts upwards as a share of those from the side, and their length [m], near the ground; rolling gusts are that many times them
over the root of length and span, and last 4 / pi spans (MIL-F-8785C). Without them rolling gusts looked like `Cl_r`."""
NO_LAG = 0.035  # s, servo where the aircraft states none
GRID_S, FINEST_S = 0.05, 0.045
"""Seconds between scans that are looked at; of those closer than the second some are left out: at 100 Hz the constant `Cl_0` had
a wrong name first in two of three, and costs are five times those at 20 Hz."""


@dataclass(frozen=True)
class NullConditions:
    """Air and instruments, one standard deviation [SI, rad]; rate: scans a second that are seen, of those that are `grid` seconds
    apart on board; loss: share of them lost.

    gust_spread: factors between which each flight's gusts are drawn, evenly in their logarithm: air is not always the usual one.
    """

    beta: float = math.radians(0.25)
    p: float = math.radians(0.4)
    r: float = math.radians(0.3)
    phi: float = math.radians(0.3)
    ay: float = 0.05
    alpha: float = math.radians(0.3)
    q: float = math.radians(0.4)
    theta: float = math.radians(0.3)
    ax: float = 0.05
    az: float = 0.08
    surface: float = math.radians(0.07)
    V: float = 0.15
    gust: float = math.radians(0.15)
    gust_spread: tuple[float, float] = (0.5, 4.0)
    speed: float = 16.5
    speed_spread: float = 1.0
    rate: float = 20.0
    loss: float = 0.0
    grid: float = 0.05


NEARLY = 0.9  # of that step, from which a scan is the next one: times are not exact


def watched_step(step: float) -> float:
    """Seconds between scans that are looked at, of an even record with so many between all."""
    return step * max(1, round(GRID_S / step)) if step < FINEST_S else step


PEAKS: Mapping[str, tuple[tuple[float, float], ...]] = {
    "lateral": ((3.0, 7.0), (2.0, 4.5)),  # of aileron and rudder
    "longitudinal": ((1.5, 4.0),),  # of the elevator
}
"""Between which hands fly the controls of a plane [deg]."""

Change = Callable[[float, dict[str, Array]], None]
"""Called at each step with the time [s] and the values flown with, which it may change: a sudden failure."""


def fly(
    airframe: Airframe,
    values: Mapping[str, float],
    effects: Sequence[MonitoredEffect],
    conditions: NullConditions,
    rng: np.random.Generator,
    flights: int,
    seconds: float,
    change: Change | None = None,
    plane: MonitoredPlane = LATERAL_PLANE,
) -> list[FlightsScan]:
    """Scans of so many flights at once; those of a link are the same ones for all of them. Raises ValueError for an aircraft that
    cannot fly level by these values."""
    truth = {
        e.name: values.get(e.name, 0.0) + e.prior * rng.standard_normal((1, flights)) for e in effects if e.prior > 0.0
    }
    truth |= {n: np.zeros((1, flights)) for n in plane.parameters if n not in truth}
    step = conditions.grid / 2.0
    steps = round(seconds / step)
    lowest_factor, highest_factor = conditions.gust_spread
    gusts = conditions.gust * np.exp(rng.uniform(math.log(lowest_factor), math.log(highest_factor), flights))
    commands = _hands(rng, flights, steps, step, PEAKS[plane.name])
    speed = conditions.speed + conditions.speed_spread * rng.uniform(-1.0, 1.0, flights)
    lag = NO_LAG if airframe.servo_lag is None else airframe.servo_lag
    fade, gust_fade = math.exp(-step / lag), math.exp(-step / GUST_TIME)
    pilot = _Leveller(speed) if plane.name == LATERAL_PLANE.name else _PitchHolder(airframe, truth, speed)
    rolling_gusts = ROLLING * UPWARD * gusts * speed / math.sqrt(UPWARD_LENGTH * airframe.span)
    rolling_fade = np.exp(-step * math.pi * speed / (4.0 * airframe.span))
    x, surfaces, gust, rolling = pilot.state, pilot.surfaces, np.zeros(flights), np.zeros(flights)
    arrives = _seen(conditions, rng, round(seconds / conditions.grid))
    scans: list[FlightsScan] = []
    motion, parts = motion_of(plane, airframe, truth), instants(step)
    for k in range(steps):
        time = k * step
        if change is not None:
            change(time, truth)
            motion = motion_of(plane, airframe, truth)
        inputs = pilot.inputs(x, surfaces)
        if k % 2 == 0 and arrives[k // 2]:
            scans.append(_scan(time, x, inputs, motion, gust, conditions, rng, plane))
        command = pilot.command(commands[k], x)
        next_surfaces = command + (surfaces - command) * fade
        driven = between(inputs, pilot.inputs(x, next_surfaces), parts)  # type: ignore[type-var]  # of the same plane
        x = motion.advance(x, driven, step, gust, rolling)  # type: ignore[arg-type]
        surfaces = next_surfaces
        gust = gust * gust_fade + gusts * math.sqrt(1.0 - gust_fade**2) * rng.standard_normal(flights)
        stirred = rolling_gusts * np.sqrt(1.0 - rolling_fade**2) * rng.standard_normal(flights)
        rolling = rolling * rolling_fade + stirred
    return scans


class _Leveller:
    """Keeps the wings level, at constant airspeed. state: (4, 1, flights) and surfaces (2, flights) at the begin."""

    def __init__(self, speed: Array) -> None:
        self._speed, self._mass = speed, np.ones_like(speed)
        self.state, self.surfaces = np.zeros((4, 1, speed.size)), np.zeros((2, speed.size))

    def inputs(self, x: Array, moved: Array) -> AnyInputs:
        """The pitch rate of the turn that the bank makes, attitude held."""
        phi = x[3, 0]
        q = GRAVITY / self._speed * np.sin(phi) * np.tan(phi)
        flat = np.full_like(self._speed, 0.08)  # rad of angle of attack and attitude
        return Inputs(q, flat, flat, self._speed, np.full_like(self._speed, DENSITY), moved[0], moved[1], self._mass)

    def command(self, hands: Array, x: Array) -> Array:
        return np.asarray(hands + np.stack([LEVEL_BANK * x[3, 0] + LEVEL_RATE * x[1, 0], np.zeros(self._speed.size)]))


class _PitchHolder:
    """Holds the attitude of level flight, at constant airspeed and the thrust that this needs."""

    def __init__(self, airframe: Airframe, truth: Mapping[str, Array], speed: Array) -> None:
        d, pressure = {n: v[0] for n, v in truth.items()}, 0.5 * DENSITY * speed**2 * airframe.area
        with np.errstate(divide="ignore", invalid="ignore"):
            CL = airframe.mass * GRAVITY / pressure
            # lift and moment of level flight, both linear in angle of attack and elevator
            moment, lift = -d["Cm_0"], CL - d["CL_0"]
            determinant = d["CL_alpha"] * d["Cm_de"] - d["Cm_alpha"] * d["CL_de"]
            alpha = (lift * d["Cm_de"] - moment * d["CL_de"]) / determinant
            elevator = (moment * d["CL_alpha"] - lift * d["Cm_alpha"]) / determinant
        if not np.all(np.isfinite(alpha) & np.isfinite(elevator)):
            raise ValueError("lift and elevator cannot hold level flight")
        self._speed, self._alpha, self._elevator, self._mass = speed, alpha, elevator, np.ones_like(speed)
        self._thrust = pressure * (d["CD_0"] + d["CD_k"] * CL**2) / np.cos(alpha)
        self.state = np.stack([alpha, np.zeros_like(alpha), alpha])[:, None]
        self.surfaces = elevator[None]

    def inputs(self, x: Array, moved: Array) -> AnyInputs:
        """Wings level."""
        zero = np.zeros_like(self._speed)
        density = np.full_like(self._speed, DENSITY)
        return ElevatorInputs(zero, zero, zero, zero, self._speed, density, self._thrust, moved[0], self._mass)

    def command(self, hands: Array, x: Array) -> Array:
        return np.asarray(hands + self._elevator + HOLD_PITCH * (x[2, 0] - self._alpha) + HOLD_RATE * x[1, 0])


def _scan(
    time: float,
    x: Array,
    now: AnyInputs,
    motion: LateralMotion | PitchMotion,
    gust: Array,
    c: NullConditions,
    rng: np.random.Generator,
    plane: MonitoredPlane,
) -> FlightsScan:
    forces = motion.forces(x, now, gust)[:, 0]  # type: ignore[arg-type]  # inputs of the same plane
    truth = np.concatenate([(x[0, 0] + gust)[None], x[1:, 0], forces])
    levels = np.array([getattr(c, channel) for channel in plane.channels])[:, None]
    measured = truth + levels * rng.standard_normal(truth.shape)
    noise = {"V": c.V, **dict.fromkeys(plane.surfaces, c.surface)}
    seen = {n: getattr(now, n) + level * rng.standard_normal(now.V.shape) for n, level in noise.items()}
    return FlightsScan(time, measured, now._replace(**seen))


def _seen(c: NullConditions, rng: np.random.Generator, count: int) -> NDArray[np.bool_]:
    """Which scans of the grid arrive."""
    transmitted = np.diff(np.floor(np.arange(count + 1) * min(1.0, c.rate * c.grid)), prepend=-1.0)[: count + 1] > 0
    return np.asarray(transmitted & (rng.uniform(size=count + 1) >= c.loss))


def _hands(
    rng: np.random.Generator, flights: int, steps: int, step: float, peaks: Sequence[tuple[float, float]]
) -> Array:
    """(steps, controls, flights) what hands ask for [rad]: now and then a few steps of one of the controls. peaks [deg]."""
    commands = np.zeros((steps, len(peaks), flights))
    for flight in range(flights):
        start = round(rng.uniform(0.5, 2.0) / step)
        while start < steps:
            control = int(rng.integers(len(peaks)))
            peak = math.radians(rng.uniform(*peaks[control]))
            sign = float(rng.choice([-1.0, 1.0]))
            for _ in range(int(rng.integers(2, 5))):
                length = round(rng.uniform(0.3, 0.9) / step)
                commands[start : start + length, control, flight] = sign * peak
                sign, start = -sign, start + length
            start += round(rng.uniform(0.8, 3.0) / step)
    return commands
