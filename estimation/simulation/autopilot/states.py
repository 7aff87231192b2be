"""States in which an exported aircraft is held against its model: the same at every call."""

import math

import numpy as np

from daq.contract.constants import GRAVITY, SEA_LEVEL_DENSITY
from estimation.simulation.autopilot.linear import FlightStates, LinearAircraft
from estimation.simulation.oracle import SURFACES

STATES = 200
SEED = 20261127
ALPHAS = (-0.1, 0.2)  # rad: where a linear aircraft flies
SIZES = {"beta": 0.2, "p": 1.0, "q": 0.6, "r": 0.6}  # rad, rad/s
DEFLECTION = 0.3  # rad, where the throw is not less
CRUISE = 0.4  # lift coefficient of the speed about which states are taken
SPEEDS = (0.7, 1.8)  # of that


def random_motion(
    craft: LinearAircraft, alphas: tuple[float, float] = ALPHAS, rho: float = SEA_LEVEL_DENSITY, count: int = STATES
) -> FlightStates:
    """States in which the aircraft may fly; rho [kg/m3] and the range of angle of attack [rad] are given."""
    rng, aircraft = np.random.default_rng(SEED), craft.aircraft
    cruise = math.sqrt(2.0 * aircraft.mass * GRAVITY / (SEA_LEVEL_DENSITY * aircraft.area * CRUISE))
    values = {n: rng.uniform(-size, size, count) for n, size in SIZES.items()}
    for name in SURFACES:
        least, greatest = craft.throws.get(name, (-DEFLECTION, DEFLECTION))
        values[name] = rng.uniform(max(least, -DEFLECTION), min(greatest, DEFLECTION), count)
    values["V"], values["alpha"] = cruise * rng.uniform(*SPEEDS, count), rng.uniform(*alphas, count)
    values["rho"] = np.full(count, rho)
    return FlightStates(values)
