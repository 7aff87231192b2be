"""Aircraft for the physics tests, built without pilot, gusts or settling."""

import numpy as np

from estimation.aircraft import load_aircraft
from firmware_sim.physics.aerodynamics import true_derivatives
from firmware_sim.physics.atmosphere import Site
from firmware_sim.physics.effects.base import HiddenEffect
from firmware_sim.physics.maths import FLOATS, State
from firmware_sim.physics.motion import Motion
from firmware_sim.physics.plant import ARMS, ATTITUDE, POSITION, THRUST, Commands, Plant
from firmware_sim.physics.trim import Trim, level_trim

QUIET = [0.0] * 4


def plain_plant(*effects: HiddenEffect, **derivatives: float) -> Plant:
    """The CDFP in still air; `derivatives` override the truth."""
    aircraft = load_aircraft("cdfp")
    return Plant(
        aircraft,
        true_derivatives(aircraft, derivatives),
        Site(),
        FLOATS,
        effects=effects,
        generators=[np.random.default_rng(5)],
    )


def no_air(plant: Plant) -> Plant:
    """The same aircraft without any aerodynamic force."""
    for name in plant.derivatives:
        plant.aero.__dict__[name] = 0.0
    return plant


def level_state(plant: Plant, speed: float = 17.0, height: float = 60.0) -> tuple[State, Commands, Trim]:
    """Trimmed level flight to the north, and the commands that hold it."""
    trim = level_trim(plant, speed, height)
    x = [0.0] * plant.size
    x[0], x[2] = speed * float(np.cos(trim.alpha)), speed * float(np.sin(trim.alpha))
    x[ATTITUDE], x[ATTITUDE + 2] = float(np.cos(trim.alpha / 2)), float(np.sin(trim.alpha / 2))
    x[POSITION + 2] = -height
    x[ARMS] = x[ARMS + 1] = trim.elevator
    x[THRUST] = trim.thrust
    return x, Commands(trim.elevator, trim.elevator, 0.0, trim.thrust / plant.thrust_available(speed)), trim


def motion_of(plant: Plant, x: State, commands: Commands) -> tuple[Motion, State]:
    """Motion and state rates at one instant."""
    dx = [0.0] * plant.size
    return plant.evaluate(0.0, x, commands, QUIET, dx), dx


def fly(plant: Plant, x: State, commands: Commands, seconds: float, step: float = 0.005) -> State:
    """The state after `seconds` with the commands held."""
    for k in range(round(seconds / step)):
        x = plant.step(k * step, x, commands, QUIET, step)
    return x
