"""Simulated flights of a model, and what the monitor's statistics do on them while nothing is wrong.

Each flight is another aircraft within what the model states of its own errors; hands fly multi-steps, air and instruments are
as configured; scans are those of the aircraft's grid, all of them or those that a radio delivers.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from daq.identification.airframe import Airframe
from daq.identification.monitor.bank import MonitoredEffect
from daq.identification.monitor.predictors import FlightsScan, Inputs, LateralMotion
from daq.utilities.constants import GRAVITY

Array = NDArray[np.float64]

LEVEL_BANK, LEVEL_RATE = (
    0.15,
    0.05,
)  # rad of aileron per rad of bank and per rad/s of roll: a pilot keeps the wings level
GUST_TIME = 1.0  # s, correlation time of gusts: some 17 m
NO_LAG = 0.035  # s, servo where the aircraft states none


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
    surface: float = math.radians(0.07)
    V: float = 0.15
    gust: float = math.radians(0.15)
    gust_spread: tuple[float, float] = (0.5, 4.0)
    speed: float = 16.5
    speed_spread: float = 1.0
    rate: float = 20.0
    loss: float = 0.0
    grid: float = 0.05


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
) -> list[FlightsScan]:
    """Scans of so many flights at once; those of a link are the same ones for all of them."""
    truth = {
        e.name: values.get(e.name, 0.0) + e.prior * rng.standard_normal((1, flights)) for e in effects if e.prior > 0.0
    }
    truth |= {n: np.zeros((1, flights)) for n in ("Cn_da", "CY_da")}
    step = conditions.grid / 2.0
    steps = round(seconds / step)
    lowest_factor, highest_factor = conditions.gust_spread
    gusts = conditions.gust * np.exp(rng.uniform(math.log(lowest_factor), math.log(highest_factor), flights))
    commands = _hands(rng, flights, steps, step)
    speed = conditions.speed + conditions.speed_spread * rng.uniform(-1.0, 1.0, flights)
    lag = NO_LAG if airframe.servo_lag is None else airframe.servo_lag
    fade, gust_fade = math.exp(-step / lag), math.exp(-step / GUST_TIME)
    x = np.zeros((4, 1, flights))
    surfaces, gust = np.zeros((2, flights)), np.zeros(flights)
    arrives = _seen(conditions, rng, round(seconds / conditions.grid))
    scans: list[FlightsScan] = []
    motion = LateralMotion(airframe, truth)
    for k in range(steps):
        time = k * step
        if change is not None:
            change(time, truth)
            motion = LateralMotion(airframe, truth)
        inputs = _inputs(x, surfaces, speed)
        if k % 2 == 0 and arrives[k // 2]:
            scans.append(_scan(time, x, inputs, motion, gust, conditions, rng))
        command = commands[k] + np.stack([LEVEL_BANK * x[3, 0] + LEVEL_RATE * x[1, 0], np.zeros(flights)])
        next_surfaces = command + (surfaces - command) * fade
        x = motion.advance(x, partial(inputs.between, _inputs(x, next_surfaces, speed)), step, gust)
        surfaces = next_surfaces
        gust = gust * gust_fade + gusts * math.sqrt(1.0 - gust_fade**2) * rng.standard_normal(flights)
    return scans


def _inputs(x: Array, moved: Array, speed: Array) -> Inputs:
    """Level flight at constant airspeed: the pitch rate of the turn that the bank makes, attitude held."""
    phi = x[3, 0]
    q = GRAVITY / speed * np.sin(phi) * np.tan(phi)
    flat = np.full_like(speed, 0.08)  # rad of angle of attack and attitude
    return Inputs(q, flat, flat, speed, np.full_like(speed, 1.2), moved[0], moved[1])


def _scan(
    time: float, x: Array, now: Inputs, motion: LateralMotion, gust: Array, c: NullConditions, rng: np.random.Generator
) -> FlightsScan:
    truth = np.stack([x[0, 0] + gust, x[1, 0], x[2, 0], x[3, 0], motion.side_force(x, now, gust)[0]])
    levels = np.array([c.beta, c.p, c.r, c.phi, c.ay])[:, None]
    measured = truth + levels * rng.standard_normal(truth.shape)
    noisy = now._replace(
        V=now.V + c.V * rng.standard_normal(now.V.shape),
        delta_a=now.delta_a + c.surface * rng.standard_normal(now.V.shape),
        delta_r=now.delta_r + c.surface * rng.standard_normal(now.V.shape),
    )
    return FlightsScan(time, measured, noisy)


def _seen(c: NullConditions, rng: np.random.Generator, count: int) -> NDArray[np.bool_]:
    """Which scans of the grid arrive."""
    transmitted = np.diff(np.floor(np.arange(count + 1) * min(1.0, c.rate * c.grid)), prepend=-1.0)[: count + 1] > 0
    return np.asarray(transmitted & (rng.uniform(size=count + 1) >= c.loss))


def _hands(rng: np.random.Generator, flights: int, steps: int, step: float) -> Array:
    """(steps, 2, flights) what hands ask for [rad]: now and then a few steps of aileron or rudder."""
    commands = np.zeros((steps, 2, flights))
    for flight in range(flights):
        start = round(rng.uniform(0.5, 2.0) / step)
        while start < steps:
            control = int(rng.integers(2))
            peak = math.radians(rng.uniform(3.0, 7.0) if control == 0 else rng.uniform(2.0, 4.5))
            sign = float(rng.choice([-1.0, 1.0]))
            for _ in range(int(rng.integers(2, 5))):
                length = round(rng.uniform(0.3, 0.9) / step)
                commands[start : start + length, control, flight] = sign * peak
                sign, start = -sign, start + length
            start += round(rng.uniform(0.8, 3.0) / step)
    return commands
